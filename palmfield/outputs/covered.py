"""Lower a body beneath its skins for drawing, so that it neither shows through them nor leaves a gap."""

from typing import NamedTuple

import numpy as np
import trimesh
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide_to_size

from palmfield.hand.triangles import on_rim
from palmfield.types import Float, Int

COVERED_M = 4e-3
"""Distance within which a skin covers a body's vertex on its inner side: coarse skins cut corners."""
EDGE_M = 2e-3
"""Spacing of the points of the skin to which distances are computed."""
SUNK_M = 4e-3
"""Depth of a covered vertex below the skin: more than the largest magnified push. It decreases to the skin's rim."""
SLOPE = 0.3


class Under(NamedTuple):
    """Vertices of a body that skins cover. All of shape (c,).

    vertex: their numbers; skin, node: the skin and its node nearest to each
    depth_m: how far each is moved against that node's outward normal [m]
    """

    vertex: Int
    skin: Int
    node: Int
    depth_m: Float


def under(points: Float, skins: list[tuple[Float, Int, Float]]) -> Under:
    """Return the vertices of a body that its skins cover, and the depths at which they are drawn.

    points: the body's at rest [m], (n, 3); skins: nodes [m] (s, 3), triangles (f, 3) and outward normals (s, 3) of each
    Depth grows from 0 at a skin's rim by SLOPE of the distance to it, up to SUNK_M, so that body and skin meet there.
    """
    found = [Under(*(np.zeros(0, np.int32),) * 3, np.zeros(0))]
    free: NDArray[np.bool_] = np.ones(len(points), np.bool_)
    for number, (nodes, faces, normals) in enumerate(skins):
        over, rim = _dense(nodes, faces)
        away, nearest = cKDTree(over).query(points)
        # A vertex nearest to the rim is outside the skin
        vertex = np.flatnonzero(free & (away < COVERED_M) & ~rim[nearest]).astype(np.int32)
        free[vertex] = False
        node = cKDTree(nodes).query(over[nearest[vertex]])[1].astype(np.int32)
        above = np.einsum("ij,ij->i", points[vertex] - over[nearest[vertex]], normals[node])
        inside = cKDTree(over[rim]).query(points[vertex])[0] if rim.any() else np.full(len(vertex), SUNK_M)
        depth = np.maximum(above, 0.0) + np.minimum(SLOPE * inside, SUNK_M)
        found.append(Under(vertex, np.full(len(vertex), number, np.int32), node, depth))
    return Under(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def sunk(surface: xr.Dataset, skins: list[xr.Dataset]) -> xr.Dataset:
    """Return a body's surface with rest positions lowered where skins cover it.

    surface: of `instances(result, "surface")`; skins: of `instances(result, "skin")`, on the same body
    """
    points: Float = surface["rest_position"].values.astype(float)
    shapes = [(skin["rest_position"].values, skin["face"].values, skin["rest_normal"].values) for skin in skins]
    covered = under(points, shapes)
    for number, (_, _, normals) in enumerate(shapes):
        mine = covered.skin == number
        points[covered.vertex[mine]] -= covered.depth_m[mine, None] * normals[covered.node[mine]]
    return surface.assign(rest_position=surface["rest_position"].copy(data=points))


def smooth_normals(points: Float, faces: Int) -> Float:
    """Unit normals of vertices, shape (n, 3): the mean of adjacent triangles' normals, weighted by angle."""
    return np.asarray(trimesh.Trimesh(points, faces, process=False).vertex_normals)


def _dense(vertices: Float, faces: Int) -> tuple[Float, NDArray[np.bool_]]:
    """Return points all over a mesh, and which of them are on its rim."""
    points, corners = subdivide_to_size(vertices, faces, EDGE_M)
    points, which = np.unique(points.round(9), axis=0, return_inverse=True)
    corners = which.ravel()[corners]
    return points, on_rim(corners, len(points))
