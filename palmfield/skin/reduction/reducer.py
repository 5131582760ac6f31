"""The vectors on which a body is reduced: a Krylov space grown until its motion stops changing.

The body moves under real shapes of its load; `palmfield.skin.reduction.krylov` takes one real factorisation for the
whole space. Two criteria decide that it is large enough: the motion under a predicted load (reduced_stepper and
solvers.reduced), or the transfer functions over a band (`reduce`, here).
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.linear_body import LinearBody
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import Krylov
from palmfield.skin.reduction.reduced import Reduced
from palmfield.types import Complex, Int

SHIFT = 0.6
"""Share of the highest relevant angular frequency: with it solutions from 0 to that frequency converge together."""
ROUND = 8
"""Vectors by which two models that are compared differ, at least."""
SAFETY = 1.5
"""Times the last change: with a circle on the palm, on large elements, the true error was up to 1.3 times that."""
WEAK = 0.1
"""Share of the largest response to which the error of weaker ones is related."""

T = TypeVar("T")


class TooManyVectorsError(SceneError):
    """A tolerance that a model of the largest allowed size does not reach. reached: the trial of that model"""

    def __init__(self, message: str, reached: object = None) -> None:
        super().__init__(message)
        self.reached = reached


def grown(krylov: Krylov, vectors: int) -> bool:
    """Grow a space by this number of vectors or more; False where it has ended."""
    target, growing = krylov.order + vectors, True
    while growing and krylov.order < target:
        growing = krylov.grow() > 0
    return growing


def grow_until(
    krylov: Krylov,
    trial: Callable[[], T],
    change: Callable[[T, T], float],
    tolerance: float,
    most_vectors: int,
    residual: Callable[[], float] | None = None,
) -> tuple[T, float]:
    """Grow a Krylov space until models of two sizes agree; return the last trial and its estimated relative error.

    trial: the result of the model of the present size. change: (trial, that of fewer vectors) -> relative difference.
    residual: another estimate, computed once the first is small enough; the larger of the two counts.
    The error is SAFETY times the change by the last ROUND vectors or more. It is above the tolerance only where the
    space ended. Raises TooManyVectorsError if most_vectors don't reach the tolerance.
    """
    before = trial()
    while True:
        growing = grown(krylov, max(ROUND, krylov.order // 6))
        now = trial()
        error = SAFETY * change(now, before)
        if error <= tolerance and residual is not None:
            error = max(error, residual())
        if error <= tolerance or not growing:
            return now, error
        if krylov.order > most_vectors:
            raise TooManyVectorsError(
                f"reduced model of the skin: error {error:.2g} with {krylov.order} vectors, target "
                f"{tolerance:.2g}; use solver 'wedges'",
                now,
            )
        before = now


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
    """Reduced model of a body between its inputs and outputs, for any course of the inputs.

    body: the full matrices, n unknowns, such as a SkinSystem.
    inputs: B, force [N] for one unit of each of j inputs, shape (n, j), sparse or dense.
    outputs: Y of the outputs y = Y u [m], shape (k, n).
    band_Hz: lowest and highest frequency at which the model must be right, 0 <= low < high.
    tolerance: target relative error of y, on a line s = d + i w over the band. 2 d is the spacing of its `points`, less
        at low w: sharper resonances have this width. Relative to the largest response at this or a higher frequency, or
        WEAK times the largest of all.
    order: elimination order of the unknowns, shape (n,), for the factor; None lets SuperLU choose.
    beyond: grow once more after that: the reference for another model then has a smaller error than that model.
    Raises SceneError for shapes that do not fit, a tolerance or band outside these ranges, or no end at most_vectors.
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
    # Resonances are narrower at low frequencies, at which unsupported bodies also drift.
    omega = 2.0 * np.pi * (low + (high - low) * np.linspace(0.0, 1.0, points) ** 3)
    weights = dynamics.weights(0.5 * np.gradient(omega) + 1j * omega)

    def responses() -> Complex:
        """Y Z(s)^-1 B of the model along the line, shape (points, k, j)."""
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
