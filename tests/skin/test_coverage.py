"""Error estimates against converged answers, on random cases of fixed seeds, and the tools that compare them."""

import math
import time

import coverage_cases as module
import numpy as np
import pytest
from coverage_cases import Row, TooLongError, at_most, equivalent, judge, relative_error, summary
from random_cases import COURSES, KINDS, curved_patch, random_case

from palmfield.skin import Layer, Slab, Spot

CHEAP = (5, 16, 21, 25, 26, 29, 30, 36)
"""Of the first 40 cases of seed 6 at 20 ms, those known and solved within 6 s: picked by their time alone."""


def test_estimates_of_random_cases_are_true() -> None:
    """Issue: true <= estimate in 90 % of the cases, median of estimate / true at most 4."""
    rows = [row for number in CHEAP for row in judge(random_case(6, number, 0.02), longest_s=0.5)]
    for row in rows:
        print(row.number, row.asked, row.solver, row.wanted, row.estimate, row.true, row.processor_s, row.missing)
    found = summary(rows)
    print(found)
    count, share, ratio, _ = found["auto"]
    assert count == len(CHEAP)
    assert share >= 0.9
    assert 1.0 <= ratio <= 4.0
    named = [row for row in rows if row.asked != "auto"]
    assert len({row.solver for row in named}) >= 3
    assert np.mean([row.estimate >= row.true for row in named]) >= 0.9
    assert np.median([row.estimate / row.true for row in named]) <= 4.0


def test_cases_are_the_same_again_and_cover_bodies_and_loads() -> None:
    for number in range(len(KINDS) * len(COURSES)):
        one, again = random_case(7, number), random_case(7, number)
        assert one.words == again.words
        np.testing.assert_array_equal(one.at, again.at)
        np.testing.assert_array_equal(one.load.peak_Pa, again.load.peak_Pa)
        assert 0.005 <= one.accuracy <= 0.1 and 0.019 < one.times[-1] <= 0.1
        assert 1 <= len(one.at) <= 3
    cases = [random_case(7, number) for number in range(24)]
    words = " ".join(case.words for case in cases)
    for kind in ("endless", "disc", "box", "layer", "step", "ramp", "modulated", "burst", "line", "circle"):
        assert kind in words
    assert random_case(8, 0).words != random_case(7, 0).words


def test_norm_is_the_worst_points_own() -> None:
    known = np.zeros((2, 3, 3))
    known[:, 0, 2], known[:, 1, 2] = 1.0, 0.01
    found = known.copy()
    found[:, 0, 2] += 0.01
    found[:, 1, 2] += 0.002
    assert relative_error(found, known) == pytest.approx(0.2)


def test_summary_counts_what_was_measured() -> None:
    def row(asked: str, estimate: float, true: float, missing: str = "") -> Row:
        return Row(0, "", asked, asked, 0.1, estimate, true, 1.0, 2.0, 1.0, "", missing)

    rows = [row("auto", 0.2, 0.1), row("auto", 0.1, 0.2), row("auto", 0.8, 0.1), row("auto", 0.0, 0.0, "dropped: x")]
    assert summary(rows) == {"auto": (3, pytest.approx(2.0 / 3.0), pytest.approx(2.0), pytest.approx(0.5))}
    assert summary(rows[3:]) == {}


def test_absorbing_slabs_are_endless_and_flat_roller_layers_are_boxes() -> None:
    case = next(c for n in range(2, 200, 4) if (c := random_case(1, n)).words.split(", ")[1].startswith("absorbing"))
    body = equivalent(case.body)
    assert isinstance(body, Slab) and body.shape == "infinite" and body.side is None
    layer = next(c for n in range(3, 200, 4) if ", flat, roller" in (c := random_case(1, n)).words).body
    assert isinstance(layer, Layer)
    box = equivalent(layer)
    assert isinstance(box, Slab) and box.shape == "box" and box.size_m is not None
    np.testing.assert_allclose(box.size_m, np.ptp(layer.patch.vertices[:, :2], axis=0))
    assert equivalent(box) is box


def test_a_bent_patch_has_its_radii() -> None:
    patch = curved_patch(np.array([0.02, 0.03]), 0.004, np.array([0.1, np.inf]), 0.002)
    assert np.ptp(patch.vertices[:, :2], axis=0) == pytest.approx([0.02, 0.03])
    assert patch.vertices[:, 2].min() == pytest.approx(-(0.01**2) / 0.2)
    np.testing.assert_allclose(np.linalg.norm(patch.inward, axis=1), 1.0)
    edge = patch.vertices[:, 0] == patch.vertices[:, 0].max()
    np.testing.assert_allclose(patch.inward[edge, 0] / patch.inward[edge, 2], 0.01 / 0.1)
    assert patch.axis is None


def test_a_run_that_takes_too_long_is_given_up_and_said() -> None:
    begin = time.perf_counter()
    with pytest.raises(TooLongError, match="given up after 0 s"), at_most(0.05):
        while time.perf_counter() - begin < 5.0:
            math.sqrt(2.0)
    assert time.perf_counter() - begin < 1.0


def test_a_case_without_a_converged_answer_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TENTH", 1e-12)
    rows = judge(random_case(5, 5, 0.02))
    assert [row.asked for row in rows] == ["auto"]
    assert rows[0].missing.startswith("dropped: lateral_waves: its own error of")
    assert isinstance(random_case(5, 5, 0.02).load, Spot)
