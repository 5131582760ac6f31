"""Transducers sorted by plane and axis, as the field kernels take them."""

import itertools
from dataclasses import dataclass

import numpy as np

from palmfield.types import Array, Float, Int

SAME_PLANE_M = 1e-9
SAME_AXIS = 1e-9


@dataclass(frozen=True)
class Groups:
    """Transducers of each group lie in one plane and radiate along its normal.

    order: the array's transducers, group after group, shape (n,)
    origins: of each group's frame [m], array frame, shape (g, 3); turns: rotations from the array frame into it,
        rows are its axes, shape (g, 3, 3)
    ranges: first transducer and one past the last, counted in `order`, shape (g, 2)
    places: x and y of the ordered transducers in their group's frame [m], shape (n, 2)
    """

    order: Int
    origins: Float
    turns: Float
    ranges: Int
    places: Float


def groups(array: Array) -> Groups:
    """Sort the array's transducers into groups; a flat board is one."""
    offset = np.einsum("ij,ij->i", array.positions, array.normals)
    keys = np.column_stack([np.round(array.normals / SAME_AXIS), np.round(offset / SAME_PLANE_M)]).astype(np.int64)
    _, member = np.unique(keys, axis=0, return_inverse=True)
    member = member.reshape(-1)
    order = np.argsort(member, kind="stable").astype(np.int32)
    bounds = np.searchsorted(member[order], np.arange(member.max(initial=-1) + 2))
    origins, turns = [], []
    places = np.zeros((len(array), 2))
    for first, stop in itertools.pairwise(bounds):
        part = order[first:stop]
        turn = axes(array.normals[part[0]])
        origin = array.positions[part].mean(axis=0)
        places[first:stop] = (array.positions[part] - origin) @ turn[:2].T
        origins.append(origin)
        turns.append(turn)
    ranges = np.column_stack([bounds[:-1], bounds[1:]]).astype(np.int32)
    return Groups(order, np.array(origins).reshape(-1, 3), np.array(turns).reshape(-1, 3, 3), ranges, places)


def axes(normals: Float) -> Float:
    """Right-handed unit axes, rows, shape (..., 3, 3), the last along `normals`, shape (..., 3)."""
    helper = np.where(np.abs(normals[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = helper - np.sum(helper * normals, axis=-1, keepdims=True) * normals
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(normals, x), normals], axis=-2)
