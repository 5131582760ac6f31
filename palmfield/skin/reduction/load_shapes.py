"""Pressures that a class of loads is made of, and the few points of a skin that tell them apart.

The sound of given arrays on a piece of skin varies no faster than half a wavelength, so that all pressures that it can
make there are sums of some hundred shapes: the leading singular vectors of examples. As many numbers tell which sum it
is, so that the pressure need not be computed at every point of the quadrature: empirical interpolation (Barrault et
al., C. R. Math. 339, 2004) takes the points by pivoted QR (Drmac & Gugercin, SIAM J. Sci. Comput. 38, 2016), here with
more points than shapes and least squares between them.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from palmfield.errors import SceneError
from palmfield.types import Float, Int

POINTS = 2
"""Points for each shape: the fit then adds less than half of what the shapes themselves leave out."""


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


def load_shapes(examples: Float, weights: Float, tolerance: float, points: int = POINTS) -> LoadShapes:
    """Shapes whose sums come within a tolerance of examples, rms over all of them.

    examples: pressures [Pa], shape (t, q); weights: areas for which the points stand [m^2], shape (q,)
    points: to look at for each shape, at most all
    Raises SceneError where nothing sounds in the examples, or a number is not finite.
    """
    if not np.isfinite(examples).all():
        raise SceneError("examples of a load are not finite: mend what computes them")
    size = float(np.einsum("tq,q,tq->", examples, weights, examples))
    if not size > 0.0:
        raise SceneError("the arrays' sound does not reach the skin: no class of loads to be made of it")
    root = np.sqrt(weights)
    left, values = _left_vectors(examples * root)
    left_out = np.sqrt(np.maximum(1.0 - np.cumsum(values) / values.sum(), 0.0))
    count = min(int(np.searchsorted(-left_out, -tolerance)) + 1, int((values > 1e-12 * values[0]).sum()))
    shapes = (left[:, :count].T @ (examples * root)) / np.sqrt(values[:count, None]) / root
    chosen = _telling_points(shapes * root, points)
    fit = np.asarray(np.linalg.pinv(shapes[:, chosen].T), dtype=np.float64)
    return LoadShapes(shapes, np.sqrt(values[:count] / len(examples)), chosen, fit)


def _telling_points(shapes: Float, times: int) -> Int:
    """Columns that tell shapes (m, q) apart, rising: those of pivoted QR some times, each time of what is left."""
    left = np.arange(shapes.shape[1])
    chosen: list[Int] = []
    for _ in range(times):
        pivots = linalg.qr(shapes[:, left], mode="r", pivoting=True)[1][: len(shapes)]
        chosen.append(left[pivots].astype(np.int32))
        left = np.delete(left, pivots)
    return np.sort(np.concatenate(chosen))


def _left_vectors(rows: Float) -> tuple[Float, Float]:
    """Eigenvectors (t, t) and eigenvalues (t,), the largest first, of rows @ rows.T."""
    values, vectors = np.linalg.eigh(rows @ rows.T)
    return vectors[:, ::-1], np.maximum(values[::-1], 0.0)
