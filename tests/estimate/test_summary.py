"""Numbers that a summary has beyond the result's arrays."""

import numpy as np
import pytest

import palmfield
from palmfield.estimate import error_budget
from palmfield.estimate.summary import (
    array_numbers,
    estimated_budget,
    scene_numbers,
    skin_numbers,
    stimulus_numbers,
)

pytestmark = pytest.mark.usefixtures("kept_operators")

TIMES = np.arange(0.0, 0.05, 5e-4)
MOTION = 2e-6 * np.sin(2 * np.pi * 200.0 * TIMES)
PEAK = np.abs(MOTION).max()  # of samples: the sine's own lies between them


def moved(scene, motion, skin="skin"):
    """Motion of the first vertex alone, and the ARP's course: skin_numbers' last arguments."""
    vertices = len(scene.runtime.model.skins[scene.skins.index(skin)].nodes[0])
    normal = np.zeros((len(TIMES), vertices))
    normal[:, 0] = motion
    return TIMES, normal, 1.0 + np.sin(2 * np.pi * 200.0 * TIMES)


def numbers(scene, loudest, skin="skin"):
    budget = estimated_budget(scene, scene.skins.index(skin), loudest)
    return skin_numbers(scene, skin, loudest, budget, *moved(scene, MOTION, skin))


def test_numbers_of_a_run(small_scene, moment):
    keys = {"array.p0_Pa_m": 2.53, "array.p0_low_Pa_m": 2.0, "array.p0_high_Pa_m": 4.0, "skin.solver": "wedges"}
    scene = palmfield.load(small_scene(), keys=keys)
    scene.step(6)
    loudest = moment(scene)
    result = numbers(scene, loudest)
    assert result["solver"] == "wedges" and result["dofs"] > 1000 and "set by key solver" in result["solver_why"]
    assert result["displacement_error_m"] == pytest.approx(PEAK * result["displacement_error_relative"])
    assert result["peak_displacement_low_m"] < PEAK < result["peak_displacement_high_m"]
    assert result["main_frequency_Hz"] == 200.0 and result["main_line_amplitude_m"] == pytest.approx(2e-6)
    assert stimulus_numbers(scene, [loudest]) == {"stimulus": {"drive_level": pytest.approx(1.0)}}
    array = array_numbers(scene.runtime.model)["array"]
    assert (array["p0_low_Pa_m"], array["p0_high_Pa_m"], array["calibrated"]) == (2.0, 4.0, False)
    whole = scene_numbers(scene, [loudest])
    assert whole["palmfield_device"] == "cpu" and whole["board"] == "ideal"


def test_what_stepped_is_named_with_its_size(small_scene, moment):
    scene = palmfield.load(small_scene(), keys={"skin.solver": "reduced"})
    scene.step(2)
    small = scene.runtime.model.begin[0].value
    assert numbers(scene, moment(scene))["solver"] == f"reduced, {small.order} vectors"
    leaving = palmfield.load(small_scene(), keys={"stimulus.arp_peak_Pa": 2.0, "skin.accuracy": 0.02})
    if leaving.runtime.model.skins[0].choice.name == "reduced":
        leaving.data.qvel[:] = 0.1
        leaving.step(10)
        assert numbers(leaving, moment(leaving))["solver"].endswith("; then wedges")


def test_a_choice_that_refuses_is_told(small_scene, moment, monkeypatch):
    def refuse(*args):
        raise palmfield.SceneError("more vectors than MOST_VECTORS")

    monkeypatch.setattr("palmfield.simulation.small_models.known_load.reduced_stepper", refuse)
    path = small_scene(skin={"element_m": 0.005})
    path.write_text(path.read_text().replace('data="0.015"', 'data="60"'))
    scene = palmfield.load(path)
    assert scene.runtime.model.skins[0].choice.name == "reduced"
    scene.step(2)
    result = numbers(scene, moment(scene))
    assert result["solver"] == "wedges" and "no reduced model reached its accuracy" in result["solver_why"]


def test_a_silent_run_has_no_error(small_scene):
    scene = palmfield.load(small_scene(stimulus={"drive_amplitude": 0}))
    scene.step(2)
    result = skin_numbers(scene, "skin", None, None, *moved(scene, 0.0 * MOTION))
    assert "displacement_error_relative" not in result
    assert result["level_afferent_human_dB_SL"] is None
    assert result["level_hasegawa_2018_why"] == "refused: no sound acts on this skin"
    assert stimulus_numbers(scene, [None]) == {"stimulus": {"drive_level": 0.0}}


def test_an_estimate_that_fails_leaves_its_reason(small_scene, moment, monkeypatch):
    def refuse(*args, **keys):
        raise palmfield.SceneError("no coarser mesh")

    scene = palmfield.load(small_scene())
    scene.step(2)
    monkeypatch.setattr(error_budget, "error_estimate", refuse)
    assert numbers(scene, moment(scene))["displacement_error_missing"] == "no coarser mesh"


def test_each_skin_has_its_own_numbers(small_scene, add_skin, moment):
    scene = palmfield.load(add_skin(small_scene(skin={"radius_m": 0.012}), "0.05 0 0.12"))
    scene.step(4)
    first, second = (numbers(scene, moment(scene), name) for name in scene.skins)
    assert "displacement_error_relative" in first and "displacement_error_relative" in second
