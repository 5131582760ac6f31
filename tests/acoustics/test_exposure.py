"""Levels and audible by-products against tables and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.exposure import (
    a_weighting_dB,
    ball_points,
    demodulated_Pa,
    dose_dB,
    force_sound_Pa,
    level_dB,
    radiated_power_W,
)
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air

AIR = Air()


def test_levels_are_over_20_micropascal():
    assert level_dB(1.0) == pytest.approx(93.9794, abs=1e-4)
    assert level_dB(0.0) == -math.inf
    # Half of a working day at 90 dB is 87 dB over all of it
    assert dose_dB((20e-6 * 10**4.5) ** 2, 4 * 3600.0) == pytest.approx(90.0 - 10 * math.log10(2.0))


def test_a_weighting_is_that_of_iec_61672():
    """Table 3 of the standard, rounded to 0.1 dB there."""
    table = {31.5: -39.4, 63: -26.2, 100: -19.1, 200: -10.9, 500: -3.2, 1000: 0.0, 2000: 1.2, 4000: 1.0, 8000: -1.1}
    nominal = 1000.0 * 10 ** (np.round(10 * np.log10(np.array(list(table)) / 1000.0)) / 10)
    np.testing.assert_allclose(a_weighting_dB(nominal), list(table.values()), atol=0.06)


def test_a_ball_has_its_middle_and_no_corner():
    points = ball_points(np.array([1.0, 0.0, 0.0]), 0.05, 0.01)
    radius = np.linalg.norm(points - [1.0, 0.0, 0.0], axis=1)
    assert radius.min() == 0.0 and radius.max() == pytest.approx(0.05)
    assert len(points) * 1e-6 == pytest.approx(4 / 3 * math.pi * 0.05**3, rel=0.05)


@pytest.mark.parametrize("frequency_Hz", [40e3, 25e3])
def test_power_is_what_goes_through_a_far_half_sphere(frequency_Hz):
    """One transducer of several, by its field in float64 there, with absorption taken off."""
    array = replace(layout("sonicsurface"), frequency_Hz=frequency_Hz)
    drive = np.zeros(len(array), complex)
    drive[17] = 0.7j
    radius, angles = 2.0, (np.arange(900) + 0.5) * 0.5 * np.pi / 900
    x, z = np.sin(angles), np.cos(angles)
    places = array.positions[17] + radius * np.column_stack([x, np.zeros_like(x), z])
    intensity = np.abs(pressure64(places, array, drive, AIR)[0]) ** 2 / (2 * density(AIR) * sound_speed(AIR))
    intensity *= math.exp(2 * absorption_Np_m(AIR, frequency_Hz) * radius)
    through = float(np.sum(intensity * 2 * np.pi * radius**2 * x) * 0.5 * np.pi / 900)
    assert radiated_power_W(array, drive, AIR) == pytest.approx(through, rel=1e-4)
    with pytest.raises(PalmfieldError, match="a drive has shape"):
        radiated_power_W(array, drive[:3], AIR)


def test_sound_of_modulated_ultrasound_is_berktays_where_absorption_ends_the_beam():
    """p = (1 + B/2A) P0^2 S/(16 pi rho c^4 alpha r) d2/dt2 E^2 (Berktay 1965), with all of E^2 going up and down."""
    p0, area, alpha, far, f = 30.0, 0.02, 0.15, 4.0, 200.0
    rho, c = density(AIR), sound_speed(AIR)
    berktay = 1.2 * p0**2 * area * (2 * math.pi * f) ** 2 / (16 * math.pi * rho * c**4 * alpha * far)
    power = p0**2 * area / (2 * rho * c)
    assert demodulated_Pa(power, 1 / (2 * alpha), far, f, AIR) == pytest.approx(berktay, rel=1e-12)


def test_sound_of_a_force_is_the_gradient_of_a_monopoles():
    """-F d/dx of e^{ikr}/(4 pi r), by differences."""
    k = 2 * math.pi * 300.0 / sound_speed(AIR)

    def monopole(r):
        return np.exp(1j * k * r) / (4 * math.pi * r)

    for r in (0.1, 0.5, 3.0):
        slope = 2e-3 * abs(monopole(r + 1e-5) - monopole(r - 1e-5)) / 2e-5
        assert force_sound_Pa(2e-3, r, 300.0, AIR) == pytest.approx(slope, rel=1e-6)
