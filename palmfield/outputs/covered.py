"""Lower the drawn surface of a body below its skins, so that it neither shows through nor leaves a gap."""

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
"""Largest distance [m] at which a body vertex below a skin counts as covered. Coarse skins deviate from the body."""
EDGE_M = 2e-3
"""Spacing of the skin points to which distances are computed [m]."""
SUNK_M = 4e-3
"""Depth of a covered vertex below the skin [m]; larger than the largest magnified motion. It decreases to the rim."""
SLOPE = 0.3


class Under(NamedTuple):
    """Vertices of a body that skins cover. All arrays have shape (c,).

    vertex: number of each vertex
    skin, node: number of the nearest skin and of its nearest node
    depth_m: displacement of each vertex against the outward normal of this node [m]
    """

    vertex: Int
    skin: Int
    node: Int
    depth_m: Float


def under(points: Float, skins: list[tuple[Float, Int, Float]]) -> Under:
    """Return the vertices of a body that its skins cover, and the depths at which they are drawn.

    points: points of the body at rest [m], shape (n, 3)
    skins: for each skin its nodes [m], shape (s, 3), triangles (f, 3) and outward normals (s, 3)
    The depth is SLOPE times the distance to the rim of the skin, at most SUNK_M. So body and skin meet at the rim.
    """
    found = [Under(*(np.zeros(0, np.int32),) * 3, np.zeros(0))]
    free: NDArray[np.bool_] = np.ones(len(points), np.bool_)
    for number, (nodes, faces, normals) in enumerate(skins):
        over, rim = _dense(nodes, faces)
        # Beyond this distance the search ends without a point, whose number is then that of the points
        away, nearest = cKDTree(over).query(points, distance_upper_bound=COVERED_M)
        # A vertex whose nearest point is on the rim is outside the skin
        vertex = np.flatnonzero(free & (away < COVERED_M) & ~np.append(rim, True)[nearest]).astype(np.int32)
        free[vertex] = False
        node = cKDTree(nodes).query(over[nearest[vertex]])[1].astype(np.int32)
        above = np.einsum("ij,ij->i", points[vertex] - over[nearest[vertex]], normals[node])
        inside = np.full(len(vertex), SUNK_M)
        if rim.any():
            inside = cKDTree(over[rim]).query(points[vertex], distance_upper_bound=SUNK_M / SLOPE)[0]
        depth = np.maximum(above, 0.0) + np.minimum(SLOPE * inside, SUNK_M)
        found.append(Under(vertex, np.full(len(vertex), number, np.int32), node, depth))
    return Under(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def sunk(surface: xr.Dataset, skins: list[xr.Dataset]) -> xr.Dataset:
    """Return the surface of a body whose rest positions are lowered below the skins.

    surface: one of `instances(result, "surface")`
    skins: those of `instances(result, "skin")` that are on the same body
    """
    points: Float = surface["rest_position"].values.astype(float)
    shapes = [(skin["rest_position"].values, skin["face"].values, skin["rest_normal"].values) for skin in skins]
    covered = under(points, shapes)
    for number, (_, _, normals) in enumerate(shapes):
        mine = covered.skin == number
        points[covered.vertex[mine]] -= covered.depth_m[mine, None] * normals[covered.node[mine]]
    return surface.assign(rest_position=surface["rest_position"].copy(data=points))


def smooth_normals(points: Float, faces: Int) -> Float:
    """Return unit normals of vertices, shape (n, 3): angle-weighted means of the normals of adjacent triangles."""
    return np.asarray(trimesh.Trimesh(points, faces, process=False).vertex_normals)


def _dense(vertices: Float, faces: Int) -> tuple[Float, NDArray[np.bool_]]:
    """Return points that cover a mesh densely, and a mask of the points on its rim."""
    points, corners = subdivide_to_size(vertices, faces, EDGE_M)
    points, which = np.unique(points.round(9), axis=0, return_inverse=True)
    corners = which.ravel()[corners]
    return points, on_rim(corners, len(points))
