"""Choose the points of a surface at which shadow weights are computed, and interpolate the weights to all points."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from palmfield.types import Float, Float32, Int
from warp_kernels.knife_edge import NEIGHBOURS

GROUP = 3.75
"""Edge of the cells whose nodes have one common viewpoint, over the spacing of the nodes."""
TURN_m = 0.03
"""Distance equivalent to an angle of 90 degrees between normals, so that the sides of a finger are not neighbours."""
STIFFNESS = 0.03
"""Regularisation of the slopes between nodes that lie nearly on a line."""


class ShadowNodes(NamedTuple):
    """Nodes among n points, sorted by group.

    numbers: point numbers of the nodes, shape (m,). groups: group of each node, shape (m,). starts: first node of each
    group, and one past the last. neighbours, shares: nodes and interpolation weights of each point, (NEIGHBOURS, n).
    """

    numbers: Int
    groups: Int
    starts: Int
    neighbours: Int
    shares: Float32


def shadow_nodes(points: Float, normals: Float, spacing_m: float) -> ShadowNodes:
    """Return nodes about `spacing_m` apart among points [m] with unit outward normals, both of shape (n, 3), n >= 1.

    The interpolation is a plane fitted to near nodes along the surface, which is exact for linear variation.
    """
    chosen = _middle_ones(points, _cells(points, normals, spacing_m))
    of_cell = _cells(points[chosen], normals[chosen], GROUP * spacing_m)
    order = np.argsort(of_cell, kind="stable")
    numbers, groups = chosen[order].astype(np.int32), of_cell[order].astype(np.int32)
    starts = np.searchsorted(groups, np.arange(groups[-1] + 2)).astype(np.int32)
    neighbours, shares = _shares(points, normals, numbers)
    return ShadowNodes(
        numbers,
        groups,
        starts,
        np.ascontiguousarray(neighbours.T.astype(np.int32)),
        np.ascontiguousarray(shares.T.astype(np.float32)),
    )


def _cells(points: Float, normals: Float, edge_m: float) -> Int:
    """Return the cell of each point, by cube and main direction of the normal, numbered from 0 without gaps."""
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(axis)), axis] > 0.0)
    keys = np.column_stack([np.floor(points / edge_m).astype(np.int64), facing])
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1), np.int32)


def _middle_ones(points: Float, cells: Int) -> Int:
    """Return for each cell the point nearest to the mean of its points."""
    count = np.bincount(cells)
    middles = np.column_stack([np.bincount(cells, column) / count for column in points.T])
    away = ((points - middles[cells]) ** 2).sum(axis=1)
    order: Int = np.lexsort((away, cells)).astype(np.int32)
    firsts = np.searchsorted(cells[order], np.arange(len(count)))
    return np.asarray(order[firsts], dtype=np.int32)


def _shares(points: Float, normals: Float, numbers: Int) -> tuple[Int, Float]:
    """Return the nodes near each point and their interpolation weights, shapes (n, NEIGHBOURS)."""
    tree = cKDTree(np.hstack([points, TURN_m * normals])[numbers])
    distance, nearest = tree.query(np.hstack([points, TURN_m * normals]), k=min(NEIGHBOURS, len(numbers)))
    distance, nearest = distance.reshape(len(points), -1), nearest.reshape(len(points), -1)
    reach = np.maximum(1.05 * distance[:, -1:], 1e-6)
    weights = (1.0 - (distance / reach) ** 2) ** 2 if distance.shape[1] > 1 else np.ones_like(distance)
    offsets = (points[numbers[nearest]] - points[:, None]) / reach[..., None]
    # Only along the surface, which contains the nodes
    offsets -= np.einsum("nki,ni->nk", offsets, normals)[..., None] * normals[:, None]
    rows = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets], axis=2)
    matrix = np.einsum("nk,nki,nkj->nij", weights, rows, rows)
    matrix[:, 1:, 1:] += STIFFNESS * weights.sum(axis=1)[:, None, None] * np.eye(3)
    first = np.zeros((len(points), 4, 1))
    first[:, 0] = 1.0
    shares = weights * np.einsum("nki,ni->nk", rows, np.linalg.solve(matrix, first)[..., 0])
    missing = NEIGHBOURS - shares.shape[1]
    return np.pad(nearest, ((0, 0), (0, missing))), np.pad(shares, ((0, 0), (0, missing)))
