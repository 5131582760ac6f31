"""The slant stack on fronts of known slope, and on a deep slab under a focus faster than its Rayleigh wave."""

import numpy as np
import pytest
from scipy.optimize import brentq

from palmfield.errors import SceneError
from palmfield.skin.analytic.mach import mach_half_angle
from palmfield.skin.materials.material import Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import SkinProblem, Slab, Spot
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves

X, Y = np.arange(-0.1, 0.1001, 1e-3), np.arange(-0.06, 0.0601, 1e-3)
SHEAR, DENSITY, NU = 23087.5, 923.5, 0.495


@pytest.mark.parametrize("angle", [27.0, 45.3, 60.0, 78.8])
def test_straight_fronts(angle):
    """Pulses along straight fronts, over round waves of a tenth, and noise; to 0.3 degrees."""
    b = np.radians(angle)
    x, y = np.meshgrid(X, Y, indexing="ij")
    s = (x - 0.07) * np.sin(b) + np.abs(y) * np.cos(b)
    round_waves = np.cos(900.0 * np.hypot(x - 0.03, y))
    noise = np.random.default_rng(1).normal(size=x.shape)
    snapshot = (
        -np.exp(-((s / 0.004) ** 2)) + 0.5 * np.exp(-(((s + 0.01) / 0.005) ** 2)) + 0.1 * round_waves + 0.3 * noise
    )
    assert mach_half_angle(snapshot, X, Y, 0.01) == pytest.approx(angle, abs=0.3)


def test_bad_input():
    with pytest.raises(SceneError, match="shape"):
        mach_half_angle(np.zeros((3, 3)), X, Y, 0.01)
    with pytest.raises(SceneError, match="three rows"):
        mach_half_angle(np.zeros((len(X), len(Y))), X, Y, 0.06)


def rayleigh_ratio():
    """c_R / c_s from Rayleigh's equation (2 - q)^2 = 4 sqrt(1 - q) sqrt(1 - q c_s^2 / c_p^2), q = (c_R / c_s)^2."""
    r = (1.0 - 2.0 * NU) / (2.0 - 2.0 * NU)
    return np.sqrt(brentq(lambda q: (2.0 - q) ** 2 - 4.0 * np.sqrt((1.0 - q) * (1.0 - q * r)), 0.5, 0.9999))


@pytest.mark.nightly
def test_deep_slab_follows_the_rayleigh_wave():
    """100 mm deep, 5.5 m/s over 240 mm, long enough for the front to leave the start's own waves behind."""
    both = Material("both", DENSITY, SHEAR, (), bulk_from_poisson(NU, SHEAR), "", 0.0202, True)
    speed, start, end = 5.5, -0.16, 0.08
    time = (end - start) / speed
    spot = Spot(0.01, np.array([0.0, time]), np.ones(2), np.array([[start, 0.0], [end, 0.0]]))
    x, y = np.arange(-0.02, 0.1001, 2e-3), np.arange(-0.06, 0.0601, 2e-3)
    at = np.stack([part.ravel() for part in np.meshgrid(x, y, indexing="ij")], axis=1)
    found = solve_lateral_waves(SkinProblem(Slab((Sheet(both, 0.1),)), spot, np.array([time]), at), tolerance=0.1)
    angle = mach_half_angle(found.velocity_m_s[0, :, 2].reshape(len(x), len(y)), x, y, 0.01)
    expected = np.degrees(np.arcsin(rayleigh_ratio() * np.sqrt(SHEAR / DENSITY) / speed))
    print("half-angle", angle, "asin(c_R / v)", expected)
    assert angle == pytest.approx(expected, abs=1.5)
