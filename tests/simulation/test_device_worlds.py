"""Worlds whose skins a device steps: here the CPU as such a device, by the same kernels and graphs."""

import numpy as np
import pytest
import warp as wp

import palmfield
from palmfield.simulation import host_backend
from palmfield.skin.reduction.device_models import DeviceWorlds

KEYS = {
    "stimulus.focus_m": [(0.0, 0.0, 0.12), (0.004, 0.0, 0.12), (0.0, -0.003, 0.12)],
    "stimulus.am_depth": [1.0, 0.5, 0.8],
    "stimulus.start_s": [0.0, 0.0035, 0.002],
}
SKIN = {"max_frequency_Hz": 400, "element_m": 0.01, "accuracy": 0.4, "solver": "modal"}
STEPS = 9


@pytest.fixture
def by_device(monkeypatch):
    """Skins in worlds are stepped as on a GPU, by kernels on the CPU; gives what has been stepped, in worlds."""
    stepped, plain = [], DeviceWorlds.step

    def step(self, state, *others):
        stepped.append(len(state))
        return plain(self, state, *others)

    def of_skin(self, skin, stepper):
        return self._own.of(skin, (), DeviceWorlds, stepper, len(self.models), "cpu").step

    monkeypatch.setattr(DeviceWorlds, "step", step)
    monkeypatch.setattr(host_backend.HostBackend, "_on_device", of_skin)
    return stepped


def watched(path):
    """Displacement and velocity of all vertices after each substep in three worlds, and states at the end."""
    sim = palmfield.Simulation(path, worlds=3, keys=KEYS)
    seen: list[list[tuple[np.ndarray, np.ndarray]]] = []
    for runtime in sim.runtimes:
        runtime.work.observe = tuple(skin.layer.surface_operator for skin in runtime.model.skins)

    def see(trace):
        if len(trace.worlds) > 1:
            seen.append([(rows, motion.copy()) for rows, motion in trace.motion[0]])

    sim.steps.observer = see
    sim.step(STEPS)
    return sim, seen


def test_a_device_steps_worlds_as_the_stepper_does(small_scene, by_device, monkeypatch):
    path = small_scene(skin=SKIN)
    on_device, seen = watched(path)
    # A world whose sound begins takes that step by itself
    assert set(by_device) == {2, 3} and len(by_device) == STEPS
    monkeypatch.undo()
    plain, known = watched(path)
    size = np.abs(plain.skin().displacement).max(axis=(1, 2))
    assert size.min() > 1e-7
    apart = np.abs(on_device.skin().displacement - plain.skin().displacement).max(axis=(1, 2))
    assert (apart < 1e-9 * size).all()
    assert len(seen) == len(known) == STEPS
    for one, other in zip(seen, known, strict=True):
        for (rows, motion), (own, its) in zip(one, other, strict=True):
            np.testing.assert_array_equal(rows, own)
            assert motion.shape == its.shape
            for part in range(2):
                largest = np.abs(its[:, :, part]).max()
                assert np.abs(motion[:, :, part] - its[:, :, part]).max() <= 2e-6 * largest


def test_a_copy_goes_on_with_the_same_bits(small_scene, by_device):
    sim = palmfield.Simulation(small_scene(skin=SKIN), worlds=3, keys=KEYS)
    sim.step(5)
    twin = sim.copy()
    sim.step(3)
    twin.step(3)
    np.testing.assert_array_equal(sim.skin().displacement, twin.skin().displacement)
    assert np.abs(sim.skin().displacement).max() > 1e-7 and len(by_device) >= 11


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no GPU here")
def test_a_new_graph_begins_from_the_state_that_is_there(small_scene):
    """What the first pass through its launches brings back must not come over it."""
    path, motions = small_scene(skin=SKIN), []
    for device in ("cpu", "cuda:0"):
        sim = palmfield.Simulation(path, worlds=3, keys=KEYS, device=device)
        sim.step(6)
        # What is watched makes a graph of its own, while all worlds move
        for runtime in sim.runtimes:
            runtime.work.observe = tuple(skin.layer.surface_operator for skin in runtime.model.skins)
        sim.step()
        motions.append(sim.skin().displacement)
    assert np.abs(motions[1] - motions[0]).max() < 1e-4 * np.abs(motions[0]).max()
