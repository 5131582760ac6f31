"""Basic operations on triangle meshes for several hand modules. Arrays as in `types.Surface`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from palmfield.errors import PalmfieldError
from palmfield.types import Float, Int

ONES = np.ones(3)
REACHED = 1e-13
"""Products of lengths [mm2] below which a point is at a corner or an edge."""


def checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[Float, Int]:
    """Return vertices [m], shape (n, 3), and faces, shape (m, 3). Raises PalmfieldError for other shapes and NaN."""
    places, triangles = np.asarray(vertices, dtype=float), np.asarray(faces)
    for name, one in (("vertices", places), ("faces", triangles)):
        if one.ndim != 2 or one.shape[1] != 3 or len(one) == 0:
            raise PalmfieldError(f"{name} have shape {one.shape}; give (n, 3), one or more")
    if not np.isfinite(places).all():
        raise PalmfieldError(f"vertex {int(np.argwhere(~np.isfinite(places))[0][0])} is not finite; give metres")
    if triangles.dtype.kind not in "iu" or not 0 <= triangles.min() <= triangles.max() < len(places):
        raise PalmfieldError(
            f"faces are {triangles.dtype} from {triangles.min()} to {triangles.max()}; give vertex numbers from 0, "
            f"below {len(places)}"
        )
    return places, triangles


def face_normals(vertices: Float, faces: Int) -> tuple[Float, Float]:
    """Return unit normals, shape (m, 3), and areas [m2], shape (m,); the normal of a face without area is zero."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    twice = np.linalg.norm(cross, axis=1)
    return cross / np.where(twice > 0.0, twice, 1.0)[:, None], 0.5 * twice


class FaceSamples(NamedTuple):
    """The faces of a mesh as samples of its surface.

    centroids: [m], normals: unit, outward, both of shape (m, 3); a face without area has the normal 0
    areas: [m2], shape (m,)
    """

    centroids: Float
    normals: Float
    areas: Float


def face_samples(vertices: Float, faces: Int) -> FaceSamples:
    """Return centroid, normal and area of each face; for repeated calls use `posed_surface.FaceSampler`.

    vertices: [m], shape (n, 3); faces: shape (m, 3)
    Raises PalmfieldError for other shapes, NaN, and invalid vertex numbers.
    """
    vertices, faces = checked_mesh(vertices, faces)
    normals, areas = face_normals(vertices, faces)
    return FaceSamples(vertices[faces].mean(axis=1), normals, areas)


def signed_areas(points: Float, faces: Int) -> Float:
    """Return the areas of faces in the plane [m2], shape (m,), negative if clockwise; points: shape (n, 2)."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    return 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))


def closest_on_each(triangles: Float, points: Float) -> Float:
    """Return the point of triangle i that is closest to point i [mm], shape (n, 3).

    Ericson 2005, Real-Time Collision Detection, 5.1.5. The result is bitwise that of `trimesh.triangles.closest_point`,
    whose import takes longer than to load a scene. For triangles without area use the function of trimesh.

    triangles: corners [mm], shape (n, 3, 3), as the tolerance at edges is absolute; points: [mm], shape (n, 3)
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, ac = b - a, c - a
    (d1, d2), (d3, d4), (d5, d6) = (((ab * p) @ ONES, (ac * p) @ ONES) for p in (points - a, points - b, points - c))
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    cases = (
        (d1 < REACHED) & (d2 < REACHED),
        (d3 > -REACHED) & (d4 <= d3),
        (vc < REACHED) & (d1 > -REACHED) & (d3 < REACHED),
        (d6 > -REACHED) & (d5 <= d6),
        (vb < REACHED) & (d2 > -REACHED) & (d6 < REACHED),
        (va < REACHED) & (d4 - d3 > -REACHED) & (d5 - d6 > -REACHED),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = d1 / (d1 - d3), d2 / (d2 - d6), (d4 - d3) / ((d4 - d3) + (d5 - d6))
        inside = 1.0 / (va + vb + vc)
        on_ab, on_ac, on_bc = (
            start + share[:, None] * edge for start, share, edge in zip((a, a, b), shares, (ab, ac, c - b), strict=True)
        )
        within = a + ab * (vb * inside)[:, None] + ac * (vc * inside)[:, None]
    return np.select([case[:, None] for case in cases], [a, b, on_ab, c, on_ac, on_bc], within)


def in_triangles(triangles: Float, points: Float) -> Float:
    """Return weights of the second and third corner of triangle i, shape (n, 3, 3), at point i; shape (n, 2)."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    w = points - triangles[:, 0]
    uu, uv, uw, vv, vw = ((p * q) @ ONES for p, q in ((u, u), (u, v), (u, w), (v, v), (v, w)))
    inverse = 1.0 / (uu * vv - uv * uv)
    return np.stack([(vv * uw - uv * vw) * inverse, (uu * vw - uv * uw) * inverse], axis=1)


def volume(vertices: Float, faces: Int) -> float:
    """Return the volume of a closed surface [m3]."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0


def vertex_areas(vertices: Float, faces: Int) -> Float:
    """Return a third of the area of the faces around each vertex [m2], shape (n,)."""
    thirds = np.repeat(face_normals(vertices, faces)[1] / 3.0, 3)
    return np.bincount(faces.ravel(), thirds, minlength=len(vertices)).astype(np.float64)


def vertex_normals(vertices: Float, faces: Int) -> Float:
    """Return unit normals at vertices, with faces weighted by corner angle, shape (n, 3)."""
    unit, _ = face_normals(vertices, faces)
    angles = corner_angles(vertices, faces)
    total = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(total, faces[:, i], unit * angles[:, i, None])
    length = np.linalg.norm(total, axis=1)
    return total / np.where(length > 0.0, length, 1.0)[:, None]


def corner_angles(vertices: Float, faces: Int) -> Float:
    """Return the angle at each corner of each face [rad], shape (m, 3)."""
    corners = vertices[faces]
    out = np.empty(faces.shape)
    for i in range(3):
        u = corners[:, (i + 1) % 3] - corners[:, i]
        v = corners[:, (i + 2) % 3] - corners[:, i]
        out[:, i] = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))
    return out


def directed_edges(faces: Int) -> Int:
    """Return the directed edges of all faces, shape (3 m, 2): first edges of all faces, then second, then third."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def unique_edges(faces: Int) -> tuple[Int, NDArray[np.int64]]:
    """Return undirected edges, shape (e, 2), and the number of faces at each, shape (e,)."""
    key, count = np.unique(_edge_keys(faces), return_counts=True)
    return _edges_of_keys(key, faces), count


def numbered_edges(faces: Int) -> tuple[Int, NDArray[np.int64], NDArray[np.int64]]:
    """Return the edges of `unique_edges`, the edge number of each directed edge, shape (3 m,), and the face counts."""
    key, which, count = np.unique(_edge_keys(faces), return_inverse=True, return_counts=True)
    return _edges_of_keys(key, faces), which, count


def _edge_keys(faces: Int) -> NDArray[np.int64]:
    """Return a sort key of each directed edge, in the order of undirected edges; sorting rows is 20 times slower."""
    directed = directed_edges(faces).astype(np.int64)
    return np.asarray(directed.min(axis=1) * (int(faces.max(initial=0)) + 1) + directed.max(axis=1))


def _edges_of_keys(key: NDArray[np.int64], faces: Int) -> Int:
    return np.stack(np.divmod(key, int(faces.max(initial=0)) + 1), axis=1).astype(faces.dtype)


def edge_lengths(vertices: Float, faces: Int) -> tuple[Int, Float]:
    """Return undirected edges, shape (e, 2), and their lengths [m], shape (e,)."""
    edges, _ = unique_edges(faces)
    return edges, np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)


def on_rim(faces: Int, number: int) -> NDArray[np.bool_]:
    """Return True for vertices of edges with only one face, shape (number,)."""
    edges, count = unique_edges(faces)
    rim = np.zeros(number, dtype=np.bool_)
    rim[edges[count == 1]] = True
    return rim


def adjacency(faces: Int, number: int) -> sparse.csr_array:
    """Return the vertex adjacency as a symmetric 0/1 matrix, shape (number, number)."""
    edges, _ = unique_edges(faces)
    ones = np.ones(len(edges))
    half = sparse.coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(number, number))
    return sparse.csr_array(half + half.T)


def neighbour_mean(values: Float, links: sparse.csr_array) -> Float:
    """Return the mean over the neighbours of each vertex, in the shape of `values`."""
    count = np.asarray(links.sum(axis=1)).reshape((-1,) + (1,) * (values.ndim - 1))
    return (links @ values) / np.maximum(count, 1.0)


def face_components(faces: Int, cut: Int | None = None) -> Int:
    """Return the label of the edge-connected part of each face, shape (m,).

    cut: edges that do not connect their faces, shape (k, 2), the lower vertex first
    """
    edges, count = np.sort(directed_edges(faces), axis=1).astype(np.int64), int(faces.max(initial=0)) + 1
    key, owner = edges[:, 0] * count + edges[:, 1], np.tile(np.arange(len(faces)), 3)
    if cut is not None:
        kept = ~np.isin(key, cut[:, 0].astype(np.int64) * count + cut[:, 1])
        key, owner = key[kept], owner[kept]
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    a, b = owner[order][:-1][same], owner[order][1:][same]
    graph = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(len(faces), len(faces)))
    return sparse.csgraph.connected_components(graph, directed=False)[1]


def largest_part(faces: Int, area: Float) -> NDArray[np.bool_]:
    """Return True for faces of the edge-connected part with the largest area, shape (m,); area: area of each face."""
    label = face_components(faces)
    return label == np.argmax(np.bincount(label, weights=area))


def consistent_winding(faces: Int) -> Int:
    """Flip faces so that neighbours run along their common edge in opposite directions.

    The first face of each part is unchanged. Every edge must have two faces.
    """
    directed, number = directed_edges(faces), len(faces)
    order = np.lexsort(np.sort(directed, axis=1).T[::-1])
    one, other = np.tile(np.arange(number), 3)[order].reshape(-1, 2).T
    forward = (directed[:, 0] < directed[:, 1])[order].reshape(-1, 2)
    # Nodes i and i + number are face i and face i flipped; each is linked to the neighbours with consistent winding
    other = other + np.where(forward[:, 0] == forward[:, 1], number, 0)
    pairs = np.concatenate([one, one + number]), np.concatenate([other, (other + number) % (2 * number)])
    graph = sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(2 * number, 2 * number))
    label = sparse.csgraph.connected_components(graph, directed=False)[1]
    # Parts are numbered by their first node, so that the part with the first face unflipped comes first
    turned = label[:number] > label[number:]
    return np.where(turned[:, None], faces[:, ::-1], faces)


def winding_numbers(vertices: Float, faces: Int, points: Float) -> Float:
    """Return the winding number of a surface about each point, shape (k,): 1 or -1 inside a closed surface, 0 outside,
    between for surfaces with holes (van Oosterom & Strackee 1983; Jacobson et al. 2013, doi 10.1145/2461912.2461916).

    points: shape (k, 3)
    """
    total = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = (vertices[faces[:, k]] - point for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        above = np.vecdot(a, np.cross(b, c))
        below = la * lb * lc + np.vecdot(a, b) * lc + np.vecdot(b, c) * la + np.vecdot(c, a) * lb
        total[i] = np.arctan2(above, below).sum() / (2.0 * np.pi)
    return total
