"""The exact layer against limits known by themselves."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_bvp

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import BASES, centre_response, layer_compliance
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Material, bulk_from_poisson, complex_shear

pytestmark = pytest.mark.numerics

ECOFLEX = PRESETS["ecoflex_00-10"]
SPOT, DEPTH = 0.0103, 0.02


def elastic(nu, shear=1e4):
    return Material("elastic", 1000.0, shear, (), bulk_from_poisson(nu, shear), "")


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.495, 0.499999])
@pytest.mark.parametrize("base", BASES)
def test_short_waves_see_a_half_space(nu, base):
    k = np.array([2e3, 1e4, 1e5])
    ratio = layer_compliance(k, 0.0, elastic(nu), DEPTH, base) * 1e4 * k / (1.0 - nu)
    np.testing.assert_allclose(ratio, 1.0, rtol=1e-9)


def test_long_waves_see_confined_compression():
    expected = DEPTH / (ECOFLEX.bulk_Pa + 4.0 / 3.0 * ECOFLEX.shear_relaxed_Pa)
    assert layer_compliance(0.0, 0.0, ECOFLEX, DEPTH) == pytest.approx(expected, rel=1e-12)
    assert layer_compliance(1e-2, 0.0, ECOFLEX, DEPTH) == pytest.approx(expected, rel=1e-5)


def test_long_waves_on_a_slippery_base_let_the_layer_widen():
    youngs = 2.0 * ECOFLEX.shear_relaxed_Pa * 1.495
    assert layer_compliance(0.1, 0.0, ECOFLEX, DEPTH, "free_slip") == pytest.approx(
        DEPTH * (1 - 0.495**2) / youngs, rel=1e-5
    )


def test_free_layer_under_long_waves_bends_like_a_thin_plate():
    material = elastic(0.3)
    youngs = 2.0 * material.shear_relaxed_Pa * 1.3
    rigidity = youngs * DEPTH**3 / (12.0 * (1.0 - 0.3**2))
    k = 0.1 / DEPTH
    assert layer_compliance(k, 0.0, material, DEPTH, "free") == pytest.approx(1.0 / (rigidity * k**4), rel=0.01)


def test_free_layer_moves_as_one_mass_at_low_frequency():
    omega = 2 * math.pi * 1.0
    expected = -1.0 / (ECOFLEX.density_kg_m3 * DEPTH * omega**2)
    assert layer_compliance(0.0, 1.0, ECOFLEX, DEPTH, "free") == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("base", BASES)
def test_static_is_the_limit_of_slow(base):
    k = np.array([10.0, 200.0, 1e4])
    slow, still = (layer_compliance(k, f, ECOFLEX, DEPTH, base) for f in (1e-4, 0.0))
    np.testing.assert_allclose(slow, still, rtol=1e-6)


def test_rayleigh_wave_of_a_deep_incompressible_layer():
    """The pole of the compliance over real k: speed 0.9553 c_s for Poisson's ratio 0.5 (Rayleigh's cubic)."""
    material, f = elastic(0.4999999), 200.0
    shear_k = 2 * math.pi * f / math.sqrt(10.0)
    speeds = np.linspace(0.95, 0.96, 4001)
    compliance = layer_compliance(shear_k / speeds, f, material, 20 * 2 * math.pi / shear_k)
    assert speeds[np.argmax(np.abs(compliance))] == pytest.approx(0.9553, abs=1e-4)


@pytest.mark.parametrize(
    ("k", "f", "base"), [(150.0, 200.0, "bonded"), (400.0, 70.0, "free_slip"), (90.0, 400.0, "bonded")]
)
def test_equations_of_motion_solved_numerically_agree(k, f, base):
    """The same plane-strain equations, integrated in depth by SciPy's collocation solver."""
    omega, shear = 2 * math.pi * f, complex_shear(ECOFLEX, f)
    lame = ECOFLEX.bulk_Pa - 2.0 / 3.0 * shear
    inertia = ECOFLEX.density_kg_m3 * omega**2
    scale = shear.real * k

    def slopes(_, y):
        # u_x = i X e^{ikx}: unknowns X, u_z, sigma_xz / (i s), sigma_zz / s.
        x, z, tangential, normal = y
        dz = (scale * normal + lame * k * x) / (lame + 2 * shear)
        along = -(lame + 2 * shear) * k * x + lame * dz
        return np.array([
            scale * tangential / shear - k * z,
            dz,
            (-inertia * x - k * along) / scale,
            (-inertia * z + k * scale * tangential) / scale,
        ])  # fmt: skip

    def ends(top, bottom):
        held = bottom[0] if base == "bonded" else bottom[2]
        return np.array([top[2], scale * top[3] + 1.0, held, bottom[1]])

    depth = np.linspace(0.0, DEPTH, 101)
    numeric = solve_bvp(slopes, ends, depth, np.zeros((4, 101), dtype=complex), tol=1e-8, max_nodes=20000)
    assert numeric.success
    assert complex(layer_compliance(k, f, ECOFLEX, DEPTH, base)) == pytest.approx(numeric.y[1, 0], rel=1e-5)


@settings(max_examples=60, deadline=None)
@given(
    k=st.floats(1.0, 1e6),
    f=st.floats(0.0, 2e3),
    depth=st.floats(1e-4, 0.5),
    nu=st.floats(0.0, 0.499999),
    base=st.sampled_from(BASES),
)
def test_finite_and_dissipative_everywhere(k, f, depth, nu, base):
    """No overflow, and a passive layer takes up power: under e^{-i w t} the imaginary part is not negative."""
    material = dataclasses.replace(ECOFLEX, bulk_Pa=bulk_from_poisson(nu, 12.5e3))
    if k * depth < 1e-2:
        return
    value = complex(layer_compliance(k, f, material, depth, base))
    assert math.isfinite(abs(value))
    assert value.imag >= -1e-7 * abs(value)


def test_large_disc_is_an_endless_layer():
    at = np.array([0.0, 0.01, 0.03])
    for f in (0.0, 200.0):
        endless = centre_response(f, ECOFLEX, DEPTH, SPOT, at=at)
        disc = centre_response(f, ECOFLEX, DEPTH, SPOT, radius_m=0.5, at=at)
        np.testing.assert_allclose(disc, endless, atol=1e-8 * abs(endless[0]))


def test_wide_spot_on_a_roller_disc_is_a_column():
    """Uniform pressure on a disc with roller sides is one-dimensional whatever its radius."""
    value = centre_response(0.0, ECOFLEX, DEPTH, 100.0, radius_m=0.05, at=0.02)
    assert value == pytest.approx(DEPTH / (ECOFLEX.bulk_Pa + 4 / 3 * ECOFLEX.shear_relaxed_Pa), rel=1e-4)


def test_narrow_spot_on_a_deep_layer_is_boussinesq():
    """Gaussian pressure on an elastic half-space: u(0) = (1 - nu) s sqrt(pi / 2) / G (Johnson 1985, ch. 3)."""
    spread = SPOT / math.sqrt(8 * math.log(2))
    expected = (1 - 0.3) * spread * math.sqrt(math.pi / 2) / 1e4
    assert centre_response(0.0, elastic(0.3), 2.0, SPOT) == pytest.approx(expected, rel=3e-3)


def test_errors():
    with pytest.raises(SceneError, match="glued"):
        layer_compliance(1.0, 0.0, ECOFLEX, DEPTH, "glued")
    with pytest.raises(SceneError, match="thickness"):
        layer_compliance(1.0, 0.0, ECOFLEX, 0.0)
    with pytest.raises(SceneError, match="free base"):
        layer_compliance(0.0, 0.0, ECOFLEX, DEPTH, "free")
    with pytest.raises(SceneError, match="spot width"):
        centre_response(0.0, ECOFLEX, DEPTH, 0.0)


@pytest.mark.parametrize("depth_m", [7e-4, 2e-3])
def test_motion_below_the_face_of_a_deep_layer_is_that_of_a_half_space(depth_m):
    """Static and incompressible: (1 + k z) e^{-k z} / (2 G k) per pressure (Boussinesq's solution by wavenumber)."""
    k = np.array([50.0, 200.0, 600.0, 1500.0])
    expected = (1.0 + k * depth_m) * np.exp(-k * depth_m) / (2.0 * PRESETS["palm"].shear_relaxed_Pa * k)
    found = layer_compliance(k, 0.0, PRESETS["palm"], 0.5, depth_m=depth_m)
    np.testing.assert_allclose(found, expected, rtol=3e-4)
    assert np.abs(layer_compliance(k, 150.0, PRESETS["palm"], 0.02, depth_m=0.02)).max() < 1e-12 * expected.max()
    with pytest.raises(SceneError, match=r"depth_m is 0\.03; allowed: 0 to the thickness 0\.02"):
        layer_compliance(k, 0.0, PRESETS["palm"], 0.02, depth_m=0.03)
