"""Gauss-Lobatto-Legendre nodes on [-1, 1]: one set of points for quadrature and interpolation."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from palmfield.types import Float


@dataclass(frozen=True)
class Rule:
    """GLL rule of a polynomial order N, n = N + 1 nodes; it integrates polynomials of degree 2 N - 1 exactly.

    nodes: ascending, shape (n,). weights: shape (n,). derivative: D[i, m] = l_m'(x_i), shape (n, n).
    top: Legendre polynomial of degree N at the nodes, shape (n,).
    top_weights: weights for the share of `top` in a function, in the inner product of the rule, shape (n,).
    """

    nodes: Float
    weights: Float
    derivative: Float
    top: Float
    top_weights: Float


@functools.cache
def rule(order: int) -> Rule:
    """Return the rule of order N >= 1 (Canuto et al., Spectral Methods, 2006, sections 2.3 and 3.8)."""
    top_series = np.zeros(order + 1)
    top_series[order] = 1.0
    inner = np.real(legendre.legroots(legendre.legder(top_series))) if order > 1 else np.zeros(0)
    nodes = np.concatenate([[-1.0], np.sort(inner), [1.0]])
    top = legendre.legval(nodes, top_series)
    weights = 2.0 / (order * (order + 1) * top**2)
    gaps = nodes[:, None] - nodes + np.eye(order + 1)
    derivative = top[:, None] / (top * gaps)
    np.fill_diagonal(derivative, 0.0)
    # Rows sum to 0, so that a rigid shift gives exactly 0 strain
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    return Rule(nodes, weights, derivative, top, weights * top / (weights @ top**2))


def lagrange(order: int, x: Float) -> Float:
    """Return the values of the Lagrange polynomials of this order at x, shape (len(x), n)."""
    vandermonde = legendre.legvander(rule(order).nodes, order)
    at = legendre.legvander(np.asarray(x, dtype=np.float64), order)
    return np.asarray(np.linalg.solve(vandermonde.T, at.T).T, dtype=np.float64)
