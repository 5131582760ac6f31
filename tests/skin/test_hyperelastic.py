import math

import numpy as np
import pytest
from hyperelastic import advance, at_rest, energy, piola, viscous_piola
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Branch, Material, complex_bulk, complex_shear

G, K = 1.2e4, 3.0e5
EYE = np.eye(3)


def deformations(count, size, seed=0):
    """Deformation gradients with det F > 0 about the identity."""
    F = EYE + size * np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3, 3))
    assert (np.linalg.det(F) > 0.1).all()
    return F


def solid(**changes):
    values = {
        "density_kg_m3": 1000.0,
        "shear_relaxed_Pa": G,
        "branches": (Branch(3e4, 2e-4), Branch(5e3, 1e-3)),
        "bulk_Pa": K,
    }
    return Material(name="t", source="", **values | changes)


SOLIDS = [solid(), solid(viscosity_Pa_s=4.0), solid(bulk_relaxes=True), solid(viscosity_Pa_s=4.0, bulk_relaxes=True)]


def test_piola_is_the_derivative_of_the_energy():
    F = deformations(20, 0.3)
    P = piola(F, G, K)
    step = 1e-6
    for i in range(3):
        for j in range(3):
            change = np.zeros((3, 3))
            change[i, j] = step
            slope = (energy(F + change, G, K) - energy(F - change, G, K)) / (2.0 * step)
            np.testing.assert_allclose(P[:, i, j], slope, rtol=1e-7, atol=1e-7 * K)


def test_rest_and_rotation_store_nothing():
    turned = Rotation.random(10, rng=1).as_matrix()
    assert np.abs(energy(turned, G, K)).max() < 1e-10 * G
    assert np.abs(piola(turned, G, K)).max() < 1e-9 * G


def test_energy_is_positive_away_from_rest():
    assert energy(deformations(200, 0.3, seed=2), G, K).min() > 0.0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), size=st.floats(1e-6, 0.3))
def test_a_turned_solid_has_turned_stress(seed, size):
    """P(Q F) = Q P(F), with its rate and through a history; P F^T is symmetric (no couple)."""
    Q = Rotation.random(rng=seed).as_matrix()
    path = deformations(4, size, seed)
    for material in SOLIDS:
        straight, turned = at_rest(material, ()), at_rest(material, ())
        for F in path:
            rate = (F - EYE) / 1e-3
            P, straight = advance(material, straight, F, rate, 1e-3)
            P_turned, turned = advance(material, turned, Q @ F, Q @ rate, 1e-3)
            scale = np.abs(P).max()
            np.testing.assert_allclose(P_turned, Q @ P, rtol=0, atol=1e-7 * scale)
            kirchhoff = P @ F.T
            np.testing.assert_allclose(kirchhoff, kirchhoff.T, rtol=0, atol=1e-9 * np.abs(kirchhoff).max())


def test_dashpot_feels_no_rotation():
    F = deformations(5, 0.2, seed=3)
    spin = np.array([[0.0, -2.0, 1.0], [2.0, 0.0, -3.0], [-1.0, 3.0, 0.0]])
    assert np.abs(viscous_piola(F, spin @ F, 5.0, 7.0)).max() < 1e-12


def test_small_strain_is_hookes_law():
    strain = np.random.default_rng(4).uniform(-1.0, 1.0, (10, 3, 3))
    e = 0.5 * (strain + np.swapaxes(strain, 1, 2))
    trace = np.trace(e, axis1=1, axis2=2)[:, None, None] * EYE
    linear = 2.0 * G * (e - trace / 3.0) + K * trace
    errors = [np.abs(piola(EYE + h * strain, G, K) / h - linear).max() / np.abs(linear).max() for h in (1e-3, 1e-4)]
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.05)  # first order in the strain


@pytest.mark.parametrize("material", SOLIDS, ids=["branches", "dashpot", "bulk", "bulk and dashpot"])
@pytest.mark.parametrize("kind", ["shear", "volume"])
def test_small_oscillation_has_the_complex_moduli(material, kind):
    """Under a strain of 1e-6 cos(w t) the steady stress tends to G* and K* of the linear law, at second order."""
    expected = complex_shear(material, 150.0) if kind == "shear" else complex_bulk(material, 150.0)
    errors = [abs(oscillation(material, kind, 150.0, steps) - expected) / abs(expected) for steps in (125, 250)]
    assert errors[1] < 2e-4
    if kind == "shear" or material.bulk_relaxes:
        assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)
    else:
        assert errors[0] < 1e-8  # elastic


def oscillation(material, kind, f, steps):
    """Complex modulus from the fourth period, by so many steps a period."""
    strain = 1e-6
    direction = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) if kind == "shear" else EYE / 3.0
    memory = at_rest(material, ())
    phases = np.arange(1, 4 * steps + 1) * 2.0 * math.pi / steps
    stress = np.empty(len(phases))
    for n, phase in enumerate(phases):
        F = EYE + strain * math.cos(phase) * direction
        rate = -strain * 2.0 * math.pi * f * math.sin(phase) * direction
        P, memory = advance(material, memory, F, rate, 1.0 / (f * steps))
        stress[n] = P[0, 1] if kind == "shear" else np.trace(P) / 3.0
    return 2.0 / steps * np.sum(stress[-steps:] * np.exp(1j * phases[-steps:])) / strain


@pytest.mark.parametrize("hold_steps", [1, 7])
def test_stress_relaxation_in_closed_form(hold_steps):
    """Deformed at once and held: the isochoric stress is (1 + sum g_i e^{-t/tau_i}) times the spring's, exactly."""
    material = solid()
    F = deformations(1, 0.3, seed=6)[0]
    still = np.zeros((3, 3))
    _, memory = advance(material, at_rest(material, ()), F, still, 1e-12)
    held = 1.3e-3
    for _ in range(hold_steps):
        P, memory = advance(material, memory, F, still, held / hold_steps)
    spring = piola(F, G, 1e-30)
    volume = piola(F, 1e-30, K)
    factor = 1.0 + sum(r * math.exp(-held / t) for r, t in material.relaxation.branches)
    np.testing.assert_allclose(P, factor * spring + volume, rtol=0, atol=1e-8 * np.abs(P).max())


def test_long_step_is_the_relaxed_solid_and_short_the_instantaneous():
    material = solid()
    F = deformations(1, 0.2, seed=7)[0]
    still = np.zeros((3, 3))
    slow, _ = advance(material, at_rest(material, ()), F, still, 1e9)
    np.testing.assert_allclose(slow, piola(F, G, K), atol=1e-9 * K)
    fast, _ = advance(material, at_rest(material, ()), F, still, 1e-15)
    np.testing.assert_allclose(fast, piola(F, material.shear_instant_Pa, K), atol=1e-9 * K)


def test_zero_time_branch_carries_nothing():
    F = deformations(1, 0.2, seed=8)[0]
    bare, empty = solid(branches=()), solid(branches=(Branch(5e4, 0.0),))
    P, _ = advance(bare, at_rest(bare, ()), F, np.zeros((3, 3)), 1e-4)
    P_empty, _ = advance(empty, at_rest(empty, ()), F, np.zeros((3, 3)), 1e-4)
    np.testing.assert_array_equal(P, P_empty)


def test_incompressible_uniaxial_stretch():
    """The pressure makes the sides free: P_1 = G (l - 1/l^2) (textbook neo-Hookean rubber)."""
    for stretch in (0.6, 0.9, 1.5, 2.0):
        F = np.diag([stretch, stretch**-0.5, stretch**-0.5])
        P = piola(F, G, K)
        pressure = -P[1, 1] * F[1, 1]
        assert P[0, 0] + pressure / stretch == pytest.approx(G * (stretch - stretch**-2), rel=1e-12)


def test_errors():
    inside_out = np.stack([EYE, np.diag([1.0, 1.0, -1.0])])
    with pytest.raises(SceneError, match=r"\[1\]"):
        piola(inside_out, G, K)
    with pytest.raises(SceneError, match="det F"):
        energy(np.zeros((3, 3)), G, K)
    with pytest.raises(SceneError, match="step"):
        advance(solid(), at_rest(solid(), ()), EYE, EYE, 0.0)
