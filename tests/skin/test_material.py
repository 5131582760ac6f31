import math

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.material import (
    INCOMPRESSIBLE,
    Branch,
    Material,
    bulk_from_poisson,
    complex_bulk,
    complex_shear,
    elastic,
    kelvin_voigt,
    prony,
    shear_wave,
    standard_linear,
)


def solid(**changes):
    values = {"density_kg_m3": 1000.0, "shear_relaxed_Pa": 1e4, "branches": (Branch(2e4, 1e-3),), "bulk_Pa": 1e6}
    return Material(name="t", source="", **values | changes)


def poisson(bulk, shear):
    return (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))


def test_modulus_limits():
    material = solid()
    assert complex_shear(material, 0.0) == 1e4
    assert complex_shear(material, 1e9).real == pytest.approx(3e4, rel=1e-6)
    assert complex_shear(solid(branches=(Branch(2e4, 0.0),)), 1e3) == 1e4
    assert shear_wave(solid(branches=()), 100.0) == (pytest.approx(math.sqrt(10.0)), math.inf)


def test_modulus_is_the_transform_of_the_relaxation():
    """G* = -i w int_0^inf G(t) e^{iwt} dt with G(t) = G_r + sum G_i e^{-t/tau_i}, by quadrature of the branches."""
    material = prony("m", 1000.0, 1e4, (2e4, 5e3), (1e-3, 2e-4))
    omega = 2.0 * math.pi * 180.0
    t = np.linspace(0.0, 0.03, 600_001)
    relaxing = 2e4 * np.exp(-t / 1e-3) + 5e3 * np.exp(-t / 2e-4)
    expected = 1e4 - 1j * omega * np.trapezoid(relaxing * np.exp(1j * omega * t), t)
    assert complex_shear(material, 180.0) == pytest.approx(expected, rel=1e-6)


def test_poisson_round_trip():
    for nu in (0.0, 0.3, 0.4999):
        assert poisson(bulk_from_poisson(nu, 1e4), 1e4) == pytest.approx(nu, abs=1e-9)


def test_constructors():
    assert elastic("t", 1000.0, 1e4, 0.3) == solid(branches=(), bulk_Pa=bulk_from_poisson(0.3, 1e4))
    voigt = kelvin_voigt("v", 1000.0, 1e4, 5.0, 0.3)
    assert complex_shear(voigt, 100.0) == pytest.approx(1e4 - 1e3j * math.pi)
    assert voigt.bulk_Pa == elastic("e", 1000.0, 1e4, 0.3).bulk_Pa
    assert standard_linear("s", 1000.0, 1e4, 2e4, 1e-3) == prony("s", 1000.0, 1e4, [2e4], [1e-3])
    assert prony("p", 1000.0, 1e4, (1.0, 2.0), (3.0, 4.0)).branches == (Branch(1.0, 3.0), Branch(2.0, 4.0))


def test_poisson_ratio_of_constructors():
    """Beside the instantaneous modulus by default, the relaxed one on demand, both where the bulk relaxes."""
    instant = standard_linear("s", 1000.0, 1e4, 2e4, 1e-3, 0.49)
    relaxed = standard_linear("s", 1000.0, 1e4, 2e4, 1e-3, 0.49, nu_of="relaxed")
    both = standard_linear("s", 1000.0, 1e4, 2e4, 1e-3, 0.49, bulk_relaxes=True)
    for material, f, nu in [(instant, 1e9, 0.49), (relaxed, 0.0, 0.49), (both, 0.0, 0.49), (both, 150.0, 0.49)]:
        found = poisson(complex_bulk(material, f), complex_shear(material, f))
        assert found == pytest.approx(nu, abs=1e-6)
    assert poisson(instant.bulk_Pa, 1e4) > 0.49


@pytest.mark.parametrize("f", [0.0, 100.0, 400.0])
@pytest.mark.parametrize("depth", [0.001, 0.02])
def test_poisson_ratio_of_a_half_is_close_to_incompressible(depth, f):
    """Motion under a spot of 10.3 mm with K = 1e6 G against K = 1e8 G, at the centre and beside it."""
    material = standard_linear("s", 1030.0, 12.5e3, 20e3, 171e-6, 0.5)
    assert material.bulk_Pa == INCOMPRESSIBLE * 32.5e3
    stiffer = solid(
        density_kg_m3=1030.0, shear_relaxed_Pa=12.5e3, branches=material.branches, bulk_Pa=100.0 * material.bulk_Pa
    )
    at = [0.0, 0.005, 0.01]
    near, limit = (centre_response(f, m, depth, 0.0103, at=at) for m in (material, stiffer))
    assert np.abs(near - limit).max() < 1e-4 * np.abs(limit).max()
    assert np.abs(near - limit).max() > 0.0


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
@pytest.mark.parametrize("field", ["density_kg_m3", "shear_relaxed_Pa", "bulk_Pa", "viscosity_Pa_s"])
def test_bad_numbers_are_named(field, value):
    with pytest.raises(SceneError, match=field):
        solid(**{field: value})


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_bad_branches_are_named(value):
    with pytest.raises(SceneError, match=r"branches\[1\].time_s"):
        solid(branches=(Branch(1.0, 1.0), Branch(1.0, value)))
    with pytest.raises(SceneError, match=r"branches\[0\].shear_Pa"):
        solid(branches=(Branch(value, 1.0),))


@pytest.mark.parametrize("field", ["density_kg_m3", "shear_relaxed_Pa"])
def test_zero_is_refused_where_it_means_nothing(field):
    with pytest.raises(SceneError, match=field):
        solid(**{field: 0.0})


def test_bad_poisson_and_frequency():
    with pytest.raises(SceneError, match=r"0\.5"):
        bulk_from_poisson(0.5, 1e4)
    with pytest.raises(SceneError, match="shear modulus"):
        bulk_from_poisson(0.4, -1.0)
    with pytest.raises(SceneError, match="frequency"):
        shear_wave(solid(), 0.0)


@pytest.mark.parametrize("nu", [-1.0, 0.51, math.nan])
def test_bad_poisson_of_constructors(nu):
    with pytest.raises(SceneError, match=r"Poisson's ratio is"):
        elastic("e", 1000.0, 1e4, nu)


def test_bad_constructor_arguments():
    with pytest.raises(SceneError, match="2 branch moduli, 1 times"):
        prony("p", 1000.0, 1e4, (1.0, 2.0), (3.0,))
    with pytest.raises(SceneError, match="'later'"):
        prony("p", 1000.0, 1e4, (), (), nu_of="later")
    with pytest.raises(SceneError, match="viscosity_Pa_s"):
        kelvin_voigt("v", 1000.0, 1e4, -5.0)
