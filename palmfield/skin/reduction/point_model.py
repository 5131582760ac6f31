"""Motion of one point of a skin under one pressure with any level over time: a reduced model of time courses.

The start of a load makes a lightly damped skin ring at its own frequencies. The responses at rest and at the main
frequency do not show this. The time course shows it; a reduced model computes it with one factorisation.
"""

import math

import numpy as np
from scipy import sparse

from palmfield import cache
from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.generalised_alpha import RHO_INF, Scheme
from palmfield.skin.fem.linear_body import Matrices, Part
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import Krylov
from palmfield.skin.reduction.reduced import Projection, Reduced
from palmfield.skin.reduction.reducer import SAFETY, SHIFT, TooManyVectorsError, grow_until
from palmfield.types import Float

WINDOW_S = 0.05
"""Time after a sudden start in which models of two sizes are compared [s]."""
MOMENTS = 256
TOLERANCE = 5e-3
"""Relative error of the motion of the point in that window at which the model is large enough."""
MOST_VECTORS = 240


class PointModel:
    """Motion of one point under one shape of force.

    projection: the body in the vectors of the model, with that force and reading. error: relative, see `point_model`.
    supported: whether the body has a support at rest.
    """

    def __init__(self, projection: Projection, error: float, supported: bool) -> None:
        self.projection, self.error, self.supported = projection, error, supported

    def static(self) -> float:
        """Return the static displacement under the force [m]. Raises SceneError for a body without support."""
        if not self.supported:
            raise SceneError(
                "a static solution needs a support: neither base nor sides hold this body; bond the base, or fix a side"
            )
        _, _, elastic, *stiffness = self.projection.matrices
        moved = np.linalg.solve(elastic + sum(stiffness), self.projection.force[:, 0])
        return float((self.projection.read @ moved)[0])

    def moved(self, level: Float, times: Float) -> Float:
        """Displacement [m] at times [s], rising, (t,), from rest at the first, exact in time.

        level: factor of the force at these times, linear between them, (t,)
        """
        with one_blas_thread:
            return np.asarray(Reduced(self.projection, 0.0).run(level[:, None], times)[0][:, 0], dtype=float)

    def stepped(self, level: Float, step_s: float) -> Float:
        """Return `moved` computed by the substeps of WedgeStepper, at the ends of steps of `step_s`, (t,)."""
        mass, damping, elastic, *stiffness = (sparse.csr_matrix(matrix) for matrix in self.projection.matrices)
        parts = [Part(each, law) for each, law in zip(stiffness, self.projection.materials, strict=True)]
        scheme = Scheme(Matrices(mass, damping, elastic, parts), step_s, RHO_INF)
        force, read = self.projection.force[:, 0], np.asarray(self.projection.read)[0]
        inverse = np.linalg.inv(scheme.effective().toarray())
        pushes = [(inverse @ term.matrix.toarray(), term.row) for term in scheme.terms]
        pushed = inverse @ force
        state = np.zeros((scheme.state_rows, len(force)))
        seen = np.zeros(len(level))
        with one_blas_thread:
            for n in range(1, len(level)):
                mixed = scheme.alpha_f * level[n - 1] + (1.0 - scheme.alpha_f) * level[n]
                x = mixed * pushed
                for matrix, row in pushes:
                    x = x + matrix @ (row @ state)
                state = scheme.advance @ state + np.outer(scheme.follow, x)
                seen[n] = read @ state[0]
        return seen


def point_model(system: SkinSystem, force: Float, read: Float, highest_Hz: float) -> PointModel:
    """Make the model of the motion of a point of a layer under a force, by one real factorisation.

    force: of the load at full level, (n,) [N]. read: of the point, (n,). highest_Hz: highest relevant frequency.
    The error is SAFETY times the change of the motion by the last ROUND vectors or more, over WINDOW_S after a sudden
    start, L2 over the window; above TOLERANCE if MOST_VECTORS don't reach it. Kept in the cache
    (`palmfield.cache`).
    Raises SceneError for a force or a reading of 0.
    """
    if not np.any(force) or not np.any(read):
        raise SceneError("a point model needs a force and a reading that are not 0")

    def make() -> cache.Arrays:
        dynamics = DynamicStiffness(system, system.elimination_order())
        krylov = Krylov(dynamics, SHIFT * 2.0 * math.pi * highest_Hz, force[:, None])
        times: Float = np.linspace(0.0, WINDOW_S, MOMENTS)

        def model() -> PointModel:
            vectors = krylov.vectors
            pushed, seen = vectors.T @ force[:, None], (read @ vectors)[None]
            return PointModel(Projection(krylov.projected, dynamics.materials, pushed, seen), 0.0, system.supported)

        def trial() -> Float:
            return model().moved(np.ones(MOMENTS), times)

        changes = []

        def change(now: Float, before: Float) -> float:
            changes.append(float(np.linalg.norm(now - before) / np.linalg.norm(now)))
            return changes[-1]

        with one_blas_thread:
            try:
                _, error = grow_until(krylov, trial, change, TOLERANCE, MOST_VECTORS)
            except TooManyVectorsError:
                error = SAFETY * changes[-1]
        small = model().projection
        return {
            "matrices": np.array(small.matrices), "force": small.force, "read": small.read, "error": np.array(error),
        }  # fmt: skip

    known = cache.kept("point-model", (system.made_of, force, read, highest_Hz), make)
    projection = Projection(list(known["matrices"]), list(system.materials), known["force"], known["read"])
    return PointModel(projection, float(known["error"]), system.supported)
