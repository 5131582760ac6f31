"""Metrics of maps against Gaussian spots, discs and images whose answers are known."""

import numpy as np
import pytest
from scipy.optimize import brentq

from palmfield.errors import MeasurementError
from palmfield.metrics import (
    area_above,
    average_residual_energy,
    energy_density,
    focal_energy_ratio,
    half_width,
    level_depth,
    mse,
    radial_profile,
    spot_diameter,
    ssim,
    strip,
)

X = np.arange(-0.040, 0.0405, 0.001)
Y = np.arange(-0.045, 0.0455, 0.001)
XX, YY = np.meshgrid(X, Y, indexing="ij")
FWHM = 0.0103


def gaussian(fwhm_x, fwhm_y=None):
    return np.exp(-4.0 * np.log(2.0) * ((XX / fwhm_x) ** 2 + (YY / (fwhm_y or fwhm_x)) ** 2))


@pytest.mark.parametrize("level", [0.1, 0.2, 0.5])
def test_diameter_of_a_gaussian_is_that_of_its_formula(level):
    exact = FWHM * np.sqrt(np.log(1.0 / level) / np.log(2.0))
    for of in ("equal_area", "widest"):
        assert spot_diameter(-3e-6 * gaussian(FWHM), X, Y, level, of=of) == pytest.approx(exact, rel=0.01)


def test_an_oval_spot_has_two_diameters():
    exact = np.sqrt(np.log(5.0) / np.log(2.0))
    oval = gaussian(0.008, 0.016)
    assert spot_diameter(oval, X, Y, 0.2) == pytest.approx(exact * np.sqrt(0.008 * 0.016), rel=0.01)
    assert spot_diameter(oval, X, Y, 0.2, of="widest") == pytest.approx(exact * 0.016, rel=0.01)


def test_a_ring_has_the_area_between_its_circles():
    radius = np.hypot(XX, YY)
    ring = 1.0 - np.abs(radius - 0.02) / 0.01
    assert area_above(ring, X, Y, 0.5) == pytest.approx(np.pi * (0.025**2 - 0.015**2), rel=0.005)


def test_spots_that_reach_the_rim_and_maps_of_zeros_are_refused():
    with pytest.raises(MeasurementError, match="give a wider map"):
        spot_diameter(gaussian(0.06), X, Y)
    with pytest.raises(MeasurementError, match="0 everywhere"):
        spot_diameter(0.0 * XX, X, Y)
    with pytest.raises(MeasurementError, match="has shape"):
        spot_diameter(XX.T, X, Y)


def test_radial_profile_of_a_gaussian():
    points = np.stack([XX.ravel(), YY.ravel()], axis=1)
    edges = np.arange(0.0, 0.0305, 0.0025)
    found = radial_profile(gaussian(0.02).ravel(), points, edges)
    c = 4.0 * np.log(2.0) / 0.02**2
    exact = (np.exp(-c * edges[:-1] ** 2) - np.exp(-c * edges[1:] ** 2)) / (c * np.diff(edges**2))
    assert found == pytest.approx(exact, abs=0.02)
    assert np.isnan(radial_profile([1.0], [[0.0, 0.0]], [0.0, 1.0, 2.0])[1])


def test_halved_depth_of_a_spherical_wave_is_twice_the_reference():
    depth = np.linspace(0.1, 1.0, 1801)
    assert level_depth(depth, 1.0 / depth, 0.2) == pytest.approx(0.4, abs=1e-6)
    assert level_depth(depth, 1.0 / depth, 0.2, 0.25) == pytest.approx(0.8, abs=1e-6)
    with pytest.raises(MeasurementError, match="give a longer curve"):
        level_depth(depth, 1.0 / depth, 0.6)


def test_focal_energy_ratio_of_a_gaussian_line():
    """Energy exp(-y^2/s^2) along a way over all x: inside |y| < w/2 lies erf(w/2s)."""
    from math import erf

    s, width = 0.01, 0.0121
    density = np.exp(-((YY / s) ** 2))
    y = Y
    inside = strip(X, y, [(-0.04, 0.0), (0.04, 0.0)], width)
    share = erf(0.5 * 0.013 / s)  # places 1 mm apart stand for half a millimetre on: |y| <= 6 mm is 6.5 mm
    assert focal_energy_ratio(density, X, y, inside, over="total") == pytest.approx(share, rel=1e-3)
    assert focal_energy_ratio(density, X, y, inside) == pytest.approx(share / (1.0 - share), rel=2e-3)
    outside = average_residual_energy(density, X, y, inside)
    assert outside == pytest.approx((1.0 - share) * np.sqrt(np.pi) * s / (0.09 - 0.013), rel=2e-3)


def test_a_strip_keeps_its_distance_from_a_bent_path():
    inside = strip(X, Y, [(0.0, -0.02), (0.0, 0.0), (0.02, 0.0)], 0.0102)
    assert inside[np.abs(X) < 1e-9].ravel()[np.abs(Y + 0.02) < 1e-9].all()
    far = np.minimum(np.hypot(XX, YY - np.clip(YY, -0.02, 0.0)), np.hypot(XX - np.clip(XX, 0.0, 0.02), YY))
    assert np.array_equal(inside, far <= 0.0051)


def test_energy_density_of_a_sine_is_half_its_square():
    t = np.arange(1000) / 1e4
    speed = np.sin(2 * np.pi * 100 * t)[:, None] * np.array([1.0, 3.0])
    assert energy_density(t, speed) == pytest.approx([0.5, 4.5])


def test_mse_of_scaled_maps_is_0_and_else_that_of_the_difference():
    spot = gaussian(FWHM)
    assert mse(spot, 7.0 * spot) == pytest.approx(0.0, abs=1e-30)
    assert mse(spot, spot + 0.25, normalised=False) == pytest.approx(0.0625)
    with pytest.raises(MeasurementError, match="zeros"):
        mse(spot, 0.0 * spot)


def test_ssim_is_the_mean_of_the_formula_over_windows():
    """Against the printed formula, window by window."""
    rng = np.random.default_rng(1)
    a, b = rng.random((19, 16)), rng.random((19, 16))
    at = np.arange(-5, 6)
    weight = np.exp(-0.5 * (at[:, None] ** 2 + at**2) / 1.5**2)
    weight /= weight.sum()
    index = []
    for i in range(5, 14):
        for j in range(5, 11):
            u, v = (m[i - 5 : i + 6, j - 5 : j + 6] for m in (a, b))
            mu, mv = (weight * u).sum(), (weight * v).sum()
            vu, vv = (weight * (u - mu) ** 2).sum(), (weight * (v - mv) ** 2).sum()
            c = (weight * (u - mu) * (v - mv)).sum()
            index.append((2 * mu * mv + 1e-4) * (2 * c + 9e-4) / ((mu**2 + mv**2 + 1e-4) * (vu + vv + 9e-4)))
    assert ssim(a, b, normalised=False) == pytest.approx(np.mean(index), rel=1e-9)
    assert ssim(a, 3.0 * a) == pytest.approx(1.0)
    with pytest.raises(MeasurementError, match="11 points"):
        ssim(a[:8], b[:8])
    for wrong in ({"sigma": 0.0}, {"sigma": -1.0}, {"radius": -1}):
        with pytest.raises(MeasurementError, match=f"{next(iter(wrong))} is"):
            ssim(a, b, **wrong)


def test_half_width_of_a_hump_is_half_its_full_width():
    at = np.linspace(-0.02, 0.03, 2001)
    assert half_width(at, np.exp(-4.0 * np.log(2.0) * ((at - 0.004) / 0.012) ** 2)) == pytest.approx(0.006, rel=1e-4)
    # a triangle that falls twice as fast on one side: (1 + 2)/2 of the short half-width
    slope = np.where(at < 0.0, 1.0 + at / 0.004, 1.0 - at / 0.008)
    assert half_width(at, np.maximum(slope, 0.0)) == pytest.approx(0.003, rel=1e-3)


def test_half_width_of_fringes_is_that_of_the_envelope_or_of_the_middle_one():
    """Fringes 8 mm apart under a Gaussian of half-width 11 mm: the crests at +-8 mm reach half, those at +-16 don't."""
    at = np.linspace(-0.05, 0.05, 20_001)

    def curve(x):
        return np.exp(-np.log(2.0) * (x / 0.011) ** 2) * np.cos(np.pi * x / 0.008) ** 2

    central = brentq(lambda x: curve(x) - 0.5, 0.0, 0.004)
    outermost = brentq(lambda x: curve(x) - 0.5, 0.0079, 0.012)
    assert half_width(at, curve(at), of="central") == pytest.approx(central, rel=1e-5)
    assert half_width(at, curve(at)) == pytest.approx(outermost, rel=1e-5)


def test_half_width_refuses_a_curve_that_ends_too_soon():
    with pytest.raises(MeasurementError, match=r"0\.01 m, the curve still exceeds 0\.5"):
        half_width([-0.01, 0.0, 0.01], [0.1, 1.0, 0.6])
    with pytest.raises(MeasurementError, match="0 everywhere"):
        half_width([0.0, 1.0, 2.0], [0.0, 0.0, 0.0])
    with pytest.raises(MeasurementError, match="outermost or central"):
        half_width([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], of="inner")


def test_areas_of_nothing_are_refused():
    with pytest.raises(MeasurementError, match="inside has shape"):
        focal_energy_ratio(gaussian(FWHM), X, Y, XX[:5] > 0.0)
    with pytest.raises(MeasurementError, match="level is nan"):
        area_above(gaussian(FWHM), X, Y, np.nan)
    with pytest.raises(MeasurementError, match="path_m at"):
        strip(X, Y, [[np.nan, 0.0], [1.0, 1.0]], 0.1)
