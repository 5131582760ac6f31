"""Flat sheets at one lateral wavenumber and frequency: polynomials in depth, plane strain.

u_x = i a(z) e^{ikx}, u_z = b(z) e^{ikx} make all matrices real and symmetric in (a, b):
int (K - 2/3 mu) (b' - k a)^2 + 2 mu (k^2 a^2 + b'^2) + mu (a' + k b)^2 - rho w^2 (a^2 + b^2) dz. In the K term a is
projected on polynomials of one degree less, those of b'. So the volume does not lock at any degree.

Unknowns are the displacement of the top of a sheet, and the rise: displacement below minus displacement of the top.
So a rigid motion of the whole depth gives exactly 0 strain. With displacements of both ends as unknowns, thin free
sheets under long slow waves lost their digits: their inertia is 1e-10 of the stiffness terms, and their loss is less.
Rounding made the loss negative, by up to 3e-5 of the impedance, so that such a foundation added energy.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from palmfield.skin.base import BaseKind, Springs
from palmfield.skin.materials.material import Material, Sheet, complex_bulk, complex_shear
from palmfield.types import Complex, Float

DEGREE = 12
REACH = 5.0
"""Largest k x thickness of one polynomial piece: degree 12 approximates e^{-5 z} with an error of 1e-8."""


def condensed(k: Float, f_Hz: float, sheets: Sequence[Sheet], degree: int | None = None) -> Complex:
    """Return the dynamic stiffness of sheets [Pa/m], shape (n, 4, 4), for (a, b) on the top, then rise to the bottom.

    k: wavenumbers [rad/m], > 0, shape (n,); f_Hz: >= 0, under e^{-i w t}; sheets: from the top down
    degree: degree of the one polynomial of each sheet, see line_matrices; None: as many pieces of DEGREE as an exact
        result needs
    """
    k = np.asarray(k, dtype=float)
    total = None
    for sheet in sheets:
        count = 1 if degree is not None else max(1, math.ceil(k.max() * sheet.thickness_m / REACH))
        piece = _piece(k, f_Hz, sheet.material, sheet.thickness_m / count, DEGREE if degree is None else degree)
        for _ in range(count):
            total = piece if total is None else _joined(total, piece)
    assert total is not None
    return total


def impedance(
    k: Float, f_Hz: float, sheets: Sequence[Sheet], base: BaseKind | Springs = "bonded", degree: int | None = None
) -> Complex:
    """Return the traction per displacement (a, b) on the top of sheets on a base [Pa/m], (n, 2, 2); see condensed."""
    matrix = condensed(k, f_Hz, sheets, degree)
    if isinstance(base, Springs):
        s = -2j * math.pi * f_Hz
        rates = [base.tangential_Pa_m + base.tangential_Pa_s_m * s, base.normal_Pa_m + base.normal_Pa_s_m * s]
        return _without(_on(matrix, np.diag(rates)), [2, 3])
    # At a fixed bottom the rise is minus the displacement of the top.
    rising = {"bonded": [], "free_slip": [0], "free": [0, 1]}[base]
    moved = np.concatenate([np.eye(2), -np.eye(2)])
    moved[[2 + i for i in rising]] = 0.0
    shape = np.concatenate([moved, np.eye(4)[:, [2 + i for i in rising]]], axis=1)
    return _without(shape.T @ matrix @ shape, range(2, 2 + len(rising)))


def on_impedance(upper: Complex, below: Complex) -> Complex:
    """Return the normal compliance of sheets, shape (n,): condensed stiffness (n, 4, 4) on an impedance (n, 2, 2)."""
    return np.linalg.inv(_on(upper, below))[:, 1, 1].astype(complex)


def _on(upper: Complex, below: Complex) -> Complex:
    """Return the condensed stiffness of sheets (n, 4, 4) with an impedance (2, 2) or (n, 2, 2) at their bottom."""
    return upper + np.tile(below, (2, 2))


def _joined(upper: Complex, lower: Complex) -> Complex:
    """Return the condensed stiffness of sheets on sheets, by way of top, whole rise, and rise of the lower sheets."""
    one, none = np.eye(2), np.zeros((2, 2))
    above, below = np.block([[one, none, none], [none, one, -one]]), np.block([[one, one, -one], [none, none, one]])
    return _without(above.T @ upper @ above + below.T @ lower @ below, [4, 5])


def _without(matrix: Complex, inner: Sequence[int]) -> Complex:
    """Return the stiffness of the other unknowns if the unknowns `inner` carry no load."""
    outer = np.setdiff1d(np.arange(matrix.shape[1]), inner)
    across = matrix[:, inner][:, :, outer]
    inside = np.linalg.solve(matrix[:, inner][:, :, inner], across) if len(inner) else across
    return matrix[:, outer][:, :, outer] - np.swapaxes(across, 1, 2) @ inside


def _piece(k: Float, f_Hz: float, material: Material, h: float, degree: int) -> Complex:
    """Return the condensed stiffness of one polynomial piece of height h [m], shape (n, 4, 4)."""
    shear, bulk = complex_shear(material, f_Hz), complex_bulk(material, f_Hz)
    mass, slope, mixed, projected = _by_rise(degree, h)
    degree = max(degree, 1)
    # z points up and nodes are numbered downwards, so d/dz is minus the derivative with respect to depth.
    wave = k[:, None, None]
    lame = bulk - 2.0 / 3.0 * shear
    inertia = material.density_kg_m3 * (2.0 * math.pi * f_Hz) ** 2 * mass
    aa = wave**2 * (4.0 / 3.0 * shear * mass + bulk * projected) - inertia + shear * slope
    bb = wave**2 * shear * mass - inertia + (lame + 2.0 * shear) * slope
    ab = wave * (lame * mixed - shear * mixed.T)
    total = np.concatenate([np.concatenate([aa, ab], 2), np.concatenate([np.swapaxes(ab, 1, 2), bb], 2)], 1)
    ends = [0, degree + 1, degree, 2 * degree + 1]
    inner = np.setdiff1d(np.arange(2 * degree + 2), ends)
    order = np.concatenate([ends, inner])
    return _without(total[:, order][:, :, order], np.arange(4, 2 * degree + 2).tolist())


def _by_rise(degree: int, h: float) -> tuple[Float, Float, Float, Float]:
    """Return line_matrices with the constant 1 as first function; the others then multiply rises from the top."""
    lines, degree = line_matrices(degree, h), max(degree, 1)
    whole = np.eye(degree + 1)
    whole[:, 0] = 1.0
    mass, slope, mixed, projected = (whole.T @ matrix @ whole for matrix in lines)
    # The derivative of 1 is 0. The other derivatives have integral 0, except the lowest (function 1 at the bottom): 1.
    slope[0], slope[:, 0], mixed[:, 0] = 0.0, 0.0, 0.0
    mixed[0, 1:] = np.arange(1, degree + 1) == degree
    return mass, slope, mixed, projected


@functools.lru_cache(maxsize=64)
def _unit_line(degree: int) -> tuple[Float, Float, Float, Float]:
    inside = legendre.Legendre.basis(degree).deriv().roots()
    nodes = np.concatenate([[-1.0], np.sort(inside.real), [1.0]])
    points, weights = legendre.leggauss(degree + 1)
    to_nodal = np.linalg.inv(legendre.legvander(nodes, degree))
    values = legendre.legvander(points, degree) @ to_nodal
    derivative = np.column_stack([legendre.legval(points, legendre.legder(row)) for row in np.eye(degree + 1)])
    slopes = derivative @ to_nodal
    lower = legendre.legvander(points, degree - 1) * np.sqrt(np.arange(degree) + 0.5)
    on_lower = lower.T @ (weights[:, None] * values)
    return (
        values.T @ (weights[:, None] * values),
        slopes.T @ (weights[:, None] * slopes),
        values.T @ (weights[:, None] * slopes),
        on_lower.T @ on_lower,
    )


def line_matrices(degree: int, h: float) -> tuple[Float, Float, Float, Float]:
    """Return int N_i N_j, N_i' N_j', N_i N_j' and Pi N_i Pi N_j over a height h [m], each (degree + 1, degree + 1).

    N: Lagrange functions of depth on Lobatto points, from the top down; Pi: projection on one degree less. Degree 0 is
    degree 1 with one point of integration: Pi replaces N.
    """
    mass, slope, mixed, projected = _unit_line(max(degree, 1))
    return 0.5 * h * (mass if degree else projected), 2.0 / h * slope, mixed, 0.5 * h * projected
