"""Cheap numbers of Reardon's page against ones from elsewhere, and that no testable claim is without an answer."""

import math

import numpy as np
import pytest

from palmfield.skin.problem import SkinProblem, Spot
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves
from palmfield_papers.answer import Setting
from palmfield_papers.entries import book
from palmfield_papers.reardon2023 import PAPER, figures, hand, lines, phantom, runs
from palmfield_papers.reardon2023.configuration import Course, Plate, plate_of, tissue_of

ENTRIES = {entry.id: entry for entry in book().of_paper("Reardon 2023")}
THICK = Plate(back="bonded", viscosity_Pa_s=3.0)


def base(name: str, **other: str) -> Setting:
    readings = dict(book().base(ENTRIES[name])) | other
    return Setting(tuple(readings.items()), quick=True)


def test_all_answers_and_causes_are_of_the_book():
    assert set(PAPER.answers) <= set(ENTRIES)
    assert set(PAPER.causes) <= {name for name, entry in ENTRIES.items() if entry.counts}
    assert all(len(causes) >= 2 for causes in PAPER.causes.values())


def test_every_testable_claim_and_every_calc_has_an_answer():
    wanted = {name for name, entry in ENTRIES.items() if entry.counts or entry.kind == "CALC"}
    assert wanted <= set(PAPER.answers)


def test_claims_that_may_disagree_have_causes():
    bare = {name for name, entry in ENTRIES.items() if entry.counts} - set(PAPER.causes)
    assert bare == {"R11f", "R12l"}


def test_readings_and_the_control_change_the_slab():
    assert plate_of(base("R7a")) == Plate()
    assert plate_of(base("R7a", reardon_back="bonded", reardon_viscosity="1 Pa s, plausible for tissue")) == Plate(
        "bonded", viscosity_Pa_s=1.0
    )
    faster = Setting(base("R7a").readings, control="wave_speed")
    assert plate_of(faster).material.shear_relaxed_Pa == pytest.approx(923.5 * 49.0)
    soft = base("R16-R18m", reardon_hand_tissue="slab of 1 cm at 3 m/s, bonded", reardon_hand_viscosity="3 Pa s")
    assert tissue_of(soft) == Plate("bonded", viscosity_Pa_s=3.0, shear_speed_m_s=3.0)


def test_all_values_of_all_axes_are_understood():
    for name, entry in ENTRIES.items():
        for readings in book().varied(entry):
            setting = Setting(readings, quick=True)
            make = tissue_of if entry.configuration == "reardon.hand" else plate_of
            assert isinstance(make(setting).slab.thickness_m, float), name


def test_the_viscosity_of_the_printed_absorption():
    """alpha = 3e5 dB/(MHz^2 cm): at 100 Hz 2.6e-4 dB/cm... of eta w^2/(2 rho c^3) Np/m the same."""
    eta = lines.ANSWERS["R5g"](Setting()).value
    omega = 2.0 * math.pi * 100.0
    per_cm = eta * omega**2 / (2.0 * 923.5 * 125.0) * 8.685889638 / 100.0
    assert per_cm == pytest.approx(3e5 * (100.0 / 1e6) ** 2, rel=1e-6)


@pytest.mark.numerics
def test_a_run_is_what_the_solver_says_at_points():
    course = runs.straight_course(7.0, 0.16, runs.QUICK)
    motion = runs.run(THICK, course, runs.QUICK, "cpu")
    times, load, _ = runs.sampled(course)
    chosen = [(0.02, 0.0), (-0.01, 0.012)]
    spot = Spot(0.006, load.times_s, load.peak_Pa, load.centres())
    known = solve_lateral_waves(
        SkinProblem(THICK.slab, spot, times, np.array(chosen), accuracy=0.01, accuracy_of="velocity")
    )
    for n, (x, y) in enumerate(chosen):
        i, j = (int(np.abs(motion.places_m - part).argmin()) for part in (x, y))
        ours, right = motion.velocity[:, i, j], known.velocity_m_s[:, n, 2]
        assert np.linalg.norm(ours - right) < 0.03 * np.linalg.norm(right)


def test_samples_meet_the_snapshots():
    for length in (0.16, 0.2):
        course = runs.straight_course(7.0, length, runs.FULL)
        times, load, end = runs.sampled(course)
        assert end == pytest.approx(length / 7.0)
        for way in (0.12, 0.875 * length):
            assert np.abs(times - way / 7.0).min() < 1e-9
            assert runs.focus_at(course, way / 7.0) == pytest.approx([way - 0.5 * length, 0.0], abs=1e-12)
    assert load.law == "linear"


def test_a_focus_with_a_rate_stays_until_the_next_tick():
    times, load, _ = runs.sampled(Course(((-0.08, 0.0), (0.08, 0.0)), 7.0, 16, rate_Hz=700.0))
    assert load.law == "held"
    assert np.diff(load.centres()[:, 0]) == pytest.approx(0.01, abs=1e-12)
    assert len(times) == 16


def synthetic(places: np.ndarray, values: np.ndarray) -> runs.Straight:
    return runs.Straight(0.16, places, values, values, values, 1.0, 0.02, np.arange(8) / 8.0, np.zeros((8, 3)))


def test_wakes_angles_and_energies_of_a_made_up_cone():
    """A cone of known half-angle and length behind the focus."""
    places = 1e-3 * np.arange(-125, 126)
    x, y = np.meshgrid(places, places, indexing="ij")
    behind = 0.04 - x
    slope = math.tan(math.radians(40.0))
    cone = np.exp(-(((np.abs(y) - slope * behind) / 2e-3) ** 2)) * (behind >= 0.0) * np.exp(-behind / 0.03)
    one = synthetic(places, cone)
    assert lines.angle_deg(one) == pytest.approx(40.0, abs=1.0)
    # exp(-d / 30 mm) is a tenth at 69 mm; the front leaves the window of 10 cm at 50/tan 40 = 60 mm
    assert lines.wake_cm(synthetic(places, np.roll(cone, 20, axis=0)), 0.3) == pytest.approx(3.6, abs=0.2)
    assert lines.wake_cm(synthetic(places, np.roll(cone, 20, axis=0)), 0.1) == pytest.approx(6.2, abs=0.3)
    flat = synthetic(places, np.ones((251, 251)))
    # The strip of 6 mm holds seven rows of the grid of 1 mm, with the two on its edges
    strip = 0.16 * 0.007 + math.pi * 0.0035**2
    assert lines.ratio_of(flat) == pytest.approx(strip / (0.25**2 - strip), rel=0.02)


def test_a_design_is_its_own_best_likeness():
    course = figures.z_course(0.06, 3.0, runs.QUICK)
    places = 1e-3 * np.arange(-60, 61)
    wanted = figures.design(course, places)
    assert wanted.argmax() in np.flatnonzero(wanted > 0.9 * wanted.max())
    on = wanted[np.abs(places - 0.0).argmin(), np.abs(places - 0.03).argmin()]
    off = wanted[np.abs(places - 0.0).argmin(), np.abs(places - 0.015).argmin()]
    assert off < 0.1 * on
    # A Gaussian along an endless line: its area across is that of the spot over the length of the path
    across = wanted[np.abs(places - 0.0).argmin(), places > 0.02]
    spot = math.pi * 0.006**2 / (4.0 * math.log(2.0))
    assert across.sum() * 1e-3 == pytest.approx(spot / (0.06 * (2.0 + math.sqrt(2.0))), rel=0.02)


def test_zigzags_have_the_frequencies_of_the_paper():
    times, load, end = runs.sampled(hand.hand_course(1.0, runs.QUICK))
    x, y = load.centres().T
    assert end == pytest.approx(0.16)
    assert np.diff(load.times_s) == pytest.approx(0.008)
    assert np.ptp(y) == pytest.approx(0.02)
    assert np.diff(x) == pytest.approx(0.008)
    assert times[-1] == pytest.approx(0.16 + hand.SILENCE_s, abs=5e-4)
    assert PAPER.answers["R16-R18j"](Setting()).value == 62.5


def test_numbers_of_squares_and_circles_of_made_up_maps():
    places = 1e-3 * np.arange(-50, 51)
    x, y = np.meshgrid(places, places, indexing="ij")
    peak = np.exp(-(((x - 0.004) ** 2 + (y + 0.002) ** 2) / 0.003**2)) + 0.5 * np.exp(
        -((x + 0.006) ** 2 + y**2) / 0.002**2
    )
    drawn = figures.Drawn(places, peak)
    assert figures.inside_mm(drawn, 0.03) == pytest.approx(11.0)
    assert figures.interior_maxima(drawn, 0.03) == 2
    assert figures.inside_mm(figures.Drawn(places, np.exp(-(((x - 0.02) ** 2 + y**2) / 1e-5))), 0.03) == pytest.approx(
        -5.0
    )
    radii = figures.RING_STEP_m * np.arange(251)
    ring = np.exp(-(((radii - 0.012) / 0.004) ** 2))
    count = figures.ANGLES
    behind = np.arange(count) / count
    spiral = np.exp(-(((radii[:, None] - 0.015) / 0.003) ** 2)) * 10.0 ** (-behind / 0.5)
    one = figures.Circled(radii, ring, spiral, drawn)
    assert figures.ring_radius(one, 0.015) == pytest.approx(0.012)
    assert figures.quiet_radius(one, 0.015, 0.3) == pytest.approx(
        0.012 - 0.004 * math.sqrt(math.log(1 / 0.3)), abs=6e-4
    )
    assert figures.spiral_length(one, 0.015) == pytest.approx(math.pi * 0.015, rel=0.02)


def test_the_scan_has_the_plates_places():
    assert len(phantom.SCAN_X_m) * len(phantom.SCAN_Y_m) == 1200
    assert 0.0 in phantom.SCAN_Y_m
    assert max(np.hypot(x, y) for x in phantom.SCAN_X_m[[0, -1]] for y in phantom.SCAN_Y_m[[0, -1]]) <= 0.1251


def test_passes_repeat_for_as_long_as_the_slowest():
    times = 1e-3 * np.arange(1, 41)
    motion = np.zeros((40, 2))
    motion[0] = 1.0
    repeated, several = hand.repeated(times, motion, 0.032)
    assert np.flatnonzero(several[:, 0]) == pytest.approx(32 * np.arange(10))
    assert len(repeated) == len(several) == 9 * 32 + 40


def test_both_directions_run_one_path_so_that_places_alone_tell_nothing():
    """Skin that doesn't propagate, passes repeated: at 4 m/s the zigzag is its own mirror image, at 11 m/s it is not,
    and there a mirrored stimulus would be told by where it has its corners."""
    apart = {}
    for v in (4.0, 11.0):
        (times, there), (_, back) = (hand.local_displacement(v, runs.QUICK, back=way) for way in (False, True))
        x, y = runs.sampled(hand.hand_course(v, runs.QUICK, back=True))[1].centres().T
        ahead = runs.sampled(hand.hand_course(v, runs.QUICK))[1].centres()
        assert np.column_stack([x, y]) == pytest.approx(ahead[::-1])
        ways = {"mirrored": there[:, ::-1], "back": back}
        (many, one), *_ = (hand.repeated(times, motion, hand.PATH_m / v) for motion in (there,))
        apart[v] = {
            name: hand.apart(many, (one, hand.repeated(times, motion, hand.PATH_m / v)[1]), hand.INTEGRATION_s)
            for name, motion in ways.items()
        }
    assert [v for v in hand.FELT if hand.own_mirror(v)] == [0.5, 1.0, 2.0, 4.0]
    assert apart[4.0]["back"] == pytest.approx(apart[4.0]["mirrored"], rel=1e-6)
    assert apart[11.0]["mirrored"] > 5.0 * apart[11.0]["back"] > 0.0


def test_an_answer_has_an_error_and_an_inequality_a_margin():
    answer = PAPER.answers["R12k"](
        base("R12k", reardon_back="bonded", reardon_viscosity="1 Pa s, plausible for tissue")
    )
    assert answer.value is not None and answer.error is not None
    assert answer.margin == pytest.approx(0.1 - answer.value)
    assert 0.03 * answer.value <= answer.error < 0.05 * answer.value
