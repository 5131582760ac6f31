"""Recorded runs compute many steps together: against plain mj_step, recorded step by step."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from unestimated import UNESTIMATED

import palmfield
from palmfield.outputs.store import MemoryStore
from palmfield.planning.scene_plan import plan
from palmfield.session import recorded_run, recorder
from palmfield.session.recorder import Recorder

pytestmark = pytest.mark.usefixtures("kept_operators")

PATH: dict[str, object] = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 100} | dict.fromkeys(
    ("modulation", "am_quantity", "am_frequency_Hz", "am_depth")
)
KEYS: dict[str, dict[str, Any]] = {
    "level": {"skin": {"solver": "reduced"}},
    "path": {"stimulus": PATH, "skin": {"solver": "reduced"}},
    "rings": {"stimulus": PATH, "array": {"response": "on"}, "skin": {"solver": "reduced"}},
    "modes": {"stimulus": PATH, "skin": {"solver": "modal"}},
    "wedges": {"stimulus": PATH, "skin": {"solver": "wedges"}},
    "held": {"stimulus": PATH | {"control_rate_Hz": 400}, "skin": {"solver": "modal"}},
    "stops": {"stimulus": PATH | {"start_s": 0.004, "stop_s": 0.0125}, "skin": {"solver": "modal"}},
}


def step_by_step(scene: Path, duration_s: float) -> Any:
    """The result of plain mj_step, written after each step."""
    sim = palmfield.Simulation(scene)
    store = MemoryStore(recorded_run.initial_block(sim), recorded_run.result_attributes(sim))
    observer = recorded_run.recorder_of(sim, store)
    observer.start()
    while sim.time < duration_s - 1e-9:
        mujoco.mj_step(sim.model, sim.data)
        palmfield.raise_errors(sim.data)
        observer.step()
    observer.stop()
    store.append(observer.surfaces())
    return store.finish({}, complete=True)


def agree(one: Any, other: Any) -> None:
    """All variables, to 1e-9 of the largest number of each."""
    assert {node.path for node in one.subtree} == {node.path for node in other.subtree}
    for node in other.subtree:
        assert set(one[node.path].data_vars) == set(node.data_vars)
        for name, expected in node.data_vars.items():
            if expected.dtype.kind in "fc":
                scale = float(np.abs(expected).max()) if expected.size else 0.0
                np.testing.assert_allclose(one[node.path][name], expected, 0.0, 1e-9 * scale, err_msg=str(name))
            else:
                np.testing.assert_array_equal(one[node.path][name], expected, str(name))


@pytest.mark.parametrize("moves", ["still", "slides", "carried"])
@pytest.mark.parametrize("kind", KEYS)
def test_a_recorded_run_has_the_numbers_of_single_steps(
    small_scene: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, kind: str, moves: str
) -> None:
    scene = small_scene(**{name: {"accuracy": 0.3} | of if name == "skin" else of for name, of in KEYS[kind].items()})
    plain = scene.with_name("plain.xml")
    if moves != "slides":
        text = re.sub(r"<joint[^>]*/>", "", plain.read_text())
        plain.write_text(
            text.replace('<body name="pad"', '<body name="pad" mocap="true"') if moves == "carried" else text
        )
    monkeypatch.setattr(recorder, "WAITING_s", 100.0)
    blocks: list[int] = []
    write = Recorder._write
    monkeypatch.setattr(Recorder, "_write", lambda self: blocks.append(len(self._waiting)) or write(self))
    with UNESTIMATED:
        result = palmfield.run(scene, None, duration_s=0.05, progress=False)
    steps, blocks[:] = max(blocks), []
    assert steps == (1 if kind == "held" else 50)
    expected = step_by_step(scene, 0.05)
    assert max(blocks) == 1
    assert float(np.abs(expected["skin/skin"]["displacement"]).max()) > 0.0
    agree(result.dataset, expected)
    assert all(one.values.flags.writeable for node in result.dataset.subtree for one in node.data_vars.values())
    why = " ".join(row.why for row in plan(scene).modelled)
    assert ("one at a time: control_rate_Hz holds foci" if kind == "held" else "for many steps together") in why


def test_steps_that_wait_are_written_after_a_while(
    small_scene: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A killed process loses little, even if its steps take long."""
    monkeypatch.setattr(recorder, "WAITING_s", -1.0)
    sim = palmfield.Simulation(small_scene())
    blocks: list[Any] = []
    sink = type("Sink", (), {"append": lambda _, block: blocks.append(block)})()
    observer = recorded_run.recorder_of(sim, sink, recorder.TOGETHER)
    observer.start()
    sim.step()
    observer.step()
    assert len(blocks) == 2
    observer.stop()
    assert len(blocks) == 2
