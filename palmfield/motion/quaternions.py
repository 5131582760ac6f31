"""Unit quaternions (w, x, y, z) as rows of small arrays. SciPy's rotations would take 20 us per call."""

import numpy as np

from palmfield.types import Float

SMALL_RAD = 1e-3
"""Angle below which a series is used instead of a quotient. The error of the series is that of rounding."""


def product(a: Float, b: Float) -> Float:
    """Return the rotation by b followed by the rotation by a, for each row, shape (n, 4)."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    result = np.empty_like(b)
    result[:, 0] = aw * bw - ax * bx - ay * by - az * bz
    result[:, 1] = aw * bx + ax * bw + ay * bz - az * by
    result[:, 2] = aw * by - ax * bz + ay * bw + az * bx
    result[:, 3] = aw * bz + ax * by - ay * bx + az * bw
    return result


def inverse(q: Float) -> Float:
    """Return the inverse rotations, shape (n, 4)."""
    return q * (1.0, -1.0, -1.0, -1.0)


def unit(q: Float) -> Float:
    """Scale to length 1, shape (n, 4)."""
    return q / np.sqrt(np.einsum("ij,ij->i", q, q))[:, None]


def of_turns(turns: Float) -> Float:
    """Return the quaternions, shape (n, 4), of rotation vectors [rad], shape (n, 3)."""
    square = np.einsum("ij,ij->i", turns, turns)
    angle = np.sqrt(square)
    small = angle < SMALL_RAD
    series = 0.5 - square / 48.0 + square * square / 3840.0
    result = np.empty((len(turns), 4))
    result[:, 0] = np.cos(0.5 * angle)
    result[:, 1:] = turns * np.where(small, series, np.sin(0.5 * angle) / np.where(small, 1.0, angle))[:, None]
    return result


def turns_of(q: Float) -> Float:
    """Return the shortest rotation vectors [rad], shape (n, 3), of quaternions, shape (n, 4)."""
    axis = q[:, 1:]
    angle = 2.0 * np.arctan2(np.sqrt(np.einsum("ij,ij->i", axis, axis)), np.abs(q[:, 0]))
    small = angle < SMALL_RAD
    square = angle * angle
    series = 2.0 + square / 12.0 + 7.0 * square * square / 2880.0
    scale = np.where(small, series, angle / np.sin(np.where(small, 1.0, 0.5 * angle)))
    return np.asarray(axis * np.copysign(scale, q[:, 0])[:, None])


def matrices(q: Float) -> Float:
    """Return rotation matrices, shape (n, 3, 3), of quaternions, shape (n, 4)."""
    w, x, y, z = q.T
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    result = np.empty((len(q), 3, 3))
    result[:, 0, 0], result[:, 1, 1], result[:, 2, 2] = xx - yy - zz + ww, -xx + yy - zz + ww, -xx - yy + zz + ww
    xy, zw, xz, yw, yz, xw = x * y, z * w, x * z, y * w, y * z, x * w
    result[:, 0, 1], result[:, 1, 0] = 2.0 * (xy - zw), 2.0 * (xy + zw)
    result[:, 0, 2], result[:, 2, 0] = 2.0 * (xz + yw), 2.0 * (xz - yw)
    result[:, 1, 2], result[:, 2, 1] = 2.0 * (yz - xw), 2.0 * (yz + xw)
    return result
