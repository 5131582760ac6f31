"""Flat sheets at one lateral wavenumber and frequency: polynomials in depth, plane strain.

u_x = i a(z) e^{ikx}, u_z = b(z) e^{ikx} make all matrices real and symmetric in (a, b):
int lambda (b' - k a)^2 + 2 mu (k^2 a^2 + b'^2) + mu (a' + k b)^2 - rho w^2 (a^2 + b^2) dz. High polynomials do not
lock.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from palmfield.skin.material import complex_bulk, complex_shear
from palmfield.skin.problem import BaseKind, Sheet, Springs
from palmfield.types import Complex, Float

DEGREE = 12
REACH = 5.0
"""Largest k x thickness of one polynomial piece: e^{-5 z} by degree 12 errs by 1e-8."""


def condensed(k: Float, f_Hz: float, sheets: Sequence[Sheet]) -> Complex:
    """Dynamic stiffness of sheets by (a, b) on their top, then (a, b) on their bottom [Pa/m], shape (n, 4, 4).

    k: wavenumbers [rad/m], > 0, shape (n,); f_Hz: >= 0, under e^{-i w t}; sheets: the first on top
    """
    matrix = _stiffness(k, f_Hz, sheets)
    size = matrix.shape[1]
    outer = [0, 1, size - 2, size - 1]
    inner = np.setdiff1d(np.arange(size), outer)
    across = matrix[:, inner][:, :, outer]
    inside = np.linalg.solve(matrix[:, inner][:, :, inner], across)
    return matrix[:, outer][:, :, outer] - np.swapaxes(across, 1, 2) @ inside


def surface_compliance(k: Float, f_Hz: float, sheets: Sequence[Sheet], base: BaseKind | Springs = "bonded") -> Complex:
    """Normal compliance of the top of sheets on a base [m/Pa], shape (n,): positive when pushed in; see condensed."""
    matrix = condensed(k, f_Hz, sheets)
    held = {"bonded": [0, 1], "free_slip": [0, 1, 2], "free": [0, 1, 2, 3]}
    kept = [0, 1, 2, 3] if isinstance(base, Springs) else held[base]
    if isinstance(base, Springs):
        s = -2j * math.pi * f_Hz
        matrix[:, 2, 2] += base.tangential_Pa_m + base.tangential_Pa_s_m * s
        matrix[:, 3, 3] += base.normal_Pa_m + base.normal_Pa_s_m * s
    load = np.zeros((len(matrix), len(kept), 1), dtype=complex)
    load[:, 1, 0] = 1.0
    return np.linalg.solve(matrix[:, kept][:, :, kept], load)[:, 1, 0].astype(complex)


def _stiffness(k: Float, f_Hz: float, sheets: Sequence[Sheet]) -> Complex:
    """Sum over the pieces of all sheets, (a, b) by node from the top to the bottom, shape (n, m, m)."""
    k = np.asarray(k, dtype=float)
    pieces = [max(1, math.ceil(k.max() * sheet.thickness_m / REACH)) for sheet in sheets]
    size = 2 * (DEGREE * sum(pieces) + 1)
    total = np.zeros((len(k), size, size), dtype=complex)
    mass, slope, mixed = _line_matrices()
    first = 0
    for sheet, count in zip(sheets, pieces, strict=True):
        shear, bulk = complex_shear(sheet.material, f_Hz), complex_bulk(sheet.material, f_Hz)
        lame = bulk - 2.0 / 3.0 * shear
        inertia = sheet.material.density_kg_m3 * (2.0 * math.pi * f_Hz) ** 2
        h = sheet.thickness_m / count
        # z points up while nodes run down: a derivative by z is minus one by depth.
        m, d, c = 0.5 * h * mass, 2.0 / h * slope, -mixed
        wave = k[:, None, None]
        aa = ((lame + 2.0 * shear) * wave**2 - inertia) * m + shear * d
        bb = (shear * wave**2 - inertia) * m + (lame + 2.0 * shear) * d
        ab = wave * (shear * c.T - lame * c)
        for _ in range(count):
            here = np.arange(2 * first, 2 * (first + DEGREE + 1), 2)
            total[:, here[:, None], here] += aa
            total[:, here[:, None] + 1, here + 1] += bb
            total[:, here[:, None], here + 1] += ab
            total[:, here[:, None] + 1, here] += np.swapaxes(ab, 1, 2)
            first += DEGREE
    return total


def _line_matrices() -> tuple[Float, Float, Float]:
    """int N_i N_j, int N_i' N_j' and int N_i N_j' on -1..1, N the Lagrange functions of Lobatto's points."""
    inside = legendre.Legendre.basis(DEGREE).deriv().roots()
    nodes = np.concatenate([[-1.0], np.sort(inside.real), [1.0]])
    points, weights = legendre.leggauss(DEGREE + 1)
    to_nodal = np.linalg.inv(legendre.legvander(nodes, DEGREE))
    values = legendre.legvander(points, DEGREE) @ to_nodal
    derivative = np.column_stack([legendre.legval(points, legendre.legder(row)) for row in np.eye(DEGREE + 1)])
    slopes = derivative @ to_nodal
    return (
        np.einsum("q,qi,qj->ij", weights, values, values),
        np.einsum("q,qi,qj->ij", weights, slopes, slopes),
        np.einsum("q,qi,qj->ij", weights, values, slopes),
    )
