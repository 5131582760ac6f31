import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.motion.pose import HandPose, checked_pose


def test_numbers_become_arrays_and_quaternions_unit(median):
    pose = checked_pose(HandPose([0, 1, 2], [0, 0, 3, 4], {"wrist_flexion": 5}), "here", median)
    assert pose.position.dtype == np.float64
    assert pose.quaternion.tolist() == pytest.approx([0.0, 0.0, 0.6, 0.8])
    assert pose.angles_deg == {"wrist_flexion": 5.0}


@pytest.mark.parametrize(
    ("position", "quaternion", "angles", "words"),
    [
        ([0, 0], [1, 0, 0, 0], {}, r"here: position has shape \(2,\); give shape \(3,\)"),
        ([0, 0, np.nan], [1, 0, 0, 0], {}, "here: position is .*nan.*; give finite numbers"),
        ("abc", [1, 0, 0, 0], {}, "here: position is 'abc'; give numbers"),
        ([0, 0, 0], [0, 0, 0, 0], {}, "here: quaternion has length 0; give"),
        ([0, 0, 0], [1, 0, 0], {}, "here: quaternion has shape"),
        ([0, 0, 0], [1, 0, 0, 0], [3.0], "here: angles_deg is .*give angles .* by name"),
        ([0, 0, 0], [1, 0, 0, 0], {"wrist_flexion": np.inf}, "here: angles_deg is .*inf"),
        ([0, 0, 0], [1, 0, 0, 0], {"elbow": 3.0}, "here: .*'elbow' is unknown"),
        ([0, 0, 0], [1, 0, 0, 0], {"wrist_flexion": 80.0}, "here: .*80 degrees; use -70 to 75"),
    ],
)
def test_wrong_poses_are_refused(median, position, quaternion, angles, words):
    with pytest.raises(SceneError, match=words):
        checked_pose(HandPose(position, quaternion, angles), "here", median)
