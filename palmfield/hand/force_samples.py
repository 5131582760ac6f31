"""Triangles whose centroids are the samples for the force on a body, in the number that an accuracy needs."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide

from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.hand.triangles import face_normals
from palmfield.types import Float, Int

A_FACE = 0.006
CELLS_m = {0.0075: 3.5e-3, 0.013: 4.5e-3}
"""Below A_FACE faces are cut in four (0.0015), from it on each face is a sample, and from these on each cell of faces,
by the spacing of cells. Values are errors of the force, root mean square over foci on the lit side of a shipped hand,
and of the torque over the force times the mean arm: scripts/bench/force_samples.py measures them,
docs/bench/force_samples.md has the figures."""
ROUNDS = 24  # of Lloyd's iteration: errors of cells average out if their sizes are about equal


class SampleMesh(NamedTuple):
    """Triangles, of which each is a sample: points [m], shape (v, 3), and corners, shape (n, 3).

    faces, samples: which faces of the surface go with which samples; areas: that those share [m2]; all of shape (k,)
    """

    points: Float
    corners: Int
    faces: Int
    samples: Int
    areas: Float


def sample_mesh(vertices: Float, faces: Int, accuracy: float) -> SampleMesh:
    """Return samples for the force on a surface of short edges (`palmfield.hand.subdivide.EDGE_m`) to a relative error.

    vertices: [m], shape (v, 3); faces: shape (m, 3)
    """
    numbers: Int = np.arange(len(faces), dtype=np.int32)
    normals, areas = face_normals(vertices, faces)
    if accuracy < A_FACE:
        points, corners = subdivide(vertices, faces)
        cut = np.arange(len(corners), dtype=np.int32)
        return SampleMesh(points, corners, cut // 4, cut, np.repeat(0.25 * areas, 4))
    spacing_m = max((spacing for least, spacing in CELLS_m.items() if accuracy >= least), default=0.0)
    if spacing_m == 0.0:
        return SampleMesh(vertices, faces, numbers, numbers, areas)
    middles = vertices[faces].mean(axis=1)
    owner = _cells(middles, normals, areas, spacing_m)
    middles, mean_normals, sizes = _means(owner, areas, middles, normals)
    # The middle of a cell is below a curved surface, where the body's own faces would shade it
    corners = vertices[faces[closest_faces(build_mesh(vertices, faces), middles, 1.0)]]
    middles = np.einsum("nk,nkd->nd", barycentric(corners, middles), corners)
    return SampleMesh(*_triangles(middles, sizes * mean_normals), numbers, owner, areas)


def _cells(points: Float, normals: Float, areas: Float, spacing_m: float) -> Int:
    """Return the cell of each face, shape (n,): centres form a honeycomb, on one side of a thin web each."""
    places = np.concatenate([points, spacing_m * normals], axis=1)
    count = min(max(round(float(areas.sum()) / (np.sqrt(0.75) * spacing_m**2)), 1), len(points))
    seeds, gap = [int(np.argmax(areas))], np.full(len(points), np.inf)
    for _ in range(count - 1):
        np.minimum(gap, np.square(places - places[seeds[-1]]).sum(axis=1), out=gap)
        seeds.append(int(np.argmax(gap)))
    centres: Float = places[seeds]
    for _ in range(ROUNDS):
        owner = cKDTree(centres).query(places)[1]
        centres = _means(np.unique(owner, return_inverse=True)[1].astype(np.int32), areas, places)[0]
    return np.unique(cKDTree(centres).query(places)[1], return_inverse=True)[1].astype(np.int32)


def _means(owner: Int, areas: Float, *values: Float) -> list[Float]:
    """Return means of values over the area of each owner's faces, shapes (c, k), and these areas, shape (c, 1)."""
    sizes: Float = np.bincount(owner, areas).astype(np.float64)[:, None]
    sums = [np.stack([np.bincount(owner, areas * row) for row in value.T], axis=1) for value in values]
    return [*(one / np.maximum(sizes, 1e-30) for one in sums), sizes]


def _triangles(middles: Float, areas: Float) -> tuple[Float, Int]:
    """Equilateral triangles round points [m] with areas as vectors along their normals [m2], both of shape (n, 3)."""
    size = np.linalg.norm(areas, axis=1)[:, None]
    normals = areas / np.maximum(size, 1e-30)
    first = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
    first *= np.sqrt(size / np.sqrt(27.0 / 16.0)) / np.linalg.norm(first, axis=1)[:, None]
    second = np.sqrt(0.75) * np.cross(normals, first)
    points = middles[:, None] + np.stack([first, second - 0.5 * first, -second - 0.5 * first], axis=1)
    return points.reshape(-1, 3), np.arange(3 * len(middles), dtype=np.int32).reshape(-1, 3)
