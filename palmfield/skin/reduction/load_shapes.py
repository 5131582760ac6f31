"""Pressure shapes that span a class of loads, and the few points of a skin that determine their shares.

The sound of given arrays on a skin hardly varies over less than half a wavelength. So all its pressures are sums of
some hundred shapes: the leading singular vectors of examples. A pressure is computed only at few points, because these
values determine the shares of the shapes. Pivoted QR chooses the points (empirical interpolation: Barrault et al., C.
R. Math. 339, 2004; QR: Drmac & Gugercin, SIAM J. Sci. Comput. 38, 2016). Here there are more points than shapes, and
the shares follow by least squares.
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.errors import SceneError
from palmfield.interrupts import left_by_interrupts
from palmfield.threads import in_parts
from palmfield.types import Float, Float32, Int

POINTS = 2
"""Number of points per shape: the error of the fit is then less than half of the error due to omitted shapes."""

MANY = 400
"""Number of shapes from which LU replaces pivoted QR: QR then takes seconds, and LU a tenth of this time."""
BLOCK = 2048
"""Number of points converted to double precision at a time."""
ROWS = 512
"""Number of rows of a product that a thread computes at a time."""
CLOSENESS = 0.003
"""Largest share of the tolerance that may be outside the initial examples of the search for singular vectors."""
SPARE, TURNS = 1.25, 3
"""Number of initial examples over the number that just reaches the tolerance; and number of products with all examples.
These products rotate the span so close to the singular vectors that the points are the same as for exact vectors."""
LEVEL = 0.005
"""Largest relative difference of neighbouring singular values that count as equal; of equal values all stay or none."""
TIE = 1e-3
"""Relative reduction of the weight from first to last point, so that rounding does not choose between equal points."""


@dataclass(frozen=True)
class LoadShapes:
    """A class of pressures on the quadrature points of a skin.

    shapes: orthonormal over the area of the skin [1/m], shape (m, q). sizes: rms share of each in the examples, (m,).
    points: numbers of the points at which a pressure is evaluated, ascending, shape (p,).
    fit: matrix from pressures at these points to shares, shape (m, p).
    """

    shapes: Float
    sizes: Float
    points: Int
    fit: Float


def load_shapes(examples: Float | Float32, weights: Float, tolerance: float, points: int = POINTS) -> LoadShapes:
    """Return shapes whose sums approximate examples within a relative tolerance, rms over all examples.

    examples: pressures [Pa], shape (t, q), in single or double precision.
    weights: areas of the points [m^2], shape (q,). points: number of points per shape, at most all points.
    Raises SceneError for examples without sound, or with a number that is not finite.
    """
    if not np.isfinite(examples).all():
        raise SceneError("sample loads are not finite: correct their source")
    root = np.sqrt(weights)
    products = _products(examples, root)
    size = float(np.trace(products))
    if not size > 0.0:
        raise SceneError("the sound of the arrays does not reach the skin, so there are no sample loads for modes")
    values, turn = left_by_interrupts(partial(_leading, products, tolerance))
    omitted = np.sqrt(np.maximum(1.0 - np.cumsum(values) / size, 0.0))
    most = int((values > 1e-12 * values[0]).sum())
    count = in_gap(np.sqrt(np.maximum(values[:most], 0.0)), int(np.searchsorted(-omitted, -tolerance)) + 1)
    flat = np.empty((count, len(root)))

    def combine(part: slice) -> None:
        flat[:, part] = turn[:, :count].T @ (examples[:, part] * root[part])

    in_parts(len(root), BLOCK, combine)
    flat = _orthonormal(flat / np.sqrt(values[:count, None]))
    chosen, shapes = _telling_points(flat, points), flat / root
    turned, triangle = np.linalg.qr(shapes[:, chosen].T)
    fit = np.asarray(scipy.linalg.solve_triangular(triangle, turned.T), dtype=np.float64)
    return LoadShapes(shapes, np.sqrt(values[:count] / len(examples)), chosen, fit)


def in_gap(sizes: Float, count: int) -> int:
    """Return the least number >= count after which the next of the descending sizes, (n,), is smaller by LEVEL.

    Symmetric bodies have pairs of equal sizes; rounding would decide which of a pair is kept.
    """
    while count < len(sizes) and sizes[count] > (1.0 - LEVEL) * sizes[count - 1]:
        count += 1
    return min(count, len(sizes))


def _telling_points(shapes: Float, times: int) -> Int:
    """Return times * m columns, ascending, that separate shapes (m, q); each round chooses m remaining columns."""
    shapes = shapes * (1.0 - TIE * np.arange(shapes.shape[1]) / shapes.shape[1])
    left = np.arange(shapes.shape[1])
    chosen: list[Int] = []
    for _ in range(times):
        pivots = _pivots(shapes[:, left])[: len(shapes)]
        chosen.append(left[pivots].astype(np.int32))
        left = np.delete(left, pivots)
    return np.sort(np.concatenate(chosen))


def _pivots(shapes: Float) -> Int:
    """Return the columns of shapes (m, q), the best first, by QR; from MANY shapes on by LU (faster, less good)."""
    if len(shapes) < MANY:
        return np.asarray(scipy.linalg.qr(shapes, mode="r", pivoting=True, check_finite=False)[1])
    _, exchanged = scipy.linalg.lu_factor(shapes.T, check_finite=False)
    rows = np.arange(shapes.shape[1], dtype=np.int32)
    for row, other in enumerate(exchanged):
        rows[[row, other]] = rows[[other, row]]
    return rows


def _products(examples: Float | Float32, root: Float) -> Float:
    """Return the products, (t, t), of all pairs of examples (t, q) with weights root**2 (q,), by blocks of points."""
    products: Float = np.zeros((len(examples), len(examples)))

    def multiply(rows: slice) -> None:
        for start in range(0, len(root), BLOCK):
            points = slice(start, start + BLOCK)
            block = examples[: rows.stop, points] * root[points]
            products[rows, : rows.stop] += block[rows] @ block.T
        products[: rows.stop, rows] = products[rows, : rows.stop].T

    in_parts(len(products), ROWS, multiply)
    return products


def _multiply(left: Float, right: Float, result: Float, rows: slice) -> None:
    np.matmul(left[rows], right, out=result[rows])


def _leading(products: Float, tolerance: float) -> tuple[Float, Float]:
    """Return the leading eigenvalues, descending, (r,), and eigenvectors, (t, r), of a matrix of products (t, t).

    There are more of them than the tolerance needs. The method is subspace iteration that begins with the columns of a
    pivoted Cholesky factorisation.
    """
    squares = np.diagonal(products)
    enough = max((CLOSENESS * tolerance) ** 2 * squares.mean(), len(squares) * np.finfo(float).eps * squares.max())
    # The matrix is symmetric, and its transpose has the layout for LAPACK
    lower, pivots, rank, _ = scipy.linalg.lapack.dpstrf(products.T, tol=enough, lower=1)
    lower = np.tril(lower[:, :rank])
    left = 1.0 - np.cumsum((lower**2).sum(axis=0)) / squares.sum()
    turned = np.empty((len(squares), min(rank, math.ceil(SPARE * (1 + (left > tolerance**2).sum())) + 16)))
    turned[pivots - 1] = lower[:, : turned.shape[1]]
    for _ in range(TURNS):
        basis = np.linalg.qr(turned)[0]
        in_parts(len(products), ROWS, partial(_multiply, products, basis, turned))
    values, turn = np.linalg.eigh(basis.T @ turned)
    return values[::-1], basis @ turn[:, ::-1]


def _orthonormal(rows: Float) -> Float:
    """Remove the round-off from rows that are nearly orthonormal."""
    return np.asarray(
        scipy.linalg.solve_triangular(np.linalg.cholesky(rows @ rows.T), rows, lower=True), dtype=np.float64
    )
