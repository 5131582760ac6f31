"""The benchmark itself: that it measures what it says, names what is missing and reports what fails."""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.errors import OutputError, PalmfieldError
from palmfield.studies.bench import field, own
from palmfield.studies.bench.problem import Method, Problem, load
from palmfield.studies.bench.processes import ROOT, Measured, measure

PROGRAM = """
import time

import numpy as np

from palmfield.studies.bench.problem import Method


def slow(points):
    time.sleep(0.02)
    return points.sum(axis=1) + np.ones(8_000_000 if len(points) > 64 else 64)[:len(points)]


METHODS = [
    Method("slow", "sphere", lambda problem: problem.points(), slow, ("numpy",)),
    Method("absent", "sphere", lambda problem: None, slow, ("no-such-program",)),
    Method("broken", "sphere", lambda problem: {}, lambda state: state["nothing"]),
]
"""


@pytest.fixture(scope="module")
def problem() -> Problem:
    return field.problem_of("sphere", 0.05, 0.4, 500, "cpu")


def run(names: list[str], problem: Problem, folder: Path) -> list[Measured]:
    """Methods of PROGRAM by name, two runs each."""
    (folder / "program.py").write_text(PROGRAM)
    (folder / "palmfield").symlink_to(ROOT / "palmfield")
    problem.save(folder / "problem.npz")
    methods = [Measured(Method(name, "sphere", len, len), "program") for name in names]
    places: dict[str, tuple[Path, Sequence[Path]]] = {"program": (Path(sys.executable), [folder])}
    ticks: list[str] = []
    measure(methods, {"sphere": folder / "problem.npz"}, places, 2, folder, ticks.append)
    assert ticks == names * 3
    return methods


def test_methods_are_timed_in_their_own_processes(problem: Problem, tmp_path: Path) -> None:
    slow, absent = run(["slow", "absent"], problem, tmp_path)
    assert slow.version == f"numpy {np.__version__}"
    # The clock ran through the sleep of 20 ms, the cores did not work then
    assert len(slow.clock_s) == 2 and slow.median_clock_s - slow.median_core_s > 0.01
    np.testing.assert_array_equal(slow.result, problem.points().sum(axis=1) + np.ones(len(slow.result)))
    assert 50.0 < slow.memory_MiB < 80.0  # 8 million doubles are 61 MiB
    assert absent.missing == "no-such-program" and not absent.clock_s


def test_a_method_that_fails_is_named_with_its_last_words(problem: Problem, tmp_path: Path) -> None:
    with pytest.raises(PalmfieldError, match=r"'broken' failed at 'prepare': KeyError: 'nothing'"):
        run(["broken"], problem, tmp_path)


def test_the_report_is_what_the_file_holds_and_names_its_picture(tmp_path: Path) -> None:
    out, picture = tmp_path / "a" / "field.md", tmp_path / "field.png"
    report = field.main(out, picture, points=500, runs=2, only="spheres", commit="abc1234")
    assert out.read_text() == report and picture.read_bytes().startswith(b"\x89PNG")
    assert "commit abc1234" in report and "../field.png" in report
    assert "    palmfield bench field --points 500 --runs 2" in report


def test_problem_survives_its_file(problem: Problem, tmp_path: Path) -> None:
    problem.save(tmp_path / "problem.npz")
    found = load(tmp_path / "problem.npz")
    for name, value in vars(problem).items():
        np.testing.assert_array_equal(getattr(found, name), value)


def test_own_methods_agree_with_float64(problem: Problem) -> None:
    for model in field.MODELS:
        posed = field.problem_of(model, 0.05, 0.4, 500, "cpu")
        pressure, gradient = field.reference(posed)
        for method in own.METHODS:
            if method.model == model:
                found = method.run(method.prepare(posed))
                if found.ndim == 2:
                    assert field.relative(found[:, 1:], gradient) < 1e-4
                    found = found[:, 0]
                assert field.relative(found, pressure) < 1e-4


@given(low=st.floats(0.02, 1.0), depth=st.floats(0.1, 2.0), points=st.integers(2000, 10**7))
def test_grid_fills_the_box_with_about_so_many_points(low: float, depth: float, points: int) -> None:
    first, steps, resolution = field.grid(low, low + depth, points)
    last = first + resolution * (steps - 1)
    assert first[2] == low and low + depth - resolution <= last[2] <= low + depth + 1e-12
    np.testing.assert_allclose(first[:2], -last[:2], atol=1e-15)
    assert 0.5 * points < np.prod(steps) < 2.5 * points
    assert resolution * 64e3 == pytest.approx(round(resolution * 64e3), rel=1e-12)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"runs": 0}, "--runs has value 0"),
        ({"points": 3}, "--points has value 3"),
        ({"only": "abacus"}, "'abacus' matches no method"),
        ({"out": Path("/proc/field.md")}, "cannot write /proc/field.md: .*; choose another --out"),
        ({"picture": Path(__file__) / "field.png"}, "cannot write .*field.png: .*; choose another --picture"),
        ({"picture": Path(__file__).parent}, "it is a folder; choose another --picture"),
        ({"device": "cuda:99"}, "cuda:99"),
    ],
)
def test_options_that_cannot_be_are_refused_before_measuring(
    options: dict, match: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(field, "run_range", lambda *_: pytest.fail("it measured"))
    with pytest.raises(PalmfieldError, match=match) as caught:
        field.main(**options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["out", "picture"])
def test_what_was_measured_is_printed_though_its_file_cannot_be_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder goes away while the benchmark runs."""
    target = tmp_path / "gone" / "file"
    measure_range = field.run_range

    def run_range(*arguments: Any) -> Any:
        shutil.rmtree(target.parent, ignore_errors=True)
        return measure_range(*arguments)

    monkeypatch.setattr(field, "run_range", run_range)
    with pytest.raises(OutputError, match="the files of the report above could not be written"):
        field.main(**{name: target}, points=100, runs=1, only="spheres", commit="abc1234")
    assert "| palmfield, spheres |" in capsys.readouterr().out
