"""A Simulation: its copies, what it says of the present moment, and keys of instances and plugins."""

import copy

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.errors import SceneError
from palmfield.session.duration import step_count
from palmfield.session.loudest_moment import nearest_focus

BAD_AND_NOT_COMPILED = '<keyframe><key qpos="0 0 0 0 0"/></keyframe>'
"""MuJoCo refuses it after the plugins were asked for their sizes, and before they are made."""


def test_a_copy_shows_what_the_simulation_shows_and_goes_on_as_it(small_scene):
    first = palmfield.Simulation(small_scene())
    first.step(5)
    second = first.copy()
    assert np.abs(first.forces).max() > 0.0
    assert np.array_equal(first.forces, second.forces)
    assert np.array_equal(first.data.sensordata, second.data.sensordata)
    for one in (first, second):
        one.step(3)
    assert np.array_equal(first.skin().displacement, second.skin().displacement)
    assert np.array_equal(first.forces, second.forces)


def test_emitted_has_the_phase_that_the_state_has(small_scene):
    sim = palmfield.Simulation(small_scene(array={"response": "on", "resonance_Hz": 40500}))
    sim.step(4)
    amplitudes = sim.runtime.amplitudes
    assert np.abs(amplitudes).max() > 0.01
    assert sim.emitted == pytest.approx(amplitudes, rel=1e-6, abs=1e-9)
    silent = palmfield.Simulation(small_scene(stimulus={"drive_amplitude": 0, "arp_peak_Pa": None}))
    assert not silent.emitted.any()


def test_a_key_of_an_instance_and_the_same_of_its_plugin_are_refused_where_there_is_no_other(small_scene):
    for keys in (
        {"skin.accuracy": 0.3, "palmfield.skin.accuracy": 0.5},
        {"palmfield.skin.accuracy": 0.5, "skin.accuracy": 0.3},
    ):
        with pytest.raises(palmfield.SceneError, match="both set accuracy of instance 'skin'"):
            palmfield.Simulation(small_scene(), keys=keys)


def test_a_start_elsewhere_forgets_what_was_held_at_a_control_tick(small_scene):
    keys = {"stimulus": {"control_rate_Hz": 10, "path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 140}}
    path = small_scene(**keys)
    used, fresh = palmfield.Simulation(path), palmfield.Simulation(path)
    used.data.qpos[0] = 0.01
    used.start_at(0.01)
    used.step(2)
    held = used.runtime.work.emission.held[0]
    used.start_at(0.03)
    fresh.start_at(0.03)
    assert used.runtime.work.emission.held[0] is not held
    assert used.runtime.work.emission.held[0].time_s == 0.03
    assert np.array_equal(used.drive, fresh.drive)
    assert np.array_equal(used.forces, fresh.forces)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_run_of_no_duration_is_refused_before_its_folder_is_made(duration_s, small_scene, tmp_path):
    with pytest.raises(palmfield.SceneError, match=r"duration_s is .*; allowed: seconds > 0"):
        palmfield.run(small_scene(), tmp_path / "out", duration_s=duration_s)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("again", ["file", "spec"])
def test_an_earlier_failure_in_stock_mujoco_is_not_told_of_another_scene(again, small_scene):
    bad = small_scene(skin={"accuracy": -3})
    text = bad.read_text()
    bad.write_text(text.replace("</mujoco>", BAD_AND_NOT_COMPILED + "</mujoco>"))
    with pytest.raises(ValueError, match="keyframe"):
        mujoco.MjModel.from_xml_path(str(bad))
    good = small_scene()
    palmfield.Simulation(good if again == "file" else mujoco.MjSpec.from_file(str(good))).step()


@pytest.mark.parametrize("another", [copy.copy, copy.deepcopy])
def test_pythons_own_copies_go_on_by_themselves(another, small_scene):
    first = palmfield.Simulation(small_scene())
    first.step(3)
    second = another(first)
    assert second.model is first.model and second.data is not first.data and second.name == first.name
    second.step(2)
    assert first.time == pytest.approx(0.003) and second.time == pytest.approx(0.005)
    first.step(2)
    np.testing.assert_array_equal(first.skin().displacement, second.skin().displacement)


@pytest.mark.parametrize("scene", [None, 5, ["scene.xml"]])
@pytest.mark.parametrize("call", [palmfield.Simulation, palmfield.run, palmfield.plan])
def test_what_is_no_scene_is_refused_by_name(call, scene):
    with pytest.raises(palmfield.SceneError) as caught:
        call(scene)
    assert str(caught.value) == f"scene is {scene!r}; allowed: the path of a file, an MjSpec or an MjModel"


@pytest.mark.parametrize("duration_s", ["x", None, [0.1]])
def test_a_duration_that_is_no_number_is_refused_by_name(duration_s, small_scene):
    sim = palmfield.Simulation(small_scene())
    with pytest.raises(palmfield.SceneError) as caught:
        sim.run(duration_s)
    assert str(caught.value) == f"duration_s is {duration_s!r}; allowed: a number of seconds above 0"
    assert sim.time == 0.0


ODD_COUNTS = (-1, 1.5, float("nan"), float("inf"), None, "", "3", [1], True)
ODD_TIMES = (-1.0, float("nan"), float("inf"), None, "", [0.1], True, 1j)


@pytest.mark.parametrize("worlds", [None, 2])
def test_odd_counts_and_times_are_refused(small_scene, worlds):
    sim = palmfield.Simulation(small_scene(), worlds=worlds)
    for count in ODD_COUNTS:
        with pytest.raises(SceneError, match="allowed: a whole number, 0 or more"):
            sim.step(count)
    for time_s in ODD_TIMES:
        with pytest.raises(SceneError, match="allowed: seconds, 0 or more"):
            sim.start_at(time_s)
    sim.step(np.int64(1))
    sim.start_at(np.float32(0.0))


def test_a_duration_is_the_steps_that_come_nearest_to_it():
    assert [step_count(k * 1e-4, 1e-4) for k in range(1, 1000)] == list(range(1, 1000))
    assert step_count(0.0029, 0.0001) == 29 and step_count(1e-6, 0.001) == 1


def test_a_skin_lies_under_the_focus_that_is_nearest_to_a_node():
    nodes = np.column_stack([np.linspace(-0.05, 0.05, 11), np.zeros((11, 2))])
    above_the_middle, at_the_rim = [0.0, 0.0, 0.004], [0.05, 0.0, 0.002]
    for foci in ([above_the_middle, at_the_rim], [at_the_rim, above_the_middle]):
        np.testing.assert_array_equal(nearest_focus(np.array(foci), nodes), at_the_rim)
