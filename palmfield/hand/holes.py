"""Boundary loops of a mesh, and faces to close them."""

from collections.abc import Collection, Iterable

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay

from palmfield.hand.region import contains
from palmfield.hand.triangles import adjacency, face_normals, neighbour_mean, unique_edges
from palmfield.types import Float, Int

MOST_JAGGED = 600
"""Most edges of a jagged loop; the time for its triangulation grows with their cube, to some seconds here."""
ROUNDS, HANGING_ROUNDS, LONGEST_SHARE, SLIVER_SHARE = 12, 20, 1.4, 0.2

Pair = tuple[int, int]
Corners = tuple[int, int, int]


def boundary_loops(faces: Int) -> list[Int]:
    """Return the vertices of each boundary loop in order, for any winding of the faces.

    Holes that touch in a vertex give separate loops. Each edge must have one or two faces.
    """
    edges, count = unique_edges(faces)
    onward: dict[int, set[int]] = {}
    for a, b in edges[count == 1].tolist():
        onward.setdefault(a, set()).add(b)
        onward.setdefault(b, set()).add(a)
    loops = []
    for start in onward:
        path = [start]
        # Each vertex has an even number of open edges, so a path ends only at its start
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


def least_area_faces(points: Float, forbidden: Collection[Pair] = ()) -> Int:
    """Return faces over a closed polygon in space with the least area of all triangulations, shape (k - 2, 3).

    points: corners of the polygon in order, shape (k, 3); forbidden: pairs of corner numbers, the lower first, that
    must not become edges. The result is empty if the forbidden pairs allow no triangulation.
    Dynamic programming from short to long spans of the polygon: G. Barequet, M. Sharir, "Filling gaps in the boundary
    of a polyhedron", CAGD 12, 207 (1995). Triangulations of plane polygons (Earcut, GEOS) fail, because the projection
    of a polygon in space may cross itself.
    """
    number = len(points)
    cost, via = np.zeros((number, number)), np.zeros((number, number), dtype=np.int32)
    for gap in range(2, number):
        first = np.arange(number - gap)[:, None]
        last, middle = first + gap, first + np.arange(1, gap)
        side, other = points[middle] - points[first], points[last] - points[first]
        total = 0.5 * np.linalg.norm(np.cross(side, other), axis=2) + cost[first, middle] + cost[middle, last]
        best = np.argmin(total, axis=1)
        rows = first[:, 0]
        cost[rows, rows + gap], via[rows, rows + gap] = total[rows, best], middle[rows, best]
        for i in rows.tolist():
            # The last span is an edge of the polygon
            if gap < number - 1 and (i, i + gap) in forbidden:
                cost[i, i + gap] = np.inf
    if not np.isfinite(cost[0, number - 1]):
        return np.zeros((0, 3), dtype=np.int32)
    faces, spans = [], [(0, number - 1)]
    while spans:
        i, j = spans.pop()
        if j - i > 1:
            k = int(via[i, j])
            faces.append((i, k, j))
            spans += [(i, k), (k, j)]
    return np.array(faces, dtype=np.int32).reshape(-1, 3)


def plane_axes(points: Float) -> Float:
    """Return two axes and the normal of the best plane through points, as rows, shape (3, 3)."""
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]


def cap(points: Float, forbidden: Collection[Pair] = ()) -> tuple[Float, Int] | None:
    """Return inner points, shape (k, 3), and faces that close a loop of n points, with edges about as long as its own.

    points: points of the loop in order, shape (n, 3); forbidden: pairs as for `least_area_faces`
    Faces number the points of the loop 0 ... n - 1 and the inner points from n on. A loop that is smooth along the
    normal of its best plane is filled by a grid in that plane, any other loop by the refined triangulation of least
    area. The result is None if a jagged loop has more than MOST_JAGGED edges or no allowed triangulation.
    """
    flat = _flat_cap(points)
    if flat is not None and not any((a, b) in forbidden for a, b in unique_edges(flat[1])[0].tolist()):
        return flat
    if len(points) > MOST_JAGGED:
        return None
    coarse = least_area_faces(points, forbidden)
    return _finer(points, coarse, forbidden) if len(coarse) else None


def _flat_cap(points: Float) -> tuple[Float, Int] | None:
    """Return a grid in the best plane of the loop, fitted to the loop; None if an edge of the loop is lost."""
    number, axes = len(points), plane_axes(points)
    flat = (points - points.mean(axis=0)) @ axes[:2].T
    step = float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).mean())
    low, high = flat.min(axis=0), flat.max(axis=0)
    rows = np.arange(low[1], high[1], step * np.sqrt(0.75))
    grid = np.array([(x + (i % 2) * step / 2, y) for i, y in enumerate(rows) for x in np.arange(low[0], high[0], step)])
    gap = np.linalg.norm(grid[:, None] - flat, axis=2).min(axis=1)
    inner = grid[(gap > 0.7 * step) & contains(flat, grid)]
    plane = np.concatenate([flat, inner])
    triangles = Delaunay(plane).simplices
    triangles = triangles[contains(flat, plane[triangles].mean(axis=1))].astype(np.int32)
    edges, count = unique_edges(triangles)
    border = np.sort(np.stack([np.arange(number), np.roll(np.arange(number), -1)], axis=1), axis=1)
    if not np.array_equal(np.unique(border, axis=0), edges[count == 1]):
        return None
    return _spanned(points, len(inner), edges), triangles


def _finer(points: Float, faces: Int, forbidden: Collection[Pair]) -> tuple[Float, Int]:
    """Refine a triangulation to the mean edge length of its loop, and fit the new points to the loop."""
    step = float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).mean())
    patch = _Patch(points, faces, forbidden)
    for _ in range(ROUNDS):
        patch.flip()
        patch.cut(LONGEST_SHARE * step)
        patch.hang()
    return patch.points[len(points) :], patch.faces()


class _Patch:
    """Faces over a loop while their inner edges are cut and flipped; `across[a, b]` is the third corner of face a-b."""

    def __init__(self, loop: Float, faces: Int, forbidden: Collection[Pair]) -> None:
        self.points, self.border, self.forbidden = loop, len(loop), forbidden
        self.across = {(f[i], f[(i + 1) % 3]): f[(i + 2) % 3] for f in faces.tolist() for i in range(3)}

    def faces(self) -> Int:
        return np.array([(a, b, c) for (a, b), c in self.across.items() if a < b and a < c], dtype=np.int32)

    def inner_edges(self) -> list[Pair]:
        return [(a, b) for a, b in self.across if a < b and (b, a) in self.across]

    def cut(self, longest: float) -> None:
        """Halve inner edges longer than `longest`, the longest first, each face at most once."""
        edges = np.array(self.inner_edges()).reshape(-1, 2)
        length = np.linalg.norm(self.points[edges[:, 0]] - self.points[edges[:, 1]], axis=1)
        done: set[Pair] = set()
        added: list[Float] = []
        for i in np.argsort(-length):
            a, b = edges[i].tolist()
            if length[i] <= longest:
                break
            c, d = self.across[a, b], self.across[b, a]
            around = {(a, c), (c, b), (b, d), (d, a)}
            if (a, b) in done:
                continue
            middle = len(self.points) + len(added)
            added.append(0.5 * (self.points[a] + self.points[b]))
            self._replace(((a, b, c), (b, a, d)), ((a, middle, c), (middle, b, c), (b, middle, d), (middle, a, d)))
            done |= {(min(e), max(e)) for e in around}
        self.points = np.concatenate([self.points, np.reshape(added, (-1, 3))])

    def flip(self) -> None:
        """Flip inner edges until the opposite angles of each add up to at most 180 degrees (Delaunay)."""
        for _ in range(ROUNDS):
            turned = False
            for a, b in self.inner_edges():
                if (a, b) not in self.across or (b, a) not in self.across:
                    continue
                c, d = self.across[a, b], self.across[b, a]
                forbidden = (min(c, d), max(c, d)) in self.forbidden or (c, d) in self.across or (d, c) in self.across
                if not forbidden and self._angle(c, a, b) + self._angle(d, a, b) > np.pi + 1e-6:
                    self._replace(((a, b, c), (b, a, d)), ((a, d, c), (d, b, c)))
                    turned = True
            if not turned:
                return

    def hang(self) -> None:
        """Move inner points towards the mean of their neighbours; only slivers may change orientation."""
        faces = self.faces()
        links = adjacency(faces, len(self.points))
        for _ in range(HANGING_ROUNDS):
            trial = neighbour_mean(self.points, links)
            trial[: self.border] = self.points[: self.border]
            before, area = face_normals(self.points, faces)
            sliver = area < SLIVER_SHARE * np.median(area)
            while (over := (np.vecdot(face_normals(trial, faces)[0], before) <= 0.0) & ~sliver).any():
                back = np.unique(faces[over])
                if np.array_equal(trial[back], self.points[back]):
                    break
                trial[back] = self.points[back]
            self.points = trial

    def _replace(self, old: Iterable[Corners], new: Iterable[Corners]) -> None:
        for a, b, c in old:
            for edge in ((a, b), (b, c), (c, a)):
                del self.across[edge]
        for a, b, c in new:
            self.across |= {(a, b): c, (b, c): a, (c, a): b}

    def _angle(self, at: int, a: int, b: int) -> float:
        u, v = self.points[a] - self.points[at], self.points[b] - self.points[at]
        return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))


def _spanned(points: Float, inner: int, edges: Int) -> Float:
    """Return the inner points of a membrane over the loop: each point is the mean of its neighbours."""
    number = len(points) + inner
    if inner == 0:
        return np.zeros((0, 3))
    ends = np.concatenate([edges, edges[:, ::-1]])
    links = sparse.csr_array((np.ones(len(ends)), ends.T), shape=(number, number))
    laplacian = sparse.csc_array(sparse.diags_array(links.sum(axis=1)) - links)
    free = np.arange(len(points), number)
    right = -laplacian[free][:, : len(points)] @ points
    return sparse.linalg.splu(sparse.csc_matrix(laplacian[free][:, free])).solve(np.asarray(right))
