"""Skin under what a board emitted, against the scene's own steps and the square law."""

import numpy as np
import pytest

import palmfield
from palmfield.drive.board import Emitted
from palmfield.studies.trial import Tracker, trial
from palmfield.studies.trial.skin_response import skin_response

STILL = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}

MIDDLE = np.array([[0.0, 0.0, 0.12]])


def test_skin_moves_as_in_the_scene_and_with_the_square_of_the_drive(small_scene):
    path = small_scene(stimulus=STILL, skin={"solver": "wedges"}, array={"response": "off"})
    sim = palmfield.load(path, device="cpu")
    drive = sim.drive
    sim.run(0.015)
    own = skin_response(path, [Emitted(0.0, drive)], 0.015, board=None, keys={}, places=MIDDLE)
    skin = sim.skin()
    nearest = np.linalg.norm(skin.rest_position[:, :2], axis=1).argmin()
    assert own.push[-1] == pytest.approx(-skin.normal_displacement[nearest], rel=1e-6)
    assert own.arp[-1] == pytest.approx(skin.arp.max(), rel=1e-5)
    half = skin_response(path, [Emitted(0.0, 0.5 * drive)], 0.015, board=None, keys={}, places=MIDDLE)
    np.testing.assert_allclose(half.push, 0.25 * own.push, rtol=1e-5)
    later = skin_response(path, [Emitted(0.005, drive)], 0.015, board=None, keys={}, places=MIDDLE)
    assert not later.push[:5].any()
    np.testing.assert_allclose(later.push[5:], own.push[:10], rtol=1e-6)


def test_a_small_model_of_the_scenes_own_sound_is_not_taken_for_another(small_scene):
    path = small_scene(skin={"solver": "reduced"}, stimulus={"start_s": 0.0})
    sim = palmfield.load(path, device="cpu", keys={f"stimulus.{key}": value for key, value in STILL.items()})
    beside = sim.drive * np.exp(1j * np.linspace(0.0, 6.0, len(sim.drive)))
    small = skin_response(path, [Emitted(0.0, beside)], 0.01, board=None, keys={}, places=MIDDLE)
    whole = skin_response(path, [Emitted(0.0, beside)], 0.01, board=None, keys={"skin.solver": "wedges"}, places=MIDDLE)
    # By the other sound's own modes; the small model of the scene's sound would be off by all of it
    assert np.abs(small.push - whole.push).max() < 0.06 * whole.push.max()


def test_a_trial_tells_what_the_skin_loses(moving_scene):
    path = moving_scene(skin={"solver": "wedges"})
    at_once = trial(path, tracker=Tracker(0.0, 0.0, ahead_s=0.0), duration_s=0.02, flight=False)
    assert at_once.numbers.push_um == pytest.approx(at_once.numbers.push_ideal_um, rel=1e-9)
    frozen = trial(path, tracker=Tracker(0.0, 0.2, ahead_s=0.0), duration_s=0.06)
    assert 0.0 < frozen.skin.arp[-1] < 0.9 * frozen.skin_ideal.arp[-1]
