"""Where a tracker stands, against placements that are known and the scatter of many repeats."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.config import MotionConfig
from palmfield.errors import SceneError
from palmfield.motion.alignment import ABOVE_M, Touches, align, read_alignment, read_touches, write_alignment
from palmfield.motion.source import motion_of
from palmfield.motion.tracking import stream_of, write_stream
from palmfield.transforms import Transform

TURN = Rotation.from_euler("xyz", [80.0, -25.0, 140.0], degrees=True)
SHIFT = np.array([0.3, -0.12, 0.45])
CORNERS = np.array([[-0.08, -0.08, 0.0], [0.08, -0.08, 0.0], [0.08, 0.08, 0.0], [-0.08, 0.08, 0.0], [0.0, 0.0, 0.0]])


def seen(places):
    """As a tracker that stands there has them."""
    return TURN.inv().apply(places - SHIFT)


@pytest.mark.parametrize(
    ("change", "said"),
    [([[0, 1, 0], [1, 0, 0], [0, 0, 1]], "x and y swapped"), ([[1, 0, 0], [0, 0, 1], [0, 1, 0]], "y and z swapped"),
     ([[1, 0, 0], [0, 1, 0], [0, 0, -1]], "z reversed"), ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "x reversed")],
)  # fmt: skip
@pytest.mark.parametrize("height_m", [0.03, 0.15])
def test_swapped_and_reversed_axes_are_named(change, said, height_m):
    places = np.vstack([CORNERS, [0.02, -0.03, height_m]])
    noise = np.random.default_rng(1).normal(0.0, 5e-4, places.shape)
    with pytest.raises(SceneError, match=f"with {said}: the axes of the tracker are left-handed"):
        align(Touches(places, (places - SHIFT + noise) @ np.array(change)))
    align(Touches(places, seen(places) + noise))  # right-handed ones, noise and all


def test_touches_in_one_plane_leave_the_hand_of_the_axes_open():
    mirror = np.diag([1.0, 1.0, -1.0])
    flat = align(Touches(CORNERS, (CORNERS - SHIFT) @ mirror))  # left-handed, and nothing is left
    assert flat.rms_m < 1e-12 and "touch one more point, 20 mm or more away from it" in str(flat)
    whole = np.vstack([CORNERS, [0.0, 0.0, 0.03]])
    assert "one plane" not in str(align(Touches(whole, seen(whole))))


@pytest.mark.parametrize("count", [3, 5])
def test_a_tracker_is_placed_exactly_by_exact_touches(count, tmp_path):
    made = align(Touches(CORNERS[:count], seen(CORNERS[:count])))
    write_alignment(tmp_path / "a.json", made)
    position, rotation = read_alignment(tmp_path / "a.json").transform
    np.testing.assert_allclose(position, SHIFT, atol=1e-12)
    np.testing.assert_allclose(rotation, TURN.as_matrix(), atol=1e-12)
    assert made.rms_m < 1e-12


def test_what_is_said_of_the_error_is_what_repeats_scatter_by():
    """Touches 2 mm off by each axis, 400 times over: place 0.2 m above, and the least known turn."""
    random = np.random.default_rng(0)
    above = np.array([0.0, 0.0, ABOVE_M])
    places, turns, said, touches = [], [], [], []
    for _ in range(400):
        made = align(Touches(CORNERS, seen(CORNERS) + random.normal(0.0, 2e-3, CORNERS.shape)))
        frame = made.transform
        places.append(frame.points(seen(above[None])[0]))
        turns.append((Rotation.from_matrix(frame.rotation) * TURN.inv()).as_rotvec())
        said.append((made.sd_m, made.turn_sd_rad))
        touches.append(made.touch_sd_m)
    said_m, said_rad = np.sqrt(np.mean(np.square(said), axis=0))
    scatter = np.sqrt((np.var(places, axis=0)).sum())
    assert said_m == pytest.approx(scatter, rel=0.1)
    assert said_rad == pytest.approx(np.std(turns, axis=0).max(), rel=0.1)
    assert np.sqrt(np.mean(np.square(touches))) == pytest.approx(2e-3, rel=0.05)


@pytest.mark.parametrize(
    ("touches", "told"),
    [
        (Touches(CORNERS[:2], seen(CORNERS[:2])), "2 points were touched; needed: 3 or more"),
        (Touches(CORNERS[[0, 4, 2]], seen(CORNERS[[0, 4, 2]])), "of a line"),
        (Touches(CORNERS, 1e3 * seen(CORNERS)), "check their order and the unit of the tracker"),
        (Touches(CORNERS, seen(CORNERS[[1, 0, 2, 3, 4]])), "mm from their positions"),
        (Touches(CORNERS[:3], np.zeros((3, 3))), "of the tracker lie within 0 mm of a line"),
    ],
)
def test_touches_that_tell_nothing_are_refused(touches, told):
    with pytest.raises(SceneError) as error:
        align(touches)
    assert told in str(error.value)


def test_files_are_read_or_refused(tmp_path):
    rows = "\n".join(",".join(map(repr, row)) for row in np.hstack([CORNERS, seen(CORNERS)]).tolist())
    head = "array_x_m,array_y_m,array_z_m,tracker_x_m,tracker_y_m,tracker_z_m\n"
    (tmp_path / "t.csv").write_text(head + rows)
    np.testing.assert_allclose(read_touches(tmp_path / "t.csv").tracker, seen(CORNERS))
    (tmp_path / "t.csv").write_text(head.replace("tracker_z_m", "tracker_w_m") + rows)
    with pytest.raises(SceneError, match="column 'tracker_z_m' is missing"):
        read_touches(tmp_path / "t.csv")
    file = tmp_path / "a.json"
    write_alignment(file, align(Touches(CORNERS, seen(CORNERS))))
    value = json.loads(file.read_text())
    for change, told in (({"quaternion": [1, 1, 0, 0]}, "length 1.41"), ({"version": 2}, "version"), ({"x": 1}, "x")):
        file.write_text(json.dumps(value | change))
        with pytest.raises(SceneError, match=told):
            read_alignment(file)


def test_a_scene_takes_an_alignment(median, swing, tmp_path):
    """A hand over an array that stands somewhere in the world, seen by a tracker that stands somewhere to the array."""
    array = Transform(np.array([0.1, 0.2, -0.3]), Rotation.from_euler("zx", [30.0, 10.0], degrees=True).as_matrix())
    times = np.arange(0.0, 0.5, 1 / 30)
    stream = stream_of(median, swing, times)
    in_array = array.inverse_points(stream.positions)
    told = type(stream)(times, seen(in_array.reshape(-1, 3)).reshape(in_array.shape), *list(vars(stream).values())[2:])
    write_stream(tmp_path / "seen.npz", told)
    write_alignment(tmp_path / "a.json", align(Touches(CORNERS, seen(CORNERS))))
    files = {"tracking": str(tmp_path / "seen.npz"), "tracking_alignment": str(tmp_path / "a.json")}
    motion = motion_of(MotionConfig.model_validate({"hand": "open_men_p50", **files}), array)
    for time_s in times[::4]:
        found, meant = motion.at(time_s), swing(time_s)
        np.testing.assert_allclose(found.position, meant.position, atol=0.2e-3)
        turn = Rotation.from_quat(found.quaternion, scalar_first=True)
        assert (turn * Rotation.from_quat(meant.quaternion, scalar_first=True).inv()).magnitude() < 1e-3
    with pytest.raises(ValueError, match="both place the tracker"):
        MotionConfig.model_validate({"hand": "open_men_p50", "tracking_up": "z", **files})
