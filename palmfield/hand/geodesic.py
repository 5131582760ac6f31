"""Shortest path between two places of a triangle mesh.

A graph with points on the edges finds the triangles that it crosses (M. Lanthier, A. Maheshwari, J.-R. Sack,
Algorithmica 30, 527 (2001)); laid flat, they are a corridor in which the shortest path is found exactly (D. T. Lee, F.
P. Preparata, Networks 14, 393 (1984), the funnel).
"""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from palmfield.errors import SceneError
from palmfield.hand.triangles import directed_edges, unique_edges
from palmfield.types import Float, Int, Surface

EDGE_POINTS = 5
FINE_EDGE_POINTS = 15
"""Points of the graph on each edge: in the whole corridor, and in the triangles about the first path."""

DETOUR = 1.25
"""Corridor of the search: along edges a path is at most about 1.16 times as long as straight across the triangles."""

# A piece of path: the face of each straight segment, and the points, one more than segments.
Piece = tuple[list[int], list[Float]]


def shortest_way(surface: Surface, start: tuple[int, Float], end: tuple[int, Float], number: int) -> Piece:
    """Return the shortest path between two places (face and position) of a surface."""
    if start[0] == end[0]:
        return [start[0]], [start[1], end[1]]
    nearby = _corridor(surface, start, end, number)
    edges, _ = _crossings(surface, nearby, start, end, EDGE_POINTS)
    # Moving the crossings cannot take the path to a vertex's other side; a finer graph does if that is shorter
    about = np.flatnonzero(np.isin(surface.faces, edges).any(axis=1))
    edges, faces = _crossings(surface, about, start, end, FINE_EDGE_POINTS)
    left, right = _sides(surface, edges, faces[0])
    crossings = _straightened(surface.vertices, left, right, start[1], end[1])
    return faces, [start[1], *crossings, end[1]]


def _corridor(surface: Surface, start: tuple[int, Float], end: tuple[int, Float], number: int) -> NDArray[np.int64]:
    """Return faces that the shortest path can cross, by distances along the edges."""
    vertices, faces = surface.vertices, surface.faces
    edges, _ = unique_edges(faces)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    count = len(vertices)
    graph = sparse.csr_array((np.maximum(length, 1e-12), (edges[:, 0], edges[:, 1])), shape=(count, count))
    away = []
    for face, position in (start, end):
        corners = faces[face]
        ways = dijkstra(graph, directed=False, indices=corners)
        away.append((ways + np.linalg.norm(vertices[corners] - position, axis=1)[:, None]).min(axis=0))
    both = away[0] + away[1]
    direct = float(both.min())
    if not math.isfinite(direct):
        raise SceneError(
            f"waypoints {number} and {number + 1} lie on unconnected parts of the mesh; connect the parts, or "
            "choose other waypoints"
        )
    # Two edges more, since the ends lie within faces
    within = both <= DETOUR * direct + 2.0 * float(length.max())
    return np.flatnonzero(within[faces].any(axis=1))


def _crossings(
    surface: Surface, nearby: NDArray[np.int64], start: tuple[int, Float], end: tuple[int, Float], count: int
) -> tuple[Int, list[int]]:
    """Edges that the shortest path over `count` points an edge crosses, shape (n, 2), and the n + 1 faces between."""
    faces = surface.faces[nearby]
    edges, which = np.unique(np.sort(directed_edges(faces), axis=1), axis=0, return_inverse=True)
    sides = which.reshape(3, -1).T
    share = ((np.arange(count) + 0.5) / count)[:, None]
    tails, heads = surface.vertices[edges[:, 0]], surface.vertices[edges[:, 1]]
    points = (tails[:, None] + share * (heads - tails)[:, None]).reshape(-1, 3)
    on_side = count * sides[:, :, None] + np.arange(count)
    # Between each two sides of each face, every point with every point
    shape = (len(faces), count, count)
    links = [
        np.stack([np.broadcast_to(on_side[:, i, :, None], shape), np.broadcast_to(on_side[:, j, None, :], shape)])
        for i, j in ((0, 1), (1, 2), (2, 0))
    ]
    for node, (face, position) in enumerate((start, end), start=len(points)):
        sight = on_side[np.flatnonzero(nearby == face)[0]].ravel()
        links.append(np.stack([np.full_like(sight, node), sight]))
        points = np.vstack([points, position])
    a, b = np.concatenate([link.reshape(2, -1) for link in links], axis=1)
    # A start on an edge point is at distance zero, which a sparse graph would treat as no link
    length = np.maximum(np.linalg.norm(points[a] - points[b], axis=1), 1e-12)
    graph = sparse.csr_array((length, (a, b)), shape=(len(points), len(points)))
    first, last = len(points) - 2, len(points) - 1
    before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)[1]
    way = [int(before[last])]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    crossed = np.array(way[-2::-1]) // count
    passed = [start[0]]
    for one, other in pairwise(crossed):
        passed.append(int(nearby[np.flatnonzero((sides == one).any(axis=1) & (sides == other).any(axis=1))[0]]))
    return edges[crossed], [*passed, end[0]]


def _sides(surface: Surface, edges: Int, first: int) -> tuple[list[int], list[int]]:
    """Return vertices of the crossed edges to the left and to the right of the path, from its first face on."""
    face = surface.faces[first].tolist()
    one, other = edges[0].tolist()
    # In a face the corners go round counter-clockwise: one that leaves it has the edge's second corner on its left
    if face[(face.index(one) + 1) % 3] != other:
        one, other = other, one
    left, right = [other], [one]
    for edge in edges[1:].tolist():
        new = edge[0] if edge[0] not in (left[-1], right[-1]) else edge[1]
        kept_left = left[-1] in edge
        left.append(left[-1] if kept_left else new)
        right.append(new if kept_left else right[-1])
    return left, right


def _straightened(vertices: Float, left: list[int], right: list[int], start: Float, end: Float) -> list[Float]:
    """Return points at which the shortest path through a strip of triangles crosses its edges [m], shape (3,) each."""
    flat_left, flat_right, flat_start, flat_end = _laid_flat(vertices, left, right, start, end)
    gates = [(flat_start, flat_start), *zip(flat_left, flat_right, strict=True), (flat_end, flat_end)]
    corners = _funnel(gates)
    points = []
    for (low, a), (high, b) in pairwise(corners):
        for gate in range(low + 1, high + 1):
            if gate > len(left):
                continue
            one, other = gates[gate]
            share = _share(one, other, a, b) if gate < high else float(abs(b - one) > abs(b - other))
            tail, head = vertices[left[gate - 1]], vertices[right[gate - 1]]
            points.append(tail + share * (head - tail))
    return points


def _laid_flat(
    vertices: Float, left: list[int], right: list[int], start: Float, end: Float
) -> tuple[list[complex], list[complex], complex, complex]:
    """Lay both sides of a strip, start and end, into its plane, as complex numbers."""

    def place(point: Float, low: int, high: int, at_l: complex, at_r: complex, beyond: float) -> complex:
        edge, there = vertices[high] - vertices[low], point - vertices[low]
        squared = float(edge @ edge)
        along = float(there @ edge) / squared
        height = math.sqrt(max(float(there @ there) / squared - along**2, 0.0))
        # Ahead is a quarter turn counter-clockwise from left to right
        return at_l + (at_r - at_l) * complex(along, beyond * height)

    flat_left = [0j]
    flat_right = [complex(float(np.linalg.norm(vertices[right[0]] - vertices[left[0]])), 0.0)]
    flat_start = place(start, left[0], right[0], flat_left[0], flat_right[0], -1.0)
    for (old_l, new_l), (old_r, new_r) in zip(pairwise(left), pairwise(right), strict=True):
        at_l, at_r = flat_left[-1], flat_right[-1]
        flat_left.append(at_l if new_l == old_l else place(vertices[new_l], old_l, old_r, at_l, at_r, 1.0))
        flat_right.append(at_r if new_r == old_r else place(vertices[new_r], old_l, old_r, at_l, at_r, 1.0))
    flat_end = place(end, left[-1], right[-1], flat_left[-1], flat_right[-1], 1.0)
    return flat_left, flat_right, flat_start, flat_end


def _turn(a: complex, b: complex, c: complex) -> float:
    """Twice the signed area of a triangle, positive if c is left of the line from a to b."""
    u, v = b - a, c - a
    return u.real * v.imag - u.imag * v.real


def _same(a: complex, b: complex) -> bool:
    """Whether two points [m] coincide within rounding; the sign of the area is then undefined."""
    return abs(a - b) < 1e-12


def _funnel(gates: list[tuple[complex, complex]]) -> list[tuple[int, complex]]:
    """Corners of the shortest path through gates (left, right), each with its gate; the first and last are points."""
    apex = left = right = gates[0][0]
    left_gate = right_gate = 0
    corners = [(0, apex)]
    gate = 1
    while gate < len(gates):
        new_left, new_right = gates[gate]
        if _same(right, apex) or _turn(apex, right, new_right) >= 0.0:
            if _same(right, apex) or _same(left, apex) or _turn(apex, left, new_right) < 0.0:
                right, right_gate = new_right, gate
            else:
                corners.append((left_gate, left))
                apex, right, right_gate, gate = left, left, left_gate, left_gate + 1
                continue
        if _same(left, apex) or _turn(apex, left, new_left) <= 0.0:
            if _same(left, apex) or _same(right, apex) or _turn(apex, right, new_left) > 0.0:
                left, left_gate = new_left, gate
            else:
                corners.append((right_gate, right))
                apex, left, left_gate, gate = right, right, right_gate, right_gate + 1
                continue
        gate += 1
    return [*corners, (len(gates) - 1, gates[-1][0])]


def _share(one: complex, other: complex, a: complex, b: complex) -> float:
    """Return where the line from a to b crosses a gate, 0..1; the end nearer to a if it runs along it."""
    before, after = _turn(a, b, one), _turn(a, b, other)
    if abs(before - after) < 1e-12 * abs(b - a) * abs(other - one):
        return float(abs(a - one) > abs(a - other))
    return min(max(before / (before - after), 0.0), 1.0)
