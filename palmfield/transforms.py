"""Where things are: rigid transforms between frames, and placements that can be compared and kept as keys."""

from typing import NamedTuple

import numpy as np

from palmfield.types import Float

Numbers = tuple[float, ...]


class Transform(NamedTuple):
    """A frame seen from another one: x_outer = rotation @ x + position.

    position: origin of the frame [m], shape (3,); rotation: its axes as columns, shape (3, 3)
    """

    position: Float
    rotation: Float

    def points(self, x: Float) -> Float:
        """Positions given in this frame [m], shape (n, 3) or (3,), in the outer one."""
        return x @ self.rotation.T + self.position

    def vectors(self, x: Float) -> Float:
        """Directions given in this frame, shape (n, 3) or (3,), in the outer one."""
        return x @ self.rotation.T

    def surface(self, points: Float, normals: Float) -> tuple[Float, Float]:
        """Positions [m] and directions given in this frame, both of shape (n, 3), in the outer one."""
        turn = self.rotation.T
        return points @ turn + self.position, normals @ turn

    def inverse_points(self, x: Float) -> Float:
        """Positions given in the outer frame [m], shape (n, 3) or (3,), in this one."""
        return (x - self.position) @ self.rotation

    def inverse_vectors(self, x: Float) -> Float:
        """Directions given in the outer frame, shape (n, 3) or (3,), in this one."""
        return x @ self.rotation


IDENTITY = Transform(np.zeros(3), np.eye(3))


class Placement(NamedTuple):
    """Where an array or a body is in the frame of something else, as numbers that can be compared and hashed.

    position: [m], 3 numbers; rotation: 9 numbers by row
    sites: position [m] and emitting direction of each transducer in the array's own frame, for layout `sites`, else
        empty; they may move against one another
    """

    position: Numbers
    rotation: Numbers
    sites: tuple[tuple[Numbers, Numbers], ...] = ()

    @property
    def transform(self) -> Transform:
        """The same as arrays."""
        return Transform(np.array(self.position), np.reshape(self.rotation, (3, 3)))

    @staticmethod
    def of(transform: Transform, sites: tuple[tuple[Numbers, Numbers], ...] = ()) -> "Placement":
        """From arrays."""
        return Placement(tuple(transform.position.tolist()), tuple(transform.rotation.ravel().tolist()), sites)


def relative(seen_from: Transform, pose: Transform) -> Transform:
    """A frame as seen from another; both are given in one outer frame."""
    return Transform(seen_from.rotation.T @ (pose.position - seen_from.position), seen_from.rotation.T @ pose.rotation)


def rotation_matrix(quaternion: Float) -> Float:
    """Rotation matrix, shape (3, 3), of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternion, dtype=np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(rotation: Float) -> Float:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix, shape (3, 3).

    By the largest of the four components, which keeps full precision near half turns (Shepperd 1978).
    """
    m = np.asarray(rotation, dtype=np.float64)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = 0.25 * np.array([1 + trace, *(1 + 2 * m[i, i] - trace for i in range(3))])
    largest = int(squares.argmax())
    q = np.empty(4)
    q[largest] = np.sqrt(squares[largest])
    scale = 0.25 / q[largest]
    if largest == 0:
        q[1:] = scale * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = scale * (m[k, j] - m[j, k])
        q[1 + j] = scale * (m[j, i] + m[i, j])
        q[1 + k] = scale * (m[k, i] + m[i, k])
    return q if q[0] >= 0 else -q


def corners_of(points: Float) -> Float:
    """Corners of the box round points, shape (n, 3), along the axes, shape (8, 3)."""
    ends = np.array([points.min(axis=0), points.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
