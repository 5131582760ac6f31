"""Boundary loops of a mesh, and faces that close them."""

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay

from palmfield.hand.triangles import unique_edges
from palmfield.types import Float, Int


def boundary_loops(faces: Int) -> list[Int]:
    """Vertices of each boundary loop in order, whatever the faces' winding.

    Holes that touch in a vertex are loops of their own. Each edge must have one or two faces.
    """
    edges, count = unique_edges(faces)
    onward: dict[int, set[int]] = {}
    for a, b in edges[count == 1].tolist():
        onward.setdefault(a, set()).add(b)
        onward.setdefault(b, set()).add(a)
    loops = []
    for start in onward:
        path = [start]
        # Each vertex has an even number of open edges, so that a walk ends only where it began.
        while onward[path[-1]]:
            here, following = path[-1], min(onward[path[-1]])
            onward[here].remove(following)
            onward[following].remove(here)
            if following in path:
                at = path.index(following)
                loops.append(np.array(path[at:], dtype=np.int32))
                path = path[:at]
            path.append(following)
    return loops


def least_area_faces(points: Float) -> Int:
    """Faces over a short polygon with the smallest area of all triangulations; points: shape (k, 3), k <= 6."""

    def best(first: int, last: int) -> tuple[float, list[tuple[int, int, int]]]:
        if last - first < 2:
            return 0.0, []
        options = []
        for k in range(first + 1, last):
            left, right = best(first, k), best(k, last)
            own = 0.5 * float(np.linalg.norm(np.cross(points[k] - points[first], points[last] - points[first])))
            options.append((left[0] + right[0] + own, [*left[1], *right[1], (first, k, last)]))
        return min(options)

    return np.array(best(0, len(points) - 1)[1], dtype=np.int32).reshape(-1, 3)


def plane_axes(points: Float) -> Float:
    """Rows: two axes of the best plane through points, and its normal, shape (3, 3)."""
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]


def cap(points: Float) -> tuple[Float, Int] | None:
    """Inner points, shape (k, 3), and faces that close a loop of n points, with edges as long as the loop's.

    points: the loop in order, shape (n, 3). Faces name its points 0 ... n - 1 and the inner ones from n on. None where
    the loop, seen along the normal of its best plane, is too jagged to be triangulated.
    """
    number, axes = len(points), plane_axes(points)
    flat = (points - points.mean(axis=0)) @ axes[:2].T
    step = float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).mean())
    low, high = flat.min(axis=0), flat.max(axis=0)
    rows = np.arange(low[1], high[1], step * np.sqrt(0.75))
    grid = np.array([(x + (i % 2) * step / 2, y) for i, y in enumerate(rows) for x in np.arange(low[0], high[0], step)])
    gap = np.linalg.norm(grid[:, None] - flat, axis=2).min(axis=1)
    inner = grid[(gap > 0.7 * step) & _inside(grid, flat)]
    plane = np.concatenate([flat, inner])
    triangles = Delaunay(plane).simplices
    triangles = triangles[_inside(plane[triangles].mean(axis=1), flat)].astype(np.int32)
    edges, count = unique_edges(triangles)
    border = np.sort(np.stack([np.arange(number), np.roll(np.arange(number), -1)], axis=1), axis=1)
    if not np.array_equal(np.unique(border, axis=0), edges[count == 1]):
        return None
    return _spanned(points, len(inner), edges), triangles


def _spanned(points: Float, inner: int, edges: Int) -> Float:
    """Inner points of a membrane hung into the loop: each at the mean of its neighbours."""
    number = len(points) + inner
    if inner == 0:
        return np.zeros((0, 3))
    ends = np.concatenate([edges, edges[:, ::-1]])
    links = sparse.csr_array((np.ones(len(ends)), ends.T), shape=(number, number))
    laplacian = sparse.csc_array(sparse.diags_array(links.sum(axis=1)) - links)
    free = np.arange(len(points), number)
    right = -laplacian[free][:, : len(points)] @ points
    return sparse.linalg.splu(sparse.csc_matrix(laplacian[free][:, free])).solve(np.asarray(right))


def _inside(points: Float, polygon: Float) -> np.ndarray:
    """Whether points of the plane lie in a polygon: a ray to +x crosses its sides an odd number of times."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    between = (a[:, 1] > points[:, 1, None]) != (b[:, 1] > points[:, 1, None])
    rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
    x = a[:, 0] + (points[:, 1, None] - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return ((between & (points[:, 0, None] < x)).sum(axis=1) % 2).astype(np.bool_)
