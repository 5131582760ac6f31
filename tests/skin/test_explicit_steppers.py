"""Spectral elements and particles as steppers of a scene's layer, on a mesh of their own."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import sparse

from palmfield.config import SkinConfig
from palmfield.errors import SceneError, naming
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.skin import own_mesh, solve
from palmfield.skin.explicit_layer import OWN, layer_solver, solver_class
from palmfield.skin.fem.probe import surface_vectors
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.material import Sheet
from palmfield.skin.own_mesh import ends_of_substeps
from palmfield.skin.problem import GAUSSIAN, Slab, Spot
from palmfield.skin.reduction.modal_stepper import ModalStepper
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.skin.scene_layer import LayerDemand, SceneLayer
from palmfield.skin.solvers.particles.run import likely_step as likely_particle_step
from palmfield.skin.solvers.particles.stepper import ParticleStepper
from palmfield.skin.solvers.spectral_elements.solve import likely_step
from palmfield.skin.solvers.spectral_elements.stepper import SpectralElementStepper
from palmfield.skin.stepper import SurfaceLoads

SOLVERS = ("spectral_elements", "particles")
STEP = 5e-4
SUBSTEPS = 4
WIDTH = 0.0105
DEMAND = LayerDemand(WIDTH, 250.0, 200.0, (0.0, 0.0), 2.0 * STEP)
DISC = {"shape": "disc", "radius_m": 0.025, "thickness_m": 0.008, "side": "free"}


def layer_of(solver, **keys):
    material = {} if "materials" in keys else {"material": "ecoflex_00-10"}
    config = SkinConfig(**(DISC | material | {"accuracy": 0.2, "step_s": STEP, "solver": solver} | keys))
    return SceneLayer(config, None, config.depth_m, np.zeros(3), DEMAND, named=naming("plugin 'palmfield.skin'"))


def explicit_layer(layer):
    return layer_solver(layer, layer.config.solver)


@pytest.fixture(scope="module", params=SOLVERS)
def layer(request):
    return layer_of(request.param)


@pytest.fixture(scope="module")
def stepper(layer):
    return explicit_layer(layer).stepper("cpu")


def rest(stepper):
    return np.zeros((1, stepper.state_size))


def bells(layer, patterns=2, substeps=SUBSTEPS, seed=0):
    """Gaussian spots about the middle with random weights."""
    rng = np.random.default_rng(seed)
    points = layer.quadrature.points
    centres = rng.uniform(-0.005, 0.005, (patterns, 1, 2))
    pressure = np.exp(-(((points[:, :2] - centres) / 0.006) ** 2).sum(axis=2))[None]
    return SurfaceLoads(pressure, *rng.uniform(0.0, 10.0, (2, 1, substeps, patterns)))


def part_of(loads, which):
    return SurfaceLoads(loads.pressure_Pa, loads.first[:, which], loads.last[:, which])


def test_the_state_is_known_before_the_stepper_is_made(layer, stepper):
    assert explicit_layer(layer) is explicit_layer(layer)
    assert explicit_layer(layer).state_size == stepper.state_size > explicit_layer(layer).unknowns


def test_all_substeps_in_one_call_are_those_one_by_one(layer, stepper):
    loads, together, alone = bells(layer), rest(stepper), rest(stepper)
    stepper.step(together, loads, 1.0, 1.0 + SUBSTEPS * STEP)
    for n in range(SUBSTEPS):
        stepper.step(alone, part_of(loads, slice(n, n + 1)), 1.0 + n * STEP, 1.0 + (n + 1) * STEP)
    np.testing.assert_array_equal(together, alone)
    assert np.abs(together).max() > 0.0


def test_observing_reads_what_read_does_and_changes_nothing(layer, stepper):
    loads, state, unseen = bells(layer), rest(stepper), rest(stepper)
    reader = stepper.reader(layer.surface_operator)
    seen = stepper.step(state, loads, 0.0, SUBSTEPS * STEP, reader)
    assert seen.shape == (1, SUBSTEPS, 2, layer.surface_operator.shape[0])
    np.testing.assert_array_equal(seen[:, -1], stepper.read(state, reader))
    assert stepper.step(unseen, loads, 0.0, SUBSTEPS * STEP) is None
    np.testing.assert_array_equal(state, unseen)
    assert np.abs(seen).max() > 0.0


def test_velocities_are_those_of_the_displacement(layer, stepper):
    """Mean over a substep by the trapezoid of readings, as exact as a course of 250 Hz in steps of 0.5 ms is."""
    times = STEP * np.arange(17)
    course = np.sin(np.pi * 250.0 * times)[None, :, None] ** 2
    pressure = bells(layer, patterns=1).pressure_Pa
    loads = SurfaceLoads(pressure, course[:, :-1], course[:, 1:])
    reader = stepper.reader(layer.probe(np.zeros(3)).operator)
    u, v = stepper.step(rest(stepper), loads, 0.0, 16 * STEP, reader)[0, :, :, 0].T
    means = 0.5 * STEP * (v[1:] + v[:-1])
    assert np.linalg.norm(np.diff(u) - means) < 0.1 * np.linalg.norm(np.diff(u))


def test_threads_share_a_stepper(layer, stepper):
    loads = [bells(layer, seed=seed) for seed in range(3)]
    begin = threading.Barrier(3)

    def carried(load, wait=True):
        state = rest(stepper)
        if wait:
            begin.wait()
        for _ in range(2):
            stepper.step(state, load, 0.0, SUBSTEPS * STEP)
        return state

    alone = [carried(load, wait=False) for load in loads]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(carried, loads))
    np.testing.assert_array_equal(together, alone)


def face_of(stepper):
    """Places of the stepper's own nodes on the face [m], and where their u and v begin in a state."""
    if stepper.name == "particles":
        return stepper._cloud.columns.face, 3 * len(stepper._cloud.points)
    solid = stepper._model.solid
    return solid.nodes[: solid.surface_nodes], 3 * len(solid.nodes)


def test_readers_give_a_bent_face_as_it_is(layer, stepper):
    """A displacement that is quadratic along the face comes back at the wedges' nodes; so does a velocity."""
    rng = np.random.default_rng(1)
    bend, slope = rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
    face, velocity = face_of(stepper)

    def field(points):
        x, y = points[:, 0], points[:, 1]
        return np.column_stack([x * x, x * y, y * y]) @ bend + points[:, :2] @ slope

    state = rest(stepper)
    state[0, : face.size] = field(face).ravel()
    state[0, velocity : velocity + face.size] = 3.0 * field(face).ravel()
    nodes = layer.mesh.nodes[: layer.mesh.surface_nodes]
    expected = np.einsum("sc,sc->s", field(nodes), layer.mesh.surface_normals())
    u, v = stepper.read(state, stepper.reader(layer.surface_operator))[0]
    # Elements of a disc are bent themselves, so that a parabola is not quite one along them
    np.testing.assert_allclose(u, expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(v, 3.0 * u, atol=1e-12)


def test_a_pressure_is_carried_over_as_it_is(layer, stepper):
    """Pressures that are quadratic along the face are the same there, at both ends of a substep."""
    transfer, (face, _) = stepper._transfer, face_of(stepper)
    points = layer.quadrature.points

    def field(at):
        x, y = (at[:, :2] / 0.01).T
        return 1.0 + x - 2.0 * y + x * x + 3.0 * x * y

    inside = np.hypot(*face[:, :2].T) < 0.02
    got = transfer.pressure @ field(points)
    np.testing.assert_allclose(got[inside], field(face)[inside], atol=1e-9 * np.abs(got).max())
    ends = ends_of_substeps(transfer.pressure, np.stack([field(points), 0.0 * field(points)]), [[1, 5]], [[3, 5]])
    np.testing.assert_allclose(ends, np.stack([got, 3.0 * got]), atol=1e-9 * np.abs(got).max())


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_disc_under_a_spot_moves_as_axisymmetric_elements_say(solver):
    """An oracle that shares neither mesh nor scheme; the difference is within what the stepper states of itself."""
    layer = layer_of(solver, accuracy=0.1, element_m=0.003)
    stepper = explicit_layer(layer).stepper("cpu")
    times = STEP * np.arange(21)
    course = np.sin(np.pi * 200.0 * times) ** 2
    material = layer.sheets[0].material
    slab = Slab((Sheet(material, 0.008),), "disc", "bonded", "free", 0.025)
    exact = solve(slab, Spot(WIDTH, times, course), times[1:], np.zeros((1, 2)), solver="axisymmetric", accuracy=0.01)
    away = (layer.quadrature.points[:, :2] ** 2).sum(axis=1)
    pressure = np.exp(-GAUSSIAN * away / WIDTH**2)[None, None]
    loads = SurfaceLoads(pressure, course[None, :-1, None], course[None, 1:, None])
    reader = stepper.reader(layer.probe(np.zeros(3)).operator)
    moved = stepper.step(rest(stepper), loads, 0.0, times[-1], reader)[0, :, 0, 0]
    expected = exact.displacement_m[:, 0, 2]
    difference = np.linalg.norm(moved - expected) / np.linalg.norm(expected)
    assert difference < stepper.error + exact.error
    assert 0.0 < stepper.error < 0.4


def test_each_of_several_worlds_moves_as_if_alone(layer, stepper):
    """States are rows of a wider array, as scenes keep them."""
    loads = bells(layer)
    pressure = np.concatenate([loads.pressure_Pa, 0.5 * loads.pressure_Pa])
    two = SurfaceLoads(pressure, *(np.concatenate([x, x]) for x in (loads.first, loads.last)))
    reader = stepper.reader(layer.probe(np.zeros(3)).operator)
    states = np.zeros((2, stepper.state_size + 5))[:, 2:-3]
    seen = stepper.step(states, two, 0.0, SUBSTEPS * STEP, reader)
    for world in range(2):
        state, one = rest(stepper), slice(world, world + 1)
        own = SurfaceLoads(two.pressure_Pa[one], two.first[one], two.last[one])
        alone = stepper.step(state, own, 0.0, SUBSTEPS * STEP, reader)
        assert np.linalg.norm(alone) > 0.0
        assert np.linalg.norm(seen[world] - alone[0]) < 1e-6 * np.linalg.norm(alone)
        assert np.linalg.norm(states[world] - state[0]) < 1e-6 * np.linalg.norm(state)


def test_what_a_step_and_a_reader_refuse(layer, stepper):
    loads = bells(layer)
    with pytest.raises(SceneError, match="needs shape"):
        stepper.step(np.zeros((2, stepper.state_size)), loads, 0.0, SUBSTEPS * STEP)
    with pytest.raises(SceneError, match="loads cover 4 substeps"):
        stepper.step(rest(stepper), loads, 0.0, 5 * STEP)
    with pytest.raises(SceneError, match="unknowns"):
        stepper.reader(sparse.csr_matrix((2, 5)))
    below = sparse.csr_matrix(([1.0], ([0], [layer.system.ndof - 1])), shape=(1, layer.system.ndof))
    with pytest.raises(SceneError, match=r"reads below the surface of the skin, with weights up to 1; .* 'wedges'"):
        stepper.reader(below)


def test_particles_that_a_load_crushes_are_refused_and_their_state_stays():
    layer = layer_of("particles", accuracy=0.5)
    stepper = explicit_layer(layer).stepper("cpu")
    loads = bells(layer, patterns=1)
    state = rest(stepper)
    stepper.step(state, loads, 0.0, SUBSTEPS * STEP)
    before = state.copy()
    with pytest.raises(SceneError, match=r"Pa from 0\.002 to 0\.004 s: .* 8 times: lower the"):
        crushing = SurfaceLoads(1e7 * loads.pressure_Pa, loads.first, loads.last)
        stepper.step(state, crushing, SUBSTEPS * STEP, 2 * SUBSTEPS * STEP)
    np.testing.assert_array_equal(state, before)


def test_particles_take_shorter_steps_where_strain_has_stiffened_them(monkeypatch):
    """The call is begun anew, and gives what a stepper gives that takes so short steps from the start."""
    layer = layer_of("particles", accuracy=0.5)
    stepper, shorter = (explicit_layer(layer).stepper("cpu") for _ in range(2))
    loads = bells(layer, patterns=1)
    strong = SurfaceLoads(4000.0 * loads.pressure_Pa, loads.first, loads.last)
    state, expected = rest(stepper), rest(stepper)
    stepper.step(state, strong, 0.0, SUBSTEPS * STEP)
    [bodies] = stepper._rooms
    assert len(bodies) > 1
    shorter.steps = max(bodies)
    shorter.step(expected, strong, 0.0, SUBSTEPS * STEP)
    np.testing.assert_array_equal(state, expected)


@pytest.fixture(scope="module")
def palm():
    hand = hand_surface(load_preset("open_men_p50"))
    return hand.surface, hand.depth_to_bone


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_layer_of_a_hand(palm, solver):
    """On a curved face under the same load, wedges and the solver agree at the spot within what the solver states."""
    surface, depth = palm
    centre = surface.vertices[np.argmin(np.linalg.norm(surface.vertices[:, :2] - [0.0, 0.06], axis=1))]
    config = SkinConfig(
        patch_site="palm_centre", patch_radius_m=0.02, accuracy=0.2, step_s=STEP, solver=solver, material="palm"
    )
    layer = SceneLayer(config, surface, depth, centre, DEMAND)
    own = explicit_layer(layer)
    stepper = own.stepper("cpu")
    assert own.body.side == "fixed" and len(own.body.patch.vertices) > 20
    assert stepper.state_size == own.state_size
    away = np.linalg.norm(layer.quadrature.points - centre, axis=1)
    pressure = np.exp(-GAUSSIAN * (away / WIDTH) ** 2)[None, None]
    course = np.sin(np.pi * 200.0 * STEP * np.arange(13)) ** 2
    loads = SurfaceLoads(pressure, course[None, :-1, None], course[None, 1:, None])
    whole = WedgeStepper(layer.system, layer.quadrature.operator, STEP)
    seen = []
    for each in (stepper, whole):
        reader = each.reader(layer.probe(centre).operator)
        seen.append(each.step(rest(each), loads, 0.0, 12 * STEP, reader)[0, :, 0, 0])
    difference = np.linalg.norm(seen[0] - seen[1]) / np.linalg.norm(seen[1])
    assert difference < stepper.error < 1.0


def test_a_solver_says_what_it_is_before_its_stepper_is_made():
    kinds = {name: solver_class(name) for name in OWN}
    assert {name for name, kind in kinds.items() if kind.own_mesh} == set(SOLVERS)
    assert [name for name, kind in kinds.items() if kind.of_class] == ["modal"]
    assert [name for name, kind in kinds.items() if not kind.any_pose] == ["reduced"]
    assert [name for name, kind in kinds.items() if kind.factorises] == ["wedges"]
    steppers = (WedgeStepper, ReducedStepper, ModalStepper, SpectralElementStepper, ParticleStepper)
    assert {stepper.name for stepper in steppers} == set(kinds)
    for said in ("any_pose", "of_class", "exact_in_time", "factorises"):
        assert {one.name: getattr(one, said) for one in steppers} == {
            name: getattr(kind, said) for name, kind in kinds.items()
        }
    assert [name for name, kind in kinds.items() if kind.large_strain] == ["particles"]


REFUSED = {
    "absorbing": (
        SOLVERS, {"side": "absorbing"}, "takes no side 'absorbing'; allowed: fixed, free, roller; or solver wedges",
        ("side",),
    ),
    "bulk": (
        SOLVERS, {"bulk_Pa": 1e10}, "a bulk modulus of 3.08e+05 times its shear modulus; allowed with the solver",
        ("material", "materials", "bulk_Pa"),
    ),
    "foundation": (
        SOLVERS, {"foundation_normal_Pa_m": 1e7, "foundation_tangential_Pa_m": 1e6},
        "takes no foundation, here of 1e+07 Pa/m; allowed: none",
        ("foundation_normal_Pa_m", "foundation_tangential_Pa_m"),
    ),
    "springs": (
        ("particles",), {"base": "springs", "base_normal_Pa_m": 1e7, "base_tangential_Pa_m": 1e7},
        "particles do not support a spring base: use base 'bonded'", (),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_solver_refuses_before_anything_is_meshed(case):
    solvers, keys, expected, mends = REFUSED[case]
    for solver in solvers:
        layer = layer_of(solver, **keys)
        with pytest.raises(SceneError) as refusal:
            explicit_layer(layer).refuse()
        assert expected in str(refusal.value) and refusal.value.mends == mends
        assert "patch" not in vars(layer) and "mesh" not in vars(layer)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("sheets", [False, True])
def test_roller_sides_and_sheets_move_as_by_wedges(solver, sheets):
    """Unknowns of the wedges are turned along such a side, and what is read there is; each sheet relaxes by its law."""
    keys = {"materials": ("ecoflex_00-10", "gelatin_2"), "shares": (0.4, 0.6)} if sheets else {}
    layer = layer_of(solver, side="roller", radius_m=0.015, accuracy=0.1, **keys)
    explicit_layer(layer).refuse()
    own, whole = explicit_layer(layer).stepper("cpu"), WedgeStepper(layer.system, layer.quadrature.operator, STEP)
    course = np.sin(np.pi * 200.0 * STEP * np.arange(9)) ** 2
    away = (layer.quadrature.points[:, :2] ** 2).sum(axis=1)
    pressure = np.exp(-GAUSSIAN * away / WIDTH**2)[None, None]
    loads = SurfaceLoads(pressure, course[None, :-1, None], course[None, 1:, None])
    operator = surface_vectors(layer.mesh, layer.system)
    seen = [each.step(rest(each), loads, 0.0, 8 * STEP, each.reader(operator))[0, :, 0] for each in (own, whole)]
    rim = np.hypot(*layer.mesh.nodes[: layer.mesh.surface_nodes, :2].T) > 0.0149
    there = [np.linalg.norm(one.reshape(8, -1, 3)[:, rim]) for one in seen]
    assert there[0] == pytest.approx(there[1], rel=own.error + 0.05) and there[1] > 0.0
    assert np.linalg.norm(seen[0] - seen[1]) < (own.error + 0.05) * np.linalg.norm(seen[1])


def test_the_predicted_steps_are_about_those_that_are_taken(layer, stepper):
    own = explicit_layer(layer)
    likely = likely_step(own.solid, own.body.sheets) if stepper.name != "particles" else likely_particle_step(own.cloud)
    assert 0.5 < likely * stepper.steps / STEP < 1.5
    assert own.seconds(1.0, "cpu") > own.seconds(0.5, "cpu") > own.seconds(0.5, "cuda:0") > 0.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_steps_so_many_that_a_run_would_not_end_are_refused(solver, monkeypatch):
    monkeypatch.setattr(own_mesh, "MOST_STEPS", 10)
    with pytest.raises(SceneError, match=r"needs \d+ steps per MuJoCo step of 0\.001 s; .* at most 10; set") as caught:
        explicit_layer(layer_of(solver)).stepper("cpu")
    assert caught.value.setting == "solver" and str(caught.value).startswith("plugin 'palmfield.skin': ")


@pytest.mark.parametrize("base", ["springs", "free_slip"])
def test_other_bases_are_taken(base):
    springs = {"base_normal_Pa_m": 1e7, "base_tangential_Pa_m": 1e7} if base == "springs" else {}
    layer = layer_of("spectral_elements", base=base, **springs)
    explicit_layer(layer).refuse()
    moved = []
    for each in (layer, layer_of("spectral_elements")):
        stepper = explicit_layer(each).stepper("cpu")
        state = rest(stepper)
        stepper.step(state, bells(each), 0.0, SUBSTEPS * STEP)
        moved.append(np.abs(stepper.read(state, stepper.reader(each.surface_operator))[0, 0]).max())
    assert moved[0] > 1.05 * moved[1]
