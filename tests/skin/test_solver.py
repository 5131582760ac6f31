"""Static, harmonic and stepped motion against exact answers, rates and conservation laws."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.linalg import spsolve

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.generalised_alpha import alpha_weights, branch_weights
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Branch, Material, bulk_from_poisson
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude

ECOFLEX = PRESETS["ecoflex_00-10"]
SPOT = 0.0103


def energy(system, state, branch_factor=1.0):
    """Kinetic, elastic and stored branch energy [J]."""
    u, v, _, q = state
    w = u - q
    branch = system.material.relaxation.branches[0][0] * branch_factor * (w @ (system.parts[0].stiffness @ w))
    return 0.5 * (v @ (system.mass @ v) + u @ (system.elastic @ u) + u @ (system.parts[0].stiffness @ u) + branch)


def consistent_acceleration(system, state):
    u, _, _, q = state
    pull = system.elastic @ u + system.parts[0].stiffness @ (u + system.material.relaxation.branches[0][0] * (u - q))
    state[2] = -spsolve(system.mass.tocsc(), pull)


def test_reference_disc_within_three_percent(make_spot):
    """The acceptance case at a fifth of its 25 k unknowns; each answer within the 3 % asked for, here within 1.5 %."""
    spot = make_spot(0.008, 2)
    assert spot.system.ndof < 25_000
    for f, limit in ((0.0, 0.01), (200.0, 0.015)):
        exact = complex(centre_response(f, ECOFLEX, 0.02, SPOT, 0.06))
        u = static(spot.system, spot.force) if f == 0.0 else harmonic(spot.system, spot.force, f)
        assert abs(spot.push(u) / exact - 1) < limit


@pytest.mark.parametrize("depth", [0.02, 0.004])
def test_no_locking(make_spot, depth):
    """Within the 3 % asked for at every Poisson's ratio, on a deep layer and on a thin one, 5 mm edges and two layers.

    From 0.4999 to 0.499999 the bulk modulus grows a hundredfold: an element that locks would follow it.
    """
    errors = []
    for nu in (0.45, 0.495, 0.4999, 0.499999):
        material = dataclasses.replace(ECOFLEX, bulk_Pa=bulk_from_poisson(nu, 12.5e3))
        spot = make_spot(0.005, 2, material=material, radius_m=0.03, depth_m=depth, growth=1.0)
        for f in (0.0, 200.0):
            exact = complex(centre_response(f, material, depth, SPOT, 0.03))
            u = static(spot.system, spot.force) if f == 0.0 else harmonic(spot.system, spot.force, f)
            errors.append(abs(spot.push(u) / exact - 1))
    by_nu = np.array(errors).reshape(4, 2)
    print("errors by nu (static, 200 Hz)", by_nu)
    assert by_nu.max() < 0.03
    assert np.abs(by_nu[3] - by_nu[2]).max() < 1e-3


@pytest.mark.slow
def test_work_converges_at_the_elements_rate():
    """Work of the load, all directions refined together. Quadratic elements: rate 4 = 2 x 2 where the answer is smooth.

    The exact disc has the polygon's area, which takes away the rim's own second-order error.
    """
    errors = []
    for n in (1, 2, 3):
        mesh = extrude(disc_patch(0.02, 0.01, 0.006 / n, 0.006 / n, 0.02), np.linspace(0.0, 1.0, n + 1))
        system = assemble(mesh, ECOFLEX, side="roller")
        quadrature = SurfaceQuadrature(mesh, system)
        distance2 = (quadrature.points[:, :2] ** 2).sum(axis=1)
        force = quadrature.assemble(np.exp(-4 * np.log(2) * distance2 / SPOT**2))
        radius = math.sqrt(quadrature.weights.sum() / math.pi)
        still = force @ static(system, force) / exact_work(radius, 0.01, 0.0) - 1
        moving = force @ harmonic(system, force, 200.0) / exact_work(radius, 0.01, 200.0) - 1
        errors.append([abs(still), abs(moving)])
    rates = np.log(np.array(errors)[0] / errors[2]) / math.log(3.0)
    print("work errors (static, 200 Hz)", errors, "rates", rates)
    assert rates[0] > 2.5
    assert rates[1] > 3.5


def exact_work(radius, depth, f):
    """Integral of p u over the roller disc, by radial quadrature of the exact series."""
    nodes, weights = np.polynomial.legendre.leggauss(120)
    r = 0.5 * radius * (1 + nodes)
    p = np.exp(-4 * np.log(2) * r**2 / SPOT**2)
    u = centre_response(f, ECOFLEX, depth, SPOT, radius, at=r)
    return np.sum(2 * np.pi * r * p * u * weights) * 0.5 * radius


def test_uniform_shear_relaxes_by_the_analytic_curve():
    """A layer sheared by its boundary is in uniform shear: the internal force follows G_r + G_m e^{-t/tau}."""
    tau, step = ECOFLEX.branches[0].time_s, 5e-5
    e, start, end = branch_weights(step, tau)
    system = assemble(
        extrude(disc_patch(0.02, 0.01, 0.01, 0.01, 0.01), np.array([0.0, 0.4, 1.0])), ECOFLEX, base="free", side="free"
    )
    sheared = np.column_stack([system.mesh.nodes[:, 2], *np.zeros((2, len(system.mesh.nodes)))]).ravel()
    volume = 0.01 * 0.5 * np.cross(*_edges(system.mesh))[:, 2].sum()
    q = np.zeros_like(sheared)
    for n in range(1, 60):
        q = e * q + (start + end) * sheared
        force = system.parts[0].stiffness @ (sheared + ECOFLEX.relaxation.branches[0][0] * (sheared - q))
        modulus = ECOFLEX.shear_relaxed_Pa + ECOFLEX.branches[0].shear_Pa * math.exp(-n * step / tau)
        assert sheared @ force == pytest.approx(modulus * volume, rel=1e-10)


def _edges(mesh):
    a, b, c = (mesh.nodes[mesh.surface_triangles6[:, i]] for i in range(3))
    return b - a, c - a


@settings(max_examples=100, deadline=None)
@given(x=st.floats(1e-9, 1e6))
def test_branch_weights_are_exact(x):
    """q' = u - q for u = 1 and for u = t over a step of x, from rest: q = 1 - e^{-x} and x - 1 + e^{-x}."""
    e, start, end = branch_weights(x, 1.0)
    assert start + end == pytest.approx(-math.expm1(-x), rel=1e-12)
    ramp = x - 1 + math.exp(-x) if x > 0.1 else x**2 * sum((-x) ** n / math.factorial(n + 2) for n in range(12))
    assert end * x == pytest.approx(ramp, rel=1e-9)
    assert 0.0 <= e < 1.0


@settings(max_examples=300, deadline=None)
@given(
    frequency=st.floats(-6, 6),
    relaxation=st.floats(-6, 6),
    ratio=st.floats(0.0, 1e3),
    rho=st.sampled_from([0, 0.5, 0.8, 1]),
)
def test_every_mode_is_stable(frequency, relaxation, ratio, rho):
    """Spectral radius of a step of a mode never above 1: w h and h/tau from 1e-6 to 1e6, any G_m/G_r."""
    stiffness = 10.0 ** (2 * frequency)
    a_m, a_f, beta, gamma = alpha_weights(rho)
    e, start, end = branch_weights(1.0, 10.0**-relaxation)
    # State (u, v, a, q) with h = 1 and unit mass; v and a in units of w and w^2 where w > 1, for well-scaled matrices.
    left = np.zeros((4, 4))
    right = np.zeros((4, 4))
    left[0] = [(1 - a_f) * stiffness * (1 + ratio), 0, 1 - a_m, -(1 - a_f) * stiffness * ratio]
    right[0] = [-a_f * stiffness * (1 + ratio), 0, -a_m, a_f * stiffness * ratio]
    left[1], right[1] = [1, 0, -beta, 0], [1, 1, 0.5 - beta, 0]
    left[2], right[2] = [0, 1, -gamma, 0], [0, 1, 1 - gamma, 0]
    left[3], right[3] = [-end, 0, 0, 1], [start, 0, 0, e]
    unit = max(1.0, math.sqrt(stiffness * (1 + ratio)))
    columns = np.array([1.0, unit, unit**2, 1.0])
    rows = np.abs(left * columns).max(axis=1, keepdims=True)
    radius = np.abs(np.linalg.eigvals(np.linalg.solve(left * columns / rows, right * columns / rows))).max()
    # Double eigenvalues at 1 and -1 are known to the square root of round-off only.
    assert radius <= 1 + 1e-6


def test_unloaded_energy_never_grows(coarse_spot, nodal_stepper):
    """rho_inf = 1: with the branch's energy weighted by (1 + e) / 2 (1 - b), see test_foundation.py, for any step.

    Default rho_inf: the plain energy, measured.
    """
    system = coarse_spot.system
    solver = nodal_stepper(system, 2e-4, rho_inf=1.0)
    state = kicked(coarse_spot)
    decay, _, end = branch_weights(2e-4, ECOFLEX.branches[0].time_s)
    rest = np.zeros(system.ndof)
    levels = []
    for _ in range(300):
        levels.append(energy(system, state, 0.5 * (1 + decay) / (1 - end)))
        solver.step(state, rest, rest)
    assert np.all(np.diff(levels) <= 1e-12 * levels[0])
    assert levels[-1] < 0.1 * levels[0]

    solver = nodal_stepper(system, 2e-4)
    state = kicked(coarse_spot)
    levels = []
    for _ in range(300):
        levels.append(energy(system, state))
        solver.step(state, rest, rest)
    assert np.all(np.diff(levels) <= 1e-12 * levels[0])


def kicked(spot):
    """At rest under the held static load, which is then taken off."""
    state = np.zeros((4, spot.system.ndof))
    state[0] = state[3] = static(spot.system, spot.force)
    consistent_acceleration(spot.system, state)
    return state


def test_free_body_keeps_momentum(nodal_stepper):
    """Impulse in = momentum out, linear and angular, and no drift afterwards."""
    mesh = extrude(disc_patch(0.02, 0.01, 0.01, 0.01, 0.01), np.array([0.0, 0.4, 1.0]))
    system = assemble(mesh, ECOFLEX, base="free", side="free")
    force = np.random.default_rng(2).normal(size=system.ndof)
    rest = np.zeros_like(force)
    x, y, z = mesh.nodes.T
    zero = np.zeros_like(x)
    spins = [np.column_stack(t).ravel() for t in ([-y, x, zero], [zero, -z, y], [z, zero, -x])]
    rigid = np.array(spins + [np.tile(axis, len(mesh.nodes)) for axis in np.eye(3)])
    expected = 1e-4 * rigid @ force
    # Below rho_inf = 1 the algorithm's acceleration takes some steps to forget the force.
    for rho, settling in ((1.0, 0), (0.8, 100)):
        solver = nodal_stepper(system, 1e-4, rho)
        state = solver.new_state()
        # Force up in one step and down in the next: an impulse of one step.
        solver.step(state, rest, force)
        solver.step(state, force, rest)
        for n in range(300):
            if n >= settling:
                np.testing.assert_allclose(rigid @ (system.mass @ state[1]), expected, rtol=1e-7)
            solver.step(state, rest, rest)


def ramp(t):
    return 0.5 * (1 - math.cos(math.pi * min(t, 1e-3) / 1e-3))


def test_second_order_on_a_ramp(coarse_spot, nodal_stepper):
    """1 ms raised-cosine ramp; largest error of the centre over 2 ms, sampled each 0.1 ms, against a fine step."""

    def pushes(step):
        solver = nodal_stepper(coarse_spot.system, step)
        state = solver.new_state()
        seen = []
        for n in range(round(2e-3 / step)):
            solver.step(state, ramp(n * step) * coarse_spot.force, ramp((n + 1) * step) * coarse_spot.force)
            seen.append(coarse_spot.push(state[0]))
        every = round(1e-4 / step)
        return np.array(seen[every - 1 :: every])

    finest = pushes(3.125e-6)
    errors = np.array([np.abs(pushes(step) - finest).max() for step in (1e-4, 5e-5, 2.5e-5)])
    rates = np.log2(errors[:-1] / errors[1:])
    print("step errors", errors / np.abs(finest).max(), "rates", rates)
    np.testing.assert_allclose(rates, 2.0, atol=0.2)


def test_stepper_reaches_its_own_symbol(coarse_spot, nodal_stepper):
    """Long-time steady state under a sampled sine = harmonic_discrete, and that converges to harmonic like h^2."""
    f, step = 200.0, 2.5e-4
    solver = nodal_stepper(coarse_spot.system, step)
    state = solver.new_state()

    def phase(n):
        return math.cos(2 * math.pi * f * n * step)

    seen = []
    # Bulk is elastic, so the 438 Hz compression of the layer rings for some 0.1 s: wait 1.5 s.
    for n in range(6000):
        solver.step(state, phase(n) * coarse_spot.force, phase(n + 1) * coarse_spot.force)
        seen.append(coarse_spot.push(state[0]))
    discrete = coarse_spot.push(harmonic_discrete(coarse_spot.system, coarse_spot.force, f, step))
    n = np.arange(5901, 6001)
    np.testing.assert_allclose(
        seen[5900:], (discrete * np.exp(-2j * math.pi * f * n * step)).real, atol=1e-7 * abs(discrete)
    )
    exact = coarse_spot.push(harmonic(coarse_spot.system, coarse_spot.force, f))
    errors = [
        abs(coarse_spot.push(harmonic_discrete(coarse_spot.system, coarse_spot.force, f, h)) - exact)
        for h in (1e-4, 5e-5, 2.5e-5)
    ]
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.1)


@pytest.mark.parametrize("step", [0.02, 0.05])
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_steps_far_above_tau_reach_the_static_answer(coarse_spot, step, rho, nodal_stepper):
    solver = nodal_stepper(coarse_spot.system, step, rho)
    state = solver.new_state()
    still = coarse_spot.push(static(coarse_spot.system, coarse_spot.force))
    seen = []
    for _ in range(400):
        solver.step(state, coarse_spot.force, coarse_spot.force)
        seen.append(coarse_spot.push(state[0]))
    assert np.abs(seen).max() < 3 * still
    assert seen[-1] == pytest.approx(still, rel=1e-6)


def test_scaling_the_load_scales_the_answer(coarse_spot, nodal_stepper):
    solver = nodal_stepper(coarse_spot.system, 1e-4)
    small, large = solver.new_state(), solver.new_state()
    for _ in range(20):
        solver.step(small, coarse_spot.force, coarse_spot.force)
        solver.step(large, 1000 * coarse_spot.force, 1000 * coarse_spot.force)
    size = np.abs(large).max(axis=1, keepdims=True)
    np.testing.assert_allclose(large / size, 1000 * small / size, atol=1e-11)


@pytest.mark.parametrize("branches", [(), (Branch(0.0, 1e-3),), (Branch(2e4, 0.0),)])
def test_without_branch_or_viscosity_the_layer_is_elastic(coarse_spot, branches, nodal_stepper):
    mesh = coarse_spot.mesh
    answers = []
    for material in (
        dataclasses.replace(ECOFLEX, branches=branches),
        Material("elastic", 1030.0, 12.5e3, (), ECOFLEX.bulk_Pa, ""),
    ):
        system = assemble(mesh, material, side="roller")
        solver = nodal_stepper(system, 1e-4)
        state = solver.new_state()
        for n in range(30):
            solver.step(state, ramp(n * 1e-4) * coarse_spot.force, ramp((n + 1) * 1e-4) * coarse_spot.force)
        answers.append(coarse_spot.push(state[0]))
    assert answers[0] == pytest.approx(answers[1], rel=1e-9)


def test_stiff_skin_on_soft_material_scales(nodal_stepper):
    """A thousand times stiffer and denser material moves a thousand times less, at the same time."""
    pushes = []
    for s in (1.0, 1000.0):
        material = Material("s", 1000.0 * s, 1e4 * s, (Branch(2e4 * s, 1e-3),), 1e7 * s, "")
        system = assemble(extrude(disc_patch(0.02, 0.01, 0.01, 0.01, 0.01), np.array([0.0, 1.0])), material)
        solver = nodal_stepper(system, 1e-4)
        state = solver.new_state()
        force = np.random.default_rng(1).normal(size=system.ndof)
        for _ in range(10):
            solver.step(state, force, force)
        pushes.append(state[0].copy())
    np.testing.assert_allclose(1000 * pushes[1], pushes[0], rtol=1e-8, atol=1e-10 * np.abs(pushes[0]).max())


def test_state_size_and_bad_steps(coarse_spot, nodal_stepper):
    solver = nodal_stepper(coarse_spot.system, 1e-3)
    assert solver.new_state().size == solver.whole.state_size == 4 * coarse_spot.system.ndof
    for step, rho in ((0.0, 0.8), (math.nan, 0.8), (1e-3, 1.2)):
        with pytest.raises(SceneError, match="rho_inf in"):
            nodal_stepper(coarse_spot.system, step, rho)
