"""Motion of a layer under the acceleration of the bones that carry it, in their frame.

In the frame of a bone every part of the layer has the load -rho (a + alpha x r + omega x (omega x r)). These are twelve
fixed nodal forces for each bone, times numbers that change in time (`palmfield.motion.rates.FrameRates.numbers`). The
Coriolis load -2 rho omega x u', gravity, and the change of the loads by the displacement are left out.
"""

import numpy as np
from scipy import sparse

from palmfield import cache
from palmfield.blas import one_blas_thread
from palmfield.motion.rates import PAIRS
from palmfield.skin.fem.assembly import SkinSystem, element_matrices
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.reduced import Reduced
from palmfield.skin.reduction.reducer import reduce
from palmfield.types import Float

HIGHEST_Hz, TOLERANCE = 200.0, 1e-3
"""Highest frequency at which the model must be right, far above that of hands, and its relative error up to there."""
LINES = 8
"""Number of frequencies at which models of two sizes are compared."""
FIELDS = 3 + 3 + len(PAIRS)


def rigid_fields(points: Float) -> Float:
    """Return the accelerations of points by each of `FrameRates.numbers`, shape (n, 3, FIELDS); points: [m], (n, 3)."""
    unit, result = np.eye(3), np.zeros((len(points), 3, FIELDS))
    result[:, :, :3] = unit
    for i in range(3):
        result[:, :, 3 + i] = np.cross(unit[i], points)
    for number, (i, j) in enumerate(PAIRS, start=6):
        if i == j:
            result[:, :, number] = unit[i] * points[:, i : i + 1] - points
        else:
            result[:, :, number] = unit[i] * points[:, j : j + 1] + unit[j] * points[:, i : i + 1]
    return result


def inertial_forces(system: SkinSystem, shares: Float) -> Float:
    """Return the nodal forces [N] by the numbers of each bone, shape (n, bones * FIELDS).

    shares: weight of each bone at each node of the surface, which applies to all nodes below it, shape (bones, S)
    """
    mesh, rows = system.mesh, system.made_of[1]
    densities = np.repeat([row.density_kg_m3 for row in rows], len(mesh.surface_triangles6))
    blocks = densities[:, None, None] * element_matrices(mesh)[2]
    across = np.broadcast_to(mesh.elements[:, :, None], blocks.shape)
    places = across.ravel(), across.swapaxes(1, 2).ravel()
    mass = sparse.coo_matrix((blocks.ravel(), places), shape=(len(mesh.nodes),) * 2).tocsr()
    fields = rigid_fields(mesh.nodes)
    below = np.tile(shares, mesh.levels)
    moved = np.concatenate([of_bone[:, None, None] * fields for of_bone in below], axis=2)
    forces = (mass @ moved.reshape(len(moved), -1)).reshape(3 * len(moved), -1)
    return np.asarray(-(system.dof_map.T @ forces))


def inertial_model(system: SkinSystem, shares: Float, read: sparse.csr_matrix) -> Reduced:
    """Return the reduced model from the numbers of the bones to what an operator reads (k, n); shares: see above.

    Stored in the cache (`palmfield.cache`). Raises SceneError like `reduce`.
    """

    def make() -> cache.Arrays:
        with one_blas_thread:
            model = reduce(
                system, inertial_forces(system, shares), read, (0.0, HIGHEST_Hz), TOLERANCE,
                order=system.elimination_order(), points=LINES,
            )  # fmt: skip
        small = model.small
        parts = {"matrices": np.array(small.matrices), "force": small.force, "read": np.asarray(small.read)}
        return parts | {"error": np.array(model.error)}

    made = cache.kept("inertia", (system.made_of, shares, read, HIGHEST_Hz, TOLERANCE, LINES), make)
    small = Projection(list(made["matrices"]), list(system.materials), made["force"], made["read"])
    return Reduced(small, float(made["error"]))
