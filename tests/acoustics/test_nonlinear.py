"""Steepening along a beam against published figures, and what a shock takes against a solver of Burgers' equation."""

import numpy as np
import pytest

from palmfield.acoustics.arrays import combined, layout, placed, with_faults
from palmfield.acoustics.focus import focus
from palmfield.acoustics.nonlinear import arp_left, beam_steepening, fundamental_left, steepening
from palmfield.errors import PalmfieldError
from palmfield.types import Air

AIR = Air()
AT = np.array([0.0, 0.0, 0.2])


@pytest.mark.parametrize(("pressure", "published_m"), [(1300.0, 0.124), (8500.0, 0.019)])
def test_a_plane_wave_has_a_shock_where_sigma_is_1(pressure: float, published_m: float) -> None:
    assert steepening(np.full(11, 1j * pressure), published_m / 10, AIR, 40e3) == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(("p0", "sigma"), [(1.27, 0.52), (2.53, 1.03), (3.4, 1.38)])
def test_sigma_of_a_16_by_16_array_at_200_mm(p0: float, sigma: float) -> None:
    array = layout("uhev1", p0)
    assert beam_steepening(array, focus(array, AIR, AT), AT, AIR) == pytest.approx(sigma, abs=0.006)


def test_a_beam_steepens_by_what_is_driven() -> None:
    array = layout("uhev1")
    drive = focus(array, AIR, AT)
    whole = beam_steepening(array, drive, AT, AIR)
    assert beam_steepening(array, 0.5 * drive, AT, AIR) == pytest.approx(0.5 * whole)
    dead = with_faults(array, dead=range(128))
    assert beam_steepening(dead, drive, AT, AIR) == pytest.approx(
        beam_steepening(array, drive * (dead.gain != 0), AT, AIR)
    )
    assert beam_steepening(array, 0.0 * drive, AT, AIR) == 0.0


def test_sound_from_all_sides_steepens_by_what_comes_from_one() -> None:
    """Two boards that face each other, whose mean direction and middle would be those of no beam; one louder."""
    array = layout("uhev1")
    other = placed(array, np.array([0.0, 0.0, 0.4]), np.diag([1.0, -1.0, -1.0]))
    both = combined([array, other])
    drive = np.concatenate([focus(array, AIR, AT), 0.7 * focus(other, AIR, AT)])
    alone = beam_steepening(array, drive[: len(array)], AT, AIR)
    assert beam_steepening(both, drive, AT, AIR) == pytest.approx(alone, rel=1e-6)
    drive[: len(array)] = 0.0
    assert beam_steepening(both, drive, AT, AIR) == pytest.approx(0.7 * alone, rel=1e-6)


def burgers(sigma: float, cells: int = 4096) -> np.ndarray:
    """sin steepened by u_t + u u_x = 0 up to t = sigma, Godunov's scheme of second order (minmod), periodic."""
    x = (np.arange(cells) + 0.5) * 2.0 * np.pi / cells
    u, width, time = np.sin(x), 2.0 * np.pi / cells, 0.0

    def rate(v: np.ndarray) -> np.ndarray:
        before, after = v - np.roll(v, 1), np.roll(v, -1) - v
        slope = np.where(before * after > 0.0, np.where(abs(before) < abs(after), before, after), 0.0)
        left, right = v + slope / 2, np.roll(v - slope / 2, -1)
        flux = np.maximum(np.maximum(left, 0.0) ** 2, np.minimum(right, 0.0) ** 2) / 2
        return -(flux - np.roll(flux, 1)) / width

    while time < sigma:
        step = min(0.4 * width / abs(u).max(), sigma - time)
        half = u + step * rate(u)
        u, time = (u + half + step * rate(half)) / 2, time + step
    return u


@pytest.mark.parametrize("sigma", [0.5, 0.9, 1.2, 1.5, 2.0, 2.6])
def test_what_is_left_is_that_of_burgers_equation(sigma: float) -> None:
    u = burgers(sigma)
    assert arp_left(sigma) == pytest.approx(2.0 * np.mean(u**2), abs=1e-3)
    assert fundamental_left(sigma) == pytest.approx(2.0 * abs(np.fft.rfft(u)[1]) / len(u), abs=1e-3)


def test_published_losses() -> None:
    """2.6 % at 1.2, 14 % at 1.5, 34 % at 2; a microphone's line loses 12 % at 1, where the ARP has lost nothing."""
    assert [round(100 * (1 - arp_left(sigma)), 1) for sigma in (1.0, 1.2)] == [0.0, 2.6]
    assert [round(100 * (1 - arp_left(sigma))) for sigma in (1.5, 2.0)] == [14, 34]
    assert round(100 * (1 - fundamental_left(1.0))) == 12 and fundamental_left(0.0) == 1.0


def test_bad_input() -> None:
    with pytest.raises(PalmfieldError, match=r"pressures_Pa\[1\] is not finite"):
        steepening([1.0, np.nan], 0.1, AIR, 40e3)
    for wrong in (-0.1, np.nan):
        with pytest.raises(PalmfieldError, match="give 0 or more"):
            arp_left(wrong)
