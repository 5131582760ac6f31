"""Interpolate pressures at scattered points of a curved surface, or spread them over the areas of the points."""

import itertools

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from palmfield.types import Float, Int

NEIGHBOURS = 9
"""Number of points nearest to a place among which the three corners of its triangle are chosen."""
CLOSEST = 6
"""Number of points, with the point itself, whose areas are averaged: quadrature points of a triangle differ in area."""
LONGEST = 3.0
"""Largest distance of a corner from the place, in spacings; there is no pressure in wider gaps."""
DISC = 1.0 / np.sqrt(np.pi)
"""Radius of a disc of the area of a point, in spacings (roots of areas)."""
SAME_SIDE = 0.3
"""Least cosine between the normals of a place and a point: it excludes points on the other side of a finger."""
FLAT = 1e-6
"""Area of a triangle, in squared spacings, below which its corners count as points on a line."""
CHUNK = 20_000


def between_points(points: Float, normals: Float, areas_m2: Float, places: Float, facing: Float) -> sparse.csr_matrix:
    """Return the matrix from pressures at points to pressures at places, csr, (q, p), linear on triangles of points.

    Rows sum to 1; rows of places without pressure sum to 0. The corners of a triangle are near points, projected on
    the tangent plane at the place. The triangle with the least mean squared distance of corners is used, as in a
    Delaunay triangulation (Rajan 1994, Discrete Comput. Geom. 12, 189). A place outside all triangles has the pressure
    of the nearest point, up to the radius of a disc of the area of this point.

    points, normals: [m] and outward unit vectors, shape (p, 3). areas_m2: area of each point, (p,).
    places, facing: positions [m] and outward unit vectors of the places, shape (q, 3).
    """
    tree = cKDTree(points)
    spacing = _spacing(tree, points, areas_m2)
    parts = [
        _shares(tree, points, normals, spacing, places[n : n + CHUNK], facing[n : n + CHUNK])
        for n in range(0, len(places), CHUNK)
    ]
    return sparse.csr_matrix(sparse.vstack(parts))


def spread_forces(
    points: Float, normals: Float, areas_m2: Float, places: Float, facing: Float, weights_m2: Float
) -> sparse.csr_matrix:
    """Return the matrix from pressures at points to pressures at places, csr, (q, p); each point acts on a disc.

    The pressure falls from the middle of the disc as a parabola; its force is pressure times the area of the point. If
    no place lies on the disc, the column is empty. Arguments as for `between_points`; weights_m2: areas of places, (q,)
    """
    # Parabola with the second moment of the disc
    reach = np.sqrt(1.5 * areas_m2 / np.pi)
    neighbours = cKDTree(places).query_ball_point(points, reach)
    columns = np.repeat(np.arange(len(points)), [len(one) for one in neighbours])
    rows = np.concatenate([np.asarray(one, dtype=int) for one in neighbours])
    far = np.linalg.norm(places[rows] - points[columns], axis=1) / reach[columns]
    shape = np.where((facing[rows] * normals[columns]).sum(axis=1) > SAME_SIDE, np.maximum(1.0 - far**2, 0.0), 0.0)
    force = np.bincount(columns, shape * weights_m2[rows], len(points))
    scale = np.divide(areas_m2, force, out=np.zeros_like(force), where=force > 0.0)
    return sparse.coo_matrix((shape * scale[columns], (rows, columns)), (len(places), len(points))).tocsr()


def _spacing(tree: cKDTree, points: Float, areas_m2: Float) -> Float:
    """Return the root of the mean area of each point and the points around it [m], shape (p,)."""
    own = np.sqrt(areas_m2)
    count = min(CLOSEST, len(points))
    far, who = (part.reshape(len(points), count) for part in tree.query(points, count))
    around = far <= LONGEST * own[:, None]
    return np.asarray(np.sqrt((areas_m2[who] * around).sum(axis=1) / around.sum(axis=1)))


def _shares(
    tree: cKDTree, points: Float, normals: Float, spacing: Float, places: Float, facing: Float
) -> sparse.csr_matrix:
    count = min(NEIGHBOURS, len(points))
    far, chosen = (part.reshape(len(places), count) for part in tree.query(places, count))
    same_side = np.einsum("qkc,qc->qk", normals[chosen], facing) > SAME_SIDE
    far = np.where(same_side, far, np.inf)
    first = far.argmin(axis=1)
    rows = np.arange(len(places))
    step = spacing[chosen[rows, first]]
    flat = _in_plane(points[chosen] - places[:, None], facing) / step[:, None, None]
    corners, shares = _triangle(flat, far <= LONGEST * step[:, None])
    inside = corners[:, 0] >= 0
    outside = ~inside & (far[rows, first] <= DISC * step)
    three = np.take_along_axis(chosen[inside], corners[inside], axis=1)
    row = np.concatenate([np.repeat(rows[inside], 3), rows[outside]])
    column = np.concatenate([three.ravel(), chosen[outside, first[outside]]])
    value = np.concatenate([shares[inside].ravel(), np.ones(int(outside.sum()))])
    return sparse.coo_matrix((value, (row, column)), (len(places), len(points))).tocsr()


def _in_plane(steps: Float, normals: Float) -> Float:
    """Return the two components of vectors (q, k, 3) perpendicular to normals (q, 3), shape (q, k, 2)."""
    helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
    along = np.cross(normals, helper)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along)], axis=1)
    return np.einsum("qkc,qac->qka", steps, axes)


def _triangle(flat: Float, counted: np.ndarray) -> tuple[Int, Float]:
    """Return the corners (q, 3) of the Delaunay triangle that contains 0 and their shares there; -1 if there is none.

    flat: near points, shape (q, k, 2); counted: whether a point may be a corner, (q, k)
    """
    best = np.full(len(flat), np.inf)
    corners, shares = np.full((len(flat), 3), -1), np.zeros((len(flat), 3))
    squared = (flat**2).sum(axis=2)
    cross = flat[:, :, None, 0] * flat[:, None, :, 1] - flat[:, :, None, 1] * flat[:, None, :, 0]
    for a, b, c in itertools.combinations(range(flat.shape[1]), 3):
        parts = np.stack([cross[:, b, c], cross[:, c, a], cross[:, a, b]], axis=1)
        twice = parts.sum(axis=1)
        good = counted[:, a] & counted[:, b] & counted[:, c] & (np.abs(twice) > FLAT)
        parts = np.divide(parts, twice[:, None], out=np.full_like(parts, -1.0), where=good[:, None])
        mean = (parts * squared[:, [a, b, c]]).sum(axis=1)
        better = (parts.min(axis=1) >= -1e-12) & (mean < best)
        best[better], corners[better], shares[better] = mean[better], (a, b, c), parts[better]
    return corners.astype(np.int32), shares
