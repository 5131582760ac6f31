"""Steps that a recording on a device computes together while nothing moves, here on the CPU, against single steps."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.outputs.store import MemoryStore
from palmfield.session import recorded_run
from palmfield.session.recorder import TOGETHER
from palmfield.simulation import step
from palmfield.simulation.still_steps import NOBODY, STEPS, StillSteps

CIRCLE: dict[str, object] = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 100} | dict.fromkeys(
    ("modulation", "am_quantity", "am_frequency_Hz", "am_depth")
)
KEYS: dict[str, dict[str, Any]] = {
    "level": {},
    "level that rings": {"array": {"response": "on"}},
    "circle": {"stimulus": CIRCLE},
    "circle that rings": {"stimulus": CIRCLE, "array": {"response": "on"}},
    "stops": {"stimulus": CIRCLE | {"stop_s": 0.05}, "array": {"response": "on"}},
    "modes": {"stimulus": CIRCLE, "skin": {"solver": "modal"}},
    "whole layer": {"stimulus": CIRCLE, "array": {"response": "on"}, "skin": {"solver": "wedges"}},
}
RUN = 60


@pytest.fixture
def opened(small_scene: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> Callable[..., palmfield.Simulation]:
    """Opens a scene whose body a mocap body carries, as on a GPU but on the CPU; by default with a reduced model."""

    def made(**keys: Any) -> palmfield.Simulation:
        scene = small_scene(**keys | {"skin": {"accuracy": 0.3, "solver": "reduced"} | keys.get("skin", {})})
        plain = scene.with_name("plain.xml")
        text = re.sub(r"<joint[^>]*/>", "", plain.read_text())
        plain.write_text(text.replace('<body name="pad"', '<body name="pad" mocap="true"'))
        with monkeypatch.context() as patch:
            patch.setattr(step, "serves", lambda model: True)
            sim = palmfield.Simulation(scene, device="cpu")
            assert isinstance(sim.runtime.steps.backends[0], StillSteps)
        return sim

    return made


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of all blocks of steps."""
    sizes: list[int] = []
    computed = StillSteps._computed

    def seen(self: StillSteps, *given: Any) -> Any:
        block = computed(self, *given)
        if block is not None:
            sizes.append(len(block.means))
        return block

    monkeypatch.setattr(StillSteps, "_computed", seen)
    return sizes


def recorded(
    sim: palmfield.Simulation, steps: int = RUN, between: Callable[[int], object] = lambda _: None
) -> dict[str, Any]:
    """The result of a recorded run from reset, by variable, and its states. between: called after each step."""
    sim.reset()
    store = MemoryStore(recorded_run.initial_block(sim), recorded_run.result_attributes(sim))
    recorder = recorded_run.recorder_of(sim, store, TOGETHER)
    recorder.start()
    emitted, skins = [], []
    for number in range(steps):
        sim.step()
        recorder.step()
        emitted.append(sim.runtime.state.emission())
        skins.append(sim.skin().normal_displacement)
        between(number)
    recorder.stop()
    tree = store.finish({}, complete=True)
    values = {f"{node.path}/{name}": part.values for node in tree.subtree for name, part in node.data_vars.items()}
    return values | {"emitted": np.array(emitted), "skins": np.array(skins)}


def one_by_one(sim: palmfield.Simulation, monkeypatch: pytest.MonkeyPatch, **given: Any) -> dict[str, Any]:
    """The same without blocks."""
    with monkeypatch.context() as patch:
        patch.setattr(StillSteps, "place", lambda *_: NOBODY)
        return recorded(sim, **given)


def agree(one: dict[str, Any], other: dict[str, Any]) -> None:
    """Rounding decides whether a point near the edge of the light counts in a force."""
    assert set(one) == set(other)
    for name, expected in other.items():
        if expected.dtype.kind in "fc" and expected.size:
            within = 5e-4 if "/forces/" in name else 2e-5 if "/sensors/" in name else 3e-6
            largest = np.abs(expected).max()
            np.testing.assert_allclose(one[name], expected, 0.0, within * largest, err_msg=name)
        else:
            np.testing.assert_array_equal(one[name], expected, name)


@pytest.mark.parametrize("kind", KEYS)
def test_steps_together_have_the_numbers_of_single_steps(
    opened: Callable[..., palmfield.Simulation], blocks: list[int], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    sim = opened(**KEYS[kind])
    alone = one_by_one(sim, monkeypatch)
    assert blocks == [] and np.abs(alone["/skin/skin/displacement"]).max() > 0.0
    together = recorded(sim)
    # The first step is made alone, and so are those from the block with the jump of the level on
    assert blocks == [STEPS] * (3 if kind == "stops" else 4)
    agree(together, alone)


def test_a_body_that_moves_ends_the_block(
    opened: Callable[..., palmfield.Simulation], blocks: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def move(number: int) -> None:
        if number in (10, 30):
            sim.data.mocap_pos[0, 0] += 1e-3 if number == 10 else -1e-3
            mujoco.mj_kinematics(sim.model, sim.data)

    sim = opened(stimulus=CIRCLE)
    with pytest.raises(palmfield.errors.SceneError, match="has moved"):
        recorded(sim, between=move)
    assert blocks == [STEPS]
    sim = opened(stimulus=CIRCLE, skin={"solver": "modal"})
    alone = one_by_one(sim, monkeypatch, between=move)
    blocks.clear()
    together = recorded(sim, between=move)
    # After steps 1, 12 (in the new pose), 28, 32 (back) and 48
    assert blocks == [STEPS] * 5
    agree(together, alone)


def test_a_run_goes_on_after_a_recording_that_stops_within_a_block(
    opened: Callable[..., palmfield.Simulation], blocks: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = opened(stimulus=CIRCLE, array={"response": "on"})
    states = []
    for record in (lambda: one_by_one(sim, monkeypatch, steps=12), lambda: recorded(sim, 12)):
        record()
        sim.step(3)
        states.append((sim.runtime.state.emission().copy(), sim.skin().normal_displacement.copy()))
    assert blocks == [STEPS]
    for one, other in zip(*states, strict=True):
        np.testing.assert_allclose(one, other, 0.0, 3e-6 * np.abs(other).max())


def test_a_state_that_other_code_writes_ends_the_block(
    opened: Callable[..., palmfield.Simulation], blocks: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = opened(stimulus=CIRCLE, array={"response": "on"})

    def silence(number: int) -> None:
        if number == 12:
            sim.runtime.state.set_emission(slice(None), np.zeros_like(sim.runtime.state.emission()))

    alone = one_by_one(sim, monkeypatch, between=silence)
    together = recorded(sim, between=silence)
    assert blocks == [STEPS] * 4  # steps 1 to 12, then from 13 on
    agree(together, alone)
