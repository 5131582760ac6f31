"""Check a mesh for boundary elements (closed, outward, fine enough), and close an open patch."""

import warnings
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import PalmfieldError
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.triangles import directed_edges, face_normals, vertex_normals
from palmfield.types import Float, Int

LEAST_ELEMENTS_PER_WAVELENGTH = 6.0
DEPTH_PER_WAVELENGTH = 0.125
DEPTH_PER_THICKNESS = 0.25


def checked(vertices: ArrayLike, faces: ArrayLike) -> tuple[Float, Int]:
    """Return vertices [m], shape (v, 3), and faces, shape (m, 3), of a closed mesh with outward faces.

    Raises PalmfieldError for other shapes, numbers that are not finite, invalid vertex numbers, faces without area, an
    open mesh, and faces that point inwards.
    """
    points = np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(faces, dtype=np.int32)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise PalmfieldError(f"mesh vertices have shape {points.shape}: give finite numbers of shape (v, 3), in metres")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise PalmfieldError(f"mesh faces have shape {triangles.shape}: give (m, 3), m > 0")
    if triangles.min() < 0 or triangles.max() >= len(points):
        worst = triangles.max() if triangles.max() >= len(points) else triangles.min()
        raise PalmfieldError(f"a mesh face names vertex {worst}; allowed: 0 to {len(points) - 1}")
    areas = face_normals(points, triangles)[1]
    if not areas.min() > 0.0:
        raise PalmfieldError(f"mesh face {int(areas.argmin())} has no area: remove it or merge its vertices")
    directed = directed_edges(triangles).astype(np.int64)
    keys, counts = np.unique(directed[:, 0] * len(points) + directed[:, 1], return_counts=True)
    turned = keys % len(points) * len(points) + keys // len(points)
    alone = int(np.count_nonzero(~np.isin(turned, keys)))
    if alone or counts.max() > 1:
        raise PalmfieldError(
            f"mesh is open or wound inconsistently ({alone} edges without an opposite one): scattering needs a closed "
            "surface; close a patch with palmfield.acoustics.bem_mesh.closed"
        )
    volume = float(trimesh.Trimesh(points, triangles, process=False).volume)
    if volume <= 0.0:
        raise PalmfieldError(f"mesh has the volume {volume:.3g} m3, so its faces point inwards: reverse their corners")
    return points, triangles


def mean_edge_m(vertices: Float, faces: Int) -> float:
    """Return the mean length of the edges [m]."""
    ends = vertices[directed_edges(faces)]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())


def elements_per_wavelength(vertices: Float, faces: Int, wavenumber: float) -> float:
    """Return wavelength over mean edge; warn (UserWarning) if it is below LEAST_ELEMENTS_PER_WAVELENGTH."""
    elements = 2.0 * np.pi / wavenumber / mean_edge_m(vertices, faces)
    if elements < LEAST_ELEMENTS_PER_WAVELENGTH:
        warnings.warn(
            f"mesh has {elements:.1f} elements per wavelength; allowed: {LEAST_ELEMENTS_PER_WAVELENGTH:g} or more: "
            f"use edges shorter than {2e3 * np.pi / wavenumber / LEAST_ELEMENTS_PER_WAVELENGTH:.2g} mm",
            stacklevel=3,
        )
    return elements


def inner_points(vertices: Float, faces: Int, wavenumber: float) -> Float:
    """Return a point under the centroid of each face [m], shape (m, 3), a wavelength/8 deep, less in thin parts."""
    normals, _ = face_normals(vertices, faces)
    centroids = vertices[faces].mean(axis=1)
    depth = DEPTH_PER_WAVELENGTH * 2.0 * np.pi / wavenumber
    thickness = exit_distances(vertices, faces, centroids, -normals, depth / DEPTH_PER_THICKNESS)
    return centroids - np.minimum(depth, DEPTH_PER_THICKNESS * thickness)[:, None] * normals


def closed(vertices: Float, faces: Int, thickness_m: float) -> tuple[Float, Int, NDArray[np.bool_]]:
    """Close an open patch to a plate, by a copy `thickness_m` behind it along the inward normals, and rim walls.

    vertices: [m], shape (v, 3). faces: shape (m, 3), counter-clockwise seen from outside.
    Returns vertices, faces (those of the patch first), and True on the faces of the patch.
    Raises PalmfieldError for a thickness that is not positive, and for a patch without a rim.
    """
    if not thickness_m > 0.0:
        raise PalmfieldError(f"thickness_m = {thickness_m} must be positive: give the depth of the plate [m]")
    directed = directed_edges(faces).astype(np.int64)
    keys = directed[:, 0] * len(vertices) + directed[:, 1]
    rim = directed[~np.isin(directed[:, 1] * len(vertices) + directed[:, 0], keys)]
    if len(rim) == 0:
        raise PalmfieldError("the mesh has no rim, so it is already closed: use it unchanged")
    count = len(vertices)
    layers = max(1, round(thickness_m / mean_edge_m(vertices, faces)))
    inward = -vertex_normals(vertices, faces)
    rim_vertices = np.unique(rim)
    place = np.full(count, -1)
    place[rim_vertices] = np.arange(len(rim_vertices))
    rings = [rim_vertices]
    points = [vertices, vertices + thickness_m * inward]
    for layer in range(1, layers):
        points.append(vertices[rim_vertices] + (thickness_m * layer / layers) * inward[rim_vertices])
        rings.append(2 * count + (layer - 1) * len(rim_vertices) + np.arange(len(rim_vertices)))
    rings.append(rim_vertices + count)
    walls = []
    for upper, lower in pairwise(rings):
        a, b = place[rim[:, 0]], place[rim[:, 1]]
        walls += [np.stack([upper[b], upper[a], lower[a]], axis=1), np.stack([upper[b], lower[a], lower[b]], axis=1)]
    whole = np.concatenate([faces, faces[:, ::-1] + count, *walls]).astype(np.int32)
    return np.concatenate(points), whole, np.arange(len(whole)) < len(faces)
