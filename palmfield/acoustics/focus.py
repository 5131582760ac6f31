"""Drives that focus an array, and that compensate phase errors of its transducers."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import sound_speed
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex


def focus(array: Array, air: Air, point: ArrayLike) -> Complex:
    """Return the drive for which the sound of all transducers arrives at `point` in phase: exp(-i k d), amplitude 1.

    point: position in the array frame [m], shape (3,)
    Returns complex amplitudes, shape (len(array),), complex128.
    Raises SceneError if the point is not finite, or not in front of every transducer.
    """
    check.array(array)
    target = np.asarray(point, dtype=float)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise SceneError(f"focus {target.tolist()} is not a finite position (x, y, z): give three numbers, in metres")
    rays = target - array.positions
    check.in_front(array, target, f"focus {target.tolist()}")
    k = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    return np.exp(-1j * k * np.linalg.norm(rays, axis=1))


def compensate(array: Array, drive: ArrayLike) -> Complex:
    """Return a drive that compensates the phases in `gain` of the array, so that transducers emit the commanded phases.

    Magnitudes are not changed, because a transducer at full drive cannot be louder; dead transducers (gain 0) get 0.

    drive: complex amplitudes for an array without errors, shape (len(array),).
    Returns complex amplitudes, shape (len(array),), complex128.
    Raises PalmfieldError for a drive of another shape or not finite, SceneError for a bad array.
    """
    check.array(array)
    requested = check.drive(drive, array)
    if array.gain is None:
        return requested
    return np.where(array.gain == 0.0, 0.0, requested * np.exp(-1j * np.angle(array.gain)))
