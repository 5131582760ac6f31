"""Ring-up of the transducers and scattered sound, in scenes."""

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield import runner
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.scattering import scatter
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


def test_plain_steps_and_a_run_agree_with_ringing(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "PICTURES", ())
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
        found, scene = arp_over_time(
            small_scene(stimulus=STEADY, array={"response": "off"}, skin={"body_sound": kind}), 3
        )
        arp[kind] = (found[1], scene.data.sensordata[2])
    # A flat pad shades nothing of its lit face, and the loss at a dark back is none
    assert arp["shadows"] == pytest.approx(arp["none"], rel=1e-6)
    # The rim, 20 mm from the middle, sends sound back there. Keller's coefficient of a rigid right-angled edge for
    # normal incidence, seen along the face, is -2/sqrt(3) e^{i pi/4}/sqrt(2 pi k); around the whole rim this makes
    # -2/sqrt(3) e^{ika} times the mean sound at the rim, against 2 p of the face.
    rig, sound = scene.skin.rig, scene.skin.rig.reference_emitter
    drive, _ = rig.unit_drive(rig.reference_focus)
    around = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    rim = rig.reference_focus + 0.02 * np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    edge = sound.pressure64(rim, drive).mean() / sound.pressure64(rig.reference_focus[None], drive)[0]
    k = 2 * np.pi * 40e3 / sound_speed(rig.air)
    back = abs(1 - edge * np.exp(1j * k * 0.02) / np.sqrt(3)) ** 2
    assert back > 1.04
    # Left out: the beam's slope at the rim, sound that passes the rim twice, and 1 % of the boundary elements
    assert arp["scattering"][0] / arp["none"][0] == pytest.approx(back, abs=0.02)
    # Over the face what comes from the rim changes sign every half wavelength, and its mean is small
    assert arp["scattering"][1] == pytest.approx(arp["none"][1], rel=0.01)


def test_the_scenes_scattering_is_the_solution_for_its_body(small_scene):
    """The scene's poses and mesh against a solution set up by hand in the array's frame."""
    path = small_scene(stimulus=STEADY, array={"response": "off"}, skin={"body_sound": "scattering", "radius_m": 0.008})
    found, scene = arp_over_time(path, 2)
    rig = scene.skin.rig
    vertices, faces = rig.posed(rig.reference_pose).boundary_mesh
    # The pad hangs upside down at 0.12 m: half a turn about y
    vertices = vertices * [-1, 1, -1] + [0, 0, 0.12]
    drive, _ = rig.unit_drive(rig.reference_focus)
    k = 2 * np.pi * 40e3 / sound_speed(rig.air)
    solved = scatter(vertices, faces, lambda x: rig.reference_emitter.pressure64(x, drive), k, device="cpu")
    nearest = np.linalg.norm(solved.centroids - [0, 0, 0.12], axis=1).argmin()
    there = solved.pressure[nearest] + solved.gradient[nearest] @ ([0, 0, 0.12] - solved.centroids[nearest])
    near = np.abs(there) ** 2 - (np.abs(solved.gradient[nearest]) ** 2).sum() / k**2
    load = near / (4 * density(rig.air) * sound_speed(rig.air) ** 2)
    assert found[1] == pytest.approx(load, rel=1e-3)
