"""scripts/bench/compare_field.py and compare_skin.py: other programs beside ours, and those that are missing."""

import re
import sys
from pathlib import Path
from typing import Any

import compare_field
import compare_skin
import peers_python
import pytest

from palmfield.errors import PalmfieldError
from palmfield.studies.bench import field, skin
from palmfield.studies.bench.skin_case import CASE

INTERPRETERS = (
    (Path("nowhere/python"), "nowhere/python is no program"),
    (Path(__file__), "is no program"),
    (Path("no-such-interpreter"), "no-such-interpreter is no program"),
    (Path("false"), "false can't import NumPy"),
)


def test_the_field_report_states_the_error_that_another_program_has(tmp_path: Path) -> None:
    out = tmp_path / "field.md"
    report = compare_field.report(out=out, points=500, runs=2, only="NumPy", commit="abc1234")
    assert out.read_text() == report and "    python scripts/bench/compare_field.py --points 500" in report
    errors = [float(row.split("|")[7]) for row in re.findall(r"^\| NumPy.*$", report, re.MULTILINE)]
    # Six or seven digits of the phase of 47 to 141 waves are left in float32: the far range is worse
    assert len(errors) == 2 and 1e-7 < errors[0] < errors[1] < 1e-4


def test_another_interpreter_finds_the_methods_and_palmfield(tmp_path: Path) -> None:
    """One that has this environment's libraries, and this repository by the benchmark only."""
    program = tmp_path / "python"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    program.chmod(0o755)
    report = compare_field.report(program, points=64, runs=1, only="NumPy", commit="abc1234")
    assert "compare_field.py --peers-python PATH --points 64" in report and "| NumPy float32 (numpy" in report


@pytest.mark.parametrize("compare", [compare_field, compare_skin])
@pytest.mark.parametrize(("python", "match"), INTERPRETERS)
def test_an_interpreter_that_is_none_is_refused_before_measuring(
    compare: Any, python: Path, match: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (field, skin):
        monkeypatch.setattr(module, "main", lambda *_, **__: pytest.fail("it measured"))
    with pytest.raises(PalmfieldError, match=match) as caught:
        compare.report(python)
    assert "\n" not in str(caught.value)


def test_an_interpreter_that_cannot_start_is_named(tmp_path: Path) -> None:
    program = tmp_path / "python"
    program.write_text("#!/nowhere/at/all\n")
    program.chmod(0o755)
    with pytest.raises(PalmfieldError, match="python does not run: No such file"):
        peers_python.interpreter(program)


@pytest.mark.parametrize("compare", [compare_field, compare_skin])
def test_a_bad_option_is_one_line_and_exit_code_2(
    compare: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["compare", "--only", "abacus"])
    with pytest.raises(SystemExit) as stop:
        compare.main()
    error = capsys.readouterr().err
    assert stop.value.code == 2 and error.startswith("palmfield: --only 'abacus'") and error.count("\n") == 1
    assert "autd3-emulator" in error or "scikit-fem" in error


def test_another_skin_program_gives_its_error_and_a_missing_one_its_name(tmp_path: Path) -> None:
    row = compare_skin.peer(CASE, "mujoco_flex", 4, 2, Path(sys.executable))
    assert row.missing == "" and row.moving is None
    # Trilinear cells lock at nu 0.495: they move by less than half of what is right
    assert row.static is not None and 0.5 < row.static < 1.0
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho no such module >&2\nexit 1\n")
    broken.chmod(0o755)
    row = compare_skin.peer(CASE, "scikit_fem", 4, 2, broken)
    assert "no such module" in row.missing and "skfem" in row.missing


def test_the_skin_report_says_what_other_programs_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare_skin, "peer", lambda *_: skin.SkinRow("MuJoCo flex, trilinear", "4 cells", 1.0, 0.5))
    report = compare_skin.report(only="flex", commit="abc1234")
    assert "    python scripts/bench/compare_skin.py --out" in report and "The other programs solve once" in report
    assert "| MuJoCo flex, trilinear | 4 cells | 1 | 50 % |" in report
