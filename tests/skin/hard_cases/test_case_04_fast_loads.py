"""Case 4, a spot that runs at the Rayleigh speed, at the shear speed, and at twice that."""

import numpy as np
import pytest
from scipy.optimize import brentq

from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.materials.material import Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Slab, Spot, spread

WIDTH, DEPTH, NU = 0.0103, 0.008, 0.45
GEL = Material("gel", 1030.0, 12.5e3, (), bulk_from_poisson(NU, 12.5e3), "", viscosity_Pa_s=2.0)
SHEAR = float(np.sqrt(12.5e3 / 1030.0))
WITHIN = {"wedges": 0.05, "reduced": 0.05, "spectral_elements": 0.01, "axisymmetric": 0.01}


def rayleigh():
    """c_R / c_s of an elastic half space: (2 - x^2)^2 = 4 sqrt(1 - x^2) sqrt(1 - k x^2)."""
    k = (1.0 - 2.0 * NU) / (2.0 - 2.0 * NU)
    return brentq(lambda x: (2 - x * x) ** 2 - 4 * np.sqrt((1 - x * x) * (1 - k * x * x)), 0.7, 0.9999)


SPEEDS = {"Rayleigh": rayleigh() * SHEAR, "shear": SHEAR, "twice shear": 2.0 * SHEAR}
AT = np.array([[0.008, 0.0], [0.0, 0.006]])


def passing(speed, half=0.012):
    """From x = -half to half, up and down in a smooth way."""
    times = np.linspace(0.0, 2.0 * half / speed, 65)
    x = -half + speed * times
    return Spot(WIDTH, times, np.sin(np.pi * times / times[-1]) ** 2, np.column_stack([x, 0.0 * x]))


def box():
    return Slab((Sheet(GEL, DEPTH),), "box", "bonded", "roller", size_m=(0.06, 0.04))


@pytest.mark.nightly
@pytest.mark.parametrize("speed", SPEEDS)
def test_spectral_wake_is_the_steady_integral(speed, solve_by, miss):
    """After 0.1 m the start is forgotten: u(x - v t, y) by a sum over k of C(k, k_x v / 2 pi) g(k), period 0.4 m."""
    v = SPEEDS[speed]
    times = np.array([0.0, 0.1 / v])
    load = Spot(WIDTH, times, np.ones(2), np.array([[-0.1, 0.0], [0.0, 0.0]]))
    x = np.linspace(-0.03, 0.012, 9)
    at = np.column_stack([x, np.where(np.arange(9) % 2, 0.006, 0.0)])
    found = solve_by("lateral_waves", Slab((Sheet(GEL, DEPTH),)), load, times[1:], at, accuracy=0.02).displacement_m[
        0, :, 2
    ]
    s, period, count = spread(WIDTH), 0.4, 90
    line = 2.0 * np.pi / period * np.arange(-count, count + 1)
    exact = np.zeros(len(x))
    for kx in line[count:]:
        k = np.hypot(kx, line)
        shape = 2.0 * np.pi * s**2 * np.exp(-0.5 * (k * s) ** 2)
        response = layer_compliance(k, kx * v / (2.0 * np.pi), GEL, DEPTH) * shape
        waves = np.exp(1j * (np.outer(kx * at[:, 0], np.ones_like(line)) + np.outer(at[:, 1], line)))
        exact -= (1.0 if kx == 0.0 else 2.0) * (waves @ response).real / period**2
    error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    print(speed, error)
    assert error < 0.01


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "speed"),
    [*(("spectral_elements", v) for v in SPEEDS), ("wedges", "shear"), ("wedges", "twice shear"), ("reduced", "shear")],
)
def test_box_under_a_fast_spot(name, speed, solve_by, sizes_like, miss):
    load = passing(SPEEDS[speed])
    times = np.linspace(0.0, 1.4 * load.times_s[-1], 15)[1:]
    how = {}
    if name != "spectral_elements":
        how = {"sizes": sizes_like(fine_radius_m=0.02, fine_m=0.005, coarse_m=0.008)}
    if name == "wedges":
        how["step_s"] = load.times_s[-1] / 40
    found, exact = (
        solve_by(n, box(), load, times, AT, **h).displacement_m for n, h in ((name, how), ("lateral_waves", {}))
    )
    print(name, speed, miss(found, exact))
    assert miss(found, exact) < WITHIN[name]


@pytest.mark.parametrize("speed", SPEEDS)
def test_particles_under_a_fast_spot_err_as_they_say(speed, solve_by, miss):
    load = passing(SPEEDS[speed])
    times = np.linspace(0.0, 1.4 * load.times_s[-1], 15)[1:]
    exact = solve_by("lateral_waves", box(), load, times, AT).displacement_m
    motion = solve_by("particles", box(), load, times, AT, spacing_m=2.4e-3)
    print(speed, miss(motion.displacement_m, exact), motion.error)
    assert miss(motion.displacement_m, exact) < motion.error < 0.5


@pytest.mark.parametrize("speed", SPEEDS)
def test_disc_and_explicit_agree_on_a_disc(speed, solve_by, miss):
    """No series knows a disc under a moving spot: harmonics in r and z against elements in x, y, z."""
    body = Slab((Sheet(GEL, DEPTH),), "disc", "bonded", "roller", 0.025)
    load = passing(SPEEDS[speed], 0.008)
    times = np.linspace(0.0, 1.4 * load.times_s[-1], 15)[1:]
    found, other = (solve_by(n, body, load, times, AT).displacement_m for n in ("axisymmetric", "spectral_elements"))
    print(speed, miss(found, other))
    assert miss(found, other) < WITHIN["axisymmetric"]
