"""The wedge on its reference prism: triangle (xi, eta >= 0, xi + eta <= 1) times zeta in -1..1, zeta outwards.

Displacement: quadratic on the triangle (three vertices, then edges 01, 12, 20) times quadratic in zeta, 18 nodes, by
level (base side, middle, surface side). Geometry: linear times linear, 6 corners, by level. Volumetric strain:
projected element by element on {1, x, y} times {1, zeta}, x = xi - 1/3, y = eta - 1/3.

Reason for this space: static error of the centre displacement of a disc, 120 x 20 mm, 6 mm triangles, 3 rows, for nu
0.45 / 0.495 / 0.4999 / 0.499999. {1}: +22 / +24 / +25 / +25 %; {1, zeta}: +17 / +20 / +20 / +20 %; {1, x, y, zeta}:
+4.7 / +5.1 / +5.1 / +5.1 %; this space: -0.3 / -0.4 / -0.5 / -0.5 %. The pair is not inf-sup stable: the constant falls
with h, from 0.055 at 8 mm to 0.025 at 3.5 mm ({1, zeta}: 0.43 to 0.32). Displacements still converge and do not lock,
but the pressure of single elements must not be used. Interior bubbles of triangles (21 nodes) are not used: they need
1.5 times the unknowns and twice the time. On seven meshes their errors were 0.02-0.65 % static and 0.03-1.7 % at
200 Hz; without them 0.2-0.9 % and 0.15-0.85 %.
"""

import numpy as np

from palmfield.types import Float

EDGES = np.array([[0, 1], [1, 2], [2, 0]])
CORNERS = [0, 1, 2, 12, 13, 14]
"""Nodes of a wedge that define its geometry, in the order of `corner_slopes`."""


def triangle_rule() -> tuple[Float, Float]:
    """Return the six points (6, 2) and weights (6,) on the reference triangle, exact to degree 4 (Dunavant 1985)."""
    a, b = 0.445948490915965, 0.091576213509771
    wa, wb = 0.223381589678011, 0.109951743655322
    points = [(p, q) for s in (a, b) for p, q in ((s, s), (1 - 2 * s, s), (s, 1 - 2 * s))]
    return np.array(points), 0.5 * np.array([wa] * 3 + [wb] * 3)


def triangle_shape(points: Float) -> Float:
    """Return the values of the six quadratic shape functions at points (q, 2); shape (q, 6)."""
    b = barycentric(points)
    return np.concatenate([b * (2 * b - 1), 4 * b[:, EDGES[:, 0]] * b[:, EDGES[:, 1]]], axis=1)


def triangle_slopes(points: Float) -> Float:
    """Return the derivatives of the six functions by (xi, eta) at points (q, 2), shape (q, 6, 2)."""
    b = barycentric(points)
    db = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    vertex = (4 * b - 1)[:, :, None] * db
    i, j = EDGES.T
    edge = 4 * (b[:, i, None] * db[j] + b[:, j, None] * db[i])
    return np.concatenate([vertex, edge], axis=1)


def barycentric(points: Float) -> Float:
    """Return the shares of the three corners at points (q, 2), shape (q, 3)."""
    return np.column_stack([1.0 - points.sum(axis=1), points])


def prism_rule() -> tuple[Float, Float]:
    """Return eighteen points (18, 3) and weights (18,): six points of the triangle times three Gauss points."""
    points, weights = triangle_rule()
    zeta, line = np.polynomial.legendre.leggauss(3)
    prism = np.column_stack([np.tile(points, (3, 1)), np.repeat(zeta, 6)])
    return prism, np.repeat(line, 6) * np.tile(weights, 3)


def displacement_shape(points: Float) -> tuple[Float, Float]:
    """Return the shape functions of the displacement (q, 18) and derivatives by (xi, eta, zeta), (q, 18, 3)."""
    z = points[:, 2]
    line = np.column_stack([z * (z - 1) / 2, 1 - z**2, z * (z + 1) / 2])
    line_slope = np.column_stack([z - 0.5, -2 * z, z + 0.5])
    return _product(triangle_shape(points[:, :2]), triangle_slopes(points[:, :2]), line, line_slope)


def corner_slopes(points: Float) -> Float:
    """Return the derivatives by (xi, eta, zeta) of the six corner functions of the geometry, shape (q, 6, 3)."""
    z = points[:, 2]
    line = np.column_stack([(1 - z) / 2, (1 + z) / 2])
    line_slope = np.broadcast_to([-0.5, 0.5], line.shape)
    slopes = np.broadcast_to([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]], (len(points), 3, 2))
    return _product(barycentric(points[:, :2]), slopes, line, line_slope)[1]


def _product(flat: Float, flat_slopes: Float, line: Float, line_slope: Float) -> tuple[Float, Float]:
    """Return the tensor product of triangle and line functions; the index of the line varies slowest."""
    count = len(flat)
    values = np.einsum("ql,qt->qlt", line, flat).reshape(count, -1)
    lateral = np.einsum("ql,qtd->qltd", line, flat_slopes)
    depth = np.einsum("ql,qt->qlt", line_slope, flat)
    return values, np.concatenate([lateral, depth[..., None]], axis=3).reshape(count, -1, 3)


def volume_basis(points: Float) -> Float:
    """Return the values of the functions on which the volumetric strain is projected, shape (q, 6)."""
    flat = np.column_stack([np.ones(len(points)), points[:, :2] - 1.0 / 3.0])
    return np.concatenate([flat, flat * points[:, 2:]], axis=1)
