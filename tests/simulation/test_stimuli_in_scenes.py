"""Several foci at once, and paths that slide on a body's surface, inside a scene."""

import mujoco
import numpy as np
import pytest
import trimesh

import palmfield
from palmfield.engine.host import raise_errors
from palmfield.errors import SceneError
from palmfield.stimulus.schedule import frame_at, frames_at

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}


def test_several_foci_are_equally_loud_and_stand_out(small_scene):
    foci = np.array([[-0.02, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]])
    text = " ".join(f"{x:g}" for x in foci.ravel())
    scene = palmfield.load(small_scene(stimulus=STEADY | {"foci_m": text, "focus_m": "0 0 0.12"}))
    skin, rig = scene.skin, scene.skin.rig
    asked = skin.to_array(frame_at(rig.stimulus, 0.0).focus)
    assert asked == pytest.approx(foci + np.array([0.0, 0.0, 0.12]), abs=1e-12)
    drive, _ = rig.unit_drive(asked)
    loud = np.abs(rig.reference_emitter.pressure64(asked, drive))
    assert loud.min() > 0.98 * loud.max()
    between = np.abs(rig.reference_emitter.pressure64(np.array([[0.0, -0.015, 0.12], [0.03, 0.02, 0.12]]), drive))
    assert between.max() < 0.5 * loud.min()
    single, _ = rig.unit_drive(asked[0])
    alone = abs(rig.reference_emitter.pressure64(asked[:1], single)[0])
    assert 0.9 / np.sqrt(3.0) < loud.mean() / alone < 1.0
    mujoco.mj_step(scene.model, scene.data)
    raise_errors(scene.data)
    assert scene.data.sensordata[2] != 0.0


def test_the_level_of_several_foci_is_that_of_the_loudest(small_scene):
    keys = {"foci_m": "-0.02 0 0 0.02 0 0", "focus_m": "0 0 0.12", "arp_peak_Pa": 5}
    scene = palmfield.load(small_scene(stimulus=STEADY | keys))
    rig = scene.skin.rig
    foci = scene.skin.to_array(frame_at(rig.stimulus, 0.0).focus)
    pressure = rig.reference_emitter.pressure64(foci, rig.unit_drive(foci)[0])
    assert (np.abs(pressure) ** 2).max() / rig.reference_emitter.impedance == pytest.approx(5.0, rel=1e-6)


def on_a_ball(small_scene, **stimulus):
    """A ball of 40 mm that hangs at 0.12 m with its lowest point at the site `centre`; its z looks down."""
    path = small_scene(
        stimulus=STEADY | {"frame": "centre", "focus_m": "0 0 0", "path_on": "skin"} | stimulus,
        skin={"shape": "mesh", "mesh": "ball.obj", "mesh_unit": "mm", "patch_site": "centre", "radius_m": None,
              "thickness_m": None, "patch_radius_m": 0.01, "element_m": 0.004, "depth_m": 0.004},
    )  # fmt: skip
    ball = trimesh.creation.icosphere(subdivisions=5, radius=20.0)
    ball.apply_translation((0, 0, -20))
    ball.export(path.with_name("ball.obj"))
    return path


def test_a_circle_on_a_ball_keeps_its_length_and_lies_on_it(small_scene):
    """It is drawn by its curvature along the skin, so it closes on a ball about, not exactly, round its middle."""
    path = on_a_ball(small_scene, path="circle", path_diameter_m=0.02, path_speed_m_s=3.0)
    scene = palmfield.load(path)
    skin, rig = scene.skin, scene.skin.rig
    turn = np.pi * 0.02 / 3.0
    points, _ = frames_at(rig.stimulus, np.linspace(0.0, turn, 401))
    foci = np.array([skin.to_array(point) for point in points])
    assert np.linalg.norm(foci - [0.0, 0.0, 0.14], axis=1) == pytest.approx(0.02, rel=2e-3)
    assert np.linalg.norm(np.diff(foci, axis=0), axis=1).sum() == pytest.approx(np.pi * 0.02, rel=0.01)
    assert foci[-1] == pytest.approx(foci[0], abs=1e-4)
    assert np.hypot(*foci[:, :2].T) == pytest.approx(0.02 * np.sin(0.5), rel=0.1)
    mujoco.mj_step(scene.model, scene.data)
    raise_errors(scene.data)


@pytest.mark.parametrize(
    ("stimulus", "words"),
    [
        ({"path": "line", "path_width_m": 0.01, "path_rate_Hz": 5, "focus_m": "0 0 0.08"}, "path_on"),
        ({"path": "sites", "path_sites": "centre nose", "path_speed_m_s": 1, "frame": None}, "no site 'nose'"),
    ],
)
def test_paths_that_miss_the_body_are_named(small_scene, stimulus, words):
    with pytest.raises(SceneError, match=words):
        palmfield.load(on_a_ball(small_scene, **stimulus))


def test_a_path_on_a_flat_disc_is_refused(small_scene):
    keys = {"path": "line", "path_width_m": 0.01, "path_rate_Hz": 5, "path_on": "skin"}
    with pytest.raises(SceneError, match="flat disc: set path_on to plane"):
        palmfield.load(small_scene(stimulus=STEADY | keys))


def test_obstacles_are_checked(small_scene):
    for keys, words in (
        ({"obstacles": "pad"}, "needs|cast shadows"),
        ({"obstacles": "pad", "body_sound": "shadows"}, "other bodies than the skin's own"),
        ({"obstacles": "nose", "body_sound": "shadows"}, "no body 'nose'"),
    ):
        with pytest.raises(SceneError, match=words):
            palmfield.load(small_scene(skin=keys))
