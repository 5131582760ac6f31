"""Gradient along a surface of values at triangles."""

import numpy as np
from scipy import sparse

from palmfield.hand.triangles import face_normals
from palmfield.types import Complex, Float, Int

CHUNK = 4096
POWERS = [(a, total - a) for total in range(4) for a in range(total + 1)]
"""Exponents of the ten terms of the cubic; (0, 1) and (1, 0) have the numbers 1 and 2."""

NEARNESS = 0.15
LEAST_COSINE = 0.5
"""Faces rotated by 60 deg or more are not used, because the gradient is not continuous across a sharp edge."""

RIDGE = 1e-9


def surface_gradient(vertices: Float, faces: Int, values: Complex) -> Complex:
    """Return the tangential gradient at the centroids [per m], shape (m, 3), of values at the centroids, shape (m,).

    A cubic in the plane of the face is fitted by least squares to two rings of neighbours, where neighbours share a
    vertex. Near faces have larger weights, rotated faces smaller ones. For a wave along the surface with eight
    triangles per wavelength the error is 1 %; a quadratic over one ring would have 6 %.
    """
    count = len(faces)
    ones = np.ones(3 * count, np.float32)
    corner = sparse.csr_array((ones, (np.repeat(np.arange(count), 3), faces.ravel())), shape=(count, len(vertices)))
    ring = sparse.csr_array(corner @ corner.T)
    around = sparse.csr_array(ring @ ring)
    centroids = vertices[faces].mean(axis=1)
    normals, _ = face_normals(vertices, faces)
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    right = np.cross(normals, helper)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(normals, right)
    result = np.empty((count, 3), np.complex128)
    for first in range(0, count, CHUNK):
        rows = np.arange(first, min(first + CHUNK, count))
        size = np.diff(around.indptr)[rows]
        slot = np.arange(size.max())
        valid = slot < size[:, None]
        neighbours = around.indices[np.where(valid, around.indptr[rows][:, None] + slot, around.indptr[rows][:, None])]
        offset = centroids[neighbours] - centroids[rows, None]
        x, y = (np.einsum("nsk,nk->ns", offset, axis[rows]) for axis in (right, up))
        scale = np.sqrt(np.where(valid, x**2 + y**2, 0.0).max(axis=1))
        x, y = x / scale[:, None], y / scale[:, None]
        facing = np.einsum("nsk,nk->ns", normals[neighbours], normals[rows])
        weight = np.where(valid, np.maximum(facing - LEAST_COSINE, 0.0) / (NEARNESS + x**2 + y**2) ** 2, 0.0)
        terms = np.stack([x**a * y**b for a, b in POWERS], axis=2)
        weighted = terms * weight[..., None]
        gram = weighted.transpose(0, 2, 1) @ terms
        gram += RIDGE * np.einsum("naa->n", gram)[:, None, None] * np.eye(len(POWERS))
        moments = weighted.transpose(0, 2, 1) @ np.stack([values[neighbours].real, values[neighbours].imag], axis=2)
        fitted = (np.linalg.solve(gram, moments) @ np.array([1.0, 1j])) / scale[:, None]
        result[rows] = fitted[:, 2, None] * right[rows] + fitted[:, 1, None] * up[rows]
    return result
