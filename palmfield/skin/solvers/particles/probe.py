"""Displacement at points of the face from the particles near them."""

import numpy as np
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.skin.problem import in_space
from palmfield.skin.solvers.particles.columns import Columns
from palmfield.types import Float, Int

NEIGHBOURS = 16


def point_weights(columns: Columns, normals: Float, at: Float) -> tuple[Float, Int, Float]:
    """Return the points on the face, and the weights that give their displacement from particles of the face.

    normals: outward area vectors of the particles of the face, shape (f, 3); at: shape (n, 3), or (n, 2) on a flat
    face. Returns points [m] (n, 3), particles (n, k), weights (n, k). The method is moving least squares in the tangent
    plane of the nearest particle, with a quadratic basis. Weights are infinite at a particle (Lancaster & Salkauskas
    1981). So quadratic fields are exact, and so is the displacement of a particle at its own place.
    Raises SceneError for other shapes and points that are not finite or farther from all particles than two spacings.
    """
    points = in_space(at)
    tree = cKDTree(columns.face)
    distance, particles = tree.query(points, k=min(NEIGHBOURS, len(columns.face)))
    far = int(np.argmax(distance[:, 0]))
    if distance[far, 0] > 2.0 * columns.spacing_m:
        raise SceneError(
            f"point {np.round(points[far], 6).tolist()} m is {distance[far, 0]:.3g} m from the face; give points "
            "on the face"
        )
    weights = np.empty(particles.shape)
    for row, (point, near) in enumerate(zip(points, particles, strict=True)):
        normal = normals[near[0]] / np.linalg.norm(normals[near[0]])
        _, _, frame = np.linalg.svd(normal[None])
        flat = (columns.face[near] - point) @ frame[1:].T / columns.spacing_m
        x, y = flat.T
        away = x**2 + y**2
        root = np.exp(-0.5 * away) / (away + 1e-6)
        basis = np.column_stack([np.ones_like(x), x, y, x**2, x * y, y**2])
        # The value at the point is the first coefficient of the weighted fit
        weights[row] = np.linalg.pinv(basis * root[:, None], rcond=1e-9)[0] * root
    return points, particles.astype(np.int32), weights
