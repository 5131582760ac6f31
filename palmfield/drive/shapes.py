"""Drives that shape one beam: traps, vortices, plane waves. They use only phases: |a| = 1 (or 0).

Like `palmfield.acoustics.focus.focus` they return the commanded drive, and ignore dead or inverted transducers.

Some shapes divide the array round the axis of the beam: the line through the focus along the mean direction of the
sound there. So the parts balance also for an off-axis focus; parts round the normal of the board would not.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.focus import focus
from palmfield.drive.foci import transfer64
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex, Float

ON_LINE = 1e-9
"""Sine of the angle from the dividing line of a twin trap below which a transducer belongs to no half."""

ALONG_Y = 1.0 - 1e-12
"""Least cosine between the normal of an array and y for which the array faces along y."""


def twin_trap(array: Array, air: Air, point: ArrayLike, azimuth_rad: float = 0.0) -> Complex:
    """Return a drive with two halves in antiphase: two lobes at the focus, and silence on the plane between them.

    The plane contains the axis of the beam; the lobes lie along azimuth_rad from x, seen along the beam. The silence is
    exact if the array is mirror-symmetric about the plane. Transducers on the plane are off.

    point: the focus [m], array frame, shape (3,)
    Returns complex amplitudes, shape (len(array),).
    Raises SceneError for a bad focus (see `focus`) or azimuth.
    Source: A. Marzo et al., Nat. Commun. 6, 8661 (2015).
    """
    if not np.isfinite(azimuth_rad):
        raise SceneError(f"azimuth_rad = {azimuth_rad} is not finite: give the direction of the lobes in radians")
    drive = focus(array, air, point)
    across, _ = round_beam(array, air, point)
    along = across @ np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    return drive * np.where(np.abs(along) < ON_LINE, 0.0, np.sign(along))


def vortex(array: Array, air: Air, point: ArrayLike, order: int = 1) -> Complex:
    """Return a drive whose phase increases by `order` turns round the axis of the beam: a ring of sound, silent inside.

    For a positive order, the phase delay of the sound increases with the azimuth, which is counted from x towards y.
    On a coarse board, high orders have aliasing: the square outline of the board also produces other orders, which are
    louder within a few millimetres of the axis.

    point: the focus [m], array frame, shape (3,)
    Returns complex amplitudes, shape (len(array),).
    Raises SceneError for a bad focus (see `focus`) or an order that is not a whole number.
    Source: B. T. Hefner, P. L. Marston, J. Acoust. Soc. Am. 106, 3313 (1999).
    """
    if not np.isfinite(order) or int(order) != order:
        raise SceneError(f"vortex order = {order} is not a whole number: the phase must close on itself after a turn")
    drive = focus(array, air, point)
    across, _ = round_beam(array, air, point)
    return drive * np.exp(1j * order * np.arctan2(across[:, 1], across[:, 0]))


def bottle(array: Array, air: Air, point: ArrayLike) -> Complex:
    """Return a drive with inner and outer transducers in antiphase: silence at the focus, with sound on all sides.

    The inner transducers give half of the total pressure at the focus. So the two parts cancel there, to within the
    transducers of one ring.

    point: the focus [m], array frame, shape (3,)
    Returns complex amplitudes, shape (len(array),).
    Raises SceneError for a bad focus (see `focus`).
    Source: A. Marzo et al., Nat. Commun. 6, 8661 (2015).
    """
    drive = focus(array, air, point)
    across, share = round_beam(array, air, point)
    rings, ring = np.unique(np.round(np.linalg.norm(across, axis=1), 9), return_inverse=True)
    inside = np.cumsum(np.bincount(ring, share, len(rings)))
    split = int(np.argmin(np.abs(inside - 0.5 * inside[-1])))
    return drive * np.where(ring <= split, 1.0, -1.0)


def plane_wave(array: Array, air: Air, direction: ArrayLike) -> Complex:
    """Return a drive for a plane wave along `direction`, limited by the aperture: exp(i k n.x) at the transducers.

    direction: array frame, shape (3,), of any length; it must be in front of every transducer
    Returns complex amplitudes, shape (len(array),).
    Raises SceneError for another direction.
    """
    check.array(array)
    vector = np.asarray(direction, float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise SceneError(
            f"direction {vector.tolist()} is not a finite vector (x, y, z) other than 0: give three numbers"
        )
    along = vector / np.linalg.norm(vector)
    if np.any(array.normals @ along <= 0.0):
        i = int(np.argmin(array.normals @ along))
        raise SceneError(
            f"direction {vector.tolist()} does not point out of array '{array.name}', whose transducer {i} faces "
            f"{array.normals[i].tolist()}: give a direction to the front of the array"
        )
    k = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    return np.exp(1j * k * (array.positions @ along))


def round_beam(array: Array, air: Air, point: ArrayLike) -> tuple[Float, Float]:
    """Return the position of each transducer relative to the axis of the beam, seen from the focus, and its pressure.

    The axis is the mean direction of arrival, weighted by |p|. y is the y of the frame, seen along the mean normal of
    the array. If the normal is along y, y is that of a board that was rotated about x to this direction.

    Returns the sines of the angles from the axis, shape (n, 2), and |p| at the focus [Pa], shape (n,), both without
    `array.gain`. Raises SceneError if the axis does not point out of the array.
    """
    target = np.asarray(point, float)
    share = np.abs(transfer64(target[None], dataclasses.replace(array, gain=None), air)[0])
    rays = target - array.positions
    arrival = rays / np.linalg.norm(rays, axis=1)[:, None]
    axis = share @ arrival / share.sum()
    out = array.normals.mean(axis=0)
    length = float(np.linalg.norm(out))
    if length < 1e-9 or axis @ out < 0.1 * length:
        raise SceneError(
            f"sound from '{array.name}' has the mean direction {np.round(axis, 3).tolist()} at the focus "
            f"{target.tolist()}, not along the array's mean normal {np.round(out, 3).tolist()}: move the focus"
        )
    axis /= np.linalg.norm(axis)
    out /= length
    up = np.array([0.0, 1.0, 0.0]) if abs(out[1]) < ALONG_Y else np.array([0.0, 0.0, -np.sign(out[1])])
    up -= (up @ out) * out
    x = np.cross(up, axis)
    x /= np.linalg.norm(x)
    return -np.column_stack([arrival @ x, arrival @ np.cross(axis, x)]), share
