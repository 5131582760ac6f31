"""The protocol of what steps a skin: the whole layer and the small model, in scenes and behind `solve` alike."""

import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import sparse
from threadpoolctl import threadpool_info

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.fem import wedge_stepper
from palmfield.skin.fem.factor import factorise, superlu
from palmfield.skin.fem.generalised_alpha import Scheme, alpha_weights, branch_weights
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import surface_motion
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.reduction.reduced_stepper import KnownLoad, reduced_stepper
from palmfield.skin.stepper import SurfaceLoads

STEP = 1e-4
SUBSTEPS = 6
RUBBERY = Material("rubbery", 1000.0, 3e4, (Branch(2e4, 1e-3), Branch(1e4, 1e-2)), 1e7, "test", 0.5)


@pytest.fixture(scope="module")
def disc(make_spot):
    """A disc of two branches and a viscosity under absorbing sides: every matrix of a system is there."""
    spot = make_spot(0.0075, 1, radius_m=0.03, material=RUBBERY, side="absorbing", absorbing_Hz=200.0)
    assert spot.system.damping.nnz
    return spot.system, SurfaceQuadrature(spot.mesh, spot.system), surface_motion(spot.mesh, spot.system), spot


@pytest.fixture(scope="module")
def whole(disc):
    return WedgeStepper(disc[0], disc[1].operator, STEP)


@pytest.fixture(scope="module")
def small(disc):
    system, quadrature, surface, spot = disc
    force = spot.force[:, None]
    times = STEP * np.arange(200)
    known = KnownLoad(force, force, [np.sin(2e3 * times)[:, None]], [(200.0, np.ones(1, complex))])
    return reduced_stepper(system, known, surface, spot.read, quadrature.operator, STEP, 400.0, 0.01)


@pytest.fixture(params=["whole", "small"])
def stepper(request):
    return request.getfixturevalue(request.param)


def rest(stepper):
    return np.zeros((1, stepper.state_size))


def bells(disc, patterns=3, substeps=SUBSTEPS, seed=0):
    """Gaussian spots about the middle with random weights."""
    rng = np.random.default_rng(seed)
    points = disc[1].points
    centres = rng.uniform(-0.005, 0.005, (patterns, 1, 2))
    pressure = np.exp(-(((points[:, :2] - centres) / 0.006) ** 2).sum(axis=2))[None]
    return SurfaceLoads(pressure, *rng.uniform(0.0, 10.0, (2, 1, substeps, patterns)))


def worlds_of(loads):
    """The loads of several bodies, stepped together; those of none have no rows."""
    if not loads:
        return SurfaceLoads(np.zeros((0, 1, 1)), np.zeros((0, SUBSTEPS, 1)), np.zeros((0, SUBSTEPS, 1)))
    parts = zip(*((one.pressure_Pa, one.first, one.last) for one in loads), strict=True)
    return SurfaceLoads(*(np.concatenate(part) for part in parts))


def part_of(loads, which):
    return SurfaceLoads(loads.pressure_Pa, loads.first[:, which], loads.last[:, which])


def test_a_substep_of_wedges_balances_forces(disc, whole):
    """Chung & Hulbert (1993), equations 12 to 15, by rows of the states before and after."""
    system, quadrature, *_ = disc
    loads = bells(disc)
    state = rest(whole)
    whole.step(state, loads, 0.0, SUBSTEPS * STEP)
    old = state[0].reshape(whole.state_rows, -1).copy()
    whole.step(state, part_of(loads, slice(0, 1)), 0.0, STEP)
    new = state[0].reshape(whole.state_rows, -1)
    alpha_m, alpha_f, beta, gamma = alpha_weights(0.8)
    u0, v0, a0 = old[:3]
    u1, v1, a1 = new[:3]
    np.testing.assert_allclose(u1, u0 + STEP * v0 + STEP**2 * ((0.5 - beta) * a0 + beta * a1), rtol=1e-9)
    np.testing.assert_allclose(v1, v0 + STEP * ((1 - gamma) * a0 + gamma * a1), rtol=1e-9, atol=1e-9 * abs(v1).max())
    middle = alpha_f * old + (1.0 - alpha_f) * new
    stresses, n = [], 3
    (part,) = system.parts
    stress = middle[0] + part.material.relaxation.viscous_time_s * middle[1]
    for ratio, tau in part.material.relaxation.branches:
        e, start, end = branch_weights(STEP, tau)
        np.testing.assert_allclose(new[n], e * old[n] + start * u0 + end * u1, rtol=1e-9, atol=1e-12 * abs(u1).max())
        stress = stress + ratio * (middle[0] - middle[n])
        n += 1
    inertia = system.mass @ (alpha_m * a0 + (1.0 - alpha_m) * a1)
    stresses = system.damping @ middle[1] + system.elastic @ middle[0] + part.stiffness @ stress
    pressure = (alpha_f * loads.first[0, 0] + (1.0 - alpha_f) * loads.last[0, 0]) @ loads.pressure_Pa[0]
    force = quadrature.assemble(pressure)
    np.testing.assert_allclose(inertia + stresses, force, atol=1e-9 * abs(stresses).max())


def test_leaving_one_matrix_out_of_a_substep_changes_nothing(disc, whole):
    system, quadrature, *_ = disc
    loads, state = bells(disc), rest(whole)
    whole.step(state, loads, 0.0, SUBSTEPS * STEP)
    scheme = Scheme(system, STEP, 0.8)
    factor = factorise(scheme.effective())
    plain = np.zeros((scheme.state_rows, system.ndof))
    for first, last in zip(loads.first[0], loads.last[0], strict=True):
        pressure = (scheme.alpha_f * first + (1.0 - scheme.alpha_f) * last) @ loads.pressure_Pa[0]
        right = quadrature.assemble(pressure) + sum(term.matrix @ (term.row @ plain) for term in scheme.terms)
        plain = scheme.advance @ plain + np.multiply.outer(scheme.follow, factor.solve(right))
    for mine, theirs in zip(state[0].reshape(plain.shape), plain, strict=True):
        # The matrices' condition makes 1e-11 of round-off: as much as another elimination order does.
        np.testing.assert_allclose(mine, theirs, atol=1e-10 * abs(theirs).max())


def test_a_substep_of_wedges_is_the_same_on_any_number_of_threads(disc, monkeypatch):
    loads, states = bells(disc, patterns=1), []
    for stored in (1, 10**9):
        monkeypatch.setattr(wedge_stepper, "STORED_PER_THREAD", stored)
        stepper = WedgeStepper(disc[0], disc[1].operator, STEP)
        states.append(rest(stepper))
        stepper.step(states[-1], loads, 0.0, SUBSTEPS * STEP)
    np.testing.assert_array_equal(*states)
    assert np.abs(states[0]).max() > 0.0


def test_the_small_model_is_exact_in_time(disc, small):
    """Consistency with the model's own exponential, which closed forms hold in test_reduced.py."""
    loads, state = bells(disc), rest(small)
    small.step(state, loads, 0.0, SUBSTEPS * STEP)
    one = np.zeros(small.state_size)
    forces = loads.pressure_Pa[0] @ disc[1].operator.T @ small.vectors
    for first, last in zip(loads.first[0], loads.last[0], strict=True):
        small.model.step(one, first @ forces, last @ forces, STEP)
    np.testing.assert_allclose(state[0], one, atol=1e-12 * abs(one).max())


def test_the_small_model_takes_substeps_of_any_length(disc, small):
    """A load that is linear over one long substep is so over its parts: by modes, by the exponential, all the same."""
    whole, parts = rest(small), rest(small)
    loads = bells(disc, substeps=1)
    shares = np.linspace(0.0, 1.0, 8)[:, None]
    courses = (1.0 - shares) * loads.first[0] + shares * loads.last[0]
    small.step(whole, loads, 0.0, 7 * STEP)
    for begin, end in ((0, 2), (2, 3), (3, 7)):
        cut = SurfaceLoads(loads.pressure_Pa, courses[None, [begin]], courses[None, [end]])
        small.step(parts, cut, begin * STEP, end * STEP)
    np.testing.assert_allclose(whole, parts, atol=1e-9 * abs(parts).max())
    steady = np.concatenate([loads.first, loads.first], axis=1)
    small.step(parts, SurfaceLoads(loads.pressure_Pa, steady, steady), 0.0, 0.5)
    still = small.model.transfer(0.0).real @ (
        loads.first[0, 0] @ loads.pressure_Pa[0] @ disc[1].operator.T @ small.vectors
    )
    np.testing.assert_allclose(small.model.displacement(parts[0]), still, atol=1e-4 * abs(still).max())


def test_small_model_and_whole_layer_agree(disc, small, whole):
    _, quadrature, surface, _ = disc
    distance2 = (quadrature.points[:, :2] ** 2).sum(axis=1)
    pressure = np.exp(-4 * np.log(2) * distance2 / 0.0103**2)[None, None]
    course = np.sin(2e3 * STEP * np.arange(201))[None, :, None]
    loads = SurfaceLoads(pressure, course[:, :-1], course[:, 1:])
    seen = [each.step(rest(each), loads, 0.0, 200 * STEP, each.reader(surface))[0, :, 0] for each in (small, whole)]
    # Generalised-alpha's own error is 0.1 (w h)^2, 0.4 %.
    assert np.linalg.norm(seen[0] - seen[1]) < 0.02 * np.linalg.norm(seen[1])


def test_all_substeps_in_one_call_are_those_one_by_one(disc, stepper):
    loads, together, alone = bells(disc), rest(stepper), rest(stepper)
    stepper.step(together, loads, 1.0, 1.0 + SUBSTEPS * STEP)
    for n in range(SUBSTEPS):
        stepper.step(alone, part_of(loads, slice(n, n + 1)), 1.0 + n * STEP, 1.0 + (n + 1) * STEP)
    np.testing.assert_allclose(together, alone, rtol=0.0, atol=1e-13 * abs(alone).max())


def test_observing_reads_what_read_does_and_changes_nothing(disc, stepper):
    loads, state, unseen = bells(disc), rest(stepper), rest(stepper)
    reader = stepper.reader(disc[2])
    seen = stepper.step(state, loads, 0.0, SUBSTEPS * STEP, reader)
    assert seen.shape == (1, SUBSTEPS, 2, disc[2].shape[0])
    np.testing.assert_allclose(seen[:, -1], stepper.read(state, reader), rtol=1e-12, atol=1e-13 * abs(seen).max())
    assert stepper.step(unseen, loads, 0.0, SUBSTEPS * STEP) is None
    np.testing.assert_array_equal(state, unseen)


def test_readers_give_displacement_and_velocity_of_the_layer(disc, small, whole):
    state = rest(small)
    small.step(state, bells(disc), 0.0, SUBSTEPS * STEP)
    pressure = np.zeros(disc[1].operator.shape[1])
    lifted = small.lifted(state, lambda: pressure)
    assert lifted.shape == (1, whole.state_size)
    rows = lifted[0].reshape(whole.state_rows, -1)
    seen = whole.read(lifted, whole.reader(disc[2]))
    np.testing.assert_allclose(seen[0], rows[:2] @ disc[2].T.toarray(), atol=1e-12 * abs(seen).max())
    np.testing.assert_allclose(small.read(state, small.reader(disc[2])), seen, atol=1e-12 * abs(seen).max())


def test_a_lifted_state_balances_in_the_small_space(disc, small):
    """M a + C v + E u + K (u + t v + sum g (u - q)) = F, tested with the vectors of the small model."""
    system, quadrature, *_ = disc
    loads, state = bells(disc), rest(small)
    small.step(state, loads, 0.0, SUBSTEPS * STEP)
    pressure = loads.last[0, -1] @ loads.pressure_Pa[0]
    u, v, a, *branches = small.lifted(state, lambda: pressure)[0].reshape(-1, system.ndof)
    (part,) = system.parts
    stress = u + part.material.relaxation.viscous_time_s * v
    stress = stress + sum(g * (u - q) for (g, _), q in zip(part.material.relaxation.branches, branches, strict=True))
    inner = system.mass @ a + system.damping @ v + system.elastic @ u + part.stiffness @ stress
    force = quadrature.assemble(pressure)
    missed = small.vectors.T @ (inner - force)
    assert abs(missed).max() < 1e-8 * abs(small.vectors.T @ force).max()


def calls_in(action):
    count = 0

    def event(frame, kind, argument):
        nonlocal count
        count += kind == "call"

    sys.setprofile(event)
    try:
        action()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize(("name", "most"), [("whole", 12), ("small", 6)])
def test_a_substep_takes_few_python_calls(disc, request, name, most):
    stepper = request.getfixturevalue(name)
    state, reader = rest(stepper), stepper.reader(disc[2])
    counts = []
    for substeps in (2, 12):
        loads = bells(disc, substeps=substeps)
        stepper.step(state, loads, 0.0, substeps * STEP, reader)
        counts.append(calls_in(lambda n=substeps, load=loads: stepper.step(state, load, 0.0, n * STEP, reader)))
    assert counts[1] - counts[0] <= 10 * most
    assert counts[0] - (counts[1] - counts[0]) / 5 <= 15


def test_threads_share_a_stepper(disc, stepper):
    loads = [bells(disc, seed=seed) for seed in range(4)]
    begin = threading.Barrier(4)

    def carried(load, wait=True):
        state = rest(stepper)
        if wait:
            begin.wait()
        for _ in range(5):
            stepper.step(state, load, 0.0, SUBSTEPS * STEP)
        return state

    alone = [carried(load, wait=False) for load in loads]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(carried, loads))
    np.testing.assert_array_equal(together, alone)


def test_each_of_several_worlds_moves_as_if_alone(disc, stepper):
    """Other loads in each, in states that are rows of a wider array, as scenes keep them."""
    loads = [bells(disc, seed=seed) for seed in range(3)]
    reader = stepper.reader(disc[2])
    room = np.full((3, stepper.state_size + 7), np.nan)
    states = room[:, 4:-3]
    states[:] = 0.0
    for _ in range(2):
        seen = stepper.step(states, worlds_of(loads), 0.0, SUBSTEPS * STEP, reader)
    assert np.isnan(room[:, [0, 3, -3, -1]]).all()
    together = stepper.read(states, reader)
    for i, load in enumerate(loads):
        state = rest(stepper)
        for _ in range(2):
            alone = stepper.step(state, load, 0.0, SUBSTEPS * STEP, reader)
        assert np.linalg.norm(seen[i] - alone[0]) < 1e-12 * np.linalg.norm(alone)
        now = stepper.read(state, reader)[0]
        assert np.linalg.norm(together[i] - now) < 1e-12 * np.linalg.norm(now)
    assert np.linalg.norm(together[0] - together[1]) > 0.01 * np.linalg.norm(together[0])


def test_pressures_that_do_not_change_give_the_same_motion(disc, stepper):
    """What a stepper keeps of them is not taken for other pressures, and pressures that may change are read anew."""
    loads = bells(disc), bells(disc, seed=1)
    fixed = [SurfaceLoads(one.pressure_Pa, one.first, one.last, fixed=True) for one in loads]
    plain, kept = rest(stepper), rest(stepper)
    for number in (0, 0, 1, 0):
        stepper.step(plain, loads[number], 0.0, SUBSTEPS * STEP)
        stepper.step(kept, fixed[number], 0.0, SUBSTEPS * STEP)
    np.testing.assert_allclose(kept, plain, rtol=1e-9, atol=1e-12 * np.abs(plain).max())
    loads[0].pressure_Pa[:] *= 2.0
    changed = rest(stepper)
    for _ in range(2):
        stepper.step(changed, loads[0], 0.0, SUBSTEPS * STEP)
    half = rest(stepper)
    for _ in range(2):
        stepper.step(half, bells(disc), 0.0, SUBSTEPS * STEP)
    assert np.linalg.norm(changed - 2.0 * half) < 1e-12 * np.linalg.norm(changed)


def test_what_is_refused(disc, stepper):
    loads = bells(disc)
    with pytest.raises(SceneError, match=r"state has shape \(2, .* of 1 worlds; .* needs shape \(1, "):
        stepper.step(np.zeros((2, stepper.state_size)), loads, 0.0, SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="needs shape"):
        stepper.step(np.zeros((1, stepper.state_size + 1)), loads, 0.0, SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="w >= 1"):
        stepper.step(np.zeros((0, stepper.state_size)), worlds_of([]), 0.0, SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="contiguous rows"):
        stepper.step(np.zeros((stepper.state_size, 1)).T.repeat(2, axis=1)[:, ::2], loads, 0.0, SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="loads cover 6 substeps"):
        stepper.step(rest(stepper), loads, 0.0, 0.0 if stepper.name == "reduced" else 2 * SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="skin loads"):
        stepper.step(rest(stepper), SurfaceLoads(loads.pressure_Pa[:, 1:], loads.first, loads.last), 0.0, 6 * STEP)
    for pressure in (loads.pressure_Pa[..., 1:], np.zeros((1, loads.pressure_Pa.shape[1], 10_000))):
        with pytest.raises(SceneError, match="skin loads"):
            stepper.step(rest(stepper), SurfaceLoads(pressure, loads.first, loads.last), 0.0, SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="s >= 1"):
        stepper.step(rest(stepper), part_of(loads, slice(0, 0)), 0.0, 0.0)
    with pytest.raises(SceneError, match="unknowns"):
        stepper.reader(sparse.csr_matrix((2, 5)))


def blas_threads():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_one_blas_thread_inside_and_as_many_as_before_after():
    before = blas_threads()
    with one_blas_thread:
        assert set(blas_threads()) == {1}
        with one_blas_thread:
            pass
        assert set(blas_threads()) == {1}
    assert blas_threads() == before


@pytest.mark.parametrize(("fine_m", "radius_m"), [(0.0075, 0.03), (0.006, 0.04)])
def test_dissection_fills_less_than_minimum_degree(make_spot, fine_m, radius_m):
    system = make_spot(fine_m, 2, radius_m=radius_m).system
    matrix = Scheme(system, STEP, 0.8).effective()
    placed, own = superlu(matrix, system.elimination_order()), superlu(matrix)
    assert placed.fill < own.fill
    right = np.random.default_rng(0).standard_normal((system.ndof, 2))
    np.testing.assert_allclose(placed.solve(right), own.solve(right), atol=1e-9 * abs(own.solve(right)).max())
    np.testing.assert_array_equal(np.sort(own.order), np.arange(system.ndof))
