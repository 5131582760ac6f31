"""Frames and rotations against SciPy's, which share nothing with them."""

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.transforms import Transform, quaternion, relative, rotation_matrix

TURN = Rotation.from_rotvec([0.3, -1.1, 0.7])
OTHER = Rotation.from_rotvec([-2.0, 0.4, 0.9])
SHIFT, AWAY = np.array([0.1, -0.2, 0.3]), np.array([-0.5, 0.7, 0.2])
POINTS = np.random.default_rng(0).normal(size=(5, 3))


def test_a_frame_carries_points_and_directions_out_and_back() -> None:
    frame = Transform(SHIFT, TURN.as_matrix())
    there, turned = TURN.apply(POINTS) + SHIFT, TURN.apply(POINTS)
    np.testing.assert_allclose(frame.points(POINTS), there, atol=1e-14)
    np.testing.assert_allclose(frame.vectors(POINTS), turned, atol=1e-14)
    for found, expected in zip(frame.surface(POINTS, POINTS), (there, turned), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-14)
    np.testing.assert_allclose(frame.inverse_points(there), POINTS, atol=1e-14)
    np.testing.assert_allclose(frame.inverse_vectors(turned), POINTS, atol=1e-14)


def test_a_frame_seen_from_another_one() -> None:
    seen = relative(Transform(SHIFT, TURN.as_matrix()), Transform(AWAY, OTHER.as_matrix()))
    expected = TURN.inv().apply(OTHER.apply(POINTS) + AWAY - SHIFT)
    np.testing.assert_allclose(seen.points(POINTS), expected, atol=1e-14)


def test_quaternions_and_matrices() -> None:
    # Half turns too, where w is 0 and another component must lead
    turns = [TURN, OTHER, *Rotation.from_rotvec(np.pi * np.eye(3)), *Rotation.from_rotvec(3.1 * np.eye(3))]
    for turn in turns:
        given = turn.as_quat(canonical=True, scalar_first=True)
        np.testing.assert_allclose(rotation_matrix(given), turn.as_matrix(), atol=1e-14)
        found = quaternion(turn.as_matrix())
        assert found[0] >= 0.0
        assert abs(abs(found @ given) - 1.0) < 1e-14
