"""Modes for every load of a class: consistency with the whole layer that they stand for, accuracy by the exact one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import eigh

from palmfield import cache
from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem.factor import factorise
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import surface_motion
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.material import Branch, Material, kelvin_voigt, standard_linear
from palmfield.skin.reduction import modal_stepper
from palmfield.skin.reduction.device_models import DeviceModes
from palmfield.skin.reduction.modal_stepper import ModalStepper, modal_body
from palmfield.skin.reduction.ritz import UNCOUPLED_Hz, laws_at
from palmfield.skin.stepper import SurfaceLoads

STEP = 2e-4
SUBSTEPS = 5
RUBBERY = Material("rubbery", 1000.0, 1.2e4, (Branch(8e3, 1e-3), Branch(4e3, 1e-2)), 1e8, "test")


TOUGH = replace(RUBBERY, name="tough", shear_relaxed_Pa=2.4e4, branches=(Branch(16e3, 1e-3), Branch(8e3, 1e-2)))
"""Of twice the stiffness, by the same law."""

QUICK = replace(TOUGH, name="quick", branches=(Branch(16e3, 1e-4), Branch(8e3, 1e-2)))
VISCOUS = kelvin_voigt("viscous", 1050.0, 8e3, 5.0)
HARD = standard_linear("hard", 1100.0, 1.2e6, 0.6e6, 3e-3)
LAWS = {"two": (QUICK, RUBBERY), "hard on soft": (HARD, RUBBERY), "three": (QUICK, RUBBERY, VISCOUS)}
CORNER_Hz = 2.0 / (np.pi * 0.009)


def parts_of(spot):
    quadrature, surface = SurfaceQuadrature(spot.mesh, spot.system), surface_motion(spot.mesh, spot.system)
    whole = WedgeStepper(spot.system, quadrature.operator, STEP)
    return SimpleNamespace(system=spot.system, quadrature=quadrature, surface=surface, whole=whole)


@pytest.fixture(scope="module")
def disc(make_spot):
    return parts_of(make_spot(0.0035, 1, radius_m=0.02, material=RUBBERY, side="free"))


def bell(disc, centres, width=0.009):
    """Gaussian spots at centres (k, 2), shape (k, q) [Pa]."""
    offset = disc.quadrature.points[:, :2] - np.asarray(centres)[:, None]
    return 100.0 * np.exp(-2.77 * ((offset / width) ** 2).sum(axis=2))


def examples(disc):
    return bell(disc, np.random.default_rng(0).uniform(-0.012, 0.012, (300, 2)))


def body(disc, blocks=12, tolerance=0.03, system=None, left_out=0.01):
    system = system or disc.system
    wanted = tolerance, blocks, left_out, STEP
    return modal_body(system, disc.quadrature, disc.surface, lambda: examples(disc), (), *wanted)


@pytest.fixture(scope="module")
def modes(disc):
    return ModalStepper(body(disc), disc.system, STEP, 100.0)


def loads(disc, count=40, speed=2.0):
    """A spot on a circle, from a sudden start, as the load of `count` calls."""
    turn = speed / 0.006 * STEP * np.arange(count * SUBSTEPS + 1)
    pressure = bell(disc, 0.006 * np.column_stack([np.cos(turn), np.sin(turn)]) + 0.0007)
    unit = np.eye(SUBSTEPS + 1)[None]
    starts = SUBSTEPS * np.arange(count)
    return [SurfaceLoads(pressure[None, i : i + SUBSTEPS + 1], unit[:, :-1], unit[:, 1:]) for i in starts]


def at_points(part, stepper):
    if stepper.points is None:
        return part
    return SurfaceLoads(part.pressure_Pa[:, :, stepper.points], part.first, part.last)


def march(stepper, parts, disc, state=None):
    """Motion of the surface, (t, 2, S), and the state at the end."""
    state = np.zeros((1, stepper.state_size)) if state is None else state
    reader, seen = stepper.reader(disc.surface), []
    for number, part in enumerate(parts):
        start = number * SUBSTEPS * STEP
        seen.append(stepper.step(state, at_points(part, stepper), start, start + SUBSTEPS * STEP, reader)[0])
    return np.concatenate(seen), state


def relative(a, b):
    return np.linalg.norm(a - b, axis=(0, 2)) / np.linalg.norm(b, axis=(0, 2))


@pytest.mark.numerics
def test_modes_move_as_the_whole_layer_under_a_load_that_no_example_is(disc, modes):
    truth, _ = march(disc.whole, loads(disc), disc)
    motion, _ = march(modes, loads(disc), disc)
    displacement, velocity = relative(motion, truth)
    stated = np.array(modes.body.modes.errors(2.0 / (np.pi * 0.009)))
    assert displacement < 0.03 and velocity < 0.3
    assert displacement < stated[0] + 0.03 and velocity < stated[1] + 0.03


def test_sheets_that_relax_by_one_law_have_modes_of_their_own(disc, make_spot, modes):
    sheets = parts_of(make_spot(0.0035, 2, radius_m=0.02, material=(TOUGH, RUBBERY), side="free"))
    truth, _ = march(sheets.whole, loads(sheets), sheets)
    stepper = ModalStepper(body(sheets), sheets.system, STEP, 100.0)
    assert relative(march(stepper, loads(sheets), sheets)[0], truth)[0] < 0.03
    of_one, _ = march(modes, loads(disc), disc)
    assert np.abs(truth[:, 0]).max() < 0.9 * np.abs(of_one[:, 0]).max()


@pytest.fixture(scope="module", params=LAWS)
def sheets(request, make_spot):
    """Sheets of several laws, and their modes."""
    parts = parts_of(make_spot(0.0035, len(LAWS[request.param]), radius_m=0.02, material=LAWS[request.param]))
    return parts, ModalStepper(body(parts, tolerance=0.01, left_out=0.003), parts.system, STEP, CORNER_Hz)


def outside_share(stepper, parts):
    sums = np.sum([stepper.outside(at_points(part, stepper)) for part in parts], axis=0)
    return np.sqrt(sums[0] / sums[1])


def without_coupling(stepper, parts):
    modes = stepper.body.modes
    none = replace(modes, coupling=modes.coupling[:0], shares=modes.shares[:0])
    return ModalStepper(replace(stepper.body, modes=none), parts.system, STEP, CORNER_Hz)


@pytest.mark.numerics
def test_sheets_that_relax_by_several_laws_move_as_the_whole_layer(sheets):
    parts, stepper = sheets
    course = loads(parts)
    truth, _ = march(parts.whole, course, parts)
    displacement, velocity = relative(march(stepper, course, parts)[0], truth)
    assert stepper.coupled and displacement < 0.02 and velocity < 0.2
    assert displacement < np.hypot(stepper.error, outside_share(stepper, course)) and velocity < stepper.velocity_error
    alone, _ = march(without_coupling(stepper, parts), course, parts)
    assert relative(alone, truth)[0] > 1.1 * displacement


def test_coupled_modes_answer_a_frequency_as_the_whole_layer(sheets):
    parts, stepper = sheets
    pressure = bell(parts, [[0.003, -0.002]])[0]
    force = parts.quadrature.operator @ pressure
    for f in (0.0, 80.0, 250.0):
        truth = parts.surface @ (harmonic(parts.system, force, f) if f else static(parts.system, force))
        mine = stepper.harmonic(pressure[stepper.points], f, parts.surface)
        assert np.linalg.norm(mine - truth) < 0.03 * np.linalg.norm(truth)


def test_coupled_modes_of_several_worlds_move_as_each_by_itself(sheets, monkeypatch):
    parts, stepper = sheets
    monkeypatch.setattr(modal_stepper, "cores", lambda: 2)
    first, other = (at_points(part, stepper) for part in loads(parts, 2))
    three = first, other, first
    stacked = (np.concatenate([getattr(load, name) for load in three]) for name in ("pressure_Pa", "first", "last"))
    together = SurfaceLoads(*stacked)
    states, reader = np.zeros((3, stepper.state_size)), stepper.reader(parts.surface)
    states[1] = 1e-6
    alone = states.copy()
    seen = stepper.step(states, together, 0.0, SUBSTEPS * STEP, reader)
    for world, load in enumerate(three):
        own = stepper.step(alone[world : world + 1], load, 0.0, SUBSTEPS * STEP, reader)
        # The coupling's product in single precision: its last digits are worth 2e-6 of the velocity, see `_coupling`
        for part, share in ((0, 1e-6), (1, 2e-6)):
            largest = np.abs(own[0, :, part]).max()
            np.testing.assert_allclose(seen[world, :, part], own[0, :, part], rtol=0.0, atol=share * largest)
    # Row by row: an acceleration is a million times its displacement, and its last digits are worth that
    rows, own_rows = (part.reshape(3, stepper.state_rows, -1) for part in (states, alone))
    for row in range(2):
        largest = np.abs(own_rows[:, row]).max()
        np.testing.assert_allclose(rows[:, row], own_rows[:, row], rtol=0.0, atol=1e-6 * largest)


def test_coupled_modes_left_alone_die_away(sheets):
    """All at once: the matrix of a substep on the whole state."""
    _, stepper = sheets
    matrix = np.eye(stepper.state_size)
    silence = SurfaceLoads(np.zeros((len(matrix), 1, len(stepper.points))), *np.zeros((2, len(matrix), 1, 1)))
    stepper.step(matrix, silence, 0.0, STEP)
    assert np.abs(np.linalg.eigvals(matrix)).max() < 1.0


def test_the_whole_layer_goes_on_from_the_state_of_coupled_modes(sheets):
    parts, stepper = sheets
    course = loads(parts, 20)
    truth, _ = march(parts.whole, course, parts)
    _, state = march(stepper, course[:10], parts)
    motion, _ = march(parts.whole, course[10:], parts, stepper.lifted(state, lambda: None))
    assert relative(motion, truth[10 * SUBSTEPS :])[0] < 0.03


def test_a_bulk_that_gives_way_couples_modes_of_one_law(make_spot):
    soft = parts_of(make_spot(0.0035, 1, radius_m=0.02, material=standard_linear("foam", 500.0, 1.2e4, 2e4, 5e-4, 0.3)))
    course = loads(soft)
    truth, _ = march(soft.whole, course, soft)
    stepper = ModalStepper(body(soft), soft.system, STEP, CORNER_Hz)
    displacement, _ = relative(march(stepper, course, soft)[0], truth)
    assert stepper.coupled and displacement < 0.03
    assert relative(march(without_coupling(stepper, soft), course, soft)[0], truth)[0] > displacement


def test_modes_span_what_a_load_moves_of_the_dense_modes_and_never_lie_below_them(disc):
    made = body(disc, blocks=20, left_out=1e-3)
    vectors, system = made.modes.vectors.astype(float), disc.system
    np.testing.assert_allclose(vectors.T @ (system.mass @ vectors), np.eye(vectors.shape[1]), atol=2e-6)
    stiff = laws_at([part.material for part in system.parts], -2j * np.pi * UNCOUPLED_Hz).real[1]
    total, mass = (system.elastic + stiff * system.parts[0].stiffness).toarray(), system.mass.toarray()
    squares, dense = eigh(total, mass)
    found = np.sort(made.modes.elastic + stiff * made.modes.stiffness[0])
    # Courant and Fischer: the k-th value in a subspace is at least the k-th of all
    assert (found > (1.0 - 1e-5) * squares[: len(found)]).all()
    pushed = dense.T @ (disc.quadrature.operator @ made.shapes.shapes.T * made.shapes.sizes)
    motion = np.linalg.norm(pushed, axis=1) / squares
    rest = 1.0 - ((vectors.T @ (mass @ dense)) ** 2).sum(axis=0)
    missed = np.sqrt((motion**2 * rest).sum() / (motion**2).sum())
    assert missed < 0.01


def test_weak_modes_that_are_left_out_cost_what_is_said(disc):
    truth, _ = march(disc.whole, loads(disc), disc)
    orders, errors, stated = [], [], []
    for left_out in (0.2, 0.05, 0.01):
        stepper = ModalStepper(body(disc, left_out=left_out), disc.system, STEP, 100.0)
        orders.append(stepper.order)
        errors.append(relative(march(stepper, loads(disc), disc)[0], truth))
        stated.append((stepper.error, stepper.velocity_error))
    assert np.diff(orders).min() > 0 and (np.diff(errors, axis=0) < 0.0).all()
    assert (np.array(errors) < np.array(stated) + 0.03).all()


def test_more_blocks_err_less_and_say_so(disc):
    truth, _ = march(disc.whole, loads(disc), disc)
    errors, stated = [], []
    for blocks in (6, 8, 10):
        stepper = ModalStepper(body(disc, blocks), disc.system, STEP, 100.0)
        errors.append(relative(march(stepper, loads(disc), disc)[0], truth))
        stated.append((stepper.error, stepper.velocity_error))
    assert (np.diff(errors, axis=0) < 0.0).all() and (np.diff(stated, axis=0) < 0.0).all()
    assert errors[2][0] < 0.5 * errors[0][0]


def test_the_whole_layer_goes_on_from_the_modes_state(disc, modes):
    parts = loads(disc, 20)
    truth, _ = march(disc.whole, parts, disc)
    _, state = march(modes, parts[:10], disc)
    lifted = modes.lifted(state, lambda: None)
    seen = disc.whole.read(lifted, disc.whole.reader(disc.surface))
    np.testing.assert_allclose(seen, modes.read(state, modes.reader(disc.surface)), atol=1e-5 * np.abs(seen).max())
    motion, _ = march(disc.whole, parts[10:], disc, lifted)
    assert relative(motion, truth[10 * SUBSTEPS :])[0] < 0.03


def test_a_mode_left_alone_dies_away(modes):
    advance = np.moveaxis(modes._modes.advance.numpy(), -1, 1).reshape(-1, modes.state_rows, modes.state_rows)
    assert np.abs(np.linalg.eigvals(advance)).max() < 1.0


def test_harmonic_motion_is_the_whole_layers(disc, modes):
    pressure = bell(disc, [[0.003, -0.002]])[0]
    for f, allowed in ((0.0, 0.02), (80.0, 0.02), (250.0, 0.06)):
        force = disc.quadrature.operator @ pressure
        truth = disc.surface @ (harmonic(disc.system, force, f) if f else static(disc.system, force))
        mine = modes.harmonic(pressure[modes.points], f, disc.surface)
        assert np.linalg.norm(mine - truth) < allowed * np.linalg.norm(truth)


def test_modes_answer_a_spot_as_the_exact_layer(make_spot):
    """Accuracy: at rest, at 200 Hz and after steps to rest, the centre of a roller disc against its exact series."""
    spot = make_spot(0.0035, 3, radius_m=0.02, growth=1.0, material=RUBBERY)
    parts = parts_of(spot)
    stepper = ModalStepper(body(parts, tolerance=0.01, left_out=0.003), parts.system, STEP, 100.0)
    pressure = bell(parts, [[0.0, 0.0]])[0][stepper.points]
    fwhm = 2.0 * 0.009 * np.sqrt(np.log(2.0) / 2.77)
    exact = [100.0 * complex(centre_response(f, RUBBERY, 0.02, fwhm, 0.02)) for f in (0.0, 200.0)]
    for f, truth, allowed in zip((0.0, 200.0), exact, (0.015, 0.04), strict=True):
        push = -stepper.harmonic(pressure, f, spot.read)[0]
        assert abs(push - truth) < allowed * abs(truth)
    state, steady = np.zeros((1, stepper.state_size)), np.ones((1, 2000, 1))
    stepper.step(state, SurfaceLoads(pressure[None, None], steady, steady), 0.0, 2000 * STEP)
    rest = -stepper.read(state, stepper.reader(spot.read))[0, 0, 0]
    assert rest == pytest.approx(exact[0].real, rel=0.015)


def test_what_lies_outside_the_class_is_seen(disc, modes):
    inside = at_points(loads(disc, 1)[0], modes)
    edge = (disc.quadrature.points[:, 0] > 0.006) * loads(disc, 1)[0].pressure_Pa
    outside = at_points(SurfaceLoads(edge, inside.first, inside.last), modes)
    shares = []
    for load in (inside, outside):
        seen = modes.outside(load)
        shares.append((np.sqrt(seen.energy / seen.energy_of_all), np.sqrt(seen.plain / seen.plain_of_all)))
    assert max(shares[0]) < 0.05
    assert min(shares[1]) > 0.15


def test_of_what_is_no_sum_of_shapes_nothing_is_hidden(disc, modes):
    """Least squares fit away a part of noise, which the share counts all the same."""
    noise = np.random.default_rng(2).standard_normal((1, 400, len(modes.points)))
    each = np.eye(400)[None]
    seen = modes.outside(SurfaceLoads(noise, each, each))
    # Of the mixture of a step's ends: both are the same here
    assert seen.plain / seen.plain_of_all == pytest.approx(1.0, abs=0.01)


def test_half_the_step_leaves_a_quarter_of_the_error(disc, modes):
    """Under a pressure that comes smoothly, against steps of a twentieth."""
    pressure = bell(disc, [[0.002, 0.001]])[:, modes.points]
    reader, ends = modes.reader(disc.surface), []
    for parts in (1, 2, 20):
        stepper = ModalStepper(modes.body, disc.system, STEP / parts, 100.0)
        times = np.linspace(0.0, 0.004, 20 * parts + 1)
        level = (np.sin(0.5 * np.pi * times / 0.004) ** 4)[None, :, None]
        state = np.zeros((1, stepper.state_size))
        stepper.step(state, SurfaceLoads(pressure[None], level[:, :-1], level[:, 1:]), 0.0, 0.004)
        ends.append(stepper.read(state, reader)[0, 0])
    errors = [np.linalg.norm(end - ends[2]) for end in ends[:2]]
    assert 3.6 < errors[0] / errors[1] < 4.4


def random_loads(disc, worlds=2, patterns=3):
    """Any patterns at any levels; of the second world the last one sounds nowhere."""
    random = np.random.default_rng(4)
    first, last = random.uniform(-1.0, 1.0, (2, worlds, SUBSTEPS, patterns))
    first[1, :, -1] = last[1, :, -1] = 0.0
    pressure = 100.0 * random.standard_normal((worlds, patterns, len(disc.quadrature.weights)))
    return SurfaceLoads(pressure.astype(np.float32), first, last)


def stepped_on_device(on_device, disc, stepper):
    loads, state = random_loads(disc), np.zeros((2, stepper.state_size))
    march(stepper, [random_loads(disc)], disc, state)
    found, squares = on_device(DeviceModes(stepper, SUBSTEPS, "cpu"), state, loads)
    expected = state.copy()
    stepper.step(expected, at_points(loads, stepper), 0.0, SUBSTEPS * STEP)
    rows = [part.reshape(2, stepper.state_rows, -1) for part in (found, expected)]
    assert (np.abs(rows[0] - rows[1]).max(axis=2) < 2e-5 * np.abs(rows[1]).max(axis=2)).all()
    for world in range(2):
        own = at_points(
            SurfaceLoads(*(part[world, None] for part in (loads.pressure_Pa, loads.first, loads.last))), stepper
        )
        np.testing.assert_allclose(stepper.weighed(squares[world]), stepper.outside(own), rtol=1e-4)


def test_a_device_moves_modes_as_their_stepper(disc, modes, on_device):
    stepped_on_device(on_device, disc, modes)


def test_a_device_moves_coupled_modes_as_their_stepper(sheets, on_device):
    assert sheets[1].coupled
    stepped_on_device(on_device, *sheets)


def test_the_energy_norm_is_that_of_the_skin(disc, modes):
    """Of a pressure that stands for the whole layer's points by the modes' own, against a solve."""
    points = modes.points
    factor = factorise(modal_stepper.shifted(disc.system), disc.system.elimination_order())
    pressure = np.random.default_rng(1).standard_normal(len(points))
    force = disc.quadrature.operator[:, points] @ pressure
    energy = force @ factor.solve(force)
    assert np.square(pressure @ modes.body.compliance).sum() == pytest.approx(energy, rel=0.03)


def test_modes_come_from_the_cache_whatever_the_stimulus(disc, tmp_path, monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path))
    first = body(disc)
    monkeypatch.setattr("palmfield.skin.fem.factor.factorise", lambda *arguments: pytest.fail("factorised again"))
    again = body(disc)
    np.testing.assert_array_equal(first.modes.vectors, again.modes.vectors)
    assert [entry.kind for entry in cache.entries()] == ["modes"]


def test_bodies_without_modes_of_their_own_are_refused(disc, make_spot):
    absorbing = make_spot(0.006, 1, radius_m=0.02, material=RUBBERY, side="absorbing", absorbing_Hz=200.0)
    with pytest.raises(SceneError, match="absorbing sides or dashpots couple"):
        body(disc, system=absorbing.system)
    count = len(disc.quadrature.weights)
    noise = np.random.default_rng(0).standard_normal((count, count))
    with pytest.raises(SceneError, match=r"2 blocks of \d+ load shapes exceed 0.4 of its \d+ unknowns"):
        modal_body(disc.system, disc.quadrature, disc.surface, lambda: noise, (), 1e-3, 2, 0.01, STEP)
