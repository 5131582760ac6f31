"""A piston on its axis against Rayleigh's integral over its disc, and against the far field of arrays."""

import math
import re

import numpy as np
import pytest

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Float
from palmfield_papers.piston_axis import on_axis, rayleigh_length_m

AIR = Air()
K = 2.0 * np.pi * 40e3 / sound_speed(AIR)
K_343 = 2.0 * np.pi * 40e3 / 343.0


def rayleigh(distance_m: float, radius_m: float, order: int) -> complex:
    """p/p0 of a disc that moves as one, -ik/(2 pi) integral exp(ikR)/R dS in place of the difference of two waves.

    Over squares mapped onto the disc (x = u sqrt(1 - v^2/2), y = v sqrt(1 - u^2/2)), which knows nothing of rings.
    """
    nodes, weights = np.polynomial.legendre.leggauss(order)
    u, v = np.meshgrid(nodes, nodes)
    across: Float = radius_m * np.stack([u * np.sqrt(1.0 - v**2 / 2.0), v * np.sqrt(1.0 - u**2 / 2.0)])
    root_u, root_v = np.sqrt(1.0 - v**2 / 2.0), np.sqrt(1.0 - u**2 / 2.0)
    area = radius_m**2 * (root_u * root_v - u**2 * v**2 / (4.0 * root_u * root_v))
    way = np.sqrt(across[0] ** 2 + across[1] ** 2 + distance_m**2)
    # p0 = rho c V k a^2/2, with the far field's phase exp(ikr) in place of -i exp(ikr)
    summed = np.sum(np.outer(weights, weights) * area * np.exp(1j * K * way) / way)
    return complex(summed / (math.pi * radius_m**2))


@pytest.mark.parametrize("radius_m", [3e-3, 4.5e-3, 6e-3, 20e-3])
@pytest.mark.parametrize("distance_m", [2e-3, 5e-3, 20e-3, 0.2])
def test_the_difference_of_two_waves_is_the_integral_over_the_disc(radius_m: float, distance_m: float):
    coarse, fine = (rayleigh(distance_m, radius_m, order) for order in (150, 300))
    assert abs(coarse - fine) < 1e-6 * abs(fine), "the integral has not converged"
    assert on_axis(distance_m, radius_m, K) == pytest.approx(fine, rel=1e-6)


def test_far_away_it_is_the_field_of_arrays_to_second_order_in_the_distance():
    one = Array("one", np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), p0_Pa_m=2.53, piston_radius_m=4.5e-3)
    distances = np.array([0.1, 0.2, 0.4, 0.8])
    points = np.column_stack([0.0 * distances, 0.0 * distances, distances])
    field, _ = pressure64(points, one, [1.0], AIR, absorption_Np_m=0.0)
    exact = on_axis(distances, 4.5e-3, K, p0_Pa_m=2.53)
    # |sin x/x| with x = k (sqrt(r^2 + a^2) - r)/2, and 2/(1 + sqrt(1 + (a/r)^2))
    excess = np.abs(field) / np.abs(exact) - 1.0
    expected = (K * 4.5e-3**2 / 4.0) ** 2 / 6.0 + 4.5e-3**2 / 4.0
    np.testing.assert_allclose(excess * distances**2, expected, rtol=1e-2)
    # The phase is ahead by k a^2/(4r): the rim is farther away than the middle
    np.testing.assert_allclose(np.angle(exact / field) * distances, K * 4.5e-3**2 / 4.0, rtol=1e-3)


def test_zeros_and_maxima_near_the_face_of_a_large_piston():
    """Minima lie where rim and middle differ by whole wavelengths, maxima where by odd halves: p = 4 p0/(k a^2)."""
    a, wavelength = 20e-3, 2.0 * math.pi / K
    for n in (1, 2):
        assert abs(on_axis((a**2 - (n * wavelength) ** 2) / (2 * n * wavelength), a, K)) < 1e-9 / a
    for half in (0.5, 1.5):
        away = (a**2 - (half * wavelength) ** 2) / (2 * half * wavelength)
        assert abs(on_axis(away, a, K)) == pytest.approx(4.0 / (K * a**2), rel=1e-12)
    assert abs(on_axis(0.0, a, K)) == pytest.approx(4.0 / (K * a**2) * abs(math.sin(K * a / 2.0)), rel=1e-12)


def test_a_point_source_and_a_tiny_piston_agree():
    distances = np.array([[1e-3, 0.05], [0.3, 2.0]])
    point = on_axis(distances, 0.0, K, p0_Pa_m=2.0)
    assert point.shape == distances.shape
    np.testing.assert_allclose(point, 2.0 / distances * np.exp(1j * K * distances), rtol=1e-12)
    np.testing.assert_allclose(on_axis(distances, 1e-7, K, p0_Pa_m=2.0), point, rtol=1e-6)


def test_rayleigh_lengths_of_the_speakers_that_are_printed():
    """Of a diaphragm of 6 mm radius, of a speaker of 10 mm diameter, and of a diaphragm of 6 mm diameter."""
    lengths = [1e3 * rayleigh_length_m(a, K_343) for a in (6e-3, 5e-3, 3e-3)]
    assert lengths == pytest.approx([13.19, 9.16, 3.30], abs=0.01)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ((-0.01, 0.005, K), "distance_m has -0.01: give finite distances in metres, 0 or more"),
        (([0.1, math.nan], 0.005, K), "distance_m has nan"),
        ((0.0, 0.0, K), "above 0, because a point source has no face"),
        ((0.1, -0.005, K), "radius_m = -0.005: give a finite radius in metres, 0 or more"),
        ((0.1, math.inf, K), "radius_m = inf"),
        ((0.1, 0.005, 0.0), "wavenumber = 0.0: give a finite wavenumber in rad/m, above 0"),
        (("far", 0.005, K), "distance_m have type"),
    ],
)
def test_what_is_no_piston_is_refused(values: tuple[float, float, float], why: str):
    with pytest.raises(PalmfieldError, match=re.escape(why)):
        on_axis(*values)
