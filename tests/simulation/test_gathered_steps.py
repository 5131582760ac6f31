"""Steps in which nothing feels the sound are computed several at once: against plain mj_step."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.planning.scene_plan import plan
from palmfield.simulation import host_backend, step

PATH: dict[str, object] = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 100} | dict.fromkeys(
    ("modulation", "am_quantity", "am_frequency_Hz", "am_depth")
)
KEYS: dict[str, dict[str, Any]] = {
    "level": {"skin": {"solver": "reduced"}},
    "path": {"stimulus": PATH, "skin": {"solver": "reduced"}},
    "modes": {"stimulus": PATH, "skin": {"solver": "modal"}},
    "held": {"stimulus": PATH | {"control_rate_Hz": 400}, "skin": {"solver": "modal"}},
    "stops": {"stimulus": PATH | {"start_s": 0.004, "stop_s": 0.0125}, "skin": {"solver": "modal"}},
    "rings": {"stimulus": PATH, "array": {"response": "on"}, "skin": {"solver": "reduced"}},
    "wedges": {"stimulus": PATH, "skin": {"solver": "wedges"}},
}


@pytest.fixture
def still(small_scene: Callable[..., Path]) -> Callable[..., Path]:
    """Writes the small scene with a pad that nothing can push, or that a mocap body carries."""

    def written(carried: bool = False, **keys: dict[str, Any]) -> Path:
        scene = small_scene(**{name: {"accuracy": 0.3} | of if name == "skin" else of for name, of in keys.items()})
        plain = scene.with_name("plain.xml")
        text = re.sub(r"<joint[^>]*/>", "", plain.read_text())
        plain.write_text(text.replace('<body name="pad"', '<body name="pad" mocap="true"') if carried else text)
        return scene

    return written


def apart(one: Any, other: Any) -> float:
    """Largest difference over the largest number of the second."""
    return float(np.abs(np.asarray(one) - other).max()) / max(float(np.abs(other).max()), 1e-300)


def agree(one: palmfield.Simulation, other: palmfield.Simulation) -> None:
    """To the rounding of float32 products, which blocks of other sizes add up in another order."""
    assert one.time == other.time
    assert apart(one.skin().displacement, other.skin().displacement) < 2e-6
    assert apart(one.emitted, other.emitted) < 1e-9
    assert apart(one.forces, other.forces) < 1e-6
    assert apart(one.data.sensordata, other.data.sensordata) < 2e-6


@pytest.mark.parametrize("kind", KEYS)
def test_steps_in_one_go_are_those_of_mujoco(
    still: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    gathered: list[int] = []
    over = step.Steps.over
    monkeypatch.setattr(step.Steps, "over", lambda *given: gathered.append(given[3]) or over(*given))
    scene = still(**KEYS[kind])
    here, there = palmfield.Simulation(scene), palmfield.Simulation(scene)
    for count in (1, 5, 40):
        here.step(count)
        for _ in range(count):
            mujoco.mj_step(there.model, there.data)
        palmfield.raise_errors(there.data)
        assert np.abs(there.skin().displacement).max() > 0.0 or there.time < 0.005
        agree(here, there)
    assert sum(gathered) == 4 + 39
    assert max(gathered) == (1 if kind in ("modes", "held", "stops") else step.TOGETHER)
    ended = here.data.plugin_state.copy()
    here.reset()
    for count in (1, 5, 40):
        here.step(count)
    np.testing.assert_array_equal(here.data.plugin_state, ended)


def test_a_carried_pad_is_computed_pose_by_pose_without_its_force(
    still: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = still(carried=True, stimulus=PATH, skin={"solver": "modal"})
    sims = [palmfield.Simulation(scene) for _ in range(2)]
    steps, forces = 0, list[int]()
    push = host_backend.HostBackend.push
    monkeypatch.setattr(host_backend.HostBackend, "push", lambda *given: forces.append(1) or push(*given))
    for sim in sims:
        forces.clear()
        for steps in (4, 6):
            sim.data.mocap_pos[0, 0] += 1e-3
            if sim is sims[0]:
                sim.step(steps)
            else:
                for _ in range(steps):
                    mujoco.mj_step(sim.model, sim.data)
        assert len(forces) == (2 if sim is sims[0] else 10)
    agree(*sims)


def test_what_feels_the_sound_is_stepped_one_by_one(
    small_scene: Callable[..., Path], still: Callable[..., Path]
) -> None:
    slides = small_scene()
    sim = palmfield.Simulation(slides)
    assert not sim.runtime.may_gather and "body 'pad' has degrees of freedom" in sim.runtime.feedback
    words = " ".join(row.why for row in plan(slides).modelled)
    assert "one at a time: body 'pad' has degrees of freedom, on which the sound acts" in words
    free = still()
    assert "several at a time, because the sound moves no body" in " ".join(row.why for row in plan(free).modelled)
    sim = palmfield.Simulation(free)
    assert sim.runtime.may_gather
    sim.steps.observer = lambda trace: None
    assert not sim.runtime.may_gather
    plain = free.with_name("plain.xml")
    arm = '<body name="arm" gravcomp="1"><joint type="slide"/><geom size="0.01" pos="0.1 0 0.2"/><body name="pad"'
    plain.write_text(plain.read_text().replace('<body name="pad"', arm).replace("</body>", "</body></body>"))
    assert "body 'arm' has degrees of freedom" in palmfield.Simulation(free).runtime.feedback


def test_a_reset_in_the_midst_is_that_of_mujoco(still: Callable[..., Path], tmp_path: Path) -> None:
    """A loose body that is pushed apart by its own damper becomes unstable, and MuJoCo resets the whole state."""
    scene = still(**KEYS["wedges"])
    plain = scene.with_name("plain.xml")
    loose = '<body pos="1 0 0"><joint type="slide" damping="-60"/><geom size="0.03" contype="0"/></body></worldbody>'
    plain.write_text(plain.read_text().replace("</worldbody>", loose))
    sim, other = palmfield.Simulation(scene), palmfield.Simulation(scene)
    assert sim.runtime.may_gather
    sim.step(60)
    for _ in range(60):
        mujoco.mj_step(other.model, other.data)
    assert sim.time < 0.5 * 60 * sim.model.opt.timestep  # it has happened
    agree(sim, other)


def test_an_error_in_the_midst_leaves_whole_steps(still: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    sim, other = (palmfield.Simulation(still(**KEYS["path"])) for _ in range(2))
    with monkeypatch.context() as patch:
        checked = sim.runtime.check_options
        calls: list[int] = []

        def options() -> None:
            calls.append(1)
            if len(calls) == 8:
                raise palmfield.SceneError("option 'timestep' was changed")
            checked()

        patch.setattr(sim.runtime, "check_options", options)
        with pytest.raises(palmfield.SceneError, match="timestep"):
            sim.step(20)
    other.step(7)
    assert apart(sim.skin().displacement, other.skin().displacement) < 2e-6
