"""Level, plate, focus, sweep and warm-up, from readings made by sums that are written here or in `laboratory`."""

import math

import numpy as np
import pytest
from laboratory import Laboratory, speed_of_sound

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.drive.calibration.focus_scan import fit_pose
from palmfield.drive.calibration.frequency_sweep import fit_sweep
from palmfield.drive.calibration.level_ladder import fit_level, fit_warm_up
from palmfield.drive.calibration.plate_scale import fit_plate, plate_force
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array

AIR = Air()
BOARD = layout("sonicsurface", 1.0)
LEVELS = np.repeat(np.linspace(0.1, 1.0, 10), 3)


def noise(seed: int, count: int, sd: float = 0.01) -> np.ndarray:
    return np.random.default_rng(seed).normal(1.0, sd, count)


@pytest.mark.parametrize("exponent", [1.0, 0.75])
def test_the_ladders_exponent(exponent: float) -> None:
    level = fit_level(LEVELS, 700.0 * LEVELS**exponent * noise(1, 30))
    assert abs(level.exponent - exponent) < 3.0 * level.exponent_sd < 0.05
    assert level.linear_to == 1.0


def test_saturation_is_told_from_the_exponent() -> None:
    level = fit_level(LEVELS, 700.0 * np.minimum(LEVELS, 0.7 + 0.1 * (LEVELS - 0.7)) * noise(2, 30))
    assert level.linear_to == pytest.approx(0.7) and level.exponent == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("levels", "pressures", "told"),
    [
        ([0.1, 0.2, 0.3, 0.4], [1, 2, 3, 4], "at least 5"),
        ([0.0, 0.2, 0.3, 0.4, 0.5], [1, 2, 3, 4, 5], "level 0"),
        ([0.1, 0.2, 0.3, 0.4, 0.5], [1, 2, -3, 4, 5], "-3 Pa"),
        ([0.1, 0.2, 0.3, 0.4, 0.5], [5, 1, 9, 2, 7], "do not follow a power of the level"),
    ],
)
def test_ladders_that_do_not_serve(levels: list[float], pressures: list[float], told: str) -> None:
    with pytest.raises(PalmfieldError, match=told):
        fit_level(levels, pressures)


def one_transducer() -> Array:
    """A point source, for which the force on a plate is known."""
    return Array("one", np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 1.0, piston_radius_m=0.0)


def test_the_force_of_a_point_source_on_a_plate_is_the_local_laws_integral() -> None:
    """|p| = p0 e^{-br}/r, u_t = |p| sin/(rho c) for kr >> 1: F = p0^2/(rho c^2) int e^{-2br} cos^2/r^2 dA."""
    h, half = 0.15, 0.05
    force = plate_force(one_transducer(), AIR, np.ones(1, complex), (2 * half, 2 * half), h)
    x = (np.arange(400) + 0.5) / 400 * 2 * half - half
    r2 = x[:, None] ** 2 + x[None] ** 2 + h**2
    beta = absorption_Np_m(AIR, 40e3)
    exact = (np.exp(-2.0 * beta * np.sqrt(r2)) * h**2 / r2**2).sum() * (x[1] - x[0]) ** 2
    exact /= density(AIR) * sound_speed(AIR) ** 2
    assert force == pytest.approx(exact, rel=2e-3), "the near field's terms in 1/(kr)^2 are left out of the sum"


def scale_readings(p0: float, seed: int) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(seed)
    drive = focus(BOARD, AIR, (0.0, 0.0, 0.15))
    h = np.repeat(0.15 + np.linspace(0.0, 3.6e-3, 5), 10)
    on, time = np.tile([0.0, 1.0], 25), 4.0 * np.arange(50)
    f = {place: plate_force(BOARD, AIR, drive, (0.1, 0.1), place) for place in np.unique(h)}
    push = p0**2 * on * np.array([f[place] for place in h])
    fringes = 1.0 + 0.2 * np.cos(4.0 * math.pi * h * 40e3 / 343.0 + 1.0)
    shown = push * fringes + 3e-5 + 2e-6 * time + random.normal(0.0, 0.01 * push.max(), 50)
    return drive, h, time, on, shown


def test_p0_from_a_plate_with_fringes_draught_and_drift() -> None:
    drive, h, time, on, shown = scale_readings(1.7, 3)
    fit = fit_plate(BOARD, AIR, drive, (0.1, 0.1), h, time, on, shown)
    assert abs(fit.p0_Pa_m - 1.7) < 4.0 * fit.p0_sd_Pa_m < 0.04
    assert fit.fringe == pytest.approx(0.2, abs=0.02) and fit.drift_N_s == pytest.approx(2e-6, rel=0.2)
    assert fit.low_Pa_m < 1.7 < fit.high_Pa_m
    plain = np.mean(shown[on == 1]) / np.mean([plate_force(BOARD, AIR, drive, (0.1, 0.1), x) for x in np.unique(h)])
    assert abs(math.sqrt(plain) - 1.7) > abs(fit.p0_Pa_m - 1.7), "the fit is nearer than the mean force"


def test_plates_that_do_not_serve() -> None:
    drive, h, time, on, shown = scale_readings(1.7, 3)
    some = h < 0.152
    for told, given in (
        ("distances over", (h[some], time[some], on[some], shown[some])),
        ("array on or off: give both at each", (h, time, np.ones(50), shown)),
        ("pulls the plate", (h, time, on, -shown)),
        (r"force_N\[0\]", (h, time, on, np.where(np.arange(50) == 0, np.nan, shown))),
        ("on = 2", (h, time, 2 * on, shown)),
        ("the same time", (h, 0.0 * time, on, shown)),
    ):
        with pytest.raises(PalmfieldError, match=told):
            fit_plate(BOARD, AIR, drive, (0.1, 0.1), *given)


def test_the_boards_place_from_a_scan_in_warmer_air() -> None:
    """The laboratory's board lies off by 2 mm, and its air and directivity differ from the fit's."""
    offset, point = np.array([2.0e-3, -1.0e-3, 1.5e-3]), np.array([0.0, 0.0, 0.15])
    random = np.random.default_rng(4)
    drive = focus(BOARD, AIR, point)
    at = point + random.uniform(-1.0, 1.0, (50, 3)) * [0.012, 0.012, 0.04]
    lab = Laboratory(BOARD.positions + offset, drive, temperature_C=21.0, noise=0.003, random=random)
    seen = np.abs(lab.read(lab.each(at).sum(axis=1)))
    pose = fit_pose(BOARD, AIR, np.tile(point, (50, 1)), at, seen)
    gaps, errors = np.abs(np.array(pose.offset_m) - offset), np.array(pose.offset_sd_m)
    assert gaps[:2].max() < 0.2e-3 and gaps[2] < 1e-3
    assert np.all(gaps < 4.0 * np.maximum(errors, 5e-5)) and pose.turn_sd_rad == (0.0, 0.0, 0.0)


def test_scans_that_do_not_serve() -> None:
    point = np.tile([0.0, 0.0, 0.15], (8, 1))
    at = point + np.random.default_rng(0).normal(0.0, 5e-3, (8, 3))
    for told, given in (
        ("8 of each", (point[:5], at[:5], np.ones(5))),
        ("negative", (point, at, -np.ones(8))),
        ("mm from it", (point, at + np.array([0.1, 0.0, 0.0]), np.ones(8))),
    ):
        with pytest.raises(PalmfieldError, match=told):
            fit_pose(BOARD, AIR, *given)


def test_resonance_and_quality_from_a_sweep_in_another_room() -> None:
    """The pole is that of a driven oscillator, x'' + (w0/Q) x' + w0^2 x = ..., in full, and places are 1 mm off."""
    random = np.random.default_rng(6)
    point, f0, quality = (0.0, 0.0, 0.15), 40_300.0, 22.0
    drive = focus(BOARD, AIR, point)
    at = np.array(point) + random.uniform(-1.0, 1.0, (8, 3)) * [3e-3, 3e-3, 10e-3]
    f = np.linspace(38e3, 42e3, 41)
    seen = np.empty((8, 41), complex)
    really = at + random.normal(0.0, 1e-3, at.shape)
    for q, frequency in enumerate(f):
        way = np.linalg.norm(really[:, None] - BOARD.positions, axis=2)
        wave = np.exp(2j * np.pi * frequency / speed_of_sound(20.7) * way) / way
        pole = (f0 * frequency / quality) / (f0 * frequency / quality - 1j * (frequency**2 - f0**2))
        seen[:, q] = pole * (wave @ drive)
    seen *= random.normal(1.0, 0.01, seen.shape)
    fit = fit_sweep(BOARD, AIR, drive, at, f, seen)
    assert fit.resonance_Hz == pytest.approx(f0, abs=30.0) and fit.quality == pytest.approx(quality, rel=0.05)
    assert fit.misfit < 0.05
    with pytest.raises(PalmfieldError, match="outside the sweep"):
        fit_sweep(BOARD, AIR, drive, at, f[:12], seen[:, :12])
    with pytest.raises(PalmfieldError, match="8 positions"):
        fit_sweep(BOARD, AIR, drive, at[:4], f, seen[:4])


def test_warm_up() -> None:
    time = np.arange(0.0, 1500.0, 50.0)
    warm_up = fit_warm_up(time, 800.0 * (1.0 + 0.08 * np.exp(-time / 240.0)) * noise(5, len(time), 2e-3))
    assert abs(warm_up.drop - 0.08) < 3.0 * warm_up.drop_sd < 0.01
    assert warm_up.time_s == pytest.approx(240.0, rel=0.15)
    for told, given in (
        ("6 of each", (time[:5], np.ones(5))),
        ("above 0", (time, -np.ones(len(time)))),
        ("record for longer|record until", (time[:8], 800.0 - time[:8])),
    ):
        with pytest.raises(PalmfieldError, match=told):
            fit_warm_up(*given)
