"""Shortest path between two points on a triangle mesh.

The edges that the path crosses are found in a graph with points on the edges (M. Lanthier, A. Maheshwari, J.-R. Sack,
Algorithmica 30, 527 (2001)). A path along vertices of these edges is straightened by edge flips with potpourri3d (N.
Sharp, K. Crane, You Can Find Geodesic Paths in Triangle Meshes by Just Flipping Edges, ACM Trans. Graph. 39, 249
(2020)). Flips from the shortest path along edges may give a path round the other side of a body: 6 % longer on a tube.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.hand.triangles import closest_on_each, edge_lengths, numbered_edges
from palmfield.types import Float, Int, Surface

EDGE_POINTS = 5
"""Number of points of the graph on each edge."""

DETOUR = 1.25
"""Width of the search corridor: a path along edges is at most about 1.16 times as long as one across the triangles."""

NEAR = 1e-6
"""Smallest barycentric weight of a point that becomes a vertex; points closer to an edge are moved by some nm."""

CORNER = 1e-12
"""A point closer to a corner than this is replaced by the corner."""

# A piece of path: the face of each straight segment, and the end points of the segments.
Piece = tuple[list[int], list[Float]]


def shortest_way(surface: Surface, start: tuple[int, Float], end: tuple[int, Float], number: int) -> Piece:
    """Return the shortest path between two points (face and position) of a surface.

    number: number of the first point, for messages. Raises SceneError for points on unconnected parts, and for a mesh
    with an edge of more than two faces or neighbours of opposite winding.
    """
    from potpourri3d import EdgeFlipGeodesicSolver

    vertices, faces, (first, last) = _with_places(surface, (start, end))
    if start[0] == end[0] or first == last:
        return [start[0]], [start[1], end[1]]
    nearby = _corridor(surface, start, end, number)
    way = [first]
    for edge in _crossed(surface, nearby, start, end):
        if last in edge:
            break
        if way[-1] not in edge:
            nearest = int(edge[np.argmin(np.linalg.norm(vertices[edge] - vertices[way[-1]], axis=1))])
            # Loops are cut off, because flips stop where a path meets itself
            del way[way.index(nearest) if nearest in way else len(way) :]
            way.append(nearest)
    used, own = np.unique(faces, return_inverse=True)
    try:
        flips = EdgeFlipGeodesicSolver(vertices[used], own.reshape(-1, 3))
    except RuntimeError:
        raise SceneError(
            "no path is found on a mesh with an edge of more than two faces, or neighbours of opposite winding; repair "
            "it first"
        ) from None
    line = flips.find_geodesic_path_poly(np.searchsorted(used, [*way, last]))
    points = [start[1], *line[1:-1], end[1]]
    passed = _faces_at(surface, nearby, 0.5 * (np.array(points[1:]) + np.array(points[:-1])))
    for at, vertex, face in ((0, first, start[0]), (-1, last, end[0])):
        if vertex >= len(surface.vertices):
            passed[at] = face
    return passed, points


def _corridor(surface: Surface, start: tuple[int, Float], end: tuple[int, Float], number: int) -> NDArray[np.int64]:
    """Return the faces that the shortest path can cross, from distances along the edges."""
    vertices, faces = surface.vertices, surface.faces
    edges, length = edge_lengths(vertices, faces)
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
    # Two edge lengths are added, because the ends are inside faces
    within = both <= DETOUR * direct + 2.0 * float(length.max())
    return np.flatnonzero(within[faces].any(axis=1))


def _crossed(surface: Surface, nearby: NDArray[np.int64], start: tuple[int, Float], end: tuple[int, Float]) -> Int:
    """Return the edges that the shortest path through points on edges crosses, shape (n, 2)."""
    faces = surface.faces[nearby]
    edges, which, _ = numbered_edges(faces)
    sides = which.reshape(3, -1).T
    count = EDGE_POINTS
    share = ((np.arange(count) + 0.5) / count)[:, None]
    tails, heads = surface.vertices[edges[:, 0]], surface.vertices[edges[:, 1]]
    points = (tails[:, None] + share * (heads - tails)[:, None]).reshape(-1, 3)
    on_side = count * sides[:, :, None] + np.arange(count)
    # In each face, every point of a side is linked with every point of the other sides
    shape = (len(faces), count, count)
    links = [
        np.stack([np.broadcast_to(on_side[:, i, :, None], shape), np.broadcast_to(on_side[:, j, None, :], shape)])
        for i, j in ((0, 1), (1, 2), (2, 0))
    ]
    for node, (face, position) in enumerate((start, end), start=len(points)):
        visible = on_side[np.flatnonzero(nearby == face)[0]].ravel()
        links.append(np.stack([np.full_like(visible, node), visible]))
        points = np.vstack([points, position])
    a, b = np.concatenate([link.reshape(2, -1) for link in links], axis=1)
    # A length of zero would mean no link in a sparse graph
    length = np.maximum(np.linalg.norm(points[a] - points[b], axis=1), 1e-12)
    graph = sparse.csr_array((length, (a, b)), shape=(len(points), len(points)))
    first, last = len(points) - 2, len(points) - 1
    before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)[1]
    way = [int(before[last])]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return edges[np.array(way[-2::-1]) // count]


def _with_places(surface: Surface, places: tuple[tuple[int, Float], ...]) -> tuple[Float, Int, list[int]]:
    """Return vertices and faces with a new vertex at each place (in different faces), and the numbers of these."""
    from trimesh.triangles import points_to_barycentric

    vertices, faces, numbers = surface.vertices, surface.faces, []
    for face, position in places:
        corners = surface.faces[face]
        weights = points_to_barycentric(surface.vertices[corners][None], position[None], method="cross")[0]
        if weights.max() > 1.0 - CORNER:
            numbers.append(int(corners[weights.argmax()]))
            continue
        weights = np.maximum(weights, NEAR)
        a, b, c = corners
        numbers.append(len(vertices))
        new = np.array([[a, b, numbers[-1]], [b, c, numbers[-1]], [c, a, numbers[-1]]])
        vertices = np.vstack([vertices, weights @ surface.vertices[corners] / weights.sum()])
        faces = np.vstack([faces, new[1:]])
        faces[face] = new[0]
    return vertices, faces, numbers


def _faces_at(surface: Surface, nearby: NDArray[np.int64], points: Float) -> list[int]:
    """Return for each point, shape (n, 3), the nearest of some faces."""
    corners = surface.vertices[surface.faces[nearby]]
    centres = corners.mean(axis=1)
    reach = 1.001 * float(np.linalg.norm(corners - centres[:, None], axis=2).max())
    hits = cKDTree(centres).query_ball_point(points, reach)
    which = np.repeat(np.arange(len(points)), [len(hit) for hit in hits])
    tried = np.concatenate(hits).astype(np.int64)
    # In millimetres, because the tolerance at edges is absolute
    distance = np.linalg.norm(closest_on_each(1e3 * corners[tried], 1e3 * points[which]) - 1e3 * points[which], axis=1)
    order = np.lexsort((distance, which))
    return nearby[tried[order[np.unique(which[order], return_index=True)[1]]]].tolist()
