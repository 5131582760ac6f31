"""Small models for loads known ahead, against the whole wedge body and analytic oscillators."""

import math

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import expm

from palmfield.errors import SceneError
from palmfield.skin.fem.linear_body import Matrices, Part
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe, surface_motion
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.reduction import reduced_stepper as module
from palmfield.skin.reduction.course import harmonics, level, periodic
from palmfield.skin.reduction.device_models import DeviceReduced
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import Krylov
from palmfield.skin.reduction.reduced_stepper import KnownLoad, reduced_stepper
from palmfield.skin.stepper import SurfaceLoads

pytestmark = pytest.mark.numerics

STEP = 1e-4
TIMES = STEP * np.arange(251)
TOLERANCE = 5e-3


@pytest.fixture(scope="module")
def disc(make_spot):
    """60 mm disc, 3 k unknowns, free sides; its quadrature and what reads its surface."""
    spot = make_spot(0.0075, 1, radius_m=0.03, side="free")
    return spot, SurfaceQuadrature(spot.mesh, spot.system), surface_motion(spot.mesh, spot.system)


def forced(spot):
    """Inputs of steppers whose "pressures" are nodal forces themselves."""
    return sparse.identity(spot.system.ndof, format="csr")


def model_of(disc, load, tolerance=TOLERANCE, highest_Hz=400.0):
    spot, _, surface = disc
    return reduced_stepper(spot.system, load, surface, spot.read, forced(spot), STEP, highest_Hz, tolerance)


def stepped(stepper, surface, force, steps, state=None, begin=0):
    """What is seen after each of `steps` substeps from number `begin` on, (steps, 2, m), and the state."""
    state = np.zeros((1, stepper.state_size)) if state is None else state
    times = stepper.step_s * np.arange(begin, begin + steps + 1)
    weights = np.eye(steps + 1)[None]
    loads = SurfaceLoads(np.array([force(t) for t in times])[None], weights[:, :-1], weights[:, 1:])
    seen = stepper.step(state, loads, times[0], times[-1], stepper.reader(surface))
    return seen[0], state


def converged(disc, force, knots, parts=2):
    """Motion of the whole body under the load's chords between knots, at the knots: two steps, then the limit."""
    spot, _, surface = disc
    known = [force(t) for t in knots]
    found = []
    for cut in (parts, 2 * parts):
        stepper = WedgeStepper(spot.system, forced(spot), STEP / cut)

        def chord(t):
            k = min(int(t / STEP + 1e-6), len(knots) - 2)
            share = t / STEP - k
            return (1 - share) * known[k] + share * known[k + 1]

        found.append(stepped(stepper, surface, chord, cut * (len(knots) - 1))[0][cut - 1 :: cut])
    return (4 * found[1] - found[0]) / 3


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def am(t):
    return (0.5 + 0.5 * np.sin(2 * np.pi * 200 * t)) ** 2


@pytest.fixture(scope="module")
def at_one_place(disc):
    force = disc[0].force[:, None]
    one = np.ones(1, complex)
    return model_of(disc, KnownLoad(force, force, [am(TIMES)[:, None]], [(0.0, one), (200.0, one), (400.0, one)]))


def test_am_is_the_whole_bodys_within_the_estimate(disc, at_one_place):
    spot, _, surface = disc
    exact = converged(disc, lambda t: am(t) * spot.force, TIMES)
    seen, _ = stepped(at_one_place, surface, lambda t: am(t) * spot.force, len(TIMES) - 1)
    error = relative(seen[:, 0], exact[:, 0])
    print(spot.system.ndof, at_one_place.model.order, "error", error, "estimate", at_one_place.error)
    assert error < at_one_place.error <= TOLERANCE
    assert at_one_place.any_course and at_one_place.model.order < 60


@pytest.mark.parametrize("f", [0.0, 70.0, 200.0, 400.0])
def test_harmonic_is_the_whole_bodys(disc, at_one_place, f):
    spot, _, surface = disc
    exact = surface @ (static(spot.system, spot.force) if f == 0.0 else harmonic(spot.system, spot.force, f))
    assert relative(at_one_place.harmonic(spot.force, f, surface), exact) < TOLERANCE


@pytest.mark.parametrize(("ring_up", "last", "most"), [(0.0, 300, 120), (5000.0, 110, 240)])
def test_a_focus_on_a_circle_takes_fewer_vectors_than_its_shapes(disc, ring_up, last, most):
    """15 harmonics, 29 shapes, of a spot that starts on a circle, 70 turns a second, and stops, or doesn't."""
    _, quadrature, surface = disc
    times = TIMES[:151]
    angle = 2 * np.pi * np.arange(64) / 64
    x, y = quadrature.points[:, 0], quadrature.points[:, 1]
    bells = np.exp(
        -4
        * np.log(2)
        * ((x[:, None] - 0.01 * np.cos(angle)) ** 2 + (y[:, None] - 0.01 * np.sin(angle)) ** 2)
        / 0.0103**2
    )
    waves = np.conj(np.fft.rfft(quadrature.operator @ bells, axis=1))[:, :15] / 64
    waves[:, 1:] *= 2
    frequencies = 70.0 * np.arange(15)
    stop = STEP * last
    begin, end = ((0.0, 1.0),), ((0.0, -1.0),)
    if ring_up:
        begin, end = ((0.0, 1.0), (ring_up, -2.0), (2 * ring_up, 1.0)), ((0.0, -1.0), (2 * ring_up, 1.0))
    events = [(0.0, begin)] if stop > times[-1] else [(0.0, begin), (stop, end)]
    course = periodic(waves, frequencies, events)

    def factor(t):
        return level(begin, t) + np.where(t < stop - 1e-9, 0.0, level(end, t - stop))

    def force(t):
        return factor(t) * (waves @ np.exp(-2j * np.pi * frequencies * t)).real

    trials = [level(fade, times)[:, None] * harmonics(frequencies, time + times) for time, fade in events]
    spectrum = [(f, np.kron(np.eye(15)[k], [1.0, -1j])) for k, f in enumerate(frequencies)]
    small = model_of(disc, KnownLoad(course, course.shapes, trials, spectrum))
    # A sudden beginning converges slowly.
    exact = converged(disc, force, times, parts=6 if ring_up == 0.0 else 2)
    seen, _ = stepped(small, surface, force, len(times) - 1)
    error = relative(seen[:, 0], exact[:, 0])
    print("order", small.model.order, "error", error, "estimate", small.error)
    assert error < small.error <= TOLERANCE
    assert not small.any_course and small.model.order < most


def test_a_state_goes_on_in_the_whole_body(disc, at_one_place):
    """Lifted in the middle of the modulation, the whole body does what the small model would have done."""
    spot, _, surface = disc
    seen, _ = stepped(at_one_place, surface, lambda t: am(t) * spot.force, 200)
    _, state = stepped(at_one_place, surface, lambda t: am(t) * spot.force, 100)
    whole = WedgeStepper(spot.system, forced(spot), STEP)
    state = at_one_place.lifted(state, lambda: am(100 * STEP) * spot.force)
    assert state.shape == (1, whole.state_size)
    there = whole.read(state, whole.reader(surface))[0]
    np.testing.assert_allclose(there, seen[99], atol=1e-12 * np.abs(seen[99]).max())
    found, _ = stepped(whole, surface, lambda t: am(t) * spot.force, 100, state, 100)
    assert relative(found[:, 0], seen[100:, 0]) < 0.01
    assert relative(found[:, 1], seen[100:, 1]) < 0.03


def test_linear_in_the_load_and_repeatable(disc, at_one_place):
    spot, _, surface = disc
    one, _ = stepped(at_one_place, surface, lambda t: am(t) * spot.force, 20)
    thousand, _ = stepped(at_one_place, surface, lambda t: 1000 * am(t) * spot.force, 20)
    np.testing.assert_allclose(thousand, 1000 * one, rtol=1e-9, atol=1e-12 * np.abs(thousand).max())
    force = spot.force[:, None]
    load = KnownLoad(force, force, [am(TIMES[:50])[:, None]], [(200.0, np.ones(1, complex))])
    models = [model_of(disc, load, 0.02) for _ in range(2)]
    np.testing.assert_array_equal(models[0].model.rates, models[1].model.rates)
    np.testing.assert_array_equal(models[0].vectors, models[1].vectors)


def test_pressures_that_stay_are_stepped_over_at_once(disc, at_one_place):
    """As substep by substep, for several worlds and patterns, and again with what was kept."""
    stepper, random = at_one_place, np.random.default_rng(3)
    pressure = random.standard_normal((3, 2, disc[0].system.ndof))
    begun = random.standard_normal((3, stepper.state_size))
    for _ in range(2):
        first, last = random.random((2, 3, 5, 2))
        states = begun.copy(), begun.copy()
        for state, fixed in zip(states, (False, True), strict=True):
            stepper.step(state, SurfaceLoads(pressure, first, last, fixed), 0.0, 5.0 * STEP)
        np.testing.assert_allclose(states[1], states[0], rtol=0.0, atol=1e-12 * np.abs(states[0]).max())


@pytest.mark.parametrize("fixed", [False, True])
def test_one_pressure_of_all_worlds_is_as_one_of_each(disc, at_one_place, fixed):
    rng = np.random.default_rng(0)
    pressure, weights = rng.normal(size=(1, at_one_place.unknowns)), rng.uniform(size=(2, 5, 4, 1))
    states = []
    for shared in (np.broadcast_to(pressure, (5, *pressure.shape)), np.tile(pressure, (5, 1, 1))):
        state = np.ones((5, at_one_place.state_size))
        for _ in range(2):
            at_one_place.step(state, SurfaceLoads(shared, *weights, fixed), 0.0, 4 * STEP)
        states.append(state)
    np.testing.assert_allclose(*states, rtol=0.0, atol=1e-12 * np.abs(states[1]).max())


def test_many_worlds_are_what_each_is_by_itself(disc, at_one_place):
    """In blocks on all cores; one sensor is read in another order of products."""
    worlds, random = 2 * module.BLOCK + 3, np.random.default_rng(4)
    pressure = random.random((1, 1, len(at_one_place.shares)), np.float32)
    shared = np.broadcast_to(pressure, (worlds, *pressure.shape[1:]))
    first, last = random.random((2, worlds, 4, 1))
    state = random.standard_normal((worlds, at_one_place.state_size))
    alone = state.copy()
    at_one_place.step(state, SurfaceLoads(shared, first, last, True), 0.0, 4 * STEP)
    reader = at_one_place.reader(disc[2][:3])
    seen = at_one_place.read(state, reader)
    for world in (0, module.BLOCK - 1, module.BLOCK, worlds - 1):
        own = slice(world, world + 1)
        at_one_place.step(alone[own], SurfaceLoads(pressure, first[own], last[own], True), 0.0, 4 * STEP)
        np.testing.assert_allclose(state[own], alone[own], rtol=0.0, atol=1e-12 * np.abs(alone[own]).max())
        np.testing.assert_allclose(seen[own], at_one_place.read(alone[own], reader), rtol=1e-9, atol=1e-15)


def test_a_device_moves_a_small_model_as_its_stepper(disc, at_one_place, on_device):
    stepper, random = at_one_place, np.random.default_rng(3)
    pressure = random.standard_normal((2, 2, disc[0].system.ndof)).astype(np.float32)
    state = random.standard_normal((2, stepper.state_size))
    first, last = random.random((2, 2, 5, 2))
    first[1, :, -1] = last[1, :, -1] = 0.0
    loads = SurfaceLoads(pressure, first, last)
    found, _ = on_device(DeviceReduced(stepper, 5, pressure.shape[2], "cpu"), state, loads)
    stepper.step(state, loads, 0.0, 5.0 * STEP)
    np.testing.assert_allclose(found, state, rtol=0.0, atol=1e-5 * np.abs(state).max())


def test_more_vectors_than_allowed_are_refused(disc, monkeypatch):
    monkeypatch.setattr(module, "MOST_VECTORS", 10)
    force = disc[0].force[:, None]
    load = KnownLoad(force, force, [am(TIMES)[:, None]], [(200.0, np.ones(1, complex))])
    with pytest.raises(SceneError, match=r"vectors.*solver 'wedges'"):
        model_of(disc, load, 1e-6)


@pytest.mark.parametrize("tau", [1e-7, 3e-4, 10.0])
@pytest.mark.parametrize("viscosity", [0.0, 1e-3])
def test_as_many_vectors_as_unknowns_lose_nothing(tau, viscosity):
    """Masses between springs: the answers of Z(s) itself, of every tau; then the space has come to its end."""
    k = 2 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1)
    material = Material("m", 1e3, 1.0, (Branch(2.0, tau), Branch(0.7, 1e-3)), 1.0, "", viscosity_Pa_s=viscosity)
    body = Matrices(1e-3 * np.eye(5), 1e-3 * k, 2e3 * k @ k, (Part(1e4 * k, material),))
    krylov = Krylov(DynamicStiffness(body), 800.0, np.eye(5)[:, :2])
    while krylov.order < 5:
        assert krylov.grow() > 0
    np.testing.assert_allclose(krylov.vectors.T @ (1e-3 * krylov.vectors), np.eye(5), atol=1e-12)
    mass, damping, elastic, relaxing = krylov.projected
    for f in (0.0, 60.0, 700.0):
        s = -2j * math.pi * f
        whole = s**2 * body.mass + s * body.damping + body.elastic + material.stiffening(s) * 1e4 * k
        small = s**2 * mass + s * damping + elastic + material.stiffening(s) * relaxing
        exact = np.linalg.solve(whole, np.eye(5)[:, :2])
        found = krylov.vectors @ np.linalg.solve(small, krylov.vectors[:2].T)
        np.testing.assert_allclose(found, exact, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("ring_up", [50.0, 900.0])
def test_a_course_is_its_sum_of_harmonics(ring_up):
    rng = np.random.default_rng(1)
    waves = rng.normal(size=(4, 3)) + 1j * rng.normal(size=(4, 3))
    frequencies, times = np.array([0.0, 70.0, 140.0]), np.array([0.0, 2.3e-3])
    begin, end = ((0.0, 1.0), (ring_up, -2.0), (2 * ring_up, 1.0)), ((0.0, -1.0), (2 * ring_up, 1.0))
    course = periodic(waves, frequencies, [(times[0], begin), (times[1], end)])
    for t in (0.0, 1e-3, 4.7e-3):
        found = course.shapes @ course.mix @ expm(t * course.rates) @ course.starts
        factor = np.array([(1 - math.exp(-ring_up * t)) ** 2, math.exp(-2 * ring_up * t) - 1])
        exact = factor * (waves @ np.exp(-2j * np.pi * np.outer(frequencies, times + t))).real
        np.testing.assert_allclose(found, exact, atol=1e-12)


def test_probe_and_surface_read_the_same_motion(disc, at_one_place):
    spot, _, surface = disc
    _, state = stepped(at_one_place, surface, lambda t: am(t) * spot.force, 30)
    node = int(np.hypot(*spot.mesh.nodes[: spot.mesh.surface_nodes, :2].T).argmin())
    probe = SurfaceProbe(spot.mesh, spot.mesh.nodes[node : node + 1], spot.system)
    np.testing.assert_allclose(
        at_one_place.read(state, at_one_place.reader(probe.operator))[0, :, 0],
        at_one_place.read(state, at_one_place.reader(surface))[0, :, node],
        rtol=1e-9,
    )


def test_two_equal_beginnings_are_one(disc):
    """A load that goes after whole turns as it came adds nothing, above all no vector of round-off."""
    spot = disc[0]
    waves = np.column_stack([spot.force, np.roll(spot.force, 3)]).astype(complex)
    frequencies = np.array([0.0, 70.0])
    once = periodic(waves, frequencies, [(0.0, ((0.0, 1.0),))])
    twice = periodic(waves, frequencies, [(0.0, ((0.0, 1.0),)), (3 / 70, ((0.0, -1.0),))])
    dynamics = DynamicStiffness(spot.system)
    orders = []
    for course in (once, twice):
        krylov = Krylov(dynamics, 1500.0, course)
        for _ in range(12):
            krylov.grow()
        gram = krylov.vectors.T @ (spot.system.mass @ krylov.vectors)
        np.testing.assert_allclose(gram, np.eye(krylov.order), atol=1e-9)
        orders.append(krylov.order)
    assert orders[0] == orders[1] == 13
