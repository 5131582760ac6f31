"""Lines of repeated loads against Hankel integrals: a spot at rest, and one on a circle."""

import math

import numpy as np
import pytest
from repeated_load import FlatLayer, RepeatedSpot
from scipy.special import jv

from palmfield.errors import SceneError
from palmfield.skin import preset
from palmfield.skin.analytic.layer_oracle import centre_response, layer_compliance

PALM, FWHM = preset("palm"), 0.0103
PHASE = 2.0 * math.pi * (np.arange(256) + 0.5) / 256


def place(layer, distance_m):
    return int(np.argmin(np.abs(layer.places() - distance_m)))


@pytest.mark.parametrize("rate_Hz", [5.0, 50.0, 200.0, 500.0])
def test_a_sine_at_rest_is_the_layers_own_answer(rate_Hz):
    """Amplitude and phase: sin(w t) is i e^{-iwt}."""
    layer = FlatLayer(PALM, 0.01)
    spot = RepeatedSpot(np.zeros((256, 2)), 2.0 + np.sin(PHASE), FWHM)
    line = layer.lines([spot], rate_Hz, [1])[0]
    exact = 1j * centre_response(rate_Hz, PALM, 0.01, FWHM, at=np.array([0.0, 0.02, 0.04]))
    columns = [place(layer, x) for x in (0.0, 0.02, 0.04)]
    middle = place(layer, 0.0)
    for found in (line[middle, columns], line[columns, middle]):
        assert np.abs(found - exact).max() < 2e-3 * abs(exact[0])


@pytest.mark.parametrize("order", [1, 3, 7])
def test_a_circle_has_bessel_functions_for_lines(order):
    """Twice the integral of C P J_n(kR) J_n(kr) k dk: by Jacobi and Anger's expansion."""
    radius, rate = 0.02, 70.0
    layer = FlatLayer(PALM, 0.01)
    centres = radius * np.column_stack([np.cos(PHASE), np.sin(PHASE)])
    line = layer.lines([RepeatedSpot(centres, np.ones(256), FWHM)], rate, [order])[0]
    k = np.linspace(0.0, 1800.0, 20001)
    spread = FWHM / math.sqrt(8.0 * math.log(2.0))
    waves = layer_compliance(k, order * rate, PALM, 0.01) * spread**2 * np.exp(-0.5 * (k * spread) ** 2) * k
    for distance in (0.01, 0.02, 0.04):
        exact = 2.0 * abs(np.trapezoid(waves * jv(order, k * radius) * jv(order, k * distance), k))
        assert abs(line[place(layer, 0.0), place(layer, distance)]) == pytest.approx(exact, rel=3e-3)


def test_a_wider_square_changes_nothing_and_a_finer_one_little():
    """Waves die out within the square; its grid may miss a maximum between places, by 0.2 dB at most."""
    spot = RepeatedSpot(np.column_stack([0.002 * np.sign(np.cos(PHASE)), np.zeros(256)]), np.ones(256), FWHM)
    own, wide, fine = (
        np.abs(FlatLayer(PALM, 0.01, span_m=span, cells=cells).lines([spot], 40.0, [1, 3, 5])).max(axis=(1, 2))
        for span, cells in ((0.4, 160), (0.6, 240), (0.4, 640))
    )
    assert own == pytest.approx(wide, rel=1e-4)
    assert own == pytest.approx(fine, rel=0.02)


def test_two_spots_add():
    layer = FlatLayer(PALM, 0.01, cells=80)
    one, other = (RepeatedSpot(np.full((2, 2), x), np.array([1.0, 0.0]), FWHM) for x in (0.0, 0.01))
    both = layer.lines([one, other], 100.0, [1])
    assert both == pytest.approx(layer.lines([one], 100.0, [1]) + layer.lines([other], 100.0, [1]), rel=1e-9)


def test_what_can_not_be_is_refused():
    with pytest.raises(SceneError, match=r"allowed: \(p, 2\)"):
        RepeatedSpot(np.zeros((3, 2)), np.ones(2), FWHM)
    with pytest.raises(SceneError, match="give a width above 0"):
        RepeatedSpot(np.zeros((1, 2)), np.ones(1), 0.0)
    spot = RepeatedSpot(np.zeros((1, 2)), np.ones(1), FWHM)
    with pytest.raises(SceneError, match="orders of 0 or more"):
        FlatLayer(PALM, 0.01).lines([spot], 10.0, [-1])


def test_the_mean_is_that_of_a_load_at_rest():
    """Order 0 of a spot that rests half of the time; below the surface half spaces damp by (1 + k z) e^{-k z}."""
    layer = FlatLayer(PALM, 0.02, cells=80)
    rest = RepeatedSpot(np.zeros((1, 2)), np.ones(1), FWHM)
    half = RepeatedSpot(np.zeros((2, 2)), np.array([1.0, 0.0]), FWHM)
    for below in ({}, {"depth_m": 7e-4, "compression": True}):
        mean, whole = (layer.lines([one], 7.0, [0], **below)[0].real for one in (half, rest))
        np.testing.assert_allclose(mean, 0.5 * whole, rtol=1e-9, atol=1e-12 * whole.max())
    middle = layer.cells // 2
    static = centre_response(0.0, PALM, 0.02, FWHM).real
    assert layer.lines([rest], 7.0, [0])[0, middle, middle].real == pytest.approx(float(static), rel=0.01)
