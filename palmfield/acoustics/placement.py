"""Make arrays from single transducers and from other arrays: poses, rigid motion, combination, faults."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import scipy  # loads its submodules at first use
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.directivities import form_of
from palmfield.acoustics.transducer import ANY_P0
from palmfield.errors import SceneError
from palmfield.types import Array, Complex, Float, Int

ROUNDED = 1e-6
"""Largest deviation from orthonormality of a rotation rounded to float32."""


def from_poses(
    name: str,
    positions: ArrayLike,
    normals: ArrayLike,
    p0_Pa_m: float = ANY_P0.value,
    *,
    frequency_Hz: float = 40e3,
    piston_radius_m: float = 4.5e-3,
    address: Int | None = None,
    gain: Complex | None = None,
    directivity_table: Float | None = None,
) -> Array:
    """Return the array of any transducers, for example the sites of an MJCF file, in the frame of the positions.

    For sites `ids` of a MuJoCo model: positions `data.site_xpos[ids]`, normals their z axes,
    `data.site_xmat[ids].reshape(-1, 3, 3)[:, :, 2]`.

    positions: [m], shape (n, 3), n at least 1.
    normals: emitting directions of any length except 0, shape (n, 3).
    p0_Pa_m, frequency_Hz, piston_radius_m, address, gain, directivity_table: see `palmfield.types.Array`.
    Raises SceneError for wrong shapes, values that are not finite, and constants that cannot radiate.
    """
    where, facing = np.array(positions, dtype=float), np.array(normals, dtype=float)
    if where.ndim != 2 or len(where) == 0:
        raise SceneError(f"array '{name}' positions have shape {where.shape}: give (n, 3), n at least 1, in metres")
    if facing.shape == where.shape:
        lengths = np.linalg.norm(facing, axis=1, keepdims=True)
        if np.any(lengths == 0.0):
            raise SceneError(f"array '{name}' normals[{int(np.argmin(lengths))}] is zero: give the emitting direction")
        facing = facing / lengths
    array = Array(name, where, facing, p0_Pa_m, frequency_Hz, piston_radius_m, address, gain, directivity_table)
    check.array(array)
    return array


def placed(array: Array, position: ArrayLike, rotation: ArrayLike) -> Array:
    """Return the array moved rigidly into another frame: x -> rotation x + position.

    position: origin of the array in the other frame [m], shape (3,).
    rotation: matrix whose columns are the axes of the array in the other frame, shape (3, 3); a matrix rounded to
        float32 is replaced by the nearest rotation.
    Raises SceneError for a position that is not three finite numbers and for a matrix that is not a rotation.
    """
    shift, turn = np.asarray(position, dtype=float), np.asarray(rotation, dtype=float)
    if shift.shape != (3,) or not np.isfinite(shift).all():
        raise SceneError(f"position {shift.tolist()} is not three finite numbers: give (x, y, z), in metres")
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), 0.0, ROUNDED) or np.linalg.det(turn) < 0.0:
        raise SceneError(f"rotation {turn.tolist()} is not a rotation matrix: give orthonormal columns, determinant +1")
    turn = scipy.linalg.polar(turn)[0]
    return replace(array, positions=array.positions @ turn.T + shift, normals=array.normals @ turn.T)


def combined(arrays: Sequence[Array], name: str | None = None) -> Array:
    """Return several arrays in one frame as one array, with their transducers in the order of the arrays.

    p0 is the largest of them; `gain` contains the ratio for the other arrays. Addresses continue if all have them.

    name: None joins the names by " + "
    Raises SceneError for no arrays, and for differing frequency, piston radius or directivity.
    """
    if not arrays:
        raise SceneError("the list of arrays to combine is empty: give at least 1")
    first = arrays[0]
    for other in arrays[1:]:
        for key in ("frequency_Hz", "piston_radius_m"):
            mine, its = getattr(first, key), getattr(other, key)
            if mine != its:
                raise SceneError(
                    f"arrays '{first.name}' and '{other.name}' differ in {key}, {mine:g} and {its:g}: make them equal"
                )
        one, two = form_of(first), form_of(other)
        if one is not two:
            raise SceneError(
                f"arrays '{first.name}' and '{other.name}' differ in directivity ('{one.name}', '{two.name}'): use one "
                "form or table for both"
            )
    p0 = max(a.p0_Pa_m for a in arrays)
    gains = [(np.ones(len(a), complex) if a.gain is None else a.gain) * (a.p0_Pa_m / p0) for a in arrays]
    plain = all(a.gain is None and a.p0_Pa_m == p0 for a in arrays)
    addresses: list[Int] = []
    for a in arrays:
        if a.address is not None:
            addresses.append(a.address + sum(len(before) for before in addresses))
    return replace(
        first,
        name=" + ".join(a.name for a in arrays) if name is None else name,
        positions=np.concatenate([a.positions for a in arrays]),
        normals=np.concatenate([a.normals for a in arrays]),
        p0_Pa_m=p0,
        address=np.concatenate(addresses).astype(np.int32) if len(addresses) == len(arrays) else None,
        gain=None if plain else np.concatenate(gains),
    )


def with_faults(
    array: Array, dead: Iterable[int] | Iterable[bool] = (), inverted: Iterable[int] | Iterable[bool] = ()
) -> Array:
    """Return the array with dead and inverted transducers, in addition to its present gain.

    dead, inverted: indices of transducers in the order of the array, 0 to len(array) - 1, or masks, shape
    (len(array),). Raises SceneError for an index outside the array or given twice, and a mask of another length.
    """
    silent, turned = indices(array, dead, "dead"), indices(array, inverted, "inverted")
    seen: set[int] = set()
    for i in silent + turned:
        if not 0 <= i < len(array):
            raise SceneError(f"transducer {i} is not in array '{array.name}': use 0 to {len(array) - 1}")
        if i in seen:
            raise SceneError(f"transducer {i} is listed twice as dead or inverted: list it once")
        seen.add(i)
    gain = np.ones(len(array), complex) if array.gain is None else array.gain.astype(complex)
    gain[silent] = 0.0
    gain[turned] *= -1.0
    return replace(array, gain=gain)


def indices(array: Array, chosen: Iterable[int] | Iterable[bool], name: str) -> list[int]:
    """Return transducer numbers from numbers or a mask. Raises SceneError for another mask length and fractions."""
    values = np.asarray(chosen if isinstance(chosen, np.ndarray) else list(chosen))
    if values.dtype == bool:
        if values.shape != (len(array),):
            raise SceneError(f"mask {name} has shape {values.shape}: give ({len(array)},), one for each transducer")
        return np.flatnonzero(values).tolist()
    if values.ndim != 1 or (len(values) and not np.issubdtype(values.dtype, np.integer)):
        raise SceneError(f"{name} = {values.tolist()} are not indices of transducers: give whole numbers, or a mask")
    return values.tolist()


def sides_of(normals: Float) -> list[Int]:
    """Group transducers by their directions, shape (n, 3); return the numbers of each group.

    There is one group if no transducer faces away from the mean direction. Otherwise transducers within 60 degrees of
    the first form a group, and so on with the others.
    """
    rest: Int = np.arange(len(normals), dtype=np.int32)
    if (normals @ normals.mean(axis=0)).min() > 0.0:
        return [rest]
    sides = []
    while len(rest):
        near = normals[rest] @ normals[rest[0]] > 0.5
        sides.append(rest[near])
        rest = rest[~near]
    return sides
