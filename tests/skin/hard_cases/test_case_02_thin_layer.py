"""Case 2, 1 mm bonded to rigid bone under 4000 Pa, E 23.5 kPa: the linear law, and neo-Hookean beside it."""

import numpy as np
import pytest
from scipy.optimize import brentq

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Slab, Spot, Traction
from palmfield.skin.solvers.particles.cloud import build_cloud
from palmfield.skin.solvers.particles.solve import run_particles

pytestmark = pytest.mark.numerics

YOUNG, PRESSURE, DEPTH, WIDTH, RADIUS = 23.5e3, 4000.0, 1e-3, 6e-3, 0.012


def damped(nu):
    """A branch in shear and bulk alike: motion dies in milliseconds and leaves the elastic answer."""
    shear = YOUNG / (2.0 * (1.0 + nu))
    bulk = bulk_from_poisson(nu, shear)
    return Material("damped skin", 1100.0, shear, (Branch(2.0 * shear, 2e-4),), bulk, "", bulk_relaxes=True)


def ramp(pressure, width=WIDTH):
    return Spot(width, np.array([0.0, 1e-3]), np.array([0.0, pressure]))


@pytest.mark.parametrize("name", ["lateral_waves", "axisymmetric", "reduced", "spectral_elements"])
def test_linear_layer_comes_to_rest_at_the_series(name, solve_by, sizes_like):
    """Against the exact series, a third and less of the uniaxial P h / E; that of wedges is in
    test_hard_cases_implicit.py."""
    nu = 0.495 if name == "spectral_elements" else 0.4999
    body = Slab((Sheet(damped(nu), DEPTH),), "disc", "bonded", "roller", RADIUS)
    how = {"spectral_elements": {"size_m": 3e-3}}.get(name, {})
    if name == "reduced":
        how = {"sizes": sizes_like(fine_m=1.4e-3, coarse_m=3e-3, fine_radius_m=4e-3, row_m=5e-4, deepest_row_m=5e-4)}
    found = -solve_by(name, body, ramp(PRESSURE), np.array([0.01, 0.02]), np.zeros((1, 2)), **how).displacement_m[
        :, 0, 2
    ]
    exact = PRESSURE * centre_response(0.0, damped(nu), DEPTH, WIDTH, RADIUS).real
    print(name, 1e6 * found, found / exact - 1)
    assert found[1] == pytest.approx(exact, rel=0.03 if name == "reduced" else 0.01, abs=0.0)
    assert found[1] < PRESSURE * DEPTH / YOUNG / 3.0


def column(material, pressure):
    """Strain of a column that cannot widen, by the neo-Hookean law in closed form, and its linear one."""
    shear, bulk = material.shear_relaxed_Pa, material.bulk_Pa

    def stress(stretch):
        return 2.0 / 3.0 * shear * (stretch ** (1.0 / 3.0) - stretch ** (-5.0 / 3.0)) + bulk * (stretch - 1.0)

    return brentq(lambda x: stress(x) + pressure, 0.2, 1.0) - 1.0, -pressure / (bulk + 4.0 / 3.0 * shear)


@pytest.mark.parametrize("name", ["lateral_waves", "wedges", "spectral_elements"])
def test_linear_column(name, solve_by, sizes_like):
    """An even pressure on a box between rollers: p h / (K + 4/3 G)."""
    material = damped(0.45)
    body = Slab((Sheet(material, DEPTH),), "box", "bonded", "roller", size_m=(2e-3, 2e-3))
    how = {
        "wedges": {"sizes": sizes_like(fine_m=1e-3, coarse_m=1e-3, row_m=5e-4, deepest_row_m=5e-4)},
        "spectral_elements": {"size_m": 2e-3},
    }.get(name, {})
    load = ramp(PRESSURE, 1e3)
    if name == "lateral_waves":
        load = even(PRESSURE)
    found = solve_by(name, body, load, np.array([0.02]), np.zeros((1, 2)), **how).displacement_m[0, 0, 2]
    print(name, found / (DEPTH * column(material, PRESSURE)[1]) - 1)
    assert found == pytest.approx(DEPTH * column(material, PRESSURE)[1], rel=3e-3, abs=0.0)


def even(pressure):
    """The ramp on 64 points of the face of 2 x 2 mm."""
    middle = (np.arange(8) + 0.5) / 8 * 2e-3 - 1e-3
    x, y = (a.ravel() for a in np.meshgrid(middle, middle))
    points = np.column_stack([x, y, 0.0 * x])
    return Traction(points, np.full(64, 4e-6 / 64), np.array([0.0, 1e-3]), np.outer([0.0, pressure], np.ones(64)))


def test_neo_hookean_column_leaves_the_linear_one_at_its_rate():
    """P = M e - 14/9 G e^2 + ..., so the two differ by 14/9 G p / M^2 of the strain: 14 % of a percent at 40 Pa."""
    material = damped(0.45)
    body = Slab((Sheet(material, DEPTH),), "box", "bonded", "roller", size_m=(1e-3, 1e-3))
    cloud = build_cloud(body, 5e-4)
    modulus = material.bulk_Pa + 4.0 / 3.0 * material.shear_relaxed_Pa
    gaps = []
    for pressure in (400.0, 4000.0, 20e3):
        _, u, _, _ = run_particles(cloud, ramp(pressure, 1e3), np.array([0.01]), np.zeros((1, 2)))
        exact, linear = column(material, pressure)
        print(pressure, u[0, 0, 2] / DEPTH, exact, linear)
        assert u[0, 0, 2] / DEPTH == pytest.approx(exact, rel=2e-5, abs=0.0)
        gaps.append(1.0 - u[0, 0, 2] / DEPTH / linear)
    first = 14.0 / 9.0 * material.shear_relaxed_Pa * 4000.0 / modulus**2
    assert gaps[1] == pytest.approx(first, rel=0.1)
    assert gaps[1] / gaps[0] == pytest.approx(10.0, rel=0.1)


def test_neo_hookean_layer_leaves_the_linear_one_at_first_order():
    """The bonded layer: particles at 0.4 Pa are linear; what 400 and 4000 Pa change goes with the pressure."""
    body = Slab((Sheet(damped(0.45), DEPTH),), "disc", "bonded", "roller", RADIUS)
    cloud = build_cloud(body, 1e-3)
    pushed = {}
    for peak in (0.4, 400.0, 4000.0):
        _, u, _, _ = run_particles(cloud, ramp(peak), np.array([6e-3]), np.zeros((1, 2)))
        pushed[peak] = -u[0, 0, 2] / peak
    exact = centre_response(0.0, damped(0.45), DEPTH, WIDTH, RADIUS).real
    small, large = (pushed[peak] / pushed[0.4] - 1.0 for peak in (400.0, 4000.0))
    print(pushed[0.4] / exact - 1, small, large)
    assert pushed[0.4] == pytest.approx(exact, rel=0.2, abs=0.0)
    assert large == pytest.approx(10.0 * small, rel=0.2)
    assert abs(large) < 0.1
