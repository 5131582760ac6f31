"""Drives that focus an array."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import sound_speed
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex


def focus(array: Array, air: Air, point: ArrayLike) -> Complex:
    """Drive under which the sound of every transducer arrives at `point` in phase: exp(-i k d), unit amplitude.

    point: position in the array frame [m], shape (3,)
    Returns complex amplitudes, shape (len(array),), complex128.
    Raises SceneError when the point is not finite, or not in front of every transducer.
    """
    check.array(array)
    target = np.asarray(point, dtype=float)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise SceneError(f"focus {target.tolist()} is not a finite position (x, y, z): give three numbers, in metres")
    rays = target - array.positions
    if np.any(np.einsum("ij,ij->i", rays, array.normals) <= 0.0):
        raise SceneError(f"focus {target.tolist()} is behind the array '{array.name}' or in its plane: use z > 0")
    k = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    return np.exp(-1j * k * np.linalg.norm(rays, axis=1))
