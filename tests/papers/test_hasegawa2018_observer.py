"""Rows H19 to H21: the palm under the focus against a finite-element slab, thresholds against tables by hand."""

import math

import numpy as np
import pytest

from palmfield.instruments.force import Plate, plate_force
from palmfield.perception.observers import OBSERVERS, line_amplitude, threshold_m
from palmfield.skin import Sheet, Slab, Spot, preset, solve
from palmfield_papers.answer import Setting
from palmfield_papers.entries import book
from palmfield_papers.hasegawa2018 import palm_focus
from palmfield_papers.hasegawa2018.observer import (
    ANSWERS,
    CAUSES,
    NAMED,
    rectangle_N,
    sine_N,
    threshold_level,
)
from palmfield_papers.hasegawa2018.palm_focus import (
    JIG_M,
    REACH_M,
    force_N,
    motion_m_per_N,
    moved_area_m2,
    ring_mean,
)

HUMAN = OBSERVERS["afferent_human"]
ENTRIES = {entry.id: entry for entry in book().of_paper("Hasegawa 2018")}


def base(name: str) -> Setting:
    return Setting(readings=book().base(ENTRIES[name]))


def test_every_claim_of_the_rows_has_an_answer():
    rows = {entry.id for entry in ENTRIES.values() if entry.row == "H19-H21" and entry.kind in ("CLAIM", "ERRATUM")}
    assert set(ANSWERS) == rows
    assert set(CAUSES) <= set(ANSWERS) and all(len(causes) >= 2 for causes in CAUSES.values())


def test_readings_name_the_observers_and_depths_that_they_mean():
    assert [NAMED[value].split("_")[0] for value in book().axes["observers"]] == ["afferent", "morioka", "bolanowski"]
    assert [value.split(", ")[1] for value in book().axes["hasegawa_palm"]] == ["10 mm", "20 mm"]


@pytest.mark.parametrize(("width_m", "within"), [(0.012, 1e-5), (0.1, 5e-4)])
def test_the_mean_over_angle_holds_the_force_on_discs(width_m, within):
    """Against the jig's own integral over a disc, which has places of its own."""
    radii, weights, pressure = ring_mean(0.5 * width_m, 96)
    disc = plate_force(palm_focus._arp_at, Plate(shape="disc", width_m=width_m, spacing_m=width_m / 200.0))
    assert float((2.0 * math.pi * radii * weights) @ pressure) == pytest.approx(
        disc.force_N / force_N(JIG_M), rel=within
    )


def test_motion_at_200_Hz_is_that_of_finite_elements_in_a_disc(monkeypatch):
    """A Gaussian spot of 10.3 mm in the focus's place, by the axisymmetric solver, which knows no wavenumbers."""
    radii, weights, _ = ring_mean(REACH_M, 96)
    width, peak_Pa = 0.0103, 50.0
    spot = np.exp(-4.0 * math.log(2.0) * (radii / width) ** 2)
    monkeypatch.setattr(palm_focus, "ring_mean", lambda reach, rings: (radii, weights, spot))
    for kept in (palm_focus._spectrum, palm_focus._motion):
        kept.cache_clear()
    ours = motion_m_per_N((200.0,), 0.01)[0]
    for kept in (palm_focus._spectrum, palm_focus._motion):
        kept.cache_clear()
    times = np.arange(0.0, 0.06, 1.0 / 200.0 / 32.0)
    load = Spot(fwhm_m=width, times_s=times, peak_Pa=peak_Pa * np.sin(2.0 * math.pi * 200.0 * times))
    body = Slab((Sheet(preset("palm"), 0.01),), shape="disc", side="fixed", radius_m=0.12)
    motion = solve(body, load, times=times, at=[[0.0, 0.0]], solver="axisymmetric", accuracy=0.02)
    amplitude = line_amplitude(times, motion.displacement_m[:, 0, 2], 200.0, periods=4)
    assert amplitude == pytest.approx(peak_Pa * ours, rel=0.02)


def test_a_stiffer_palm_moves_less_and_a_finer_run_changes_little():
    soft, preset_, stiff = (motion_m_per_N((10.0,), 0.01, which)[0] for which in ("softest", "preset", "stiffest"))
    # At rest and of one material all motion goes with 1/G: 0.64 and 1.67
    assert soft / preset_ == pytest.approx(1.0 / 0.64, rel=0.02) and preset_ / stiff == pytest.approx(1.67, rel=0.02)
    coarse, fine = (motion_m_per_N((5.0, 200.0, 490.0), 0.01, fine=fine) for fine in (False, True))
    assert coarse == pytest.approx(fine, rel=5e-4)
    assert 0.2e-4 < moved_area_m2(200.0, 0.01) < 2.9e-4


def test_thresholds_are_those_of_tables_over_motions():
    motion = motion_m_per_N((200.0,), 0.01)[0]
    assert sine_N(HUMAN, 200.0, 0.01) == pytest.approx(0.042e-6 / motion)
    assert math.isnan(sine_N(HUMAN, 500.0, 0.01)) and math.isnan(sine_N(OBSERVERS["morioka_griffin_2006"], 5.0, 0.01))
    answer = threshold_level(base("H19-H21b"))
    assert answer.value == pytest.approx(20.0 * math.log10(0.042e-6 / motion / 19.6133e-3))
    assert answer.band[0] < answer.value - 10.0 and answer.band[1] > answer.value + 10.0


def test_a_rectangle_is_felt_by_the_root_of_its_harmonics_squares():
    """At 100 Hz the single-unit table has two odd harmonics, 100 and 300 Hz."""
    first, third = motion_m_per_N((100.0, 300.0), 0.01) / threshold_m(HUMAN, [100.0, 300.0])
    wanted = math.pi / 4.0 / math.hypot(first, third / 3.0)
    assert rectangle_N(HUMAN, 100.0, 0.01) == pytest.approx(wanted)
    # Four channels: 10 and 30 Hz do not add to 50 Hz and above
    probe = OBSERVERS["bolanowski_1988"]
    lines = np.arange(50.0, 500.0, 20.0)
    pacinian = motion_m_per_N(tuple(lines.tolist()), 0.01) / threshold_m(probe, lines) * 10.0 / lines
    assert rectangle_N(probe, 10.0, 0.01) == pytest.approx(math.pi / 4.0 / np.sqrt((pacinian**2).sum()))


def test_eq_8_moves_the_level_by_a_factor_of_two():
    entry = ENTRIES["H19-H21b"]
    printed, other = (
        threshold_level(Setting(readings=tuple((axis, dict(base(entry.id).readings)[axis]) for axis in axes) + last))
        for axes, last in (
            (entry.readings, ()),
            (entry.readings[:2], (("hasegawa_eq8", book().axes["hasegawa_eq8"][1]),)),
        )
    )
    assert other.value - printed.value == pytest.approx(6.0206, abs=1e-3)
    assert other.shown["threshold by afferent_human, mN"] == printed.shown["threshold by afferent_human, mN"]


def test_the_hand_grip_table_is_told_to_be_a_lower_bound():
    """Wherever it is printed as the answer."""
    for name in ("H19-H21a", "H19-H21b", "H19-H21e"):
        for readings in book().varied(ENTRIES[name]):
            answer = ANSWERS[name](Setting(readings=readings))
            hand = NAMED[dict(readings)["observers"]] == "morioka_griffin_2006"
            assert ("lower bound" in answer.note) == hand


def test_what_an_observer_can_not_say_has_no_value():
    for name in ("H19-H21m", "H19-H21n"):
        assert ANSWERS[name](Setting()).value is None and ANSWERS[name](Setting()).note
