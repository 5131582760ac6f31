"""A scene's sound in one graph against the stages that the CPU computes it by, one by one; here both on the CPU."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import warp as wp

import palmfield
from palmfield.acoustics.surface_load import CLEARANCE_M
from palmfield.data import folder
from palmfield.device import Branches
from palmfield.drive.transducer_response import of_drives, rows
from palmfield.errors import DeviceError, PalmfieldError
from palmfield.simulation import backend, graph_work, moving_worlds, scene_graph, step, validate
from palmfield.simulation.backend import Frames, serves
from palmfield.simulation.emission import Emission, of_one
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.scene_graph import SceneGraph
from palmfield.simulation.step import Steps
from palmfield.simulation.workspace import Workspace
from palmfield.skin.reduction import device_models
from palmfield.skin.reduction.modal_stepper import ModalStepper

SCENES = folder("mjcf") / "scenes"
CIRCLE: dict[str, object] = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 100}
LEVER_M = 0.01
"""About as long as bones are thick: forces at their surfaces turn them by this."""
NO_WAVE: dict[str, object] = dict.fromkeys(("modulation", "am_quantity", "am_frequency_Hz", "am_depth"))


@pytest.fixture
def by_graph(monkeypatch: pytest.MonkeyPatch) -> Callable[..., palmfield.Simulation]:
    """Opens a scene whose sound is computed by a graph, on the CPU."""

    def opened(scene: Path, **keywords: Any) -> palmfield.Simulation:
        with monkeypatch.context() as patch:
            patch.setattr(step, "serves", lambda model: True)
            patch.setattr(moving_worlds, "may_join", lambda *_: False)
            return palmfield.Simulation(scene, device="cpu", **keywords)

    return opened


def at(posed: PosedScene) -> Frames:
    """One world in this pose."""
    return Frames(np.zeros((1, 0, 3)), np.zeros((1, 0, 9)), lambda here: {0: posed})


def begin(graph: SceneGraph, posed: PosedScene, t0: float) -> None:
    """Compute the step that begins at t0 [s] there, in the graph."""
    graph.observer = lambda trace: None
    graph.joined = graph.place(at(posed), np.ones(1, dtype=bool), t0)
    graph.emit(t0)
    assert graph.course is not None


def stages(sim: palmfield.Simulation) -> dict[str, Any]:
    """What the CPU's own stages give for the step that begins now, with the emission of the simulation itself."""
    runtime, work = sim.runtime, sim.runtime.work
    posed, emitted, now = runtime.posed, runtime.amplitudes, sim.data.time
    radiation = Radiation(runtime.model)
    _, course = work.emission.over(posed, emitted, now, runtime.model.substeps)
    loads = []
    for skin in range(len(runtime.model.skins)):
        loads.append(radiation.many(posed, skin, course.units if len(course.units) == 1 else rows(course)))
    steps = Steps([runtime.model], [Workspace(runtime.model)], runtime.state)
    steps.begin(at(posed), now)
    turn = posed.array_frame.rotation
    forces = [tuple(force[0] @ turn) for force in steps.forces]
    return {"posed": posed, "course": course, "loads": loads, "forces": forces}


def graphs(sim: palmfield.Simulation) -> dict[str, Any]:
    """The same by the graph, in the step that has begun."""
    runtime, graph = sim.runtime, sim.runtime.steps.host
    sim.runtime.body_forces()
    loads = [graph.load(skin).copy() for skin in range(len(runtime.model.skins))]
    forces = graph.of_bodies()
    return {"loads": loads, "forces": forces}


def agree(sim: palmfield.Simulation, flipped: float = 0.0) -> None:
    """Loads and forces agree; flipped: share of the points where a ray grazes an edge and rounding decides."""
    one = stages(sim)
    other = graphs(sim)
    for mine, its in zip(one["loads"], other["loads"], strict=True):
        assert mine.shape == its.shape and mine.max() > 0.0
        assert (np.abs(its - mine) > 3e-5 * np.abs(mine).max()).mean() <= flipped
    for (force, torque), (its_force, its_torque) in zip(one["forces"], other["forces"], strict=True):
        largest = np.linalg.norm(force, axis=1).max()
        assert largest > 0.0
        np.testing.assert_allclose(its_force, force, rtol=0.0, atol=1e-5 * largest)
        np.testing.assert_allclose(its_torque, torque, rtol=0.0, atol=1e-5 * largest * LEVER_M)


def test_only_scenes_on_a_gpu_take_it(small_scene: Any) -> None:
    assert not serves(palmfield.Simulation(small_scene()).runtime.model)


def test_boundary_elements_and_float64_are_left_to_the_stages(
    small_scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backend, "resolve", lambda device: "cuda:0")
    for keys, served in (
        ({}, True),
        ({"skin": {"body_sound": "shadows"}}, True),
        ({"skin": {"body_sound": "scattering"}}, False),
        ({"array": {"precision": "accurate"}}, False),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(step, "serves", lambda model: False)
            sim = palmfield.Simulation(small_scene(**keys))
        assert serves(sim.runtime.model) is served


@pytest.mark.parametrize("response", ["on", "off"])
@pytest.mark.parametrize("path", [{}, CIRCLE | NO_WAVE], ids=["point", "circle"])
def test_a_pad_that_slides(small_scene: Any, by_graph: Any, path: dict[str, object], response: str) -> None:
    scene = small_scene(stimulus=path, array={"response": response})
    sim = by_graph(scene)
    other = palmfield.Simulation(scene)
    for _ in range(6):
        sim.step()
        other.step()
        assert sim.data.sensordata[2] != 0.0
        largest = np.abs(other.data.sensordata).max() * 1e-5
        np.testing.assert_allclose(sim.data.sensordata[2:], other.data.sensordata[2:], rtol=2e-5, atol=1e-4 * largest)
    agree(sim)


@pytest.mark.parametrize(("accuracy", "apart"), [(0.5, False), (0.05, True)])
def test_a_moving_focus_is_driven_on_the_device(small_scene: Any, by_graph: Any, accuracy: float, apart: bool) -> None:
    """What the transducers emit at a step's end, against NumPy's way of the same course.

    apart: whether the sound of some is under way for longer, as the accuracy asks
    """
    scene = small_scene(stimulus=CIRCLE | NO_WAVE, array={"response": "on"}, skin={"accuracy": accuracy})
    sim = by_graph(scene)
    sim.step(3)
    runtime, work = sim.runtime, sim.runtime.work
    posed, begun, now = runtime.posed, runtime.amplitudes, sim.data.time
    runtime.body_forces()
    known = runtime.steps.host.course
    assert known is not None
    assert runtime.model.stimuli[0].response.delayed == apart
    _, course = work.emission.over(posed, begun, now, runtime.model.substeps)
    assert np.abs(course.end).max() > 0.1
    np.testing.assert_allclose(known[1].end, course.end, rtol=0.0, atol=1e-12)
    points = np.arange(0, 40, 7)
    load = runtime.steps.host.load(0, points).copy()
    other = Radiation(runtime.model).many(posed, 0, course.units)[:, points]
    np.testing.assert_allclose(load, other, rtol=0.0, atol=3e-5 * np.abs(other).max())


def test_a_focus_that_transducers_cannot_make_is_said_as_ever(small_scene: Any, by_graph: Any) -> None:
    scene = small_scene(stimulus=CIRCLE | NO_WAVE | {"arp_peak_Pa": 1e5})
    with pytest.raises(PalmfieldError, match="exceeds the output of the array at"):
        by_graph(scene)


SHEETS = {"material": None, "materials": "finger_pad ecoflex_00-10", "shares": "0.3 0.7"}


@pytest.mark.parametrize(("solver", "sheets"), [("modal", {}), ("modal", SHEETS), ("reduced", {})])
def test_small_models_are_stepped_on_the_device(
    small_scene: Any, by_graph: Any, solver: str, sheets: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device_models, "LEAST_NUMBERS", 1)
    scene = small_scene(stimulus=CIRCLE | NO_WAVE, skin={"accuracy": 0.2, "solver": solver} | sheets)
    here, there = palmfield.Simulation(scene), by_graph(scene)
    taken = []
    steps_here = SceneGraph._steps_here
    monkeypatch.setattr(SceneGraph, "_steps_here", lambda *a: taken.append(steps_here(*a)) or taken[-1])
    for sim in (here, there):
        # From a reset on the stepper is there, so that the device takes the first step as well
        sim.step(2)
        sim.reset()
    taken.clear()
    for _ in range(8):
        here.step()
        there.step()
    assert len(taken) >= 8 and all(graph is not None for graph in taken)
    stepper = there.runtime.model.begin[0].value
    assert isinstance(stepper, ModalStepper) == (solver == "modal") and getattr(stepper, "coupled", False) == bool(
        sheets
    )
    mine, its = (sim.runtime.skin_states()[0][1] for sim in (here, there))
    np.testing.assert_allclose(its, mine, rtol=0.0, atol=1e-5 * np.abs(mine).max())
    one, other = (sim.runtime.work.outside[0] for sim in (here, there))
    assert (one.energy_share > 0.0) == (solver == "modal")
    np.testing.assert_allclose(
        [other.energy_share, other.pressure_share], [one.energy_share, one.pressure_share], rtol=1e-3
    )


def test_a_state_that_is_put_back_goes_on_from_there(small_scene: Any, by_graph: Any) -> None:
    """The device keeps nothing of a skin: all depends on the state in mjData alone."""
    scene = small_scene(stimulus=CIRCLE | NO_WAVE, skin={"accuracy": 0.2, "solver": "modal"})
    sim = by_graph(scene)
    sim.step(3)
    spec = mujoco.mjtState.mjSTATE_INTEGRATION
    kept = np.zeros(mujoco.mj_stateSize(sim.model, spec))
    mujoco.mj_getState(sim.model, sim.data, kept, spec)
    sim.step(2)
    first = sim.runtime.skin_states()[0][1].copy()
    mujoco.mj_setState(sim.model, sim.data, kept, spec)
    sim.step(2)
    np.testing.assert_array_equal(sim.runtime.skin_states()[0][1], first)
    # Changed after the forces of the step were computed, with which the device steps the skin
    ends = []
    for more in (0.0, 1e-6):
        mujoco.mj_setState(sim.model, sim.data, kept, spec)
        mujoco.mj_step1(sim.model, sim.data)
        sim.runtime.skin_states()[0][1][0, 0] += more
        mujoco.mj_step2(sim.model, sim.data)
        palmfield.raise_errors(sim.data)
        ends.append(sim.runtime.skin_states()[0][1][0].copy())
    assert np.abs(ends[1] - ends[0]).max() > 1e-8


def test_branches_of_a_graph_are_all_done() -> None:
    done: list[str] = []
    branches = Branches(tuple([lambda name=name: done.append(name) for name in part] for part in ("ab", "c")))
    branches()
    assert done == ["a", "b", "c"]


def test_bones_carry_points_and_samples(by_graph: Any) -> None:
    sim = by_graph(SCENES / "approach_withdraw.xml", accuracy=0.5)
    sim.start_at(0.2)
    # Hand and fingers turned about different axes, so that bones stand apart
    sim.data.qpos[3:7] = np.cos(0.1), np.sin(0.1), 0.0, 0.0
    sim.data.qpos[13:] = sim.data.ctrl[6:] = 0.3
    sim.step(3)
    agree(sim)


@pytest.mark.parametrize(("scene", "start_s"), [("two_hands", 0.3), ("grasp_object", 0.2)])
@pytest.mark.parametrize("edges", ["rays", "knife_edge"])
def test_shadows_of_hands_and_of_an_obstacle(by_graph: Any, edges: str, scene: str, start_s: float) -> None:
    sim = by_graph(SCENES / f"{scene}.xml", accuracy=0.5, keys={"skin.shadow_edges": edges})
    sim.start_at(start_s)
    sim.step(2)
    agree(sim, flipped=2e-3)


def test_two_skins_two_arrays_two_stimuli(by_graph: Any) -> None:
    sim = by_graph(SCENES / "two_hands_both_feel.xml", accuracy=0.5)
    sim.step(3)
    agree(sim)


def test_one_launch_a_step_and_none_where_only_the_level_changes(small_scene: Any, by_graph: Any) -> None:
    joint = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
    sims = []
    for kept in (joint.replace("1 0 0", "0 0 1"), ""):
        scene = small_scene(skin={"solver": "wedges"})
        plain = scene.with_name("plain.xml")
        plain.write_text(plain.read_text().replace(joint, kept))
        sims.append(by_graph(scene))
    for sim, expected in zip(sims, (10, 0), strict=True):
        sim.step(3)
        before = sim.runtime.steps.host.launches
        for _ in range(10):
            mujoco.mj_step(sim.model, sim.data)
        palmfield.raise_errors(sim.data)
        assert sim.runtime.steps.host.launches - before == expected


def test_a_step_runs_few_python_functions(by_graph: Any, python_calls: Any) -> None:
    sim = by_graph(SCENES / "approach_withdraw.xml", accuracy=0.5)
    sim.step(3)
    assert python_calls(lambda: mujoco.mj_step(sim.model, sim.data)) <= 193
    palmfield.raise_errors(sim.data)


def test_runs_repeat_to_the_bit(small_scene: Any, by_graph: Any) -> None:
    sensors = []
    for _ in range(2):
        sim = by_graph(small_scene(stimulus=CIRCLE | NO_WAVE, array={"response": "on"}))
        sim.step(5)
        sensors.append(sim.data.sensordata.copy())
    np.testing.assert_array_equal(*sensors)


def test_a_copy_goes_on_by_itself(small_scene: Any, by_graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    sim = by_graph(small_scene())
    sim.step(3)
    monkeypatch.setattr(step, "serves", lambda model: True)
    twin = sim.copy()
    sim.step(4)
    twin.step(4)
    assert twin.runtime.steps.host is not sim.runtime.steps.host and twin.runtime.steps.in_graph
    np.testing.assert_array_equal(twin.data.sensordata, sim.data.sensordata)


def test_more_drives_than_before_take_more_room(
    small_scene: Any, by_graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = by_graph(small_scene())
    sim.step(2)
    runtime, graph = sim.runtime, sim.runtime.steps.host
    posed = runtime.posed
    rng = np.random.default_rng(0)
    drives = np.exp(2j * np.pi * rng.uniform(size=(11, 256)))
    moments, course = runtime.work.emission.over(posed, runtime.amplitudes, sim.data.time, 2)
    many = of_drives(drives, course.end)
    for wanted in (many, of_drives(drives[:1], course.end), many):
        monkeypatch.setattr(Emission, "over", lambda *_, wanted=wanted: (moments, wanted))
        monkeypatch.setattr(graph, "_copy_states", lambda *_: None)
        expected = Radiation(runtime.model).many(posed, 0, wanted.units)
        begin(graph, posed, sim.data.time)
        assert np.abs(graph.load(0) - expected).max() < 3e-5 * expected.max()


@pytest.mark.parametrize("response", ["off", "on"])
def test_what_sounded_last_does_not_push_in_silence(small_scene: Any, by_graph: Any, response: str) -> None:
    """Neither after the end of a sound nor before its beginning in a second run."""
    ends = small_scene(
        stimulus=CIRCLE | NO_WAVE | {"start_s": 0.003, "stop_s": 0.006},
        array={"response": response},
        skin={"solver": "modal"},
        duration_s=0.05,
    )
    ways = by_graph(ends), palmfield.Simulation(ends, device="cpu")
    for _ in range(2):
        moved: list[list[Any]] = [[], []]
        for _ in range(12):
            for sim, seen in zip(ways, moved, strict=True):
                sim.step()
                seen.append(sim.skin().displacement.copy())
        graph, plain = (np.array(seen) for seen in moved)
        assert np.abs(graph - plain).max() < 1e-4 * np.abs(plain).max() > 0.0
        assert not plain[1].any() and not graph[1].any()
        assert response == "on" or not any(sim.forces.any() for sim in ways)
        for sim in ways:
            sim.reset()


def test_silence_pushes_nothing(small_scene: Any, by_graph: Any) -> None:
    sim = by_graph(small_scene(stimulus={"start_s": 0.004}))
    sim.step(3)
    assert sim.runtime.steps.host.launches == 0
    assert not sim.forces.any() and not sim.data.sensordata.any()
    sim.step(3)
    assert sim.forces.any()


def test_what_is_not_finite_is_named(small_scene: Any, by_graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    sim = by_graph(small_scene())
    sim.step(2)
    posed, now = sim.runtime.posed, sim.data.time
    drive = np.ones(256, complex)
    drive[7] = np.nan
    with monkeypatch.context() as patch:
        patch.setattr(Emission, "mean_drives", lambda *_: of_one(drive[None], 1.0, 1))
        with pytest.raises(PalmfieldError, match=r"drive of transducer 7 = .*nan.* is not finite"):
            begin(sim.runtime.steps.host, posed, now)
    posed.bodies[0].frame.position[1] = np.inf
    graph = SceneGraph([sim.runtime.model], [sim.runtime.work], sim.runtime.state, False)
    with pytest.raises(PalmfieldError, match=r"pose of 'pad' at .*inf.* is not finite"):
        begin(graph, posed, now)


@pytest.mark.parametrize("at", ["build", "step"])
def test_memory_that_runs_out_says_what_to_change(
    small_scene: Any, by_graph: Any, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    """What Warp raises there, word for word; here nothing runs out."""

    def full(*_: object) -> None:
        raise RuntimeError("Failed to allocate 68719476736 bytes on device 'cuda:0'")

    sim = None
    if at == "step":
        sim = by_graph(small_scene(stimulus=CIRCLE | NO_WAVE))
        sim.step()
        monkeypatch.setattr(graph_work.GraphWork, "launch", full)
    else:
        monkeypatch.setattr(scene_graph, "Transducers", full)
    with pytest.raises(DeviceError, match=r"cuda:0.*accuracy.*patch_radius_m.*worlds.*device") as raised:
        sim.step() if sim else by_graph(small_scene())
    assert "\n" not in str(raised.value)


def test_boxes_hold_the_whole_surface_in_any_pose(by_graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    sim = palmfield.Simulation(SCENES / "approach_withdraw.xml", device="cpu", accuracy=0.5)
    rng = np.random.default_rng(0)
    for _ in range(3):
        sim.data.qpos[7:] = rng.uniform(-0.5, 1.0, len(sim.data.qpos) - 7)
        mujoco.mj_forward(sim.model, sim.data)
        palmfield.raise_errors(sim.data)
        [body] = sim.runtime.posed.bodies
        directions = rng.normal(size=(50, 3))
        assert ((body.hull @ directions.T).max(axis=0) >= (body.vertices_in_array @ directions.T).max(axis=0)).all()
    lowest = body.vertices_in_array[:, 2].min()
    posed = sim.runtime.posed
    height = posed.arrays.boards[0].height
    for gap, clear in ((0.5 * CLEARANCE_M, False), (2.0 * CLEARANCE_M, True)):
        moved = posed.bodies[0].frame.position.copy()
        posed.bodies[0].frame.position[2] += height + gap - lowest
        vars(posed.bodies[0]).pop("vertices_in_array", None)
        if clear:
            validate.check_clear(posed)
        else:
            with pytest.raises(PalmfieldError, match="is too close to the array"):
                validate.check_clear(posed)
        posed.bodies[0].frame.position[:] = moved


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no GPU here")
@pytest.mark.parametrize("body_sound", ["none", "shadows"])
@pytest.mark.parametrize("path", [{}, CIRCLE | NO_WAVE], ids=["point", "circle"])
def test_a_gpu_gives_what_the_cpu_gives(small_scene: Any, path: dict[str, object], body_sound: str) -> None:
    keys: dict[str, Any] = {"stimulus": path, "skin": {"body_sound": body_sound, "solver": "wedges"}}
    here, *there = (palmfield.Simulation(small_scene(**keys), device=device) for device in ("cpu", "cuda:0", "cuda:0"))
    for _ in range(8):
        for sim in (here, *there):
            sim.step()
        assert there[0].runtime.steps.in_graph
        np.testing.assert_array_equal(there[0].data.sensordata, there[1].data.sensordata)
        mine, its = (sim.data.sensordata for sim in (here, there[0]))
        np.testing.assert_allclose(its[2:5], mine[2:5], rtol=1e-4, atol=1e-12)
