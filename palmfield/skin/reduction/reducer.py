"""Reduced model of a body between inputs and outputs, accurate over a frequency band; and that of one point.

The start of a load makes a lightly damped skin oscillate at its own frequencies. Only the time course shows this, not
the static response and the response at the main frequency. A reduced model computes all three with one real
factorisation, also for other materials on the same mesh.
"""

import math
from collections.abc import Sequence
from typing import Any

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


class PointModel:
    """Motion of one point under one shape of force.

    projection: the body in the vectors of the model, with force and reading. error: relative, see `point_model`.
    supported: whether the body has a support, so that a static solution exists.
    """

    def __init__(self, projection: Projection, error: float, supported: bool) -> None:
        self.projection, self.error, self.supported = projection, error, supported

    def static(self) -> float:
        """Return the static displacement under the force [m]. Raises SceneError for a body without support."""
        if not self.supported:
            raise SceneError(
                "a static solution needs a support: base and sides leave this body free; bond the base, or fix a side"
            )
        return float(self.projection.moved(0.0, 0.0, [1.0] * len(self.projection.materials))[0].real)

    def harmonic(self, f_Hz: float) -> complex:
        """Return the complex displacement [m] under the force times e^{-i w t}, exact in time."""
        return complex(self.projection.harmonic(f_Hz)[0])

    def discrete(self, f_Hz: float, step_s: float) -> complex:
        """Return the complex displacement [m] in the steady state of WedgeStepper, substeps `step_s` [s]; f_Hz > 0."""
        return complex(self.projection.moved(*discrete_weights(self.projection.materials, f_Hz, step_s))[0])

    def moved(self, level: Float, times: Float) -> Float:
        """Return the displacement [m] at ascending times [s], (t,), exact in time; the body starts at rest.

        level: factor of the force at these times, linear between them, (t,)
        """
        with one_blas_thread:
            return np.asarray(Reduced(self.projection, 0.0).run(level[:, None], times)[0][:, 0], dtype=float)

    def stepped(self, level: Float, step_s: float) -> Float:
        """Return the same as `moved` with the substeps of WedgeStepper, at the ends of steps of `step_s`, (t,)."""
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


def point_model(
    system: SkinSystem,
    force: Float,
    read: Float,
    main_Hz: float,
    highest_Hz: float,
    others: Sequence[SkinSystem] = (),
) -> list[PointModel]:
    """Return models of the motion of a point of a layer under a force, by one real factorisation.

    force: force of the load at full level, (n,) [N]. read: vector that reads the point, (n,).
    main_Hz, highest_Hz: main and highest frequency of the load.
    others: the layer with other materials, on the same mesh with the same conditions. Their models use the same vectors
        and follow that of the layer in the list. Their displacements are within 1 % for moduli of 0.6 to 1.7 times
        those of the layer (tests/skin/test_point_model.py).
    The error is SAFETY times the largest of three changes by the last ROUND or more vectors: of the motion over
    WINDOW_S after a sudden start (L2), of the static displacement, and of the harmonic displacements in BAND. It is
    above TOLERANCE if MOST_VECTORS are not enough. Models are stored in the cache (`palmfield.cache`).
    Raises SceneError for a force or a reading of 0.
    """
    size = float(np.linalg.norm(force))
    if not size > 0.0 or not np.any(read):
        raise SceneError("a point model needs a force and a reading that are not 0")
    unit = np.round(force / size, DIGITS)
    highest_Hz = max(highest_Hz, main_Hz)  # key max_frequency_Hz may be lower than the main frequency
    shares = BAND if main_Hz <= max(BAND) * highest_Hz else (*BAND, 1.0)

    def make() -> cache.Arrays:
        dynamics = DynamicStiffness(system, system.elimination_order())
        krylov = Krylov(dynamics, SHIFT * 2.0 * math.pi * highest_Hz, unit[:, None])
        times: Float = np.linspace(0.0, WINDOW_S, MOMENTS)

        def model() -> PointModel:
            vectors = krylov.vectors
            pushed, seen = vectors.T @ unit[:, None], (read @ vectors)[None]
            return PointModel(Projection(krylov.projected, dynamics.materials, pushed, seen), 0.0, system.supported)

        def trial() -> tuple[Float, Complex]:
            now = model()
            lines: list[complex] = [now.harmonic(share * highest_Hz) for share in shares]
            lines += [now.static()] if system.supported else []
            return now.moved(np.ones(MOMENTS), times), np.array(lines)

        changes = []

        def change(now: tuple[Float, Complex], before: tuple[Float, Complex]) -> float:
            (course, lines), (course_before, lines_before) = now, before
            scale = np.maximum(np.abs(lines), WEAK * np.abs(lines).max())
            of_lines = np.abs(lines - lines_before) / scale
            changes.append(max(float(np.linalg.norm(course - course_before) / np.linalg.norm(course)), *of_lines))
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

    depends_on = system.made_of, [other.made_of for other in others], unit, read, shares, highest_Hz
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
