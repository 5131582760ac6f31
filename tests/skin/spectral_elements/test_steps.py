"""The explicit scheme: energy, momentum, branches, bases and loads."""

import numpy as np
import pytest
from spectral_states import energy, momentum, place, state

from palmfield.errors import SceneError
from palmfield.skin.base import Springs
from palmfield.skin.materials.material import Branch, Material, Sheet
from palmfield.skin.problem import GAUSSIAN, Spot, Traction
from palmfield.skin.solvers.spectral_elements.model import SAFETY, Model, hold
from palmfield.skin.solvers.spectral_elements.places import Table, find, table_of
from palmfield.skin.solvers.spectral_elements.run import Points, Stepper
from palmfield.skin.solvers.spectral_elements.solid import box_quads, extrude, face_areas

SOFT = Material("soft", 1030.0, 10e3, (Branch(20e3, 1.7e-4), Branch(5e3, 1e-7)), 1e6, "test")
VOIGT = Material("voigt", 1100.0, 25e3, (Branch(8e3, 2e-3), Branch(3e3, 0.0)), 2e6, "test", viscosity_Pa_s=0.3)
FOLLOWING = Material("following", 1000.0, 15e3, (Branch(10e3, 3e-4),), 5e5, "test", 0.1, bulk_relaxes=True)


def no_load(steps):
    return Table(True, steps, np.zeros((steps, 3)), 0.0, np.zeros((1, 1)), np.zeros(1, np.int64), np.zeros(1))


def block(sheets, order=2, precision="float64", cells=2):
    line = np.linspace(-0.01, 0.01, cells + 1)
    thickness = sum(sheet.thickness_m for sheet in sheets)
    solid = extrude(box_quads(line, line, thickness, order), sheets, (1,) * len(sheets))
    return Model(solid, sheets, "cpu", precision)


def stepper(model, base, side, steps, load=None, step_s=None, at=((0.0, 0.0, 0.0),)):
    holds = hold(model, base, side)
    rows = model.mass[holds.rows, None, None]
    stable = model.stable_step(float((np.abs(holds.spring) / rows).sum(axis=2).max(initial=0.0)))
    step = SAFETY * stable if step_s is None else step_s
    solid = model.solid
    table = no_load(steps) if load is None else table_of(load, solid, step, steps)
    return Stepper(model, holds, step, table, Points(*find(solid, np.array(at))), np.arange(steps), stable)


def rough(model, seed=0):
    """A displacement and velocity of all wavelengths, in balance as to energy."""
    rng = np.random.default_rng(seed)
    shape = model.solid.nodes.shape
    return 1e-6 * rng.standard_normal(shape), 1e-2 * rng.standard_normal(shape)


@pytest.mark.parametrize(
    "sheets",
    [
        (Sheet(SOFT, 0.005),),
        (Sheet(VOIGT, 0.004), Sheet(SOFT, 0.006)),
        (Sheet(FOLLOWING, 0.004), Sheet(VOIGT, 0.006)),
        (Sheet(FOLLOWING, 0.005),),
    ],
    ids=["branches", "two laws and a dashpot", "bulk follows in one", "bulk follows"],
)
def test_energy_never_grows(sheets):
    model = block(sheets)
    run = stepper(model, "free", "free", 200)
    place(run, *rough(model))
    energies, before = [], state(run)
    for _ in range(200):
        run.advance(1)
        after = state(run)
        energies.append(energy(run, before, after))
        before = after
    energies = np.array(energies)
    assert (energies > 0.0).all()
    assert np.diff(energies).max() <= 1e-12 * energies[0]
    assert energies[-1] < 0.9 * energies[0]


def test_elastic_energy_stays():
    elastic = Material("elastic", 1000.0, 1e4, (), 1e6, "test")
    model = block((Sheet(elastic, 0.005),))
    run = stepper(model, "bonded", "free", 300)
    u, v = rough(model)
    bottom = slice(-model.solid.surface_nodes, None)
    u[bottom] = v[bottom] = 0.0
    place(run, u, v)
    energies, before = [], state(run)
    for _ in range(300):
        run.advance(1)
        after = state(run)
        energies.append(energy(run, before, after))
        before = after
    assert np.ptp(energies) < 1e-11 * energies[0]


@pytest.mark.parametrize("factor, grows", [(1.0, False), (1.6, True)])
def test_the_stable_step_is_one(factor, grows):
    """At the step found nothing grows; the bound by elements leaves less than 1.6 of room."""
    model = block((Sheet(SOFT, 0.005),))
    model_step = model.stable_step()
    holds = hold(model, "free", "free")
    run = Stepper(
        model,
        holds,
        factor * model_step,
        no_load(2000),
        Points(*find(model.solid, np.zeros((1, 3)))),
        np.arange(1),
        10.0 * model_step,
    )
    place(run, *rough(model))
    run.advance(2000)
    speed = np.abs(state(run).v).max()
    assert (not np.isfinite(speed) or speed > 1.0) == grows


def test_momentum_of_a_free_body_is_exact():
    """It stays without a load, and with one grows by the force times the time."""
    sheets = (Sheet(VOIGT, 0.004), Sheet(SOFT, 0.006))
    model = block(sheets)
    run = stepper(model, "free", "free", 400)
    place(run, *rough(model))
    start = momentum(run)
    scale = float(model.mass @ np.abs(state(run).v).max(axis=1))
    run.advance(400)
    assert np.abs(momentum(run) - start).max() < 1e-12 * scale
    load = Spot(0.01, np.array([0.0, 1e-3]), np.array([0.0, 2.0]))
    run = stepper(model, "free", "free", 100, load)
    run.advance(100)
    solid = model.solid
    pressure = np.exp(-GAUSSIAN / 0.01**2 * (solid.nodes[: solid.surface_nodes, :2] ** 2).sum(axis=1))
    course = np.minimum(run.step_s * np.arange(100) / 1e-3, 1.0) * 2.0
    impulse = -run.step_s * course.sum() * (pressure @ face_areas(solid))
    assert momentum(run) == pytest.approx(impulse, rel=1e-12, abs=1e-12 * np.abs(impulse).max())


def test_momentum_in_single_precision():
    model = block((Sheet(SOFT, 0.005),), precision="float32")
    run = stepper(model, "free", "free", 2000)
    place(run, *rough(model))
    start = momentum(run)
    scale = float(model.mass @ np.abs(state(run).v).max(axis=1))
    run.advance(2000)
    assert np.abs(momentum(run) - start).max() < 1e-5 * scale


def test_sheets_of_one_material_written_differently_move_alike():
    """A branch cut in two equal ones is another law to the code, and the same physics."""
    whole = Material("whole", 1030.0, 1e4, (Branch(2e4, 1.7e-4),), 1e6, "test")
    cut = Material("cut", 1030.0, 1e4, (Branch(1e4, 1.7e-4), Branch(1e4, 1.7e-4)), 1e6, "test")
    load = Spot(0.008, np.array([0.0, 1e-3]), np.array([0.0, 5.0]))
    moved = []
    for lower in (whole, cut):
        model = block((Sheet(whole, 0.005), Sheet(lower, 0.005)))
        run = stepper(model, "bonded", "roller", 300, load)
        run.advance(300)
        moved.append(run.readings()[0].numpy())
    assert np.abs(moved[0] - moved[1]).max() < 1e-12 * np.abs(moved[0]).max()


def test_column_on_springs_comes_to_rest_where_it_must():
    """u = p (h / (K + 4 G / 3) + 1 / k) under even pressure, with the springs' dashpots taking the motion out."""
    elastic = Material("elastic", 1000.0, 1e4, (), 1e5, "test")
    thickness, modulus = 0.01, 1e5 + 4e4 / 3.0
    spring = 5e6
    springs = Springs(spring, 1e6, np.sqrt(1000.0 * modulus), 100.0)
    model = block((Sheet(elastic, thickness),), order=3, cells=1)
    run = stepper(model, springs, "roller", 6000, Spot(1e3, np.array([0.0, 0.01]), np.array([0.0, 3.0])))
    run.advance(6000)
    found = run.readings()[0].numpy()[-1, 0]
    assert -found[2] == pytest.approx(3.0 * (thickness / modulus + 1.0 / spring), rel=1e-4)
    assert np.abs(found[:2]).max() < 1e-6 * abs(found[2])


def test_dashpots_of_a_side_take_a_shear_wave_that_meets_them_head_on():
    """u_y = f(x - c t) in a bar whose long sides let nothing but u_y pass: a plane wave, and rho c_s ends it."""
    elastic = Material("elastic", 1000.0, 1e4, (), 1e5, "test")
    sheets = (Sheet(elastic, 0.01),)
    solid = extrude(box_quads(np.linspace(0.0, 0.2, 21), np.array([-0.005, 0.005]), 0.01, 3), sheets, (1,))
    model = Model(solid, sheets, "cpu", "float64")
    holds = hold(model, "free", "absorbing")
    x, y = solid.nodes[holds.rows, 0], solid.nodes[holds.rows, 1]
    end, edge = x > 0.2 - 1e-9, np.abs(np.abs(y) - 0.005) < 1e-9
    # GLL's weights of order 3, 1/6 and 5/6, along y and z
    share = 0.25 * np.outer([1 / 6, 5 / 6, 5 / 6, 1 / 6], [1 / 6, 5 / 6, 5 / 6, 1 / 6])
    total = 1e-4 * 1000.0 * np.diag([np.sqrt(100.0 + 40.0 / 3.0), np.sqrt(10.0), np.sqrt(10.0)])
    inner = holds.dashpot[end & ~edge].sum(axis=0)
    assert inner == pytest.approx(total * share[1:3].sum(), rel=1e-12, abs=1e-15)
    # At its edges the end carries the long sides' dashpots as well: leave the end its own
    level = np.searchsorted(np.unique(solid.nodes[:, 2]), solid.nodes[holds.rows, 2] - 1e-9)
    holds.dashpot[end & edge] = total * share[0][level[end & edge], None, None]
    holds.dashpot[~end] = 0.0
    holds.projector[edge] = np.diag([0.0, 1.0, 0.0])
    stable = model.stable_step()
    steps = int(0.06 / (SAFETY * stable))
    points = Points(*find(solid, np.array([[0.1, 0.0, 0.0]])))
    table = no_load(steps)
    run = Stepper(model, holds, SAFETY * stable, table, points, np.arange(1), stable)
    away = (solid.nodes[:, 0] - 0.1) / 0.015
    u, v = np.zeros_like(solid.nodes), np.zeros_like(solid.nodes)
    u[:, 1] = 1e-6 * np.exp(-(away**2))
    v[:, 1] = np.sqrt(10.0) * 2.0 * away / 0.015 * u[:, 1]
    place(run, u, v)
    run.advance(steps // 4)
    assert np.abs(state(run).u[:, 1]).max() > 0.9e-6
    run.advance(steps - steps // 4)
    assert np.abs(state(run).u[:, 1]).max() < 0.01e-6


def test_pressures_at_points_press_like_the_spot_they_sample():
    model = block((Sheet(SOFT, 0.01),), order=4, cells=4)
    spot = Spot(0.008, np.array([0.0, 1e-3, 2e-3]), np.array([0.0, 5.0, 1.0]))
    line = (np.arange(240) + 0.5) / 240 * 0.02 - 0.01
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    shape = np.exp(-GAUSSIAN / 0.008**2 * (x**2 + y**2))
    points = np.column_stack([x, y, np.zeros_like(x)])
    spread = Traction(points, np.full(len(x), (0.02 / 240) ** 2), spot.times_s, spot.peak_Pa[:, None] * shape)
    moved = []
    for load in (spot, spread):
        run = stepper(model, "bonded", "fixed", 200, load, at=[[0.0, 0.0, 0.0], [0.004, 0.002, 0.0]])
        run.advance(200)
        moved.append(run.readings()[0].numpy())
    assert np.linalg.norm(moved[0] - moved[1]) < 5e-3 * np.linalg.norm(moved[0])


def test_a_held_load_jumps_in_the_middle_of_a_step():
    """The scheme stays of second order: half the step, a quarter of the error at a jump between steps."""
    elastic = Material("elastic", 1000.0, 1e4, (), 1e5, "test")
    load = Spot(1e3, np.array([0.0, 0.00113]), np.array([1.0, 0.0]), law="held")
    end = 0.0021
    model = block((Sheet(elastic, 0.01),), order=2, cells=1)
    stable = model.stable_step()
    found = []
    for count in (64, 128, 256, 4096):
        step = end / count
        assert step < stable
        run = stepper(model, "bonded", "roller", count, load, step_s=step)
        run.advance(count)
        found.append(run.readings()[0].numpy()[count - 1, 0, 2])
    errors = np.abs(np.array(found[:3]) - found[3])
    assert errors[2] < errors[0] / 8.0


def test_a_step_above_the_stable_one_is_named():
    model = block((Sheet(SOFT, 0.005),))
    stable = model.stable_step()
    with pytest.raises(
        SceneError, match=rf"step_s is {1.01 * stable:.4g} s; allowed: above 0, at most the stable step {stable:.4g} s"
    ):
        stepper(model, "bonded", "free", 10, step_s=1.01 * stable)
