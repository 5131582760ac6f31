"""Reduced model of a body between inputs and outputs, with accurate transfer functions over a frequency band."""

from typing import Any

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.linear_body import LinearBody
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import ROUND, SHIFT, Krylov, grow_until, grown
from palmfield.skin.reduction.reduced import Reduced
from palmfield.types import Complex, Int

WEAK = 0.1
"""Share of the largest response that is the reference for errors of weaker responses."""


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
