"""Pressures that a class of loads is made of, and the few points of a skin that tell them apart.

The sound of given arrays on a piece of skin varies no faster than half a wavelength, so that all pressures that it can
make there are sums of some hundred shapes: the leading singular vectors of examples. As many numbers tell which sum it
is, so that the pressure need not be computed at every point of the quadrature: empirical interpolation (Barrault et
al., C. R. Math. 339, 2004) takes the points, by the pivots of an LU factorisation, here more of them than shapes and
with least squares between them.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from palmfield.errors import SceneError
from palmfield.types import Float, Int

POINTS = 2
"""Points for each shape: the fit then adds less than half of what the shapes themselves leave out."""

CLOSENESS = 0.3
"""Of the tolerance, what the examples that are taken may leave out of the others."""


@dataclass(frozen=True)
class LoadShapes:
    """A class of pressures on the points of a skin's quadrature.

    shapes: orthonormal over the skin's area [1/m], shape (m, q); sizes: rms share of each in the examples, (m,)
    points: numbers of the points at which a pressure is looked at, rising, shape (p,)
    fit: what a pressure at these points is made of: shares = fit @ pressure, shape (m, p)
    """

    shapes: Float
    sizes: Float
    points: Int
    fit: Float


def load_shapes(examples: Float, weights: Float, tolerance: float) -> LoadShapes:
    """Shapes whose sums come within a tolerance of examples, rms over all of them.

    examples: pressures [Pa], shape (t, q); weights: areas for which the points stand [m^2], shape (q,)
    Raises SceneError where nothing sounds in the examples, or a number is not finite.
    """
    if not np.isfinite(examples).all():
        raise SceneError("examples of a load are not finite: mend what computes them")
    size = float(np.einsum("tq,q,tq->", examples, weights, examples))
    if not size > 0.0:
        raise SceneError("the arrays' sound does not reach the skin: no class of loads to be made of it")
    rooted = examples * np.sqrt(weights)
    basis, shares = _basis(rooted, (CLOSENESS * tolerance) ** 2)
    values, turn = np.linalg.eigh(shares.T @ shares)
    values, turn = values[::-1], turn[:, ::-1]
    left_out = np.sqrt(np.maximum(1.0 - np.cumsum(values) / size, 0.0))
    count = min(int(np.searchsorted(-left_out, -tolerance)) + 1, int((values > 1e-12 * values[0]).sum()))
    flat = _orthonormal(turn[:, :count].T @ basis)
    points, shapes = _telling_points(flat), flat / np.sqrt(weights)
    turned, triangle = np.linalg.qr(shapes[:, points].T)
    fit = np.asarray(linalg.solve_triangular(triangle, turned.T), dtype=np.float64)
    return LoadShapes(shapes, np.sqrt(values[:count] / len(examples)), points, fit)


def _telling_points(shapes: Float) -> Int:
    """Columns that tell shapes (m, q) apart, rising: POINTS times as many as shapes, each time of what is left."""
    left = np.arange(shapes.shape[1])
    chosen: list[Int] = []
    for _ in range(POINTS):
        _, exchanged = linalg.lu_factor(shapes[:, left].T, check_finite=False)
        rows = np.arange(len(left))
        for row, other in enumerate(exchanged):
            rows[[row, other]] = rows[[other, row]]
        pivots = rows[: len(shapes)]
        chosen.append(left[pivots].astype(np.int32))
        left = np.delete(left, pivots)
    return np.sort(np.concatenate(chosen))


def _basis(rows: Float, left_out: float) -> tuple[Float, Float]:
    """Orthonormal sums of some of the rows (t, q), shape (r, q), and what of them all rows are but for a part of their
    squares, (t, r): of many rows that are alike few are needed, those that a pivoted Cholesky factorisation takes."""
    products = rows @ rows.T
    squares = np.diagonal(products)
    enough = max(left_out * squares.mean(), len(rows) * np.finfo(float).eps * squares.max())
    lower, pivots, rank, _ = lapack.dpstrf(products, tol=enough, lower=1)
    lower = np.tril(lower)[:, :rank]
    shares = np.empty_like(lower)
    shares[pivots - 1] = lower
    return linalg.solve_triangular(lower[:rank], rows[pivots[:rank] - 1], lower=True), shares


def _orthonormal(rows: Float) -> Float:
    """Rows that are orthonormal but for round-off, without it."""
    return np.asarray(linalg.solve_triangular(np.linalg.cholesky(rows @ rows.T), rows, lower=True), dtype=np.float64)
