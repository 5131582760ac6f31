"""The wind of a beam against closed forms, and against what was measured of such beams."""

import math

import numpy as np
import pytest
from scipy.special import jv

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.nonlinear import beams, wind
from palmfield.types import Air

AIR = Air()
F = 40e3
STIFF = density(AIR) * sound_speed(AIR) ** 2


def test_a_weak_gaussian_beams_wind_is_its_arp_along_the_axis() -> None:
    """ARP p^2/(rho c^2)/(1 + z^2/zR^2): the wind is stopped by alpha ARP zR (atan(a/zR) + atan(b/zR))."""
    rayleigh, before, step = 0.02, 0.2, 1e-4
    z = np.arange(-before, 0.5 * step, step)
    found = wind(step, 10.0 / np.sqrt(1.0 + (z / rayleigh) ** 2) * np.exp(1j * z), AIR, F)
    expected = absorption_Np_m(AIR, F) * 100.0 / STIFF * rayleigh * math.atan(before / rayleigh)
    assert found.pressure_Pa == pytest.approx(expected, rel=1e-3)
    assert 0.5 * density(AIR) * found.speed_m_s**2 == pytest.approx(expected, rel=1e-3)
    assert found.harmonics == pytest.approx(0.0, abs=1e-5)


def test_the_momentum_of_a_plane_wave_is_kept() -> None:
    """Of a weak one that falls by e^{-2 alpha x}: the wind has half, as a wall has twice the momentum that arrives."""
    step, count = 1e-3, 101
    found = wind(step, np.full(count, 1.0 + 0j), AIR, F)
    lost = 1.0 - math.exp(-2.0 * absorption_Np_m(AIR, F) * step * (count - 1))
    assert found.force == pytest.approx(lost / 2.0, rel=0.02)
    assert found.pressure_Pa == pytest.approx(found.force / STIFF)


@pytest.mark.parametrize("sigma", [0.3, 0.6, 0.9])
def test_harmonics_take_up_what_fubinis_series_says(sigma: float) -> None:
    """alpha goes with n^2: sum n^2 B_n^2, B_n = 2 J_n(n sigma)/(n sigma), over the way of a plane wave up to sigma."""
    per_m = 2.0
    pressure = per_m * density(AIR) * sound_speed(AIR) ** 3 / (1.2 * 2.0 * math.pi * F)
    way = sigma / per_m
    found = wind(way / 400, np.full(401, pressure + 0j), AIR, F)
    n = np.arange(1, 400)
    steps = np.linspace(1e-6, sigma, 400)
    shares = [float((n**2 * (2.0 * jv(n, n * s) / (n * s)) ** 2).sum()) for s in steps]
    expected = absorption_Np_m(AIR, F) * np.trapezoid(shares, steps) / per_m
    assert found.force == pytest.approx(expected, rel=0.01)
    assert found.harmonics == pytest.approx(2.0 * (expected - absorption_Np_m(AIR, F) * way), rel=0.05)


def test_a_measured_air_stream_is_slower_than_the_bound_and_not_by_much() -> None:
    """Hasegawa et al. 2017 (doi 10.1063/1.4985159): 3 m/s in a Bessel beam that reaches 400 mm from four units."""
    array = layout("autd2018_2x2")
    middle = array.positions.mean(axis=0)
    radius = np.linalg.norm((array.positions - middle)[:, :2], axis=1)
    # So that what comes from the far corners meets the axis at 400 mm or beyond
    sine = radius.max() / math.hypot(radius.max(), 0.4)
    speeds = []
    for part in (0.6, 0.8):
        drive = np.exp(-2j * math.pi * F / sound_speed(AIR) * part * sine * radius)
        ((step, pressures),) = beams(array, drive, middle + np.array([0.0, 0.0, 0.4]), AIR)
        speeds.append(wind(step, pressures, AIR, F).speed_m_s)
    assert all(3.0 < speed < 10.0 for speed in speeds)


def test_a_focus_of_an_array_of_16_by_16_has_winds_as_measured() -> None:
    """Stone et al. 2025 (arXiv 2503.21271) saw more than 0.4 m/s above a board of such transducers in one focus."""
    array, at = layout("sonicsurface"), np.array([0.0, 0.0, 0.1])
    ((step, pressures),) = beams(array, focus(array, AIR, at), at, AIR)
    assert 0.4 < wind(step, pressures, AIR, F).speed_m_s < 1.0
