"""Analytic accelerations of a smooth motion and of the bones, against differences of the poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate, bone_poses
from palmfield.hand.preset import load_preset
from palmfield.motion.keyframes import keyframes
from palmfield.motion.rates import FrameRates
from palmfield.transforms import Transform

HAND = articulate(load_preset("open_men_p50"))
TIMES = np.array([0.0, 0.3, 0.7, 1.0, 1.5])
POSES = [
    "relaxed",
    {"index_mcp_flexion": 40.0, "wrist_flexion": 30.0, "wrist_deviation": 10.0},
    "splay",
    {"thumb_cmc_flexion": 5.0, "thumb_cmc_abduction": 20.0, "index_pip_flexion": 50.0},
    "relaxed",
]
STEP_s = 2e-4


@pytest.fixture(scope="module")
def curve():
    rng = np.random.default_rng(0)
    turns = Rotation.random(5, random_state=rng).as_quat(scalar_first=True)
    return keyframes(HAND, TIMES, rng.normal(0.0, 0.1, (5, 3)), turns, POSES, smooth=True)


def placed(curve, time_s, bone, point):
    """Position in the world of a point of a bone, given at rest, and the rotation of the bone."""
    pose = curve(time_s)
    positions, rotations = bone_poses(HAND, pose.angles_deg)
    turn = Rotation.from_quat(pose.quaternion, scalar_first=True).as_matrix()
    at = positions[bone] + rotations[bone] @ (point - HAND.bones[bone].origin)
    return pose.position + turn @ at, turn @ rotations[bone]


@pytest.mark.parametrize("time_s", [0.13, 0.45, 0.9, 1.2])
@pytest.mark.parametrize("name", ["forearm", "hand", "index_middle", "thumb_metacarpal", "index_distal"])
def test_points_of_bones_accelerate_as_their_positions_do(curve, time_s, name):
    bone = HAND.bone(name)
    point = HAND.bones[bone].origin + np.array([0.01, 0.02, -0.005])
    before, (now, turn), after = (placed(curve, time_s + shift, bone, point) for shift in (-STEP_s, 0.0, STEP_s))
    expected = turn.T @ (after[0] - 2.0 * now + before[0]) / STEP_s**2
    found = curve.rates(time_s).bones(HAND)[bone].at(point)
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_a_frame_fixed_in_another_has_the_same_points(curve):
    frame = curve.rates(0.45).frame
    inner = Transform(np.array([0.02, -0.01, 0.05]), Rotation.from_rotvec([0.3, 0.7, -0.2]).as_matrix())
    point = np.array([0.01, 0.03, -0.02])
    assert inner.rotation @ frame.fixed(inner).at(point) == pytest.approx(frame.at(inner.points(point)))


def test_accelerations_are_continuous_and_end_at_rest(curve):
    for time in TIMES:
        before, after = (curve.rates(time + shift).bones(HAND) for shift in (-1e-9, 1e-9))
        for one, other in zip(before, after, strict=True):
            assert one.numbers() == pytest.approx(other.numbers(), abs=1e-5)
    for time in (-0.1, TIMES[0], TIMES[-1], 2.0):
        assert all(not bone.numbers().any() for bone in curve.rates(time).bones(HAND))


def test_from_rest_to_rest_the_jerk_is_least():
    """Flash & Hogan (1985): x = 10 s^3 - 15 s^4 + 6 s^5, for the place, the angles and the angle of the rotation."""
    turn = Rotation.from_euler("z", [[0], [40]], degrees=True).as_quat(scalar_first=True)
    curve = keyframes(HAND, [0.0, 0.5], [[0, 0, 0.2], [0.08, 0, 0.2]], turn, ["flat", {"index_pip_flexion": 60}], True)
    start = curve(0.0).angles_deg["index_pip_flexion"]
    for s in np.linspace(0.0, 1.0, 11):
        share, pose = 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5, curve(0.5 * s)
        assert pose.position[0] == pytest.approx(0.08 * share, abs=1e-12)
        assert pose.angles_deg["index_pip_flexion"] == pytest.approx(start + (60 - start) * share)
        turned = Rotation.from_quat(pose.quaternion, scalar_first=True).magnitude()
        assert np.rad2deg(turned) == pytest.approx(40.0 * share, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_smooth_angles_stay_between_their_keys_too(seed):
    rng = np.random.default_rng(seed)
    times, angles = np.cumsum(rng.uniform(0.05, 1.0, 8)), rng.uniform(0.0, 100.0, 8)
    poses = [{"index_pip_flexion": float(angle)} for angle in angles]
    curve = keyframes(HAND, times, np.zeros((8, 3)), [[1, 0, 0, 0]] * 8, poses, smooth=True)
    for n in range(7):
        between = [curve(t).angles_deg["index_pip_flexion"] for t in np.linspace(times[n], times[n + 1], 40)]
        assert min(angles[n : n + 2]) - 1e-9 <= min(between) and max(between) <= max(angles[n : n + 2]) + 1e-9


def test_a_constant_velocity_has_no_acceleration_in_any_fixed_frame():
    straight = FrameRates.at_rest()
    assert not straight.hinge(np.array([0.0, 0.0, 1.0]), (0.5, 0.0, 0.0), np.array([0.1, 0.2, 0.3])).numbers().any()
    assert straight.at(np.array([0.1, 0.2, 0.3])) == pytest.approx(0.0, abs=0.0)


def test_smooth_applies_to_keyframes_only():
    from palmfield.config import MotionConfig
    from palmfield.config.base import parse

    with pytest.raises(SceneError, match="interpolation 'smooth' applies to keyframes only: remove it"):
        parse(MotionConfig, {"trajectory": "wave.csv", "interpolation": "smooth"}, "plugin 'palmfield.motion'")
