"""Field in float64 NumPy: slow and direct, the reference for the fast kernels."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import form_of
from palmfield.types import Air, Array, Complex, Float

CHUNK = 256


def pressure64(
    points: ArrayLike,
    array: Array,
    drive: ArrayLike,
    air: Air,
    *,
    gradient: bool = False,
    absorption_Np_m: float | None = None,
    normals: Float | None = None,
) -> tuple[Complex, Complex | None]:
    """Return the complex peak pressure of an array in a baffle, and optionally its gradient.

    p = p0/d A g D(angle) exp(ikd - beta d), summed over the transducers, with their drive A and gain g. A transducer
    emits no sound to points in or behind its own plane (baffle). D is the level of the form of directivity
    (`palmfield.acoustics.directivities`), for example 2 J1(kb sin)/(kb sin) for a piston.

    points: [m], array frame, shape (n, 3).
    drive: complex amplitudes, 1 is full drive, shape (len(array),).
    absorption_Np_m: replaces the absorption of the air, for example 0 for lossless air.
    normals: unit outward normals of opaque surfaces at the points, shape (n, 3); the sound of each transducer is
        weighted by 0.5 + 5 cos(angle between normal and direction to it), clipped to 0 to 1.
    Returns pressure [Pa], shape (n,), complex128, and gradient [Pa/m], shape (n, 3), complex128, or None.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points or drive, SceneError for a bad array or air.
    """
    check.array(array)
    where = check.points(points, np.float64)
    strength = array.p0_Pa_m * check.drive(drive, array)
    if array.gain is not None:
        strength = strength * array.gain
    beta = check.absorption(air_absorption(air, array.frequency_Hz) if absorption_Np_m is None else absorption_Np_m)
    k = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    pressure = np.zeros(len(where), np.complex128)
    slope = np.zeros((len(where), 3), np.complex128) if gradient else None
    for start in range(0, len(where), CHUNK):
        part = slice(start, start + CHUNK)
        rays = where[part, None, :] - array.positions
        d = np.sqrt(np.einsum("ijk,ijk->ij", rays, rays))
        d = np.maximum(d, 1e-9)
        cosine = np.einsum("ijk,jk->ij", rays, array.normals) / d
        front = cosine > 0.0
        shape = np.where(front, directivity(array, k, cosine), 0.0)
        wave = strength / d * np.exp((1j * k - beta) * d)
        if normals is not None:
            wave = wave * np.clip(0.5 - 5.0 * np.einsum("ijk,ik->ij", rays, normals[part]) / d, 0.0, 1.0)
        pressure[part] = (wave * shape).sum(axis=1)
        if slope is not None:
            bend = np.where(front, directivity_bend(array, k, cosine), 0.0)
            along = shape * (1j * k - beta - 1.0 / d) - bend * cosine / d
            slope[part] = np.einsum("ij,ijk->ik", wave * along / d, rays)
            slope[part] += (wave * bend / d) @ array.normals
    return pressure, slope


def directivity(array: Array, wavenumber: float, cosine: Float) -> Float:
    """Return the directivity at the cosine of the angle off the axis, in the shape of the cosine."""
    return form_of(array).level(np.maximum(1.0 - cosine**2, 0.0), wavenumber * array.piston_radius_m)


def directivity_bend(array: Array, wavenumber: float, cosine: Float) -> Float:
    """Return d(directivity)/d(cos) for cosines of the angle off the axis, in the shape of the cosines."""
    square = np.maximum(1.0 - cosine**2, 0.0)
    return np.asarray(-2.0 * cosine * form_of(array).slope(square, wavenumber * array.piston_radius_m))
