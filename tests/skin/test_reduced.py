"""The reduced model against the full wedge body, analytic oscillators and its own promises."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.linear_body import Matrices, Part
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.reduction.reducer import reduce
from palmfield.skin.solvers.axisymmetric.samples import principal_shapes

pytestmark = pytest.mark.numerics

ECOFLEX = preset("ecoflex_00-10")
BAND = (0.0, 600.0)
TOLERANCE = 1e-3


def chain(material, count=6, elastic=2e3, stiffness=1e4, damping=0.0, held=True):
    """Masses of 1 g on a line, between springs; the first is held to the ground."""
    k = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    k[-1, -1] = 1.0
    if not held:
        k[0, 0] = 1.0
    return Matrices(1e-3 * np.eye(count), damping * k, elastic * k, (Part(stiffness * k, material),))


def full_rates(body):
    """First-order form of a chain over (u, v, q of each branch), for comparison."""
    n = len(body.mass)
    part = body.parts[0]
    branches, viscous = part.material.relaxation
    rates = np.zeros(((2 + len(branches)) * n,) * 2)
    inverse = np.linalg.inv(body.mass)
    rates[:n, n : 2 * n] = np.eye(n)
    rates[n : 2 * n, :n] = -inverse @ (body.elastic + (1 + sum(ratio for ratio, _ in branches)) * part.stiffness)
    rates[n : 2 * n, n : 2 * n] = -inverse @ (body.damping + viscous * part.stiffness)
    for i, (ratio, tau) in enumerate(branches):
        mine = slice((2 + i) * n, (3 + i) * n)
        rates[n : 2 * n, mine] = ratio * inverse @ part.stiffness
        rates[mine, :n] = np.eye(n) / tau
        rates[mine, mine] = -np.eye(n) / tau
    return rates


@pytest.fixture(scope="module")
def skin(coarse_spot):
    system = coarse_spot.system
    model = reduce(
        system, coarse_spot.force[:, None], -coarse_spot.read, BAND, TOLERANCE, order=system.elimination_order()
    )
    print(f"{system.ndof} unknowns -> {model.order} vectors, error {model.error:.2g}")
    return model


def test_skin_static_is_exact_and_harmonic_within_the_estimate(skin, coarse_spot):
    still = coarse_spot.push(static(coarse_spot.system, coarse_spot.force))
    assert skin.transfer(0.0)[0, 0] == pytest.approx(still, rel=1e-9)
    errors = []
    for f in (35.0, 70.0, 200.0, 333.0, 590.0):
        exact = coarse_spot.push(harmonic(coarse_spot.system, coarse_spot.force, f))
        errors.append(abs(skin.transfer(f)[0, 0] / exact - 1))
    print("errors", errors, "estimate", skin.error)
    assert skin.error <= TOLERANCE
    assert max(errors) < 2 * TOLERANCE


def test_skin_am_is_the_full_bodys(skin, coarse_spot, nodal_stepper):
    """AM 200 Hz from rest, 20 ms: against the full stepper, whose own step error falls as h^2 (Richardson)."""

    def load(t):
        return 0.5 * (1 - np.cos(2 * math.pi * 200 * t))

    def stepped(step):
        solver = nodal_stepper(coarse_spot.system, step)
        state = solver.new_state()
        seen = [0.0]
        for n in range(round(0.02 / step)):
            solver.step(state, load(n * step) * coarse_spot.force, load((n + 1) * step) * coarse_spot.force)
            seen.append(coarse_spot.push(state[0]))
        return np.array(seen)[:: round(2e-4 / step)]

    coarse, fine = stepped(1e-4), stepped(5e-5)
    exact = (4 * fine - coarse) / 3
    times = np.linspace(0.0, 0.02, 1001)
    moved, velocity = skin.run(load(times)[:, None], times)
    error = np.linalg.norm(moved[::10, 0] - exact) / np.linalg.norm(exact)
    print("AM error", error)
    assert error < 2 * TOLERANCE
    middle = (moved[2:, 0] - moved[:-2, 0]) / (times[2:] - times[:-2])
    assert np.linalg.norm(velocity[1:-1, 0] - middle) < 3e-3 * np.linalg.norm(middle)


def test_steps_are_the_run_and_a_state_is_one_array(skin):
    times = np.linspace(0.0, 5e-3, 26)
    forces = np.sin(1e3 * times)[:, None]
    moved, velocity = skin.run(forces, times)
    state = skin.new_state()
    assert state.shape == (skin.state_size,) and state.dtype == np.float64
    for n in range(25):
        skin.step(state, forces[n], forces[n + 1], times[1] - times[0])
        # A copy by bytes goes on as the state itself.
        state = np.frombuffer(state.tobytes()).copy()
    scale = np.abs(moved).max()
    assert abs(skin.displacement(state)[0] - moved[-1, 0]) < 1e-8 * scale
    assert abs(skin.velocity(state)[0] - velocity[-1, 0]) < 1e-8 * np.abs(velocity).max()
    held, _ = skin.run(forces, times, "held")
    state[:] = 0.0
    for n in range(25):
        skin.step(state, forces[n], forces[n], times[1] - times[0])
    assert abs(skin.displacement(state)[0] - held[-1, 0]) < 1e-8 * scale


@pytest.mark.parametrize("step_s", [1e-7, 1e-4, 2e-3, 0.05])
def test_energy_never_grows(skin, step_s):
    """|x|^2 / 2 is the energy: no step without a load makes any state longer; long steps end at the static answer."""
    columns = np.eye(skin.state_size)
    for column in columns:
        skin.step(column, np.zeros(1), np.zeros(1), step_s)
    assert np.linalg.norm(columns, 2) <= 1 + 1e-12
    state = skin.new_state()
    for _ in range(math.ceil(1.0 / step_s) if step_s > 1e-3 else 1):
        skin.step(state, np.ones(1), np.ones(1), step_s)
    if step_s > 1e-3:
        assert skin.displacement(state)[0] == pytest.approx(skin.transfer(0.0).real[0, 0], rel=1e-6)


def test_repeats_bit_by_bit(coarse_spot):
    system = coarse_spot.system
    models = [reduce(system, coarse_spot.force[:, None], coarse_spot.read, BAND, 0.01) for _ in range(2)]
    np.testing.assert_array_equal(models[0].rates, models[1].rates)


@settings(max_examples=30, deadline=None)
@given(
    tau=st.floats(-7, 2),
    ratio=st.floats(0.0, 30.0),
    viscosity=st.sampled_from([0.0, 1e-3]),
    elastic=st.floats(0.0, 1e5),
)
def test_small_chain_is_reproduced(tau, ratio, viscosity, elastic):
    """With as many vectors as unknowns nothing is lost: transfer functions of the full first-order form, any tau."""
    material = Material("m", 1e3, 1.0, (Branch(ratio, 10.0**tau),), 1.0, "", viscosity_Pa_s=viscosity)
    body = chain(material, 4, elastic=elastic, damping=1e-3)
    inputs = np.eye(4)[:, :2]
    outputs = np.eye(4)
    model = reduce(body, inputs, outputs, (0.0, 3000.0), 1e-9)
    rates = full_rates(body)
    drive = np.zeros((len(rates), 2))
    drive[4:8] = inputs / 1e-3
    for f in (0.0, 100.0, 900.0):
        s = -2j * math.pi * f
        exact = np.linalg.solve(s * np.eye(len(rates)) - rates, drive)[:4]
        assert np.linalg.norm(model.transfer(f) - exact) < 1e-6 * np.linalg.norm(exact)


def test_oscillator_under_a_ramp_and_a_free_mass():
    """Analytic: u = a (t - sin(w t) / w) / (m w^2) under a t; t^3 / 6 m for a free mass, whose modes coincide."""
    elastic = Material("e", 1e3, 1.0, (), 1.0, "")
    times = np.array([0.0, 1e-3, 2.5e-3, 7e-3, 0.02])
    one = Matrices(np.eye(1) * 2.0, np.zeros((1, 1)), np.eye(1) * 8e5, (Part(np.zeros((1, 1)), elastic),))
    model = reduce(one, np.eye(1), np.eye(1), (0.0, 500.0), 1e-6)
    moved, velocity = model.run(3.0 * times[:, None], times)
    w = math.sqrt(4e5)
    np.testing.assert_allclose(moved[:, 0], 3.0 / 8e5 * (times - np.sin(w * times) / w), rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(velocity[:, 0], 3.0 / 8e5 * (1 - np.cos(w * times)), rtol=1e-9, atol=1e-16)
    free = chain(elastic, 3, held=False)
    model = reduce(free, np.full((3, 1), 1 / 3), np.full((1, 3), 1 / 3), (0.0, 500.0), 1e-6)
    moved, velocity = model.run(times[:, None], times)
    np.testing.assert_allclose(moved[:, 0], times**3 / 6 / 3e-3, rtol=1e-9)
    np.testing.assert_allclose(velocity[:, 0], times**2 / 2 / 3e-3, rtol=1e-9)


def test_steps_of_an_oscillator_under_a_ramp_follow_the_closed_form():
    """As above, step by step and of unequal lengths, the force linear within each."""
    one = Matrices(np.eye(1) * 2.0, np.zeros((1, 1)), np.eye(1) * 8e5, ())
    model = reduce(one, np.eye(1), np.eye(1), (0.0, 500.0), 1e-6)
    w, t, state = math.sqrt(4e5), 0.0, np.zeros(model.state_size)
    for step in (1e-3, 1.5e-3, 4.5e-3, 1e-3):
        model.step(state, np.array([3.0 * t]), np.array([3.0 * (t + step)]), step)
        t += step
        assert model.displacement(state)[0] == pytest.approx(3.0 / 8e5 * (t - math.sin(w * t) / w), rel=1e-9)
        assert model.velocity(state)[0] == pytest.approx(3.0 / 8e5 * (1.0 - math.cos(w * t)), rel=1e-9)


@settings(max_examples=20, deadline=None)
@given(tau=st.floats(-5, 0), ratio=st.floats(0.1, 10.0), damping=st.floats(0.0, 1.0), seed=st.integers(0, 1000))
def test_decoupled_steps_are_those_of_the_matrix_exponential(tau, ratio, damping, seed):
    """For several states at once, from any of them on; damping and relaxation couple the body's undamped modes."""
    body = chain(Material("m", 1e3, 1.0, (Branch(ratio, 10.0**tau),), 1.0, ""), 5, damping=damping)
    model = reduce(body, np.eye(5)[:, :2], np.eye(5), (0.0, 3000.0), 1e-9)
    modes = model.decoupled(2e-4)
    random = np.random.default_rng(seed)
    states = random.normal(size=(3, model.state_size))
    first, last = random.normal(size=(2, 3, 6, 2))
    z = first @ modes.start + last @ modes.end
    modes.march(states @ modes.there, z)
    assert len(modes.fall) > 0
    for state, starts, ends, found in zip(states, first, last, z @ modes.back, strict=True):
        for force, then, after in zip(starts, ends, found, strict=True):
            model.step(state, force, then, 2e-4)
            assert np.abs(after - state).max() < 1e-9 * np.abs(found).max()


def test_modes_that_coincide_are_not_decoupled():
    free = chain(Material("e", 1e3, 1.0, (), 1.0, ""), 3, held=False)
    assert reduce(free, np.eye(3)[:, :1], np.eye(3), (0.0, 500.0), 1e-6).decoupled(1e-4) is None


def test_complex_forces_are_two_real_runs(skin):
    times = np.linspace(0.0, 4e-3, 41)
    a, b = np.cos(900 * times)[:, None], np.sin(500 * times)[:, None]
    both = skin.run(a + 1j * b, times)[0]
    np.testing.assert_allclose(both, skin.run(a, times)[0] + 1j * skin.run(b, times)[0], atol=1e-20)


def test_pod_keeps_what_matters():
    x = np.linspace(-1.0, 1.0, 200)
    loads = np.exp(-(((x[:, None] - np.linspace(-0.5, 0.5, 60)) / 0.3) ** 2))
    for tolerance in (1e-1, 1e-3, 1e-6):
        shapes, coordinates = principal_shapes(loads, tolerance)
        assert shapes.shape[1] < 20
        assert np.linalg.norm(loads - shapes @ coordinates, 2) <= tolerance * np.linalg.norm(loads, 2)


def test_bad_input():
    body = chain(ECOFLEX)
    force, read = np.eye(6)[:, :1], np.eye(6)[:1]
    for keys, reason in (
        ({"inputs": force[:4]}, "give"),
        ({"outputs": read[:, :3]}, "give"),
        ({"band_Hz": (100.0, 50.0)}, "band"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"inputs": np.full((6, 1), np.nan)}, "finite"),
        ({"outputs": 0.0 * read}, "do not move"),
    ):
        with pytest.raises(SceneError, match=reason):
            reduce(body, **{"inputs": force, "outputs": read, "band_Hz": BAND, "tolerance": 1e-3, **keys})
    long = chain(ECOFLEX, 60)
    with pytest.raises(SceneError, match=r"with \d+ vectors"):
        reduce(long, np.eye(60)[:, :1], np.eye(60)[:1], BAND, 1e-12, most_vectors=9)
    model = reduce(body, sparse.csr_matrix(force), read, BAND, 1e-3)
    with pytest.raises(SceneError, match="rising"):
        model.run(np.ones((2, 1)), np.array([0.0, 0.0]))
    with pytest.raises(SceneError, match="forces"):
        model.run(np.ones((2, 2)), np.array([0.0, 1.0]))
