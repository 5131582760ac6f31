from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate, checked_angles
from palmfield.hand.poses import named_pose
from palmfield.hand.preset import load_preset
from palmfield.motion.keyframes import keyframes

HAND = articulate(load_preset("open_men_p50"))
ANGLES_deg = st.floats(0.0, 100.0).map(lambda angle: round(angle, 6))
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def turned(pose):
    return Rotation.from_quat(pose.quaternion, scalar_first=True)


@settings(max_examples=20, deadline=None)
@given(angles=st.lists(ANGLES_deg, min_size=2, max_size=6), scale=st.floats(0.01, 10.0))
def test_angles_and_places_pass_through_their_keys_and_stay_between(angles, scale):
    times = scale * np.cumsum(np.linspace(1.0, 2.0, len(angles)))
    places = np.array([[0.01 * angle, -0.02 * angle, 0.2] for angle in angles])
    poses = [{"index_pip_flexion": angle} for angle in angles]
    curve = keyframes(HAND, times, places, [IDENTITY] * len(angles), poses)
    for time, angle, place in zip(times, angles, places, strict=True):
        assert curve(time).angles_deg["index_pip_flexion"] == pytest.approx(angle, abs=1e-9)
        assert curve(time).position == pytest.approx(place, abs=1e-12)
    for n in range(len(angles) - 1):
        between = [curve(t) for t in np.linspace(times[n], times[n + 1], 20)]
        low, high = min(angles[n : n + 2]), max(angles[n : n + 2])
        assert all(low - 1e-9 <= pose.angles_deg["index_pip_flexion"] <= high + 1e-9 for pose in between)
        assert all(0.01 * low - 1e-9 <= pose.position[0] <= 0.01 * high + 1e-9 for pose in between)


@pytest.mark.parametrize("seed", range(4))
def test_orientation_passes_through_its_keys_without_jumps_of_speed(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 1.0, 6))
    keys = Rotation.random(6, random_state=rng)
    # Lengths and signs of quaternions must not matter.
    unscaled = keys.as_quat(scalar_first=True) * rng.uniform(-2.0, 2.0, (6, 1))
    curve = keyframes(HAND, times, np.zeros((6, 3)), unscaled, [{}] * 6)
    step = 1e-5

    def speed(time):
        return (turned(curve(time + step)) * turned(curve(time)).inv()).as_rotvec() / step

    for time, key in zip(times, keys, strict=True):
        assert (turned(curve(time)) * key.inv()).magnitude() < 1e-9
        assert speed(time - step) == pytest.approx(speed(time), abs=0.02)
    along = [turned(curve(t)) for t in np.linspace(times[0], times[-1], 601)]
    turns = [(b * a.inv()).magnitude() for a, b in pairwise(along)]
    assert max(turns) < 20.0 * (times[-1] - times[0]) / 600


def test_turn_about_one_axis_is_the_monotone_cubic_of_its_angle():
    times, angles = np.array([0.0, 0.4, 1.5, 2.0, 2.3]), np.array([0.0, 0.9, 1.1, 0.4, 0.4])
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    keys = Rotation.from_rotvec(angles[:, None] * axis).as_quat(scalar_first=True)
    curve = keyframes(HAND, times, np.zeros((5, 3)), keys, [{}] * 5)
    slopes = PchipInterpolator(times, angles).derivative()(times)
    slopes[[0, -1]] = 0.0
    expected = CubicHermiteSpline(times, angles, slopes)
    for time in np.linspace(0.0, 2.3, 40):
        assert turned(curve(time)).as_rotvec() == pytest.approx(expected(time) * axis, abs=1e-9)


@pytest.mark.smoke
def test_orientation_does_not_depend_on_the_frame():
    rng = np.random.default_rng(5)
    keys, frame = Rotation.random(4, random_state=rng), Rotation.random(random_state=rng)
    times = [0.0, 0.5, 0.9, 2.0]
    curves = [
        keyframes(HAND, times, np.zeros((4, 3)), q.as_quat(scalar_first=True), [{}] * 4) for q in (keys, frame * keys)
    ]
    for time in np.linspace(0.0, 2.0, 15):
        plain, other = (turned(curve(time)) for curve in curves)
        assert (other * (frame * plain).inv()).magnitude() < 1e-9


def test_equal_keys_are_a_rest_and_the_curve_stands_still_outside():
    keys = Rotation.from_euler("x", [[0.0], [40.0], [40.0], [70.0]], degrees=True).as_quat(scalar_first=True)
    places = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0, 0], [0.3, 0, 0]])
    curve = keyframes(HAND, [1.0, 2.0, 3.0, 4.0], places, keys, ["flat", "relaxed", "relaxed", "splay"])
    assert curve.span_s == (1.0, 4.0)
    for first, second in ((0.0, 1.0), (2.0, 2.4), (2.7, 3.0), (4.0, 9.0)):
        a, b = curve(first), curve(second)
        assert a.position == pytest.approx(b.position, abs=1e-12)
        assert (turned(a) * turned(b).inv()).magnitude() < 1e-9
        assert a.angles_deg == pytest.approx(b.angles_deg, abs=1e-9)
    # At rest at the ends: after a thousandth of the interval it has moved by the square of that.
    assert curve(1.001).position[0] < 0.1 * 4e-6


def test_named_poses_are_those_of_the_hand():
    curve = keyframes(HAND, [0.0, 1.0], np.zeros((2, 3)), [IDENTITY] * 2, ["splay", {"wrist_flexion": 9.0}])
    assert curve(0.0).angles_deg == pytest.approx(named_pose(HAND, "splay"))
    assert list(curve(1.0).angles_deg.values()) == pytest.approx(checked_angles(HAND, {"wrist_flexion": 9.0}).tolist())


@pytest.mark.parametrize(
    ("times", "places", "quaternions", "poses", "words"),
    [
        ([0.0], np.zeros((1, 3)), [IDENTITY], [{}], "two or more that rise"),
        ([0.0, 0.0], np.zeros((2, 3)), [IDENTITY] * 2, [{}] * 2, "two or more that rise"),
        ([0.0, np.nan], np.zeros((2, 3)), [IDENTITY] * 2, [{}] * 2, "two or more that rise"),
        ([0.0, 1.0], np.zeros((2, 3)), [IDENTITY] * 2, [{}], "1 poses for 2 times"),
        ([0.0, 1.0], np.zeros((3, 3)), [IDENTITY] * 2, [{}] * 2, r"positions has shape \(3, 3\); give shape \(2, 3\)"),
        ([0.0, 1.0], np.full((2, 3), np.inf), [IDENTITY] * 2, [{}] * 2, "positions is .*finite"),
        ([0.0, 1.0], np.zeros((2, 3)), [IDENTITY, (0, 0, 0, 0)], [{}] * 2, "quaternions has length 0"),
        ([0.0, 1.0], np.zeros((2, 3)), [IDENTITY] * 2, [{}, "fist"], "at 1 s: hand pose 'fist' is unknown"),
        ([0.0, 1.0], np.zeros((2, 3)), [IDENTITY] * 2, [{}, {"wrist_flexion": 80.0}], "at 1 s: .*80 degrees; use -70"),
    ],
)
def test_wrong_keyframes_are_refused(times, places, quaternions, poses, words):
    with pytest.raises(SceneError, match=words):
        keyframes(HAND, times, places, quaternions, poses)
