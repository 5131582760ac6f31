"""Among which points of a surface the weights of shadows are computed, and how all others take theirs from these."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from palmfield.types import Float, Float32, Int
from warp_kernels.knife_edge import NEIGHBOURS

GROUP = 3.75
"""Edge of the cells whose nodes look at bodies from one place, over the nodes' spacing."""
TURN_m = 0.03
"""Distance for which normals count that are at right angles: two sides of a finger are no neighbours."""
STIFFNESS = 0.03
"""Regularisation of the slopes between nodes where nodes are nearly in a line."""


class ShadowNodes(NamedTuple):
    """Nodes among n points, all sorted by group.

    numbers: of the points that are nodes, shape (m,). groups: of each, shape (m,). starts: first node of each group,
    and one past the last. neighbours, shares: nodes from which each point takes its weights and the share of each,
    shapes (NEIGHBOURS, n).
    """

    numbers: Int
    groups: Int
    starts: Int
    neighbours: Int
    shares: Float32


def shadow_nodes(points: Float, normals: Float, spacing_m: float) -> ShadowNodes:
    """Nodes about `spacing_m` apart among points [m] with unit outward normals, both of shape (n, 3), n >= 1.

    Shares are those of a plane fitted to near nodes along the surface, so that linear variation is exact.
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
    """The cell of each point: cubes, and in them which way points face most; numbered from 0 without gaps."""
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(axis)), axis] > 0.0)
    keys = np.column_stack([np.floor(points / edge_m).astype(np.int64), facing])
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1), np.int32)


def _middle_ones(points: Float, cells: Int) -> Int:
    """For each cell the point that is nearest to the middle of its points."""
    count = np.bincount(cells)
    middles = np.column_stack([np.bincount(cells, column) / count for column in points.T])
    away = ((points - middles[cells]) ** 2).sum(axis=1)
    order: Int = np.lexsort((away, cells)).astype(np.int32)
    firsts = np.searchsorted(cells[order], np.arange(len(count)))
    return np.asarray(order[firsts], dtype=np.int32)


def _shares(points: Float, normals: Float, numbers: Int) -> tuple[Int, Float]:
    """Nodes near each point and how much of each it takes, shapes (n, NEIGHBOURS)."""
    there = cKDTree(np.hstack([points, TURN_m * normals])[numbers])
    distance, nearest = there.query(np.hstack([points, TURN_m * normals]), k=min(NEIGHBOURS, len(numbers)))
    distance, nearest = distance.reshape(len(points), -1), nearest.reshape(len(points), -1)
    reach = np.maximum(1.05 * distance[:, -1:], 1e-6)
    weights = (1.0 - (distance / reach) ** 2) ** 2 if distance.shape[1] > 1 else np.ones_like(distance)
    offsets = (points[numbers[nearest]] - points[:, None]) / reach[..., None]
    # Along the surface only: nodes lie in it
    offsets -= np.einsum("nki,ni->nk", offsets, normals)[..., None] * normals[:, None]
    rows = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets], axis=2)
    matrix = np.einsum("nk,nki,nkj->nij", weights, rows, rows)
    matrix[:, 1:, 1:] += STIFFNESS * weights.sum(axis=1)[:, None, None] * np.eye(3)
    first = np.zeros((len(points), 4, 1))
    first[:, 0] = 1.0
    shares = weights * np.einsum("nki,ni->nk", rows, np.linalg.solve(matrix, first)[..., 0])
    missing = NEIGHBOURS - shares.shape[1]
    return np.pad(nearest, ((0, 0), (0, missing))), np.pad(shares, ((0, 0), (0, missing)))
