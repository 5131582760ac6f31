"""The coverage run: cases that are plain data, truths that are no solver's own, nothing dropped."""

import csv
import json
import math
import subprocess
import time

import coverage
import coverage_judge
import coverage_report
import coverage_store
import numpy as np
import pytest
from coverage_draw import FAMILIES, draw, draw_case, height, patch_of, problem_of
from coverage_judge import TooLongError, answers, at_most, relative_error
from coverage_report import Verdict, band, contradictions, counts, verdicts
from coverage_scenes import run_scene, with_load
from coverage_store import ChangedCodeError

from palmfield.skin import Layer, Slab, solve


def test_cases_are_plain_data_the_same_again_and_cover_the_families() -> None:
    cases = draw(3, 60)
    assert json.loads(json.dumps(cases)) == cases
    assert draw_case(3, 40) == cases[40] and draw(4, 1) != cases[:1]
    assert {case["family"] for case in cases} == set(FAMILIES)
    still, deep = ([draw_case(3, len(FAMILIES) * turn + place) for turn in range(40)] for place in (0, 5))
    widths = [case["load"]["fwhm_m"] for case in still]
    assert 1e-3 <= min(widths) < 3e-3 and 0.1 < max(widths) <= 0.3
    depths = [sum(sheet["thickness_m"] for sheet in case["body"]["sheets"]) for case in deep]
    assert 1e-3 <= min(depths) < 2e-3 and 0.03 < max(depths) <= 0.05
    for case in (case for case in cases if case["family"] != "scenes"):
        problem = problem_of(case)
        shear = [sheet.material.shear_relaxed_Pa for sheet in problem.body.sheets]
        if case["family"] == "contrast":
            assert max(shear) / min(shear) == pytest.approx(100.0)
        if case["family"] in ("curved", "meshes"):
            assert isinstance(problem.body, Layer)
        else:
            assert isinstance(problem.body, Slab)
        if case["family"] == "sudden":
            assert problem.load.law == "held" and len(problem.load.times_s) == 1
        assert 0.02 <= case["accuracy"] <= 0.15 and 1 <= len(problem.at) <= 3
        assert case["solvers"][0] == "auto" and len(set(case["solvers"])) == 3
        assert case["by_scikit_fem"] or case["by_others"]
        moves = np.ptp(np.asarray(case["load"]["centre_m"]), axis=0).any()
        assert moves == (case["family"] == "moving" or (case["family"] == "rims" and case["body"]["shape"] == "box"))


def test_a_bent_patch_lies_on_its_surface() -> None:
    body = {
        "size_m": [0.03, 0.04], "radii_m": [0.1, 0.2], "bump": [1e-4, 60.0], "depth_m": 0.004, "edge_m": 0.003,
        "triangles_seed": 5,
    }  # fmt: skip
    patch = patch_of(body)
    x, y, z = patch.vertices.T
    np.testing.assert_allclose(z, -(x**2) / 0.2 - y**2 / 0.4 + 1e-4 * np.cos(60.0 * x) * np.cos(60.0 * y), atol=1e-15)
    step = 1e-7
    slope = (height(body, x + step, y) - height(body, x - step, y)) / (2.0 * step)
    np.testing.assert_allclose(-patch.inward[:, 0] / patch.inward[:, 2], slope, atol=1e-7)
    a, b, c = (patch.vertices[patch.faces[:, i]] * [1.0, 1.0, 0.0] for i in range(3))
    areas = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert (areas > 0.0).all() and areas.sum() == pytest.approx(0.03 * 0.04)


def row(asked: str, **changes) -> dict:
    moved = np.ones((3, 1, 3))
    plain = {
        "key": "1-0", "asked": asked, "solver": f"{asked}: made up", "displacement_m": (1.02 * moved).tolist(),
        "displacement_error": 0.03, "seconds": 1.0,
    }  # fmt: skip
    return plain | changes


def truth(by: str, error: float, factor: float = 1.0) -> dict:
    return {"key": "1-0", "by": by, "error": error, "displacement_m": (factor * np.ones((3, 1, 3))).tolist()}


DRAWN = {"seed": 1, "cases": [{"key": "1-0", "family": "still", "accuracy": 0.05}]}


def test_answers_are_judged_by_the_surest_truth_of_another_code() -> None:
    known = [truth("wedges", 1e-6, 1.02), truth("scikit-fem", 1e-3), truth("axisymmetric", 2e-3, 1.1)]
    (found,) = verdicts(DRAWN, known, [row("wedges")])
    assert found.kind == "judged" and found.by == "scikit-fem" and found.independent
    assert found.true == pytest.approx(0.02) and found.estimate == 0.03
    assert [v.by for v in verdicts(DRAWN, known[:2], [row("reduced")])] == ["scikit-fem"]
    assert [v.kind for v in verdicts(DRAWN, known[:1], [row("reduced")])] == ["no truth"]
    (unsure,) = verdicts(DRAWN, [truth("axisymmetric", 0.02)], [row("wedges")])
    assert unsure.kind == "no truth" and unsure.true == pytest.approx(0.02)
    assert [v.kind for v in verdicts(DRAWN, [], [row("wedges")])] == ["no truth"]


def test_nothing_is_dropped() -> None:
    rows = [row("wedges"), {"key": "1-0", "asked": "axisymmetric", "refused": "no disc"}]
    rows += [{"key": "1-0", "asked": "reduced", "missing": "TooLongError: given up"}]
    rows += [{"key": "1-0", "asked": "particles", "refused_late": "crushed"}]
    found = verdicts(DRAWN, [truth("scikit-fem", 1e-3)], rows)
    assert [v.kind for v in found] == ["judged", "refused", "no answer", "refused late"]
    cells = counts(found)
    assert cells[:2] == ["4", "1"] and cells[5:7] == ["1, 1, 1", "0"]
    assert cells[-1] == band(1, 4)


def test_bands_are_those_of_the_binomial() -> None:
    """Of 20 hits out of 20 the lower end solves p^20 = 0.025."""
    low = 100.0 * 0.025 ** (1.0 / 20.0)
    assert band(20, 20) == f"100 % ({low:.0f} to 100)"
    assert band(0, 0) == "-"


def test_truths_that_contradict_one_another_are_named() -> None:
    assert contradictions(DRAWN, [truth("wedges", 1e-3), truth("scikit-fem", 1e-3, 1.001)]) == []
    (line,) = contradictions(DRAWN, [truth("wedges", 1e-3), truth("scikit-fem", 1e-3, 1.1)])
    assert line.startswith("1-0 (still): scikit-fem and wedges differ by")


def test_norm_is_the_worst_points_own() -> None:
    known = np.zeros((2, 3, 3))
    known[:, 0, 2], known[:, 1, 2] = 1.0, 0.01
    found = known.copy()
    found[:, 0, 2] += 0.01
    found[:, 1, 2] += 0.002
    assert relative_error(found, known) == pytest.approx(0.2)


def test_a_run_goes_on_where_it_ended(tmp_path) -> None:
    cases, path, asked = draw(1, 4), tmp_path / "rows.jsonl", []

    def work(case):
        asked.append(case["key"])
        if len(asked) == 3:
            raise KeyboardInterrupt
        return [{"key": case["key"], "seconds": 0.0}]

    with pytest.raises(KeyboardInterrupt):
        coverage.go_on(cases, path, work)
    coverage.go_on(cases, path, work)
    assert [each["key"] for each in coverage.rows_of(path)] == [case["key"] for case in cases]
    assert asked == ["1-0", "1-1", "1-2", "1-2", "1-3"]


def test_a_run_that_takes_too_long_is_given_up_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = time.perf_counter()
    with pytest.raises(TooLongError, match="given up after 0 s"), at_most(0.05):
        while time.perf_counter() - begin < 5.0:
            math.sqrt(2.0)
    assert time.perf_counter() - begin < 1.0


@pytest.mark.nightly
def test_estimates_of_a_round_case_hold_by_every_solver(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two solvers at two accuracies on one case, through the page."""
    monkeypatch.setattr(coverage_judge, "TRUTHS", {"disc": ("axisymmetric", "spectral_elements")})
    case = draw_case(1, 15) | {"solvers": ["auto", "spectral_elements", "lateral_waves"], "by_others": True}
    rows = answers(case, 60.0, 30.0)
    assert [each["asked"] for each in rows] == ["auto", "spectral_elements", "lateral_waves"] and "refused" in rows[2]
    known = coverage_judge.truths(case, rows[0], 60.0)
    drawn = {"seed": 1, "cases": [case]}
    found = {v.asked: v for v in verdicts(drawn, known, rows)}
    judged = [v for v in found.values() if v.kind == "judged"]
    assert judged and all(v.estimate >= v.true for v in judged)
    out = tmp_path / "page.md"
    coverage_report.write_report(drawn, known, rows, out)
    text = out.read_text()
    # The run's folder has the case, the page counts it
    kept = [json.loads(coverage_store.line(each)) for each in rows]
    (auto,) = [v for v in verdicts(drawn, known, kept) if v.asked == "auto"]
    assert (auto.case, auto.family, auto.kind) == ("1-15", "depths", "judged")
    cells = {name: line.split(" | ") for line in text.splitlines() for name in [line[2:].partition(" |")[0]]}
    families = {row[0]: row for row in csv.reader((tmp_path / "data" / "page.csv").open())}
    assert families["depths"][1:3] == ["1", "1"] and cells["auto"][1:3] == ["1", "1"]
    assert cells["lateral_waves"][1:3] == ["1", "0"]
    assert cells["lateral_waves"][6:8] == ["1, 0, 0", "0"], "refused before the run, not late"
    assert text.endswith("estimate below the true error\n\nNone.\n")
    assert out.with_suffix(".png").stat().st_size > 5000


def test_a_scene_says_how_far_it_is_off_and_gives_its_load() -> None:
    """The focus is at the level that the scene's file names, half of it within some half a wavelength of 8.6 mm."""
    case = with_load(draw_case(1, 9))
    load = json.loads(json.dumps(case))["load"]
    assert max(load["peak_Pa"]) * load["profile_Pa"][0] == pytest.approx(12.0, rel=1e-3)
    assert 0.006 < load["fwhm_m"] < 0.013
    (row,) = answers(case | {"solvers": ["auto"]}, 60.0, 30.0)
    assert len(row["displacement_m"]) == len(case["times_s"]) and row["solver"]
    assert 0.0 < row["displacement_error"] < 2.0 * case["accuracy"]


def test_a_verdict_of_scikit_fem_is_independent() -> None:
    assert Verdict("1-0", "still", "auto", "judged", by="scikit-fem").independent
    assert not Verdict("1-0", "still", "auto", "judged", by="wedges").independent


def test_a_run_is_kept_in_small_lines_and_refuses_other_code(tmp_path) -> None:
    """A repository of its own: begun at a commit, continued in a later one, refused once the code has changed."""

    def git(*words: str) -> None:
        subprocess.run(["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True)

    code, folder = tmp_path / "palmfield" / "a.py", tmp_path / "docs" / "run"
    code.parent.mkdir()
    code.write_text("x = 1\n")
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "first")
    with pytest.raises(ChangedCodeError, match="no run in"):
        coverage_store.known_head(folder, tmp_path)
    head = coverage_store.begin(folder, 5, 7, tmp_path)
    with pytest.raises(ChangedCodeError, match="holds the run of seed 5"):
        coverage_store.begin(folder, 6, 7, tmp_path)
    git("add", "-A")
    git("commit", "-qm", "what was found so far")
    assert coverage_store.known_head(folder, tmp_path) == head and (head["seed"], head["count"]) == (5, 7)
    code.write_text("x = 2\n")
    with pytest.raises(ChangedCodeError, match=r"not that of commit .*palmfield/a\.py"):
        coverage_store.known_head(folder, tmp_path)
    code.write_text("x = 1\n")
    (code.parent / "b.py").write_text("")
    with pytest.raises(ChangedCodeError, match=r"palmfield/b\.py"):
        coverage_store.known_head(folder, tmp_path)


def test_a_kept_line_has_six_digits_and_no_velocities() -> None:
    moved = (1e-6 * np.random.default_rng(0).standard_normal((24, 3, 3))).tolist()
    text = coverage_store.line(row("wedges", displacement_m=moved, velocity_m_s=moved))
    assert len(text) < 3500 and "velocity" not in text
    again = json.loads(text)
    assert relative_error(again["displacement_m"], moved) < 1e-5 and again["displacement_error"] == 0.03


def test_scenes_are_of_discs_hands_and_meshes_in_turn() -> None:
    scenes = [draw_case(2, 9 + 10 * turn) for turn in range(6)]
    assert [case["scene"] for case in scenes[1:3]] == ["palm_am200", "ellipsoid"]
    assert [case["by_scikit_fem"] for case in scenes] == [True, False, False] * 2
    assert all(case["by_scikit_fem"] or case["by_others"] for case in scenes)


def test_a_users_mesh_in_a_scene_answers() -> None:
    case = draw_case(2, 29)
    case["keys"] |= {"skin.accuracy": 0.15, "skin.patch_radius_m": 0.016}
    found = run_scene(case, "auto")
    assert len(found["displacement_m"]) == len(case["times_s"]) and np.ptp(found["displacement_m"]) > 0.0
    assert 0.0 < found["displacement_error"] < 1.0


def test_a_scenes_truth_knows_its_error_from_two_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Displacements that are off by the square of the elements' edges."""
    nodes = {0.06: 1000, 0.03: 8000}

    def by_edges(case, solver, accuracy):
        count = nodes[round(accuracy, 6)]
        moved = [[[0.0, 0.0, 1.0 + count ** (-2.0 / 3.0)]]] * 3
        return {"displacement_m": moved, "solver": f"{solver}: 9 elements of order 2, {count} nodes, a bulk modulus"}

    monkeypatch.setattr(coverage_judge, "run_scene", by_edges)
    (found,) = coverage_judge.truths({"key": "1-19", "scene": "ellipsoid", "accuracy": 0.12}, {}, 10.0)
    assert found["by"] == "spectral_elements" and found["error"] == pytest.approx(1.0 / 400.0, rel=5e-3)
    nodes[0.06] = 7000
    (found,) = coverage_judge.truths({"key": "1-19", "scene": "ellipsoid", "accuracy": 0.12}, {}, 10.0)
    assert "edges are 1.05 times as fine" in found["missing"]


@pytest.mark.parametrize(("number", "solver"), [(42, "particles"), (74, "reduced")])
def test_estimates_that_were_too_small_hold(number: int, solver: str) -> None:
    """A spot twice as wide as its disc, and few triangles under one: of the error 43 and 95 % were stated."""
    case = draw_case(1795415096, number)
    (found,) = answers(case | {"solvers": [solver]}, 30.0, 30.0)
    problem = problem_of(case)
    known = solve(problem.body, problem.load, problem.times, problem.at, solver="axisymmetric", accuracy=0.003)
    true = relative_error(found["displacement_m"], known.displacement_m)
    assert known.error < 0.25 * found["displacement_error"]
    assert true < found["displacement_error"] < 6.0 * true
