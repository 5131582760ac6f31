"""Ctrl-C while MuJoCo steps: between two whole steps with a Simulation, said by raise_errors with plain mj_step."""

import copy
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.interrupts import interrupts_delayed
from palmfield.simulation import build, model

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"


@pytest.fixture(autouse=True)
def python_raises():
    """A shell that runs tests in the background has them ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def ctrl_c_in_call(number, name, monkeypatch):
    """Ctrl-C in a later call of a method of SceneRuntime, all of which run inside MuJoCo's C code."""
    plain, calls = getattr(SceneRuntime, name), []

    def method(*arguments):
        calls.append(1)
        if len(calls) == number:
            os.kill(os.getpid(), signal.SIGINT)
        return plain(*arguments)

    monkeypatch.setattr(SceneRuntime, name, method)


def numbers(sim):
    state = mujoco.mjtState.mjSTATE_INTEGRATION
    found = np.empty(mujoco.mj_stateSize(sim.model, state))
    mujoco.mj_getState(sim.model, sim.data, found, state)
    return np.concatenate((found, sim.data.sensordata))


def test_ctrl_c_while_mujoco_asks_for_sizes_builds_nothing_more(small_scene, monkeypatch):
    begun, plain = [], build.build

    def interrupted(*arguments):
        begun.append(1)
        if len(begun) == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return plain(*arguments)

    path = small_scene(skin={"thickness_m": 0.0041})  # a model that no test has built
    with monkeypatch.context() as patch:
        patch.setattr(build, "build", interrupted)
        with pytest.raises(KeyboardInterrupt):
            palmfield.Simulation(path)
    assert len(begun) == 1
    palmfield.Simulation(path).step()


def test_ctrl_c_does_not_wait_for_meshes_and_samples_of_a_scene(monkeypatch):
    delayed, sample, nodes = [], model.sample_mesh, model.SkinModel.nodes.func

    def noted(made):
        def make(*arguments):
            delayed.append(interrupts_delayed._inside)
            return made(*arguments)

        return make

    monkeypatch.setattr(model, "sample_mesh", noted(sample))
    monkeypatch.setattr(model.SkinModel.nodes, "func", noted(nodes))
    palmfield.Simulation(SCENES / "palm_am200.xml", accuracy=0.47)
    assert delayed == [False, False]


@pytest.mark.parametrize("stage", ["push", "sense", "advance"])
def test_a_simulation_stops_between_two_whole_steps_and_can_go_on(small_scene, stage, monkeypatch):
    path = small_scene()
    whole, sim = palmfield.Simulation(path), palmfield.Simulation(path)
    whole.step(4)
    with monkeypatch.context() as patch:
        ctrl_c_in_call(4, stage, patch)
        with pytest.raises(KeyboardInterrupt):
            sim.run(0.1)
    assert sim.time == whole.time
    np.testing.assert_array_equal(numbers(sim), numbers(whole))
    whole.step(3)
    sim.step(3)
    np.testing.assert_array_equal(numbers(sim), numbers(whole))


@pytest.mark.parametrize("call", [palmfield.Simulation.reset, lambda sim: sim.start_at(0.05)])
def test_a_start_is_whole_before_ctrl_c_is_raised(small_scene, call, monkeypatch):
    path = small_scene()
    whole, sim = palmfield.Simulation(path), palmfield.Simulation(path)
    sim.step(2)
    call(whole)
    with monkeypatch.context() as patch:
        ctrl_c_in_call(1, "push", patch)
        with pytest.raises(KeyboardInterrupt):
            call(sim)
    np.testing.assert_array_equal(numbers(sim), numbers(whole))


def test_ctrl_c_at_any_moment_stops_a_simulation(small_scene):
    """Real signals, which also come while MuJoCo's own code runs, before any line of a callback."""
    script = """
import signal, sys
import palmfield
signal.signal(signal.SIGINT, signal.default_int_handler)
sim = palmfield.Simulation(sys.argv[1])
sim.step()
for _ in range(10):
    try:
        print("begun", flush=True)
        sim.step(10**9)
    except KeyboardInterrupt:
        print("stopped", flush=True)
"""
    command = [sys.executable, "-c", script, str(small_scene())]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    watch = threading.Timer(60.0, child.kill)  # one that goes on says nothing
    watch.start()
    try:
        for number in range(10):
            assert child.stdout.readline() == "begun\n"
            time.sleep(0.01 + 0.0013 * number)
            child.send_signal(signal.SIGINT)
            assert child.stdout.readline() == "stopped\n"
        said, errors = child.communicate(timeout=60)
    finally:
        watch.cancel()
        child.kill()
    assert (child.returncode, said, errors) == (0, "", "")


@pytest.mark.parametrize("stage", ["push", "sense", "advance"])
def test_plain_mj_step_says_that_the_state_is_incomplete(small_scene, stage, monkeypatch):
    sim = palmfield.Simulation(small_scene())
    sim.step(2)
    before = copy.copy(sim)
    with monkeypatch.context() as patch:
        ctrl_c_in_call(1, stage, patch)
        mujoco.mj_step(sim.model, sim.data)
    with pytest.raises(KeyboardInterrupt, match="the state is incomplete: reset it, or restore a copy"):
        palmfield.raise_errors(sim.data)
    palmfield.raise_errors(sim.data)  # said once
    # Sensors are read after the forces
    assert stage == "push" or np.isnan(sim.data.sensordata).all()
    before.step(2)


def test_a_program_that_never_asks_is_ended_by_further_ones(small_scene):
    """Each of them may be lost between two callbacks, as before; in a process of its own, for one may come late."""
    script = """
import signal, sys
import mujoco, palmfield
signal.signal(signal.SIGINT, signal.default_int_handler)
sim = palmfield.Simulation(sys.argv[1])
print("begun", flush=True)
while True:
    mujoco.mj_step(sim.model, sim.data)
"""
    command = [sys.executable, "-c", script, str(small_scene())]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert child.stdout.readline() == "begun\n"
        deadline = time.monotonic() + 30.0
        while child.poll() is None and time.monotonic() < deadline:
            child.send_signal(signal.SIGINT)
            time.sleep(0.02)
        assert child.poll() is not None
    finally:
        child.kill()
        child.communicate()


def test_ctrl_c_while_a_scene_is_loaded_is_raised_as_such(small_scene, monkeypatch):
    path = small_scene()
    plain = SceneRuntime.__init__

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        plain(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(SceneRuntime, "__init__", interrupted)
        with pytest.raises(KeyboardInterrupt):
            palmfield.Simulation(path)
    palmfield.Simulation(path).step()
