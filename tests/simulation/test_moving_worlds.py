"""Worlds whose bodies move, in one graph on a device (here the CPU as one), against simulations by themselves."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield import device
from palmfield.data import folder
from palmfield.errors import DeviceError
from palmfield.simulation import graph_work, step

SCENES = folder("mjcf") / "scenes"
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
MOST_CALLS = 63
COARSE = {"skin.accuracy": 0.5, "skin.max_frequency_Hz": 300}


@pytest.fixture
def by_graph(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Opens a scene on the CPU as on a device whose graphs step worlds."""

    def opened(*scene: Any, **keywords: Any) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr(step, "serves", lambda model: True)
            return palmfield.Simulation(*scene, device="cpu", **keywords)

    return opened


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference over the largest number of the second."""
    return float(np.abs(one - other).max()) / float(np.abs(other).max())


@pytest.mark.parametrize(
    ("scene", "differs", "start_s"),
    [
        (
            "hover_explore",
            {"stimulus.path_diameter_m": [0.02, 0.015, 0.01], "stimulus.drive_amplitude": [1, 0.5, 0.8]},
            0.1,
        ),
        ("follow_fingertip", {"stimulus.am_frequency_Hz": [200, 150, 80]}, 0.1),
    ],
)
def test_worlds_are_what_each_is_by_itself(
    by_graph: Callable[..., Any], scene: str, differs: dict[str, list[float]], start_s: float
) -> None:
    path = SCENES / f"{scene}.xml"
    worlds = by_graph(path, worlds=3, keys=COARSE | differs)
    worlds.start_at(start_s)
    worlds.step(4)
    assert len(worlds.steps.backends[0].joined) == 3
    for world in range(3):
        keys = {name: values[world] for name, values in differs.items()}
        alone = palmfield.Simulation(path, device="cpu", keys=COARSE | keys | {"skin.solver": "modal"})
        alone.start_at(start_s)
        alone.step(4)
        assert apart(worlds.forces[world], alone.forces) < 1e-5
        assert apart(worlds.skin().displacement[world], alone.skin().displacement) < 1e-5
        assert apart(worlds.sensors[world], np.array(alone.data.sensordata)) < 1e-4
        assert apart(worlds.data[world].qpos, alone.data.qpos) < 1e-9


def copied(sim: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A copy, as on such a device."""
    with monkeypatch.context() as patch:
        patch.setattr(step, "serves", lambda model: True)
        return sim.copy()


def test_copies_and_resets_go_on_from_what_the_device_has(
    by_graph: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """States lie on the device: a copy, a reset and a look at the skin in between change nothing of what comes."""
    levels = {"stimulus.drive_amplitude": [1.0, 0.6]}
    worlds = by_graph(SCENES / "hover_explore.xml", worlds=2, keys=COARSE | levels)
    worlds.start_at(0.1)
    worlds.step(2)
    twin = copied(worlds, monkeypatch)
    looked = worlds.skin().displacement
    worlds.step(2)
    twin.step(2)
    ended, forces = worlds.skin().displacement, worlds.forces
    assert len(twin.steps.backends[0].joined) == 2 and np.abs(ended - looked).max() > 0.0
    np.testing.assert_array_equal(twin.skin().displacement, ended)
    np.testing.assert_array_equal(twin.forces, forces)
    worlds.start_at(0.1)
    assert not worlds.skin().displacement.any()
    worlds.step(4)
    np.testing.assert_array_equal(worlds.skin().displacement, ended)


@pytest.mark.parametrize("graphs", [1, 2])
def test_a_step_in_which_a_level_jumps_is_taken_by_each_world_itself(
    by_graph: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, graphs: int
) -> None:
    """graphs: among which worlds are shared out; MuJoCo moves the bodies of one before the other is ready."""
    monkeypatch.setattr(step, "LEAST_WORLDS", 2 if graphs == 2 else 9)
    stops = {"stimulus.stop_s": [0.1025, 0.2]}
    worlds = by_graph(SCENES / "hover_explore.xml", worlds=2, keys=COARSE | stops)
    worlds.start_at(0.1)
    joined = []
    for _ in range(5):
        worlds.step()
        joined.append(np.concatenate([each.joined for each in worlds.steps.backends[:-1]]).tolist())
    assert joined == [[0, 1], [0, 1], [1], [0, 1], [0, 1]] and len(worlds.steps.backends) == graphs + 1
    alone = palmfield.Simulation(
        SCENES / "hover_explore.xml", device="cpu", keys=COARSE | {"stimulus.stop_s": 0.1025, "skin.solver": "modal"}
    )
    alone.start_at(0.1)
    alone.step(5)
    assert apart(worlds.skin().displacement[0], alone.skin().displacement) < 1e-5
    assert apart(worlds.emitted[0], alone.emitted) < 1e-9


def test_inputs_are_not_written_while_a_step_that_an_error_cut_off_is_computed(
    by_graph: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first of two graphs computes when the second fails; its next step waits, and goes on as without the error."""
    monkeypatch.setattr(step, "LEAST_WORLDS", 2)
    worlds = by_graph(SCENES / "hover_explore.xml", worlds=2, keys=COARSE | {"stimulus.drive_amplitude": [1.0, 0.6]})
    worlds.start_at(0.1)
    worlds.step(2)
    twin = copied(worlds, monkeypatch)
    first, second, _ = worlds.steps.backends

    def fails(*_: Any) -> None:
        raise DeviceError("no memory")

    with monkeypatch.context() as patch:
        patch.setattr(second, "place", fails)
        with pytest.raises(DeviceError, match="no memory"):
            worlds.step()
    assert first._work.computes
    waits = []
    monkeypatch.setattr(first._work, "wait", lambda wait=first._work.wait: waits.append(wait()))
    worlds.step(2)
    twin.step(2)
    assert len(waits) == 3 and not first._work.computes
    np.testing.assert_array_equal(worlds.forces, twin.forces)


@pytest.mark.parametrize("scene", ["hover_explore", "follow_fingertip"])
def test_one_world_takes_the_same_graph(
    by_graph: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, scene: str, python_calls: Any
) -> None:
    """In MuJoCo's own step, whose state is all that it goes on from."""
    path, keys = SCENES / f"{scene}.xml", COARSE | {"skin.solver": "modal"}
    sims = by_graph(path, keys=keys), palmfield.Simulation(path, device="cpu", keys=keys)
    for sim in sims:
        sim.start_at(0.1)
        sim.step(3)
    graph, alone = sims
    assert len(graph.steps.backends[0].joined) == 1 and len(graph.steps.host.joined) == 0
    kept = np.zeros(mujoco.mj_stateSize(graph.model, STATE))
    mujoco.mj_getState(graph.model, graph.data, kept, STATE)
    twin = copied(graph, monkeypatch)
    graph.step(3)
    alone.step(3)
    assert apart(graph.forces, alone.forces) < 1e-5
    assert apart(graph.skin().displacement, alone.skin().displacement) < 1e-5
    assert apart(graph.data.sensordata, alone.data.sensordata) < 1e-4
    assert apart(graph.data.qpos, alone.data.qpos) < 1e-9 and apart(graph.emitted, alone.emitted) < 1e-9
    shares = [sim.runtime.work.outside[0].energy_share for sim in sims]
    assert shares[0] == pytest.approx(shares[1], rel=1e-3) and shares[1] > 0.0
    ended = graph.data.plugin_state.copy()
    mujoco.mj_setState(graph.model, graph.data, kept, STATE)
    for sim in (graph, twin):
        sim.step(3)
        np.testing.assert_array_equal(sim.data.plugin_state, ended)
    assert python_calls(lambda: mujoco.mj_step(graph.model, graph.data)) <= MOST_CALLS
    palmfield.raise_errors(graph.data)


def test_worlds_that_a_device_has_no_room_for_are_refused_with_the_number_that_fits(
    by_graph: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[int] = []
    real = graph_work.check_room

    def check(needed: int, worlds: int, device: str) -> None:
        taken.append(needed)
        real(needed, worlds, device)

    monkeypatch.setattr(graph_work, "check_room", check)
    levels = {"stimulus.drive_amplitude": [1.0, 0.8, 0.6]}
    path = SCENES / "hover_explore.xml"
    worlds = by_graph(path, worlds=3, keys=COARSE | levels)
    worlds.start_at(0.1)
    worlds.step()
    work = worlds.steps.backends[0]._work
    points = work.load.array.size * 4 + sum(part.nbytes for part in (work.inputs, work.results))
    assert points < taken[0] < 3 * 2**24
    monkeypatch.setattr(device, "free_bytes", lambda _: taken[0] // 2)
    with pytest.raises(DeviceError, match=r"3 worlds need .* GB on cpu, .* MB each.*allowed: worlds <= 1"):
        by_graph(path, worlds=3, keys=COARSE | levels)
