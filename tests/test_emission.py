"""Ring-up of the transducers and flight time, in scenes and by themselves."""

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.drive.response import Pole, envelope_response, pole_step
from palmfield.emission import asked
from palmfield.errors import SceneError

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}


def arp_over_time(path, steps):
    scene = palmfield.load(path)
    found = []
    for _ in range(steps):
        mujoco.mj_step(scene.model, scene.data)
        found.append(scene.data.sensordata[5])
    return np.array(found), scene


def test_a_step_rings_up_with_the_pole(small_scene):
    slow = {"response": "on", "quality": 200}
    rung, scene = arp_over_time(small_scene(stimulus=STEADY, array=slow), 8)
    steady, _ = arp_over_time(small_scene(stimulus=STEADY, array={"response": "off"}), 2)
    # The sensor after step n shows the time n - 1 steps.
    time = 1e-3 * np.arange(8)
    damping = np.pi * 40e3 / 200
    np.testing.assert_allclose(rung, steady[0] * (1 - np.exp(-damping * time)) ** 2, rtol=1e-6, atol=1e-9)
    assert scene.skin.rig.response.on


def test_sound_dies_away_after_the_stop(small_scene):
    found, _ = arp_over_time(
        small_scene(stimulus=STEADY | {"stop_s": 0.0042}, array={"response": "on", "quality": 200}), 12
    )
    damping = np.pi * 40e3 / 200
    assert found[4] > 0
    np.testing.assert_allclose(found[7:] / found[6:-1], np.exp(-2 * damping * 1e-3), rtol=1e-6)


def test_am_is_filtered_as_the_pole_says(small_scene):
    scene = palmfield.load(small_scene(array={"response": "on"}))
    rig = scene.skin.rig
    emitter, pole = rig.reference_emitter, rig.response.pole
    step, emitted = 2e-5, np.zeros(len(rig.array), complex)
    level = []
    for k in range(2000):
        first, last = (
            asked(rig.stimulus, emitter, np.zeros(len(rig.array)), t, np.asarray) for t in (k * step, (k + 1) * step)
        )
        emitted = pole_step(emitted, first, last, pole, step)
        level.append(abs(emitted[0]))
    last_turn = np.array(level[-250:])
    response = envelope_response(200.0, Pole(40e3, 25.0))[..., 0]
    time = step * np.arange(1751, 2001)
    wanted = 0.5 + 0.5 * np.imag(np.conj(response) * np.exp(2j * np.pi * 200 * time))
    np.testing.assert_allclose(last_turn, wanted, atol=2e-4)


def test_auto_keeps_what_matters(small_scene):
    def heard(**changes):
        return palmfield.load(small_scene(**changes)).skin.rig.response

    assert heard().on
    assert not heard(stimulus={"am_frequency_Hz": 5}).on
    assert not heard(stimulus=STEADY).on
    assert not heard(array={"quality": 2}).on
    assert heard(stimulus={"am_frequency_Hz": 50}, skin={"accuracy": 0.002}).on
    assert not heard(array={"response": "off"}).on


def test_leaving_it_out_costs_no_more_than_the_bound(small_scene):
    rig = palmfield.load(small_scene()).skin.rig
    response = envelope_response(200.0, rig.response.pole)[0]
    delay = 1 / rig.response.pole.damping[0]
    actual = abs(1 - response * np.exp(-2j * np.pi * 200.0 * delay))
    assert 0.5 * rig.response.ring_bound < actual <= rig.response.ring_bound


def test_far_transducers_play_what_was_asked_earlier(small_scene):
    circle = STEADY | {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 100}
    scene = palmfield.load(small_scene(stimulus=circle, array={"response": "on"}))
    rig = scene.skin.rig
    delays = rig.response.delays_s
    far = np.linalg.norm(rig.array.positions - rig.reference_focus, axis=1)
    assert delays[far.argmax()] > 0 > delays[far.argmin()]
    assert np.abs(delays - (far - 0.5 * (far.max() + far.min())) / 343.2).max() < 1.1e-5
    now = asked(rig.stimulus, rig.reference_emitter, delays, 0.005, np.asarray)
    e = int(far.argmax())
    earlier = asked(rig.stimulus, rig.reference_emitter, np.zeros(256), 0.005 - delays[e], np.asarray)
    assert now[e] == pytest.approx(earlier[e], abs=1e-12)


def test_plain_steps_and_a_run_agree_with_ringing(small_scene, tmp_path):
    path = small_scene(array={"response": "on"})
    scene = palmfield.load(path)
    palmfield.run(scene, tmp_path / "out", duration_s=0.01, progress=False)
    other = palmfield.load(path)
    for _ in range(10):
        mujoco.mj_step(other.model, other.data)
    np.testing.assert_array_equal(scene.data.sensordata, other.data.sensordata)
    # The force is the step's mean: between its ends, where the level rises.
    assert np.isfinite(scene.data.sensordata).all()


def test_scattering_wants_one_focus_and_one_pole(small_scene):
    circle = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 50}
    with pytest.raises(SceneError, match="'scattering'; allowed: with path 'point'"):
        palmfield.load(small_scene(stimulus=circle, skin={"body_sound": "scattering"}))
    with pytest.raises(SceneError, match="arp_law 'default'"):
        palmfield.load(small_scene(skin={"body_sound": "scattering", "arp_law": "alpha"}))


def test_shadows_and_scattering_on_a_flat_pad(small_scene):
    arp = {}
    for kind in ("none", "shadows", "scattering"):
        found, scene = arp_over_time(small_scene(stimulus=STEADY, skin={"body_sound": kind}), 3)
        arp[kind] = (found[1], scene.data.sensordata[2])
    # A flat pad shades nothing of its lit face; its edge scatters some sound back.
    assert arp["shadows"][0] == pytest.approx(arp["none"][0], rel=1e-6)
    assert arp["shadows"][1] == pytest.approx(arp["none"][1], rel=0.01)
    assert arp["scattering"][0] == pytest.approx(arp["none"][0], rel=0.15)
    assert arp["scattering"][0] != arp["none"][0]
    assert arp["scattering"][1] == pytest.approx(arp["none"][1], rel=0.15)
