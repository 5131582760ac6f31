"""Levels of many worlds' unit drives, against what each world's transducers emit one by one."""

import numpy as np
import pytest

import palmfield
from palmfield.drive.transducer_response import rows
from palmfield.simulation.emission import Emission
from palmfield.simulation.posed_scene import PosedScene, reference_scene
from palmfield.simulation.smooth_sound import SHARED_FROM, SmoothSound
from palmfield.simulation.state import new_state
from palmfield.stimulus.schedule import substep_moments
from palmfield.transforms import IDENTITY, Transform

KEYS = {
    "stimulus.focus_m": [(0.0, 0.0, 0.12), (0.004, 0.0, 0.12), (0.0, -0.003, 0.12)],
    "stimulus.am_frequency_Hz": [200.0, 150.0, 90.0],
    "stimulus.start_s": [0.0, 0.0035, 0.002],
    "stimulus.stop_s": [None, 0.009, None],
}
MOVES_AT, PUT_BACK_AT = 7, 6


def powers(amplitudes):
    return np.abs(np.atleast_2d(amplitudes)) ** 2


@pytest.mark.parametrize("response", ["on", "off"])
@pytest.mark.parametrize("alone", [True, False])
def test_one_level_a_world_is_what_its_transducers_emit(small_scene, response, alone):
    """At the beginning of each step, at its moments, and in the mean over it; a focus moves aside on the way."""
    models = palmfield.Simulation(small_scene(array={"response": response}), worlds=3, keys=KEYS)._scenes.models
    first, worlds = models[0], range(3)
    rest = reference_scene(first)
    aside = [Transform(np.array([0.002, 0.0, 0.0]), np.eye(3))]
    moved = PosedScene(IDENTITY, rest.arrays, aside, rest.bodies, rest.skins)
    state, emissions = new_state(first, 3), [Emission(model) for model in models]
    smooth = SmoothSound(models, [Emission(model) for model in models], state, [True] * 3, alone)
    [emitted], met = state.emitted, np.zeros(3, int)
    ends = emitted.copy()
    for step in range(14):
        t0 = step * first.spec.timestep_s
        if not alone and step == PUT_BACK_AT:
            emitted[2] *= 0.5  # by somebody else
            ends[2] *= 0.5
        scenes = {world: moved if world == 0 and step >= MOVES_AT else rest for world in worlds}
        others = smooth.begin(scenes, t0)
        levels, end = smooth.over(substep_moments((), t0, first.step_s, first.substeps))
        present, mean = smooth.present_factors(), smooth.mean_factors()
        courses = {}
        for world, scene in scenes.items():
            begun = ends[world].copy()
            courses[world] = emissions[world].over(scene, begun, t0, first.substeps)[1]
            if world in others:
                continue
            i, unit = smooth.joined.tolist().index(world), smooth.unit(world)
            np.testing.assert_allclose(levels[i][:, None] * unit, rows(courses[world]), atol=1e-9)
            now = rows(emissions[world].now(scene, begun, t0))
            np.testing.assert_allclose(present[i] * powers(unit), powers(now), atol=1e-9)
            drives = emissions[world].mean_drives(scene, begun, t0)
            felt = drives.weights @ powers(drives.levels @ drives.units) if len(drives.weights) else 0.0
            np.testing.assert_allclose(mean[i] * powers(unit)[0], felt, atol=1e-9)
            met[world] += 1
        smooth.advance(end)
        for world in others:
            emitted[world] = courses[world].end
        if response == "on":
            ends = np.array([courses[world].end for world in worlds])
            if step % 2:  # in the others the state of worlds that nobody else writes may wait
                smooth.fetch()
            if step % 2 or not alone:
                np.testing.assert_allclose(emitted, ends, atol=1e-9)
    # All but steps in which a sound begins or ends, and 5 in which the old drive fades: exp(-pi 40 kHz/25 t) = SILENT
    assert met.tolist() == [9 if response == "on" else 14, 12, 13]


def test_many_worlds_of_other_levels_have_one_field(small_scene):
    levels = np.linspace(0.4, 1.0, SHARED_FROM)
    scene = small_scene(skin={"solver": "wedges", "accuracy": 0.5})
    worlds = palmfield.Simulation(scene, worlds=SHARED_FROM, keys={"stimulus.drive_amplitude": levels})
    worlds.step(4)
    assert len(np.unique(worlds.steps.host.smooth.serials)) == 1
    for world in (0, 17, SHARED_FROM - 1):
        alone = palmfield.Simulation(scene, keys={"stimulus.drive_amplitude": levels[world]})
        alone.step(4)
        for mine, its in (
            (worlds.forces[world], alone.forces),
            (worlds.sensors[world], alone.data.sensordata),
            (worlds.skin().displacement[world], alone.skin().displacement),
            (worlds.emitted[world], alone.emitted),
        ):
            assert np.abs(mine - its).max() < 5e-6 * np.abs(its).max()  # the field itself errs by 2e-5
