"""`palmfield bench skin`: its numbers against what is known, and its report."""

from pathlib import Path

import pytest

from palmfield.errors import OutputError, PalmfieldError
from palmfield.studies.bench import skin
from palmfield.studies.bench.skin_case import CASE


def test_our_row_holds_the_true_error_and_the_stated_one() -> None:
    row = skin.own(CASE, "lateral_waves", 0.01, "cpu", 1)
    assert row.static is not None and row.moving is not None and row.stated is not None
    assert row.worst < 0.01 and row.stated < 0.01
    assert row.seconds > 0.0


def test_report_and_picture(tmp_path: Path) -> None:
    rows = [
        skin.SkinRow("palmfield lateral_waves", "target 0.1", 0.3, 0.004, 0.007, 0.005),
        skin.SkinRow("scikit-fem, quadratic", "4 cells", missing="not here"),
        skin.SkinRow("MuJoCo flex, trilinear", "8 cells", 3.8, 0.53, None),
    ]
    picture = tmp_path / "skin.png"
    skin.draw([row for row in rows if not row.missing], picture)
    assert picture.stat().st_size > 5000
    text = skin.as_markdown(rows, "cpu", 0.04, "abc", picture, tmp_path / "skin.md")
    assert "| palmfield lateral_waves | target 0.1 | 0.3 | 0.4 % | 0.7 % | 0.5 % |" in text
    assert "not run: not here" in text and "![Time against error](skin.png)" in text


def test_bad_options_are_refused_before_measuring(tmp_path: Path) -> None:
    with pytest.raises(PalmfieldError, match="--only 'magic' matches no method"):
        skin.main(only="magic")
    with pytest.raises(PalmfieldError, match="--runs has value 0"):
        skin.main(runs=0)
    with pytest.raises(OutputError):
        skin.main(out=Path("/proc/no/table.md"), only="lateral_waves")
