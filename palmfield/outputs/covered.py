"""What of a body is seen beside the skins that lie on it."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide_to_size

from palmfield.types import Float, Int

COVERED_M = 4e-3
"""A body's vertex nearer than this to the inside of its skin is covered by it: coarse skins cut corners."""
EDGE_M = 2e-3
"""So close together are the points of the skin that distances are taken to."""


def uncovered_faces(surface: xr.Dataset, skins: list[xr.Dataset]) -> Int:
    """Triangles of a body's surface on which none of its skins lies, shape (n, 3).

    surface: of `instances(result, "surface")`; skins: of `instances(result, "skin")`, on the same body
    """
    faces: Int = surface["face"].values
    if not skins:
        return faces
    points: Float = surface["rest_position"].values
    covered: NDArray[np.bool_] = np.zeros(len(points), np.bool_)
    for skin in skins:
        over, rim = _dense(skin["rest_position"].values, skin["face"].values)
        away, nearest = cKDTree(over).query(points)
        # What is nearest to the skin's rim lies beside the skin
        covered |= (away < COVERED_M) & ~rim[nearest]
    return faces[~covered[faces].all(axis=1)]


def _dense(vertices: Float, faces: Int) -> tuple[Float, NDArray[np.bool_]]:
    """Points all over a mesh, and which of them lie on its rim."""
    points, corners = subdivide_to_size(vertices, faces, EDGE_M)
    points, which = np.unique(points.round(9), axis=0, return_inverse=True)
    corners = which.ravel()[corners]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    single, uses = np.unique(edges, axis=0, return_counts=True)
    rim: NDArray[np.bool_] = np.zeros(len(points), np.bool_)
    rim[single[uses == 1]] = True
    return points, rim
