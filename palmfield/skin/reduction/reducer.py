"""Reduced model of a body between inputs and outputs, accurate over a frequency band; and that of a few points.

The start of a load makes a lightly damped skin oscillate at its own frequencies. Only the time course shows this, not
the static response and the response at the main frequency. A reduced model computes all three with one real
factorisation, also for other materials on the same mesh. A moving focus has many pressures. Matrices are symmetric, so
vectors from a force on the first point represent its motion under all of them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from palmfield import cache
from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.generalised_alpha import RHO_INF, Scheme
from palmfield.skin.fem.linear_body import LinearBody, Matrices, Part
from palmfield.skin.fem.solver import discrete_weights
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import ROUND, SAFETY, SHIFT, Krylov, TooManyVectorsError, grow_until, grown
from palmfield.skin.reduction.reduced import Reduced
from palmfield.types import Complex, Float, Int

WEAK = 0.1
"""Share of the largest response that is the reference for errors of weaker responses."""
WINDOW_S = 0.05
"""Time after a sudden start over which models of two sizes are compared [s]."""
MOMENTS = 256
BAND = 0.25, 0.5
"""Further frequencies of this comparison, over the highest relevant frequency. If the main frequency is above them,
the highest is added."""
TOLERANCE = 5e-3
"""Largest relative error of the motion of the point, in this window and at these frequencies, for a finished model."""
MOST_VECTORS = 240
DIGITS = 12
"""Number of decimal places of a force over its norm: one model is valid for all levels of a force."""


def reduce(
    body: LinearBody,
    inputs: Any,
    outputs: Any,
    band_Hz: tuple[float, float],
    tolerance: float,
    *,
    order: Int | None = None,
    points: int = 64,
    most_vectors: int = 1200,
    beyond: bool = False,
) -> Reduced:
    """Return a reduced model of a body between its inputs and outputs, for any time course of the inputs.

    body: full matrices with n unknowns, such as a SkinSystem.
    inputs: B, force [N] for one unit of each of j inputs, shape (n, j), sparse or dense.
    outputs: Y of the outputs y = Y u [m], shape (k, n).
    band_Hz: lowest and highest frequency at which the model must be accurate, 0 <= low < high.
    tolerance: target relative error of y on a line s = d + i w over the band. 2 d is the spacing of its `points`, which
        is less at low w; sharper resonances are smoothed to this width. The error is relative to the largest response
        at this or a higher frequency, or to WEAK times the largest response of all.
    order: elimination order of the unknowns, shape (n,), for the factor; None: SuperLU chooses.
    beyond: whether to add one more block, so that the model can be the reference for another model.
    Raises SceneError for shapes that do not fit, a tolerance or band outside these ranges, or too small most_vectors.
    """
    forces = np.asarray(inputs.toarray() if sparse.issparse(inputs) else inputs, dtype=float)
    read = sparse.csr_matrix(outputs)
    low, high = band_Hz
    size = body.mass.shape[0]
    if forces.ndim != 2 or forces.shape[0] != size or read.shape[1] != size:
        raise SceneError(f"inputs {forces.shape}, outputs {read.shape}: give ({size}, j) and (k, {size})")
    if not (0.0 <= low < high < np.inf and 0.0 < tolerance < 1.0 and np.isfinite(forces).all()):
        raise SceneError(f"band {band_Hz} Hz, tolerance {tolerance}: need 0 <= low < high, 0 < tolerance < 1, finite B")
    dynamics = DynamicStiffness(body, order)
    krylov = Krylov(dynamics, SHIFT * 2.0 * np.pi * high, forces)
    # Points are dense at low frequencies, where resonances are narrower and unsupported bodies drift
    omega = 2.0 * np.pi * (low + (high - low) * np.linspace(0.0, 1.0, points) ** 3)
    weights = dynamics.weights(0.5 * np.gradient(omega) + 1j * omega)

    def responses() -> Complex:
        """Return Y Z(s)^-1 B of the model along the line, shape (points, k, j)."""
        small = np.tensordot(weights, np.array(krylov.projected), axes=1)
        pushed = (krylov.vectors.T @ forces).astype(complex)
        return (read @ krylov.vectors) @ np.linalg.solve(small, pushed[None])

    def change(now: Complex, before: Complex) -> float:
        seen = np.linalg.norm(now, axis=(1, 2))
        scale = np.maximum(np.maximum.accumulate(seen[::-1])[::-1], WEAK * seen.max())
        if not scale[0] > 0.0:
            raise SceneError("reduced model: the outputs do not move under the inputs: check B and Y")
        return float((np.linalg.norm(now - before, axis=(1, 2)) / scale).max())

    _, error = grow_until(krylov, responses, change, tolerance, most_vectors)
    if beyond:
        grown(krylov, ROUND)
    vectors = krylov.vectors
    return Reduced(Projection(krylov.projected, dynamics.materials, vectors.T @ forces, read @ vectors), error)


class Course(NamedTuple):
    """A load over time: factors of the main force, (t, 1), or of the forces of a path, (t, k), linear between times.

    times: ascending [s], (t,). path: whether the factors are those of the path.
    """

    times: Float
    factors: Float
    path: bool = False


class PointModel:
    """Motion of p points under a main force, and of the first one under k forces of a path.

    projection: the body in the vectors of the model, with forces (r, 1 + k) and readings (p, r).
    error: relative, see `point_model`. supported: whether the body has a support, so that a static solution exists.
    """

    def __init__(self, projection: Projection, error: float, supported: bool) -> None:
        self.projection, self.error, self.supported = projection, error, supported

    def static(self) -> Float:
        """Return the static displacements under the force [m], (p,). Raises SceneError for a body without support."""
        if not self.supported:
            raise SceneError(
                "a static solution needs a support: base and sides leave this body free; bond the base, or fix a side"
            )
        return self.projection.moved(0.0, 0.0, [1.0] * len(self.projection.materials)).real

    def harmonic(self, f_Hz: float) -> Complex:
        """Return the complex displacements [m], (p,), under the force times e^{-i w t}, exact in time."""
        return self.projection.harmonic(f_Hz)

    def of_path(self, f_Hz: float) -> Complex:
        """Return those of the first point under each force of the path, (k,)."""
        small = self.projection
        return replace(small, force=small.read[:1].T, read=small.force[:, 1:].T).harmonic(f_Hz)

    def discrete(self, f_Hz: float, step_s: float) -> Complex:
        """Return the same as `harmonic` in the steady state of WedgeStepper, substeps `step_s` [s]; f_Hz > 0."""
        return self.projection.moved(*discrete_weights(self.projection.materials, f_Hz, step_s))

    def moved(self, course: Course) -> Float:
        """Return displacement [m] and velocity [m/s], (2, t, p), exact in time; the body starts at rest."""
        with one_blas_thread:
            run = Reduced(self._along(course), 0.0).run(course.factors, course.times)
            return np.array(run, dtype=float)

    def stepped(self, course: Course) -> Float:
        """Return the same as `moved` with the substeps of WedgeStepper; the times are the ends of equal substeps."""
        small = self._along(course)
        mass, damping, elastic, *stiffness = (sparse.csr_matrix(matrix) for matrix in small.matrices)
        parts = [Part(each, law) for each, law in zip(stiffness, small.materials, strict=True)]
        scheme = Scheme(Matrices(mass, damping, elastic, parts), course.times[1] - course.times[0], RHO_INF)
        inverse = np.linalg.inv(scheme.effective().toarray())
        pushes = [(inverse @ term.matrix.toarray(), term.row) for term in scheme.terms]
        before, after = course.factors[:-1], course.factors[1:]
        state = np.zeros((scheme.state_rows, len(small.force)))
        seen = np.zeros((2, len(course.times), len(small.read)))
        with one_blas_thread:
            mixed = (scheme.alpha_f * before + (1.0 - scheme.alpha_f) * after) @ (inverse @ small.force).T
            for n, pushed in enumerate(mixed, 1):
                x = pushed
                for matrix, row in pushes:
                    x = x + matrix @ (row @ state)
                state = scheme.advance @ state + np.outer(scheme.follow, x)
                seen[:, n] = state[:2] @ small.read.T
        return seen

    def smaller(self) -> "PointModel":
        """Return the model without its last ROUND vectors."""
        small, count = self.projection, max(len(self.projection.force) - ROUND, 1)
        matrices = [matrix[:count, :count] for matrix in small.matrices]
        less = Projection(matrices, small.materials, small.force[:count], small.read[:, :count])
        return PointModel(less, self.error, self.supported)

    def _along(self, course: Course) -> Projection:
        small, path = self.projection, course.path
        return replace(
            small, force=small.force[:, 1:] if path else small.force[:, :1], read=small.read[: 1 if path else None]
        )


def point_model(
    system: SkinSystem,
    force: Float,
    read: Float,
    main_Hz: float,
    highest_Hz: float,
    others: Sequence[SkinSystem] = (),
    path: Float | None = None,
) -> list[PointModel]:
    """Return models of the motion of points of a layer under a force, by one real factorisation.

    force: force of the load at full level, (n,) [N]. read: vectors that read the points, (p, n), or one, (n,).
    main_Hz, highest_Hz: main and highest frequency of the load.
    others: the layer with other materials, on the same mesh with the same conditions. Their models use the same vectors
        and follow that of the layer in the list. Their displacements are within 1 % for moduli of 0.6 to 1.7 times
        those of the layer (tests/skin/test_point_model.py).
    The error is SAFETY times the largest of three changes by the last ROUND or more vectors: of the motion over
    WINDOW_S after a sudden start, of the static displacement, and of the harmonic displacements in BAND, also under the
    forces of the path. Each is an L2 norm over points, times and forces. The error is above TOLERANCE if MOST_VECTORS
    are not enough. Models are stored in the cache (`palmfield.cache`).
    Raises SceneError for a force or a reading of 0.
    """
    size = float(np.linalg.norm(force))
    if not size > 0.0 or not np.any(read):
        raise SceneError("a point model needs a force and a reading that are not 0")
    read = np.atleast_2d(read)
    unit, along = np.round(force / size, DIGITS), np.zeros((len(force), 0)) if path is None else path / size
    forces = np.column_stack([unit, np.round(along, DIGITS)])
    highest_Hz = max(highest_Hz, main_Hz)  # key max_frequency_Hz may be lower than the main frequency
    shares = BAND if main_Hz <= max(BAND) * highest_Hz else (*BAND, 1.0)

    def make() -> cache.Arrays:
        dynamics = DynamicStiffness(system, system.elimination_order())
        starts = unit[:, None] if path is None else np.column_stack([unit, read[0]])
        krylov = Krylov(dynamics, SHIFT * 2.0 * math.pi * highest_Hz, starts)
        times: Float = np.linspace(0.0, WINDOW_S, MOMENTS)

        def model() -> PointModel:
            vectors = krylov.vectors
            pushed, seen = vectors.T @ forces, read @ vectors
            return PointModel(Projection(krylov.projected, dynamics.materials, pushed, seen), 0.0, system.supported)

        def trial() -> list[Complex]:
            """Return the motion after a sudden start, and the response at rest and at some frequencies."""
            now = model()
            lines: list[Float | Complex] = [now.harmonic(share * highest_Hz) for share in shares]
            lines += [now.static()] if system.supported else []
            paths = [] if path is None else [now.of_path(share * highest_Hz) for share in shares]
            course = now.moved(Course(times, np.ones((MOMENTS, 1))))[0]
            return [np.array(values, dtype=complex) for values in (course, lines, paths)]

        changes = []

        def change(now: list[Complex], before: list[Complex]) -> float:
            (course, *lines), (course_before, *lines_before) = now, before
            found = [float(np.linalg.norm(course - course_before) / np.linalg.norm(course))]
            for mine, others in zip(lines, lines_before, strict=True):
                if len(mine):
                    size = np.linalg.norm(mine, axis=1)
                    of_lines = np.linalg.norm(mine - others, axis=1) / np.maximum(size, WEAK * size.max())
                    found.append(float(of_lines.max()))
            changes.append(max(found))
            return changes[-1]

        with one_blas_thread:
            try:
                _, error = grow_until(krylov, trial, change, TOLERANCE, MOST_VECTORS)
            except TooManyVectorsError:
                error = SAFETY * changes[-1]
        small, vectors = model().projection, krylov.vectors
        result = {
            "matrices": np.array(small.matrices), "force": small.force, "read": small.read, "error": np.array(error),
        }  # fmt: skip
        for number, other in enumerate(others):
            factors = system.scaled_by(other)
            if factors is None:
                of_other = np.array([vectors.T @ (matrix @ vectors) for matrix in DynamicStiffness(other).matrices])
            else:
                of_other = np.array(factors)[:, None, None] * result["matrices"]
            result[f"others_{number}"] = of_other
        return result

    depends_on = system.made_of, [other.made_of for other in others], forces, read, shares, highest_Hz, path is None
    stored = cache.kept("point-model", depends_on, make)
    systems = {"matrices": system} | {f"others_{number}": other for number, other in enumerate(others)}
    return [
        PointModel(
            Projection(list(stored[name]), list(each.materials), size * stored["force"], stored["read"]),
            float(stored["error"]),
            each.supported,
        )
        for name, each in systems.items()
    ]
