"""Steps of a scene: nothing piles up, substeps in one call, the same numbers again, and in every way of stepping."""

import gc
import re
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

import palmfield
from palmfield.acoustics import surface_arp
from palmfield.simulation.backend import Frames
from palmfield.simulation.state import HEADER, new_state
from palmfield.simulation.step import Steps
from palmfield.simulation.workspace import Workspace
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.reduction.reduced_stepper import ReducedStepper

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 140}
RINGING_CIRCLE = {"stimulus": CIRCLE, "array": {"response": "on"}}
MOST_GROWTH_BYTES = 64 * 1024


# -- memory --------------------------------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("changes", "speed"),
    [({}, 0.0), ({}, 3.0), (RINGING_CIRCLE, 0.0), ({"skin": {"solver": "reduced"}}, 0.0)],
    ids=["am, still", "am, moving", "circle, still", "am, small model"],
)
def test_memory_after_1000_steps_is_that_after_100(small_scene, changes, speed):
    sim = palmfield.Simulation(small_scene(**changes))
    places = set()

    def on(count):
        for step in range(count):
            if step % 20 == 0 and speed:
                sim.data.qvel[0] = speed if sim.data.qpos[0] < 0.0 else -speed
            sim.step()
            if step % 100 == 99:
                places.add(float(sim.data.qpos[0]))
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        after_100 = on(100)
        after_1000 = on(900)
    finally:
        tracemalloc.stop()
    assert after_1000 - after_100 < MOST_GROWTH_BYTES
    assert (len(places) > 1) == bool(speed)


# -- without MuJoCo ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["wedges", "reduced"])
def test_a_state_of_its_own_steps_as_mujocos_does(small_scene, solver):
    """Plain arrays and a pose are all that a step needs; a copy of a state goes on by itself."""
    path = small_scene(stimulus=STEADY, skin={"solver": solver}, array={"response": "on"})
    plain = path.with_name("plain.xml")
    plain.write_text(re.sub('<joint name="slide".*/>', "", plain.read_text()))
    sim = palmfield.Simulation(path)
    model, timestep_s = sim.runtime.model, sim.model.opt.timestep

    def on(state, first, last):
        work = Workspace(model)
        steps = Steps([model], [work], state)
        frames = Frames(np.zeros((1, 0, 3)), np.zeros((1, 0, 9)), lambda here: {0: work.reference})
        for number in range(first, last):
            steps.begin(frames, number * timestep_s)
            steps.advance(number * timestep_s, (number + 1) * timestep_s)

    state = new_state(model)
    on(state, 0, 4)
    copy = state.copy()
    on(copy, 4, 5)
    for mine, steps in ((state, 4), (copy, 1)):
        sim.step(steps)
        for own, mujocos in zip(mine.skins, sim.runtime.state.skins, strict=True):
            np.testing.assert_allclose(own, mujocos, rtol=1e-6, atol=1e-9 * np.abs(mujocos[:, HEADER:]).max())
        np.testing.assert_allclose(mine.emitted, sim.runtime.state.emitted, rtol=1e-9)
    assert np.abs(copy.emitted[0]).min() > 0.5 and not np.array_equal(copy.skins[0], state.skins[0])


# -- substeps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("solver", "kind"), [("wedges", WedgeStepper), ("reduced", ReducedStepper)])
@pytest.mark.parametrize("step_s", [0.001, 0.0005, 0.0001])
def test_all_substeps_of_a_step_are_one_call(small_scene, monkeypatch, solver, kind, step_s):
    calls = []
    real = kind.step

    def counted(self, state, loads, t0, t1, observe=None):
        calls.append((loads.first.shape[1], t0, t1))
        return real(self, state, loads, t0, t1, observe)

    monkeypatch.setattr(kind, "step", counted)
    sim = palmfield.Simulation(small_scene(skin={"solver": solver, "step_s": step_s}))
    calls.clear()  # what making a small model takes
    sim.step(4)
    assert [count for count, _, _ in calls] == 4 * [round(0.001 / step_s)]
    np.testing.assert_allclose([(t0, t1) for _, t0, t1 in calls], [(1e-3 * i, 1e-3 * (i + 1)) for i in range(4)])
    assert np.abs(sim.skin().displacement).max() > 0


# -- the same again ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [{}, RINGING_CIRCLE, {"skin": {"body_sound": "shadows"}}],
    ids=["am", "circle", "shadows"],
)
def test_moving_scenes_repeat_to_the_bit_on_several_threads(small_scene, many_threads, changes):
    path = small_scene(**changes)

    def course():
        sim = palmfield.Simulation(path)
        sim.data.qvel[0] = 3.0
        seen = []
        for _ in range(12):
            sim.step()
            skin = sim.skin()
            seen += [skin.displacement, skin.velocity, skin.arp, sim.forces, sim.emitted, sim.data.sensordata]
        assert sim.data.qpos[0] > 0.001
        assert many_threads(sim.data) > 1
        return b"".join(np.ascontiguousarray(part).tobytes() for part in seen)

    first = course()
    for _ in range(2):
        assert course() == first


def test_threads_change_no_number(small_scene, many_threads, monkeypatch):
    """A point's field doesn't depend on the block in which it is computed."""
    path = small_scene()
    seen = []
    for cores in (4, 1):
        monkeypatch.setattr(surface_arp, "cores", lambda count=cores: count)
        sim = palmfield.Simulation(path)
        sim.data.qvel[0] = 3.0
        sim.step(5)
        assert (many_threads(sim.data) > 1) == (cores > 1)
        seen.append(sim.data.plugin_state.tobytes())
    assert seen[0] == seen[1]


# -- every way of stepping -----------------------------------------------------------------------------------------

STOCK = """
import sys, mujoco
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
data.qvel[0] = 2.0
for _ in range(20):
    mujoco.mj_step(model, data)
print(*(float(x).hex() for x in [*data.qpos, *data.qvel, *data.sensordata]))
print(*(float(x).hex() for x in data.plugin_state))
"""


@pytest.mark.parametrize("changes", [{}, {"stimulus": CIRCLE}], ids=["am", "circle"])
def test_stock_mujoco_in_a_process_of_its_own_equals_a_simulation(small_scene, changes):
    path = small_scene(**changes)
    sim = palmfield.Simulation(path)
    sim.data.qvel[0] = 2.0
    sim.step(20)
    done = subprocess.run(
        [sys.executable, "-c", STOCK, str(path)], capture_output=True, text=True, timeout=300, check=True
    )
    plain, state = (np.array([float.fromhex(x) for x in line.split()]) for line in done.stdout.splitlines())
    mine = np.array([*sim.data.qpos, *sim.data.qvel, *sim.data.sensordata])
    np.testing.assert_allclose(plain, mine, rtol=1e-6, atol=1e-15)
    assert np.linalg.norm(state - sim.data.plugin_state) <= 1e-6 * np.linalg.norm(state)
    assert np.abs(sim.skin().displacement).max() > 1e-9


@pytest.mark.parametrize("changes", [{}, RINGING_CIRCLE], ids=["am", "circle"])
def test_a_run_records_the_motion_that_a_simulation_has(small_scene, changes):
    path = small_scene(duration_s=0.012, **changes)
    result = palmfield.run(path, None, progress=False)
    assert result.out is None
    sim = palmfield.Simulation(path)
    substeps = sim.runtime.model.substeps
    recorded = result.dataset["/skin/skin"]
    for steps in range(1, 13):
        sim.step()
        skin = sim.skin()
        for name in ("displacement", "velocity"):
            whole = recorded[name].values
            assert whole.dtype == np.float32
            largest = np.abs(whole).max()
            assert largest > 0
            now = getattr(skin, name)
            row = substeps * steps - 1 + len(whole) - 12 * substeps
            assert np.abs(whole[row] - now).max() <= 1e-6 * max(largest, np.abs(now).max())
    np.testing.assert_allclose(recorded["displacement"].values[-1], sim.skin().displacement, rtol=1e-6, atol=1e-13)
