"""The focus that phases make, and what rounding leaves of a real one."""

import numpy as np
import pytest
from scipy.optimize import minimize

from palmfield.acoustics.arrays import layout
from palmfield.drive.boards import BOARDS
from palmfield.drive.focal_peak import loudest_point
from palmfield.drive.focus_fit import fitted_focus

K = 2 * np.pi * 40e3 / 343.2
PLACES = layout("sonicsurface").positions


def focusing(point: np.ndarray) -> np.ndarray:
    return np.exp(-1j * K * np.linalg.norm(PLACES - point, axis=1))


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.12), (0.05, -0.05, 0.2), (-0.03, 0.04, 0.45), (0.08, 0.0, 0.1)])
def test_an_exact_focus_is_found_from_anywhere(point):
    found, misfit = fitted_focus(PLACES, 0.3 * np.exp(1j) * focusing(np.array(point)), K)
    np.testing.assert_allclose(found, point, atol=1e-7)
    assert misfit < 1e-6


def test_what_makes_no_focus_has_a_large_misfit():
    rng = np.random.default_rng(0)
    _, misfit = fitted_focus(PLACES, np.exp(2j * np.pi * rng.random(256)), K)
    assert misfit > 1.0
    place, misfit = fitted_focus(PLACES, np.zeros(256, complex), K)
    assert np.isnan(place).all() and np.isnan(misfit)


def pressure(points: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Of monopoles, without absorption."""
    distance = np.linalg.norm(points[:, None] - PLACES, axis=2)
    return (drive * np.exp(1j * K * distance) / distance).sum(axis=1)


def peak_in_plane(drive: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, float]:
    """The loudest point of the plane through a focus, and |p| there."""
    scale = abs(pressure(near[None], drive)[0])
    found = minimize(
        lambda xy: -abs(pressure(np.array([[*xy, near[2]]]), drive)[0]) / scale,
        near[:2],
        method="Nelder-Mead",
        options={
            "xatol": 1e-7,
            "fatol": 1e-12,
            "initial_simplex": near[:2] + 1e-3 * np.array([[0, 0], [1, 0], [0, 1]]),
        },
    )
    return found.x, -found.fun * scale


@pytest.mark.parametrize("name", ["sonicsurface", "openmpd"])
def test_in_the_focal_plane_rounding_moves_the_peak_by_little_and_keeps_its_pressure(name):
    board = BOARDS[name]
    # Both have 256 transducers 10.5 mm apart; the phases are asked for in the order of PLACES
    worst_m, least = 0.0, 1.0
    for x in (-0.05, 0.0, 0.05):
        for y in (-0.05, 0.01, 0.05):
            for z in (0.12, 0.17, 0.25):
                focus = np.array([x, y, z])
                asked = focusing(focus)
                before, whole = peak_in_plane(asked, focus)
                after, kept = peak_in_plane(board.decode(board.encode(asked))[-1], focus)
                worst_m, least = max(worst_m, float(np.hypot(*(after - before)))), min(least, kept / whole)
    assert worst_m <= 0.3e-3
    assert least >= 0.99


@pytest.mark.parametrize(("z", "low", "high"), [(0.12, 2.0, 6.0), (0.234, 8.0, 16.0)])
def test_the_loudest_point_lies_nearer_than_the_focus(z, low, high):
    focus = np.array([0.0, 0.0, z])
    drive = focusing(focus)
    loudest = loudest_point(lambda points: pressure(points, drive), np.zeros(3), focus)
    assert low < 1e3 * (z - loudest[2]) < high
    axis = np.column_stack([np.zeros((4001, 2)), np.linspace(0.5 * z, 1.2 * z, 4001)])
    assert loudest[2] == pytest.approx(axis[np.abs(pressure(axis, drive)).argmax(), 2], abs=1e-4)
