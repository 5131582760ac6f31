"""Checks of arguments, for the float32 field and the float64 reference."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics.directivities import form_of
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Array

FARTHEST_m = 1e4
"""Largest coordinate of a point [m]; beyond it float32 resolves only half a millimetre, and sound has decayed."""


def numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return the values as an array. Raises PalmfieldError for text, objects and rows of unequal length."""
    try:
        result = np.asarray(values)
    except ValueError as error:
        raise PalmfieldError(f"{name} have rows of unequal length: give a rectangular array of numbers") from error
    if result.dtype.kind not in "biufc":
        raise PalmfieldError(f"{name} have type {result.dtype}: give numbers")
    return result


def first_bad(values: NDArray[np.inexact]) -> int:
    """Return the index of the first row with NaN or infinity."""
    rows = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    return int(np.argmin(rows))


def positions(values: ArrayLike) -> NDArray[Any]:
    """Return the values as an array (n, 3). Raises PalmfieldError for another shape, complex numbers and text."""
    result = numbers(values, "points")
    if result.dtype.kind == "c":
        raise PalmfieldError("points are complex: give real positions (x, y, z), in metres")
    if result.ndim != 2 or result.shape[1] != 3:
        raise PalmfieldError(f"points have shape {result.shape}: give (n, 3), in metres")
    return result


def points(values: ArrayLike, dtype: type[np.floating]) -> NDArray[np.floating]:
    """Return positions as a contiguous array of `dtype`, shape (n, 3).

    Raises PalmfieldError like `positions`, and for NaN, infinity, and coordinates beyond FARTHEST_m.
    """
    result = positions(values)
    if not (np.abs(result) <= FARTHEST_m).all():
        if np.isfinite(result).all():
            i = int(np.argmax(np.abs(result).max(axis=1)))
            raise PalmfieldError(f"points[{i}] = {result[i].tolist()} is over {FARTHEST_m:g} m away: give metres")
        i = first_bad(result)
        raise PalmfieldError(f"points[{i}] = {result[i].tolist()} is not finite: remove or correct it")
    return np.ascontiguousarray(result, dtype=dtype)


def drive(values: ArrayLike, array: Array) -> NDArray[np.complex128]:
    """Return complex amplitudes (len(array),). Raises PalmfieldError for another shape, text, NaN or infinity."""
    return amplitudes(values, len(array), f"array '{array.name}'")


def amplitudes(values: ArrayLike, count: int, name: str) -> NDArray[np.complex128]:
    """Return complex amplitudes, shape (count,). Raises like `drive`; name: name of the array, for messages."""
    drive = numbers(values, "drive").astype(np.complex128)
    if drive.shape != (count,):
        raise PalmfieldError(f"drive has shape {drive.shape} but {name} has {count} transducers: give shape ({count},)")
    if not np.isfinite(drive).all():
        i = first_bad(drive)
        raise PalmfieldError(f"drive[{i}] = {drive[i]} is not finite: remove or correct it")
    return drive


def frames(values: ArrayLike, array: Array) -> NDArray[np.complex128]:
    """Return the drives of several frames, shape (frames, len(array)), contiguous.

    Raises PalmfieldError for another shape, text, NaN or infinity.
    """
    drives = np.ascontiguousarray(numbers(values, "drives"), dtype=np.complex128)
    if drives.ndim != 2 or drives.shape[1] != len(array):
        raise PalmfieldError(
            f"drives have shape {drives.shape} but array '{array.name}' has {len(array)} transducers: "
            f"give shape (frames, {len(array)})"
        )
    if not np.isfinite(drives).all():
        raise PalmfieldError(f"drives[{first_bad(drives)}] are not finite: remove or correct the frame")
    return drives


def array(value: Array) -> None:
    """Raise SceneError for an array with invalid geometry or constants."""
    for name in ("positions", "normals", "gain", "directivity_table"):
        member = getattr(value, name)
        if not isinstance(member, np.ndarray) and not (member is None and name in ("gain", "directivity_table")):
            raise SceneError(
                f"array '{value.name}' {name} is a {type(member).__name__}: give a NumPy array, np.array(...), or "
                "make the array with palmfield.acoustics.arrays.from_poses"
            )
    count = len(value.positions)
    for name, vectors in (("positions", value.positions), ("normals", value.normals)):
        if vectors.shape != (count, 3) or not np.isfinite(vectors).all():
            raise SceneError(f"array '{value.name}' {name} of shape {vectors.shape} must be finite and ({count}, 3)")
    lengths = np.linalg.norm(value.normals, axis=1)
    if np.any(np.abs(lengths - 1.0) > 1e-6):
        i = int(np.argmax(np.abs(lengths - 1.0)))
        raise SceneError(f"array '{value.name}' normals[{i}] has length {lengths[i]:.6g}: divide it by its length")
    for name in ("p0_Pa_m", "frequency_Hz"):
        number = getattr(value, name)
        if not 0.0 < number < np.inf:
            raise SceneError(f"array '{value.name}' {name} = {number} must be positive and finite")
    if not 0.0 <= value.piston_radius_m < np.inf:
        raise SceneError(
            f"array '{value.name}' piston_radius_m = {value.piston_radius_m} must be 0 or more, and finite"
        )
    if value.gain is not None and (value.gain.shape != (count,) or not np.isfinite(value.gain).all()):
        raise SceneError(f"array '{value.name}' gain of shape {value.gain.shape} must be finite and ({count},)")
    if value.directivity_table is None:
        form_of(value)
    else:
        directivity_table(value.name, value.directivity_table)


def directivity_table(name: str, table: NDArray[np.float64]) -> None:
    """Raise SceneError unless the table goes from (0 deg, 1) to 90 deg with rising angles and amplitudes >= 0."""
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < 3 or not np.isfinite(table).all():
        raise SceneError(f"array '{name}' directivity_table of shape {table.shape} must be finite and (3 or more, 2)")
    angle, amplitude = table.T
    if angle[0] != 0.0 or angle[-1] != 90.0 or np.any(np.diff(angle) <= 0.0):
        raise SceneError(
            f"array '{name}' directivity_table has angles {angle[0]:g} to {angle[-1]:g} deg; allowed: rising from "
            "0 to 90"
        )
    if amplitude[0] != 1.0 or np.any(amplitude < 0.0):
        raise SceneError(
            f"array '{name}' directivity_table has {amplitude[0]:g} on the axis and a minimum of "
            f"{amplitude.min():g}; allowed: 1 on the axis and values of 0 or more: divide the table by its value "
            "on the axis, and use magnitudes"
        )


def frequency(value: float) -> float:
    """Return the carrier [Hz]. Raises SceneError if it is not positive and finite."""
    if not 0.0 < value < np.inf:
        raise SceneError(f"frequency_Hz = {value} is not positive and finite: give the carrier, for example 40e3")
    return value


def angular_frequency(frequency_Hz: float) -> float:
    """Return 2 pi f [rad/s]. Raises SceneError for a frequency that is not positive and finite."""
    return 2.0 * np.pi * frequency(frequency_Hz)


def in_front(array: Array, point: NDArray[np.float64], name: str) -> None:
    """Raise SceneError, with `name`, unless the point [m], shape (3,), is in front of every transducer."""
    height = np.einsum("ij,ij->i", point - array.positions, array.normals)
    if np.any(height <= 0.0):
        i = int(np.argmin(height))
        raise SceneError(
            f"{name} is behind array '{array.name}' or in its plane ({height[i]:.3g} m in front of transducer "
            f"{i}): give a point in front of the array"
        )


def absorption(value: float) -> float:
    """Return the absorption [Np/m]. Raises PalmfieldError if it is negative or not finite."""
    if not 0.0 <= value < np.inf:
        raise PalmfieldError(f"absorption_Np_m = {value} must be 0 or more, and finite")
    return float(value)
