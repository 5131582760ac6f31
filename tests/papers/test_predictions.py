"""The committed predictions: the page holds the numbers, and cheap ones of them come out again."""

import json
import math
from pathlib import Path

import numpy as np
import predictions
import predictions_felt as felt
import predictions_force as force
import pytest
import score_predictions as score

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.langevin import radiation_stress
from palmfield.perception.observers import OBSERVERS

GALLERY = Path(__file__).resolve().parents[2] / "docs" / "gallery"
NUMBERS = json.loads((GALLERY / predictions.NUMBERS).read_text(encoding="utf-8"))
STILL = json.loads((GALLERY / score.STILL).read_text(encoding="utf-8"))
FINDINGS = {finding.name: finding for finding in felt.FINDINGS}


def test_the_page_is_made_of_the_numbers():
    assert (GALLERY / predictions.PAGE).read_text(encoding="utf-8") == predictions.page(NUMBERS)


def test_the_score_is_made_of_the_committed_numbers_and_has_every_finding():
    assert (GALLERY / score.PAGE).read_text(encoding="utf-8") == score.page(NUMBERS, STILL)
    assert set(score.OUTCOMES) == set(FINDINGS)


def test_directions_and_sizes_are_judged_by_the_rules_of_the_page():
    """Five of six predict, one of six denies; a factor of 1.5, and 3 dB, by the median."""
    for right, wanted in ((6, "yes"), (5, "yes"), (4, "split"), (2, "split"), (1, "no"), (0, "no")):
        assert score.predicted({"with_the_claim": right, "of": 6}) == wanted
    sizes = {"10 mm": {"a": 10.0, "b": None, "c": 20.0}, "20 mm": {"a": 15.0, "b": 15.0, "c": 15.0}}
    for unit, size, told in (
        ("mm", 22.0, "within"),
        ("mm", 23.0, "outside"),
        ("dB", 17.9, "within"),
        ("dB", 18.1, "outside"),
    ):
        assert score.size_text({"sizes": sizes, "unit": unit}, score.Outcome("s", "t", True, size)).endswith(told)
    assert score.size_text({"sizes": sizes, "unit": "mm"}, score.Outcome("s", "t", True)) == "none published"


def test_every_finding_and_case_has_numbers():
    assert [one["name"] for one in NUMBERS["findings"]] == list(FINDINGS) and len(FINDINGS) >= 6
    assert len(NUMBERS["force"]) == len(force.LAYOUTS) * len(force.DEPTHS_M) * len(force.PLATES_M)
    for one in NUMBERS["findings"]:
        assert (one["with_the_claim"], one["of"]) == felt.agreement(FINDINGS[one["name"]], one["sizes"])


@pytest.mark.parametrize("name", ["LM step", "more foci", "tactile pointer"])
def test_levels_come_out_again(name):
    (committed,) = (one for one in NUMBERS["findings"] if one["name"] == name)
    found = FINDINGS[name].size(OBSERVERS["bolanowski_1988"], 0.01)
    assert found == pytest.approx(committed["sizes"]["10 mm"]["bolanowski_1988"], abs=0.01)


@pytest.mark.parametrize("name", ["LM step", "more foci", "tactile pointer"])
def test_a_skin_without_waves_comes_out_again(name):
    (committed,) = (one for one in STILL if one["name"] == name)
    found = FINDINGS[name].size(OBSERVERS["bolanowski_1988"], felt.NO_WAVES)
    assert found == pytest.approx(committed["sizes"]["0 mm"]["bolanowski_1988"], abs=0.01)


def test_a_skin_without_waves_moves_where_it_is_pressed_alone():
    """Pressure AM of depth 1 has ARP lines of 1/2 and 1/8 of its peak: ((1 + sin)/2)^2 = 3/8 + sin/2 - cos(2)/8."""
    skin = felt.layer(felt.NO_WAVES)
    lines = np.abs(skin.lines([felt.pressure_am()], 200.0, [1, 2, 3]))
    middle = len(skin.places()) // 2
    np.testing.assert_allclose(lines[:, middle, middle], [5e-7, 1.25e-7, 0.0], atol=2e-10)
    half = np.interp(0.5 * felt.FWHM_M, skin.places(), lines[0, middle])
    assert half == pytest.approx(0.5 * 5e-7, rel=0.02)


def test_a_ratio_of_forces_comes_out_again():
    (committed,) = (
        one for one in NUMBERS["force"]
        if (one["layout"], one["depth_m"], one["plate_m"]) == ("autd2018_2x2", 0.2, 0.012)
    )  # fmt: skip
    found = force.case("autd2018_2x2", 0.2, 0.012)
    assert found.ratio == pytest.approx(committed["ratio"], rel=1e-3)


def test_the_stated_error_holds_what_a_finer_grid_changes_where_it_is_largest():
    worst = max(NUMBERS["force"], key=predictions._error)
    array = layout(worst["layout"])
    field = force.FieldEvaluator(array, force.Air(), device="cpu")
    drive = force.focus(array, force.Air(), [0.0, 0.0, worst["depth_m"]])
    by_law, by_formula = (
        force._force(field, drive, worst["depth_m"], worst["plate_m"], law, 0, 0.5 * force.SPACING_M)[0]
        for law in ("default", "alpha")
    )
    assert abs(by_law / by_formula - worst["ratio"]) <= predictions._error(worst) < 0.03


def test_the_law_gives_the_momentum_that_the_beam_carries():
    """On a plane wide enough for all of it, where the law and twice the axial flux must agree; the formula does not."""
    array, depth, edge = layout("uhev1"), 0.2, 1.2
    field = force.FieldEvaluator(array, force.Air(), device="cpu", absorption_Np_m=0.0)
    drive = force.focus(array, force.Air(), [0.0, 0.0, depth])
    by_law, _ = force._force(field, drive, depth, edge, "default")
    by_formula, _ = force._force(field, drive, depth, edge, "alpha")
    spacing = force.SPACING_M
    x = (np.arange(2 * math.ceil(0.5 * edge / spacing)) + 0.5) * spacing - 0.5 * edge
    points = np.stack([*(grid.ravel() for grid in np.meshgrid(x, x)), np.full(x.size**2, depth)], axis=1)
    sound = field.pressure(points, drive, gradient=True)
    momentum = 2.0 * radiation_stress(sound, force.Air(), array.frequency_Hz)[:, 2, 2].sum() * spacing**2
    assert by_law == pytest.approx(momentum, rel=0.01)
    assert by_formula > 1.1 * momentum


def test_steepening_raises_what_is_measured_and_ends_at_sigma_1():
    case = force.Case("uhev1", 0.2, 0.012, 0.9, 1.0, 0.9, 0.1, 1.0, 1.0)
    # 2 J1(sigma)/sigma is 0.8801 at sigma 1 and 1 - sigma^2/8 below
    assert case.as_measured(1.0) == pytest.approx(0.9 / 0.8801**2, rel=1e-3)
    assert case.as_measured(0.1) == pytest.approx(0.9 * (1.0 + 0.01 / 4.0), rel=1e-4)
    loud = force.Case("uhev1", 0.2, 0.012, 0.9, 1.0, 0.9, 0.1, 1.0, 2.0)
    assert loud.as_measured(1.0) is None and loud.as_measured(0.5) is not None


def test_a_pair_at_no_distance_has_no_dip_and_a_wide_one_has():
    """At 60 mm both spots stand alone: the dip is that of one spot's level 30 mm away, summed of two waves."""
    observer = OBSERVERS["afferent_human"]
    assert felt.dip_dB(observer, 0.01, 0.0025) == pytest.approx(0.0, abs=0.1)
    assert felt.dip_dB(observer, 0.01, 0.06) > 6.0
    assert np.isfinite(felt.dip_dB(observer, 0.01, 0.03))
