"""Triangles whose centroids are the samples for the force on a body; their number follows from the target accuracy."""

from typing import NamedTuple

import numpy as np
import scipy  # which loads its parts when they are used
from scipy import sparse

from palmfield import cache
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.hand.triangles import face_normals
from palmfield.types import Float, Int

A_FACE, BY_DEFAULT = 0.004, 0.006
CELLS_m = {BY_DEFAULT: 4.2e-3, 0.012: 6e-3}
"""Accuracies at which the samples get coarser: below A_FACE four per face (error 0.0015), from A_FACE one per face, and
from the keys of CELLS_m one per cell of this spacing. The errors are those of the force, rms over foci on the lit side
of a shipped hand, and of the torque over force times mean arm (scripts/bench/force_samples.py,
docs/bench/force_samples.md)."""
ROUNDS = 24  # of Lloyd's iteration, which makes the cells about equal so that their errors average out
NEIGHBOURS, KERNEL_m, KERNEL_TURN, ROUGH, SIDE_m = 32, 6e-3, 1.0, 0.01, 8e-3
"""Interpolation of the ARP between samples: number of samples per face, length of the Gaussian kernel along the surface
and between unit normals, share of the variance that differs from face to face, and distance equivalent to a difference
of 1 between normals in the search for samples."""
AT_ONCE = 256  # faces that are interpolated together: their arrays fit the cache of a processor
MOST_STORED = 32
_stored: dict[str, "SampleMesh"] = {}


class SampleMesh(NamedTuple):
    """Sample triangles: points [m], shape (v, 3), and corners, shape (n, 3).

    The ARP of a face is a weighted mean over samples. For each pair of face and sample, shape (k,): faces: number of
    the face; samples: number of the sample; areas: weighted area of the face [m2]
    """

    points: Float
    corners: Int
    faces: Int
    samples: Int
    areas: Float


def sample_count(areas: Float, accuracy: float) -> int:
    """Estimate the number of samples that `sample_mesh` returns for faces of these areas [m2], shape (m,)."""
    if accuracy < A_FACE:
        return 4 * len(areas)
    spacing_m = _spacing_m(accuracy)
    return len(areas) if spacing_m == 0.0 else _cell_count(areas, spacing_m)


def _spacing_m(accuracy: float) -> float:
    """Return the spacing of cells [m]; 0 if each face is a sample."""
    return max((spacing for least, spacing in CELLS_m.items() if accuracy >= least), default=0.0)


def _cell_count(areas: Float, spacing_m: float) -> int:
    return min(max(round(float(areas.sum()) / (np.sqrt(0.75) * spacing_m**2)), 1), len(areas))


def sample_mesh(vertices: Float, faces: Int, accuracy: float) -> SampleMesh:
    """Return the samples for the force on a surface with edges up to `palmfield.hand.subdivide.EDGE_m`.

    vertices: [m], shape (v, 3); faces: shape (m, 3); accuracy: target relative error of the force
    """
    spacing_m = _spacing_m(accuracy)
    if spacing_m == 0.0:
        areas, parts, points, corners = face_normals(vertices, faces)[1], 1, vertices, faces
        if accuracy < A_FACE:
            from trimesh.remesh import subdivide

            parts, (points, corners) = 4, subdivide(vertices, faces)
        numbers: Int = np.arange(len(corners), dtype=np.int32)
        return SampleMesh(points, corners, numbers // parts, numbers, np.repeat(areas / parts, parts))
    of = vertices, faces, spacing_m
    key = cache.digest(*of)
    samples = _stored.get(key)
    if samples is None:
        if len(_stored) >= MOST_STORED:
            _stored.clear()
        made = cache.kept("force-samples", of, lambda: _sparse(*of))
        samples = _stored[key] = SampleMesh(*(made[name] for name in SampleMesh._fields))
    return samples


def _sparse(vertices: Float, faces: Int, spacing_m: float) -> cache.Arrays:
    """Return one sample per cell of a spacing [m], weighted by its share in the ARP interpolated over the surface."""
    normals, areas = face_normals(vertices, faces)
    places = vertices[faces].mean(axis=1)
    # Rounded, so that cells do not depend on the rounding errors of a processor
    owner = _cells(np.round(places, 9), np.round(normals, 6), areas, spacing_m)
    middles, outward, _ = _means(owner, areas, places, normals)
    # The mean of a cell is below a convex surface, so it is moved onto the surface, where no face shades it
    corners = vertices[np.sort(faces[closest_faces(build_mesh(vertices, faces), middles, 1.0)], axis=1)]
    middles = np.einsum("nk,nkd->nd", barycentric(corners, middles), corners)
    away = corners - middles[:, None]
    farthest = np.round(np.linalg.norm(away, axis=2), 9).argmax(axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-30)[:, None]
    shares = _interpolation(middles, outward, places, normals)
    pushes: Float = shares.T @ (areas[:, None] * normals)
    points, triangles = _triangles(middles, pushes, away[np.arange(len(away)), farthest])
    of = shares.tocoo()
    face: Int = of.row.astype(np.int32)
    numbers = face, of.col.astype(np.int32), of.data * areas[face]
    return dict(zip(SampleMesh._fields, (points, triangles, *numbers), strict=True))


def _interpolation(samples: Float, outward: Float, places: Float, normals: Float) -> sparse.csr_array:
    """Return the weights that interpolate values from samples to places, shape (places, samples), rows of sum 1.

    The interpolation is a Gaussian process of unknown mean over points [m] and unit normals, all of shape (n, 3).
    """
    count = min(NEIGHBOURS, len(samples))
    tree = scipy.spatial.cKDTree(np.concatenate([samples, SIDE_m * outward], axis=1))
    near = tree.query(np.concatenate([places, SIDE_m * normals], axis=1), count)[1].reshape(len(places), count)
    at, around = (
        np.concatenate([p / KERNEL_m, n / KERNEL_TURN], axis=1) for p, n in ((places, normals), (samples, outward))
    )
    shares = np.empty(near.shape)
    for start in range(0, len(places), AT_ONCE):
        block = slice(start, start + AT_ONCE)
        gaps = around[near[block]] - at[block, None]
        products = gaps @ gaps.swapaxes(1, 2)
        squares = np.einsum("nkk->nk", products)
        system = np.ones((len(gaps), count + 1, count + 1))
        between = products - 0.5 * (squares[:, :, None] + squares[:, None])
        system[:, :-1, :-1] = np.exp(between) + ROUGH * np.eye(count)
        system[:, -1, -1] = 0.0
        right = np.ones((len(gaps), count + 1, 1))
        right[:, :-1, 0] = np.exp(-0.5 * squares)
        shares[block] = np.linalg.solve(system, right)[:, :-1, 0]
    starts = np.arange(0, shares.size + 1, count)
    return sparse.csr_array((shares.ravel(), near.ravel(), starts), shape=(len(places), len(samples)))


def _cells(points: Float, normals: Float, areas: Float, spacing_m: float) -> Int:
    """Return the cell of each face, shape (n,). Centres form a honeycomb; both sides of a thin web have own cells."""
    places = np.concatenate([points, spacing_m * normals], axis=1)
    columns = np.ascontiguousarray(places.T)
    seeds, gap = [int(np.argmax(areas))], np.full(len(points), np.inf)
    for _ in range(_cell_count(areas, spacing_m) - 1):
        np.minimum(gap, np.square(columns - columns[:, seeds[-1:]]).sum(axis=0), out=gap)
        seeds.append(int(np.argmax(gap)))
    centres: Float = places[seeds]
    for _ in range(ROUNDS):
        owner = scipy.spatial.cKDTree(centres).query(places)[1]
        centres = _means(np.unique(owner, return_inverse=True)[1].astype(np.int32), areas, places)[0]
    return np.unique(scipy.spatial.cKDTree(centres).query(places)[1], return_inverse=True)[1].astype(np.int32)


def _means(owner: Int, areas: Float, *values: Float) -> list[Float]:
    """Return area-weighted means of values over the faces of each owner, shapes (c, k), and the areas, shape (c, 1)."""
    sizes: Float = np.bincount(owner, areas).astype(np.float64)[:, None]
    sums = [np.stack([np.bincount(owner, areas * row) for row in value.T], axis=1) for value in values]
    return [*(one / np.maximum(sizes, 1e-30) for one in sums), sizes]


def _triangles(middles: Float, areas: Float, towards: Float) -> tuple[Float, Int]:
    """Return equilateral triangles about points [m] with given area vectors [m2], all of shape (n, 3).

    towards: direction of the first corner; it makes the triangles of a mirrored surface mirror images
    """
    size = np.linalg.norm(areas, axis=1)[:, None]
    normals = areas / np.maximum(size, 1e-30)
    first = towards - np.add.reduce(towards * normals, axis=1)[:, None] * normals
    first *= np.sqrt(size / np.sqrt(27.0 / 16.0)) / np.linalg.norm(first, axis=1)[:, None]
    second = np.sqrt(0.75) * np.cross(normals, first)
    points = middles[:, None] + np.stack([first, second - 0.5 * first, -second - 0.5 * first], axis=1)
    return points.reshape(-1, 3), np.arange(3 * len(middles), dtype=np.int32).reshape(-1, 3)
