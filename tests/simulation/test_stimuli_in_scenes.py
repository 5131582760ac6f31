"""Several foci at once, and paths that slide on a body's surface, inside a scene."""

import numpy as np
import pytest
import trimesh

from palmfield.errors import SceneError
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.stimulus.schedule import frame_at, frames_at

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}


def places_of(sim):
    """Keys of the scene's one stimulus, how it drives the array, and where its points are."""
    model = sim.runtime.model
    return (
        model.stimuli[0].config,
        array_drives(model, model.arrays)[0],
        sim.runtime.posed.focal_points(model.stimuli[0], 0),
    )


def test_several_foci_are_equally_loud_and_stand_out(small_scene):
    foci = np.array([[-0.02, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]])
    text = " ".join(f"{x:g}" for x in foci.ravel())
    sim = load(small_scene(stimulus=STEADY | {"foci_m": text, "focus_m": "0 0 0.12"}))
    stimulus, drive, places = places_of(sim)
    arrays = sim.runtime.model.arrays
    requested = places.at(frame_at(stimulus, 0.0).focus)
    assert requested == pytest.approx(foci + np.array([0.0, 0.0, 0.12]), abs=1e-12)
    loud = np.abs(arrays.pressure64(requested, drive.unit_drive(requested).amplitudes))
    assert loud.min() > 0.98 * loud.max()
    elsewhere = np.array([[0.0, -0.015, 0.12], [0.03, 0.02, 0.12]])
    between = np.abs(arrays.pressure64(elsewhere, drive.unit_drive(requested).amplitudes))
    assert between.max() < 0.5 * loud.min()
    alone = abs(arrays.pressure64(requested[:1], drive.unit_drive(requested[0]).amplitudes)[0])
    assert 0.9 / np.sqrt(3.0) < loud.mean() / alone < 1.0
    sim.step()
    assert sim.data.sensordata[2] != 0.0


@pytest.mark.parametrize("weights", ["1 0.25 0.5", "3 1 0"])
def test_foci_have_the_arp_that_is_asked_of_each(small_scene, weights):
    """By the float64 field at the foci; a focus of weight 0 is none, where what is left is a side lobe's."""
    keys = {"foci_m": "-0.02 0 0 0.02 0 0 0 0.02 0", "foci_arp": weights, "focus_m": "0 0 0.12", "arp_peak_Pa": 5}
    sim = load(small_scene(stimulus=STEADY | keys))
    stimulus, drive, places = places_of(sim)
    point = frame_at(stimulus, 0.0).focus
    arrays, wanted = sim.runtime.model.arrays, np.array([float(x) for x in weights.split()])
    amplitudes = drive.unit_drive_at(places, point).amplitudes
    arp = np.abs(arrays.pressure64(places.at(point), amplitudes)) ** 2 / arrays.impedance
    assert arp[0] == pytest.approx(5.0, rel=1e-6)  # arp_peak_Pa is that of the loudest
    sounding = wanted > 0.0
    np.testing.assert_allclose((arp / arp[0])[sounding], (wanted / wanted[0])[sounding], rtol=0.02)
    assert (arp[~sounding] < 0.3 * arp[sounding].min()).all()
    many = drive.unit_drives(np.array([point, point]), places)
    np.testing.assert_array_equal(many, [amplitudes, amplitudes])


def test_the_level_of_several_foci_is_that_of_the_loudest(small_scene):
    keys = {"foci_m": "-0.02 0 0 0.02 0 0", "focus_m": "0 0 0.12", "arp_peak_Pa": 5}
    sim = load(small_scene(stimulus=STEADY | keys))
    stimulus, drive, places = places_of(sim)
    arrays = sim.runtime.model.arrays
    foci = places.at(frame_at(stimulus, 0.0).focus)
    pressure = arrays.pressure64(foci, drive.unit_drive(foci).amplitudes)
    assert (np.abs(pressure) ** 2).max() / arrays.impedance == pytest.approx(5.0, rel=1e-6)


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
    sim = load(path)
    stimulus, _, places = places_of(sim)
    turn = np.pi * 0.02 / 3.0
    points, _ = frames_at(stimulus, np.linspace(0.0, turn, 401))
    foci = places.along(points)
    assert foci[::50] == pytest.approx(np.array([places.at(point) for point in points[::50]]), abs=1e-12)
    assert np.linalg.norm(foci - [0.0, 0.0, 0.14], axis=1) == pytest.approx(0.02, rel=2e-3)
    assert np.linalg.norm(np.diff(foci, axis=0), axis=1).sum() == pytest.approx(np.pi * 0.02, rel=0.01)
    assert foci[-1] == pytest.approx(foci[0], abs=1e-4)
    assert np.hypot(*foci[:, :2].T) == pytest.approx(0.02 * np.sin(0.5), rel=0.1)
    sim.step()


def test_a_zigzag_about_a_line_on_a_ball_has_both_speeds(small_scene):
    """16 mm at 1.6 m/s along take 10 ms, in which 2 m/s across make five strokes of 4 mm."""
    path = on_a_ball(
        small_scene, path="line", path_width_m=0.016, path_speed_m_s=1.6, path_zigzag_width_m=0.004,
        path_zigzag_speed_m_s=2.0,
    )  # fmt: skip
    sim = load(path)
    stimulus, _, places = places_of(sim)
    times = np.linspace(0.0, 0.01, 401)
    foci = places.along(frames_at(stimulus, times)[0])
    assert np.linalg.norm(foci - [0.0, 0.0, 0.14], axis=1) == pytest.approx(0.02, rel=2e-3)
    speed = np.linalg.norm(np.diff(foci, axis=0), axis=1).sum() / 0.01
    assert speed == pytest.approx(np.hypot(1.6, 2.0), rel=0.01)
    across = np.arcsin(foci[:, 1] / 0.02) * 0.02
    turns = np.flatnonzero(np.diff(np.sign(np.diff(across))))
    assert np.diff(times[turns]) == pytest.approx(0.002, rel=0.1)
    assert abs(foci[-1] - foci[0])[0] == pytest.approx(2.0 * 0.02 * np.sin(0.4), rel=0.01)
    sim.step()


@pytest.mark.parametrize(
    ("stimulus", "words"),
    [
        ({"path": "line", "path_width_m": 0.01, "path_rate_Hz": 5, "focus_m": "0 0 0.08"}, "path_on"),
        ({"path": "sites", "path_sites": "centre nose", "path_speed_m_s": 1, "frame": None}, "no site 'nose'"),
    ],
)
def test_paths_that_miss_the_body_are_named(small_scene, stimulus, words):
    with pytest.raises(SceneError, match=words):
        load(on_a_ball(small_scene, **stimulus))


def test_a_path_on_a_flat_disc_is_refused(small_scene):
    keys = {"path": "line", "path_width_m": 0.01, "path_rate_Hz": 5, "path_on": "skin"}
    with pytest.raises(SceneError, match="flat disc: set path_on to plane"):
        load(small_scene(stimulus=STEADY | keys))


def test_obstacles_are_checked(small_scene):
    for keys, words in (
        ({"obstacles": "pad"}, "obstacles need body_sound|cast shadows"),
        ({"obstacles": "pad", "body_sound": "shadows"}, "bodies other than the body of the skin"),
        ({"obstacles": "nose", "body_sound": "shadows"}, "no body 'nose'"),
    ):
        with pytest.raises(SceneError, match=words):
            load(small_scene(skin=keys))
