"""Rigid transforms between frames, and placements that can be compared and used as keys."""

from typing import NamedTuple

import numpy as np

from palmfield.types import Float, Float32

Numbers = tuple[float, ...]


class Transform(NamedTuple):
    """Pose of a frame relative to an outer frame: x_outer = rotation @ x + position.

    position: origin of the frame [m], shape (3,); rotation: axes of the frame as columns, shape (3, 3)
    """

    position: Float
    rotation: Float

    def points(self, x: Float) -> Float:
        """Transform positions [m], shape (n, 3) or (3,), from this frame to the outer one."""
        return x @ self.rotation.T + self.position

    def vectors(self, x: Float) -> Float:
        """Transform directions, shape (n, 3) or (3,), from this frame to the outer one."""
        return x @ self.rotation.T

    def surface(self, points: Float, normals: Float) -> tuple[Float, Float]:
        """Transform positions [m] and directions, both of shape (n, 3), from this frame to the outer one."""
        turn = self.rotation.T
        return points @ turn + self.position, normals @ turn

    def inverse_points(self, x: Float) -> Float:
        """Transform positions [m], shape (n, 3) or (3,), from the outer frame to this one."""
        return (x - self.position) @ self.rotation

    def inverse_vectors(self, x: Float) -> Float:
        """Transform directions, shape (n, 3) or (3,), from the outer frame to this one."""
        return x @ self.rotation


IDENTITY = Transform(np.zeros(3), np.eye(3))


class Placement(NamedTuple):
    """Pose of an array or body in another frame, as numbers that can be compared and hashed.

    position: [m], 3 numbers; rotation: 9 numbers, row by row
    sites: position [m] and emitting direction of each transducer in the array frame, for layout `sites`, whose
        transducers may move relative to each other; empty for other layouts
    """

    position: Numbers
    rotation: Numbers
    sites: tuple[tuple[Numbers, Numbers], ...] = ()

    @property
    def transform(self) -> Transform:
        """The placement as a Transform."""
        return Transform(np.array(self.position), np.reshape(self.rotation, (3, 3)))

    @staticmethod
    def of(transform: Transform, sites: tuple[tuple[Numbers, Numbers], ...] = ()) -> "Placement":
        """Return the placement of a Transform."""
        return Placement(tuple(transform.position.tolist()), tuple(transform.rotation.ravel().tolist()), sites)


def relative(frame: Transform, pose: Transform) -> Transform:
    """Return a frame relative to another one. Both are expressed in one outer frame."""
    return Transform(frame.rotation.T @ (pose.position - frame.position), frame.rotation.T @ pose.rotation)


def rotation_matrix(quaternion: Float) -> Float:
    """Return the rotation matrix, shape (3, 3), of a unit quaternion (w, x, y, z)."""
    import mujoco  # loads palmfield's plugins, which need this module

    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, dtype=np.float64))
    return matrix.reshape(3, 3)


def quaternion(rotation: Float) -> Float:
    """Return the unit quaternion (w, x, y, z), w >= 0, of a rotation matrix, shape (3, 3)."""
    import mujoco

    q = np.empty(4)
    mujoco.mju_mat2Quat(q, np.asarray(rotation, dtype=np.float64).ravel())
    return q if q[0] >= 0 else -q


def facing(directions: Float | Float32) -> Float:
    """Return unit quaternions (w, x, y, z) that rotate the z axis to unit vectors, (n, 3) -> (n, 4)."""
    x, y, z = np.asarray(directions, np.float64).T
    half = np.column_stack([1.0 + z, -y, x, np.zeros(len(z))])
    # Opposite to z: half a turn about x
    half[z < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def corners_of(points: Float) -> Float:
    """Return the corners of the axis-aligned bounding box of points, shape (n, 3) -> (8, 3)."""
    ends = np.array([points.min(axis=0), points.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
