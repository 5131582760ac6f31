"""Answers of Hasegawa & Shinoda 2018 (field and drive) against sums and integrations that they do not use."""

import numpy as np
import pytest
from scipy.special import j1

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.drive.response import Pole, filter_frames
from palmfield_papers.answer import Setting
from palmfield_papers.entries import book
from palmfield_papers.hasegawa2018 import PAPER, drive, focus, observer, units
from palmfield_papers.hasegawa2018.units import Units

ENTRIES = {entry.id: entry for entry in book().of_paper("Hasegawa 2018")}


def answer(name, control="", **readings):
    base = tuple((axis, readings.get(axis, value)) for axis, value in book().base(ENTRIES[name]))
    return PAPER.answers[name](Setting(readings=base, control=control, quick=True))


def test_every_claim_has_an_answer_and_every_answer_an_entry():
    assert set(PAPER.answers) <= set(ENTRIES)
    assert {name for name, entry in ENTRIES.items() if entry.counts} <= set(PAPER.answers)
    assert set(PAPER.causes) <= set(PAPER.answers)
    assert len(PAPER.answers) == len(focus.ANSWERS) + len(drive.ANSWERS) + len(observer.ANSWERS)


@pytest.mark.parametrize(("count", "depth"), [(1, 0.4), (4, 0.2), (4, 1.0)])
def test_at_its_focus_every_transducer_adds_its_magnitude(count, depth):
    array = units.array_of(Units(count))
    rays = np.array([0.0, 0.0, depth]) - array.positions
    distance = np.linalg.norm(rays, axis=1)
    x = units.wavenumber() * 4.5e-3 * np.hypot(rays[:, 0], rays[:, 1]) / distance
    shape = np.where(x > 1e-9, 2.0 * j1(x) / np.maximum(x, 1e-9), 1.0)
    loss = np.exp(-absorption_Np_m(units.ROOM, 40e3) * distance)
    exact = (array.p0_Pa_m / distance * shape * loss).sum() / np.sqrt(2.0)
    assert units.focal_pressure(Units(count), depth, "point") == pytest.approx(exact, rel=1e-4)


def test_losses_to_harmonics_by_fubinis_series():
    """Of a quiet drive, by sums of our own along the axis: 2 J1(s)/s = 1 - s^2/8 + s^4/192."""
    drive, array, room = 0.1, units.array_of(Units(4)), units.ROOM
    left = []
    for depth in (0.8, 0.2):
        at = np.linspace(5e-3, depth, 1501)
        rays = np.stack([np.zeros_like(at), np.zeros_like(at), at], axis=1)[:, None] - array.positions
        distance = np.linalg.norm(rays, axis=2)
        x = units.wavenumber() * 4.5e-3 * np.hypot(rays[..., 0], rays[..., 1]) / distance
        shape = np.where(x > 1e-9, 2.0 * j1(x) / np.maximum(x, 1e-9), 1.0)
        phase = np.exp(1j * units.wavenumber() * (distance - distance[-1]))
        loss = np.exp(-absorption_Np_m(room, 40e3) * distance)
        loud = np.abs((array.p0_Pa_m / distance * shape * loss * phase).sum(axis=1))
        s = drive * 1.2 * 2.0 * np.pi * 40e3 / (density(room) * sound_speed(room) ** 3) * np.trapezoid(loud, at)
        left.append(1.0 - s**2 / 8.0 + s**4 / 192.0)
    setting = Setting(readings=tuple(book().base(ENTRIES["H13-H14c"])))
    linear = focus.ratio(Units(4), 0.8, 0.2)
    for far, expected in ((True, left[0] / left[1]), (False, 1.0 / left[1])):
        found = focus.lossy_ratio(4, 0.8, drive, far)(setting).value / linear
        assert abs(expected - 1.0) > 5e-4
        assert found - 1.0 == pytest.approx(expected - 1.0, rel=0.1)


def test_the_microphone_takes_most_of_the_nearest_focus():
    """Four units at 100 mm arrive from up to 60 degrees; one at 1000 mm from ahead."""

    def left(count, depth):
        return units.focal_pressure(Units(count), depth) / units.focal_pressure(Units(count), depth, "point")

    assert left(4, 0.1) < left(4, 0.2) < left(1, 0.2) < left(1, 1.0) < 1.0
    assert left(1, 1.0) > 0.995


def test_points_arrive_louder_from_the_side_than_pistons():
    """The control: 4 units near at hand gain most, so that a far focus is relatively softer."""
    assert answer("H13-H14c", control="directivity_point").value < answer("H13-H14c").value
    assert answer("H13-H14c", hasegawa_reference="100 mm").value == pytest.approx(
        units.focal_pressure(Units(4), 0.8) / units.focal_pressure(Units(4), 0.1)
    )


def test_the_force_on_a_small_jig_is_pressure_times_area():
    edge = 1e-3
    rms = units.focal_pressure(Units(4), 0.2, "point")
    by_hand = 2.0 * rms**2 / units.impedance_Pa() * edge**2
    assert focus.force(Units(4), edge)[0] == pytest.approx(by_hand, rel=0.02)


def test_the_focus_is_where_it_is_commanded():
    """By symmetry the largest pressure of the focus on the axis lies there; beside it a delay rounds to 1/640."""
    assert focus.peaks_mm(Units(4), False)[0] == pytest.approx(0.0, abs=1e-3)
    assert np.array(focus.peaks_mm(Units(4), True)) == pytest.approx(1e3 * focus.STEPS_M, abs=0.02)


def test_a_steady_wish_is_met_but_for_a_tick():
    course = drive.emitted(drive.packets(np.full(400, 0.3), 1.5), 25.0)
    assert np.abs(course[2000:6000]) ** 2 == pytest.approx(0.3, abs=0.004)


@pytest.mark.parametrize(("frequency", "quality"), [(1000.0, 25.0), (300.0, 40.0)])
def test_lines_through_the_resonance_are_what_stepping_gives(frequency, quality):
    """The envelope by its Fourier lines against the pole stepped through ten periods."""
    step = 1e-6
    count = round(1.0 / (frequency * step))
    times = np.arange(10 * count) / count
    commanded = np.sqrt(0.5 + 0.5 * np.sin(2.0 * np.pi * times)).astype(complex)[:, None]
    stepped = filter_frames(commanded, 1.0 / (frequency * count), Pole(40e3, quality), linear=True)[-count:, 0]
    square, exact = np.abs(drive.continuous(frequency, quality)) ** 2, np.abs(stepped) ** 2
    assert square.mean() == pytest.approx(exact.mean(), rel=2e-4)
    first, by_steps = (2.0 * abs(np.fft.fft(one)[1]) / len(one) for one in (square, exact))
    assert first == pytest.approx(by_steps, rel=2e-4)


def test_quick_transducers_lose_nothing():
    assert drive.continuous_loss_dB("component", 0.05) == pytest.approx(0.0, abs=1e-3)


def test_the_sound_of_four_units_is_spread_in_time():
    """By the distances of the nearest and the farthest transducer to the focus at 200 mm."""
    distance = np.linalg.norm(units.array_of(Units(4)).positions - [0.0, 0.0, 0.2], axis=1)
    delays, weights = drive.flights()
    assert np.ptp(delays) / 40e3 == pytest.approx(np.ptp(distance) / 343.2, rel=0.03)
    assert weights.sum() == pytest.approx(1.0)


def test_numbers_by_hand():
    assert answer("H5c").value == pytest.approx(0.576)
    assert answer("H22c").value == pytest.approx(-11.94, abs=0.01)
    # in the middle of the window: beta F_M + F_M / 2
    assert answer("H18c").value == pytest.approx(1.5)
    assert answer("H13-H14j").value == pytest.approx(np.pi * 40e3 * 3.175e-3 / 343.2, rel=1e-3)
