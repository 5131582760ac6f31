"""Speed against error, drawn of reports that the benchmarks wrote."""

import sys

import numpy as np
import pytest

from palmfield.cli.app import main
from palmfield.errors import OutputError
from palmfield.studies.bench import field, skin, table
from palmfield.studies.bench.read_table import speed_picture

HEAD = table.Head("command", "abc", "processor", "CPU", 0.04, 2.0, 5, 996, (100,), "")
SKIN_ROWS = [
    skin.SkinRow("one", "target 0.1", 0.359, 0.0043, 0.0068, 0.0081),
    skin.SkinRow("one", "target 0.01", 1.35, 0.0038, 0.0073, None),
    skin.SkinRow("still", "4 cells", 0.428, 0.77, None, None),
    skin.SkinRow("absent", "4 cells", missing="it is not installed"),
]


def test_the_points_of_the_skin_are_those_that_were_measured(tmp_path):
    path = tmp_path / "skin.md"
    path.write_text(skin.as_markdown(SKIN_ROWS, "cpu", 0.04, "abc", None, path))
    one, still = speed_picture(path).axes[0].get_lines()
    np.testing.assert_allclose(one.get_xydata(), [[0.68, 0.359], [0.73, 1.35]])
    np.testing.assert_allclose(still.get_xydata(), [[77.0, 0.428]])
    assert (one.get_label(), still.get_label()) == ("one", "still")


def test_the_points_of_the_field_are_those_that_were_measured(tmp_path):
    rows = [
        table.FieldRow("fast", "piston", "near", clock_s=0.01, pairs_per_s=2e9, pairs_per_core_s=1e9, error=1.5e-5),
        table.FieldRow("card", "sphere", "near", clock_s=0.01, pairs_per_s=5e9, error=2e-5, magnitude=True),
        table.FieldRow("fast", "piston", "far", version="x 1", pairs_per_s=2e9, pairs_per_core_s=3e9, error=1e-6),
        table.FieldRow("none", "piston", "far", missing="x"),
    ]
    path = tmp_path / "field.md"
    path.write_text(table.as_markdown(rows, HEAD, field.MODELS))
    near, far = speed_picture(path).axes
    assert [axes.get_title() or axes.get_title("left") for axes in (near, far)] == [
        "Points near away",
        "Points far away",
    ]
    drawn = [
        [line.get_xydata()[0].tolist() for line in axes.get_lines() if len(line.get_xdata())] for axes in (near, far)
    ]
    assert drawn == [[[1.5e-5, 1e9], [2e-5, 5e9]], [[1e-6, 3e9]]]


def test_what_is_no_report_is_refused(tmp_path, monkeypatch, capsys):
    path = tmp_path / "other.md"
    path.write_text("# A page\n\n| a | b |\n|---|---|\n| 1 | 2 |\n")
    with pytest.raises(OutputError, match="no table of palmfield bench skin or field"):
        speed_picture(path)
    path.write_text(skin.as_markdown(SKIN_ROWS, "cpu", 0.04, "abc", None, path).replace("0.359", "fast"))
    with pytest.raises(OutputError, match="row of 'one'"):
        speed_picture(path)
    for asked, words in (
        ((path, "motion"), "only picture 'speed'"),
        ((path, "--format", "gif"), "allowed: png, svg, pdf"),
        ((tmp_path, "speed"), "palmfield bench skin --out FILE.md"),
        ((tmp_path / "none.md",), "cannot be read"),
    ):
        monkeypatch.setattr(sys, "argv", ["palmfield", "plot", *map(str, asked)])
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code == 2 and words in capsys.readouterr().err


def test_it_is_written_beside_the_report(tmp_path, monkeypatch, capsys):
    path = tmp_path / "skin.md"
    path.write_text(skin.as_markdown(SKIN_ROWS, "cpu", 0.04, "abc", None, path))
    monkeypatch.setattr(sys, "argv", ["palmfield", "plot", str(path), "--format", "svg"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 0 and b"still" in (tmp_path / "plots" / "speed.svg").read_bytes()
