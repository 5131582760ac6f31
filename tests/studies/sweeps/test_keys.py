"""Keys of a sweep held against a scene: before anything is computed, what can't be is refused."""

import numpy as np
import pytest

import palmfield
from palmfield.errors import SceneError
from palmfield.studies.sweeps.design import grid
from palmfield.studies.sweeps.keys import scene_keys

FREQUENCY = "stimulus.am_frequency_Hz"


def test_a_number_of_a_vector_is_swept_alone(small_scene):
    design = grid({"stimulus.focus_m[0]": [0.0, 0.01], "stimulus.focus_m[1]": [0.0, 0.02]})
    keys = scene_keys(small_scene(), design, {})
    assert keys.of_point(design.point(3)) == {"stimulus.focus_m": (0.01, 0.02, 0.12)}
    higher = scene_keys(small_scene(), design, {"stimulus.focus_m": (0.0, 0.0, 0.15)})
    assert higher.of_point(design.point(3)) == {"stimulus.focus_m": (0.01, 0.02, 0.15)}


def test_a_key_that_the_scene_leaves_out_starts_from_its_default(small_scene):
    design = grid({"stimulus.focus_m[2]": [0.1, 0.3]})
    keys = scene_keys(small_scene(stimulus={"focus_m": None}), design, {})
    assert keys.of_point(design.point(1)) == {"stimulus.focus_m": (0.0, 0.0, 0.3)}


def test_a_key_is_taken_out(small_scene):
    circle = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 70}
    design, fixed = grid({"stimulus.path_speed_m_s": [1.0, 2.0]}), {"stimulus.path_rate_Hz": None}
    scene = small_scene(stimulus=circle)
    keys = scene_keys(scene, design, fixed).of_point(design.point(1))
    assert palmfield.Simulation(scene, keys=keys).runtime.spec.stimuli[0].config.path_speed_m_s == 2.0


def test_a_plugins_key_is_of_all_its_instances_and_stimuli_share_a_model(small_scene):
    design = grid({f"palmfield.{FREQUENCY}": [100.0, 200.0], "skin.thickness_m": [0.006, 0.008]})
    keys = scene_keys(small_scene(), design, {})
    assert keys.of_point(design.point(0)) == {FREQUENCY: 100.0, "skin.thickness_m": 0.006}
    models = [keys.of_model(design.point(number)) for number in range(4)]
    assert models[0] == models[2] != models[1] == models[3]


@pytest.mark.parametrize(
    ("values", "fixed", "said"),
    [
        ({"nose.x": [1, 2]}, {}, "'nose.x' belongs to no instance or plugin of this scene; it has: array, driver"),
        ({"stimulus.nose": [1, 2]}, {}, "unknown key 'nose'; allowed: arrays, focus_m"),
        ({FREQUENCY: [100, 200]}, {"skin.nose": 1}, "unknown key 'nose'"),
        ({FREQUENCY: [100, "loud"]}, {}, "value 'loud'; allowed: finite number > 0"),
        ({FREQUENCY: [100, 200]}, {"stimulus.am_depth": 2}, "value '2'; allowed: finite number >= 0 and <= 1"),
        ({FREQUENCY: [1, 2], f"palmfield.{FREQUENCY}": [1, 2]}, {}, f"both set {FREQUENCY}; give one of them"),
        ({FREQUENCY: [1, 2]}, {FREQUENCY: 3}, "both set"),
        ({"stimulus.focus_m[0]": [0.0, 0.1], "stimulus.focus_m": [(0, 0, 1), (0, 0, 2)]}, {}, "both set"),
        ({"stimulus.focus_m": [(0, 0, 1), (0, 0, 2)]}, {"stimulus.focus_m[0]": 0.1}, "both set"),
        ({"stimulus.focus_m[3]": [0.0, 0.1]}, {}, "has 3 numbers; allowed: 0 to 2"),
        ({"stimulus.path[0]": [0.0, 0.1]}, {}, "allowed: numbers in a vector"),
        ({"stimulus.focus_m": [(0.0, 0.1)]}, {}, "value '0.0 0.1'; allowed: three finite numbers"),
    ],
    ids=str,
)
def test_keys_that_are_refused(values, fixed, said, small_scene):
    with pytest.raises(SceneError, match=said.replace("[", r"\[")):
        scene_keys(small_scene(), grid(values), fixed)


def test_files_that_a_sweep_reads_are_known(small_scene):
    design = grid({"skin.mesh": ["a.obj", "b.obj"], "stimulus.am_depth": np.array([0.5, 1.0])})
    assert scene_keys(small_scene(), design, {}).files(design) == ["a.obj", "b.obj"]
