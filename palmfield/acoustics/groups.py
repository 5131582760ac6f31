"""Sort transducers by plane and axis for the field kernels."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Array, Float, Int

SAME_PLANE_M = 1e-9
SAME_AXIS = 1e-9
FLAT_FROM = 32
"""Number of transducers per saved plane up to which a height for each transducer costs less than separate planes. A
group costs as much as two to four pairs (point, transducer), a height 1/20 to 1/10 of a pair."""


@dataclass(frozen=True)
class Groups:
    """Groups of transducers with one axis, each in one plane normal to the axis if `flat`.

    order: numbers of the transducers by group, shape (n,).
    origins: origin of the frame of each group [m], array frame, shape (g, 3); turns: rotations from the array frame
        into the group frame, whose rows are its axes, shape (g, 3, 3).
    ranges: first transducer and one past the last, in the numbering of `order`, shape (g, 2).
    places: x, y, z of the ordered transducers in the frame of their group [m], shape (n, 3); z is 0 if `flat`.
    """

    order: Int
    origins: Float
    turns: Float
    ranges: Int
    places: Float
    flat: bool


def groups(array: Array) -> Groups:
    """Sort the transducers into groups; a flat board is one group, also if its positions are rounded."""
    offset = np.einsum("ij,ij->i", array.positions, array.normals)
    axis = numbered(np.round(array.normals / SAME_AXIS).astype(np.int64))
    plane = numbered(np.column_stack([axis, np.round(offset / SAME_PLANE_M).astype(np.int64)]))
    flat = FLAT_FROM * (plane.max(initial=-1) - axis.max(initial=-1)) <= len(array)
    member = plane if flat else axis
    order = np.argsort(member, kind="stable").astype(np.int32)
    bounds = np.searchsorted(member[order], np.arange(member.max(initial=-1) + 2))
    origins, turns = [], []
    places = np.zeros((len(array), 3))
    for first, stop in itertools.pairwise(bounds):
        part = order[first:stop]
        turn = axes(array.normals[part[0]])
        origin = array.positions[part].mean(axis=0)
        places[first:stop] = (array.positions[part] - origin) @ turn.T
        origins.append(origin)
        turns.append(turn)
    ranges = np.column_stack([bounds[:-1], bounds[1:]]).astype(np.int32)
    if flat:
        places[:, 2] = 0.0
    return Groups(
        order, np.array(origins).reshape(-1, 3), np.array(turns).reshape(-1, 3, 3), ranges, places, bool(flat)
    )


def numbered(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each row the number of its distinct value, from 0 without gaps, shape (n,)."""
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def axes(normals: Float) -> Float:
    """Return right-handed unit axes as rows, shape (..., 3, 3), the last along `normals`, shape (..., 3)."""
    helper = np.where(np.abs(normals[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = helper - np.sum(helper * normals, axis=-1, keepdims=True) * normals
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(normals, x), normals], axis=-2)
