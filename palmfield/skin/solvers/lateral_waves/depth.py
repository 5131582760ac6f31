"""A slab in depth for one lateral wavenumber: matrices of one polynomial element a sheet.

Motion u_x = i U(z) e^{ikx}, u_z = W(z) e^{ikx} makes the strain -k U, W', (U' + k W) / 2 and every matrix real and
symmetric. Polynomials of high degree neither lock at Poisson's ratio 0.5 nor disperse (Szabo & Babuska 1991, ch. 6,
give the basis: integrated Legendre polynomials).
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from palmfield.skin.problem import Sheet, Slab, Springs
from palmfield.types import Float

STIFFEST = 1e7
"""K / G_r above which a sheet is as good as incompressible: a larger ratio costs digits and changes none that stay."""


@dataclass(frozen=True)
class Relaxing:
    """Force g Q (u - q) with tau q' = u - q. matrix: Q [Pa], shape (n, n); ratio: g; time_s: tau [s], > 0"""

    matrix: Float
    ratio: float
    time_s: float


@dataclass(frozen=True)
class DepthProblem:
    """M u'' + D u' + E u + sum g Q (u - q) = force, by area of the face.

    mass, damping, stiffness: M [kg/m^2], D [Pa s/m], E [Pa/m], shape (n, n)
    relaxing: the terms of the Maxwell branches
    normal, lateral: places of the face's W and U among the n unknowns; lateral is None at k = 0, where they part
    """

    mass: Float
    damping: Float
    stiffness: Float
    relaxing: tuple[Relaxing, ...]
    normal: int
    lateral: int | None


@lru_cache(maxsize=8)
def _reference(degree: int) -> tuple[Float, Float, Float]:
    """Integrals over [-1, 1] of N_i N_j, N_i N_j' and N_i' N_j', shape (degree + 1, degree + 1); leading blocks serve
    lower degrees. N_0 is 1 at the lower end, N_1 at the upper one; the others vanish at both."""
    points, weights = leggauss(degree + 1)
    legendre = legvander(points, degree)
    values, slopes = np.empty_like(legendre), np.empty_like(legendre)
    values[:, 0], values[:, 1] = 0.5 * (1.0 - points), 0.5 * (1.0 + points)
    slopes[:, 0], slopes[:, 1] = -0.5, 0.5
    j = np.arange(2, degree + 1)
    values[:, 2:] = (legendre[:, 2:] - legendre[:, :-2]) / np.sqrt(2.0 * (2.0 * j - 1.0))
    slopes[:, 2:] = legendre[:, 1:-1] * np.sqrt(0.5 * (2.0 * j - 1.0))
    weighted = weights[:, None] * values
    return values.T @ weighted, weighted.T @ slopes, slopes.T @ (weights[:, None] * slopes)


def reference(degree: int) -> tuple[Float, Float, Float]:
    block = slice(degree + 1)
    plain, mixed, steep = _reference(64 * math.ceil(degree / 64))
    return plain[block, block], mixed[block, block], steep[block, block]


def sheet_matrices(k: float, thickness_m: float, degree: int) -> tuple[Float, Float, Float]:
    """Of one sheet: mass for density 1, stiffness for K = 1 and for G = 1 (U first, then W), shape (2p + 2, 2p + 2)."""
    plain, mixed, steep = reference(degree)
    plain, steep = 0.5 * thickness_m * plain, 2.0 / thickness_m * steep
    cross = k * (2.0 / 3.0 * mixed + mixed.T)
    mass = _blocks(plain, 0.0, plain)
    bulk = _blocks(k**2 * plain, -k * mixed, steep)
    shear = _blocks(4.0 / 3.0 * k**2 * plain + steep, cross, 4.0 / 3.0 * steep + k**2 * plain)
    return mass, bulk, shear


def _blocks(first: Float, cross: Float | float, second: Float) -> Float:
    """Symmetric matrix of U and W; np.block takes ten times as long."""
    n = len(first)
    result = np.empty((2 * n, 2 * n))
    result[:n, :n], result[:n, n:], result[n:, :n], result[n:, n:] = first, cross, np.transpose(cross), second
    return result


def _places(sheet: int, sheets: int, degrees: tuple[int, ...]) -> np.ndarray:
    """Where a sheet's functions stand among all: interfaces first (the face is 0), then the insides."""
    inside = sheets + 1 + sum(p - 1 for p in degrees[:sheet])
    return np.concatenate([[sheet + 1, sheet], np.arange(inside, inside + degrees[sheet] - 1)])


def _laws(sheet: Sheet, bulk: Float, shear: Float) -> tuple[Float, Float, list[Relaxing]]:
    """Stiffness, damping and relaxing terms of one sheet."""
    material = sheet.material
    modulus = min(material.bulk_Pa, STIFFEST * material.shear_relaxed_Pa)
    elastic, delayed = modulus * bulk, material.shear_relaxed_Pa * shear
    if material.bulk_relaxes:
        delayed = delayed + elastic
        elastic = np.zeros_like(elastic)
    branches = zip(material.ratios, material.times_s, strict=True)
    relaxing = [Relaxing(delayed, ratio, time) for ratio, time in branches if ratio > 0.0 and time > 0.0]
    return elastic + delayed, material.viscous_time_s * delayed, relaxing


def depth_problem(slab: Slab, k: float, degrees: tuple[int, ...]) -> DepthProblem:
    """Matrices of a slab at lateral wavenumber k [rad/m], >= 0, with a polynomial degree (>= 2) for each sheet."""
    sheets = len(slab.sheets)
    count = sheets + 1 + sum(p - 1 for p in degrees)
    mass, damping, stiffness = (np.zeros((2 * count, 2 * count)) for _ in range(3))
    relaxing = []
    for number, (sheet, degree) in enumerate(zip(slab.sheets, degrees, strict=True)):
        places = _places(number, sheets, degrees)
        places = np.concatenate([places, count + places])
        where = np.ix_(places, places)
        plain, bulk, shear = sheet_matrices(k, sheet.thickness_m, degree)
        still, viscous, terms = _laws(sheet, bulk, shear)
        mass[where] += sheet.material.density_kg_m3 * plain
        stiffness[where] += still
        damping[where] += viscous
        for term in terms:
            whole = np.zeros_like(mass)
            whole[where] = term.matrix
            relaxing.append(Relaxing(whole, term.ratio, term.time_s))
    bottom = np.array([sheets, count + sheets])
    if isinstance(slab.base, Springs):
        stiffness[bottom, bottom] += [slab.base.tangential_Pa_m, slab.base.normal_Pa_m]
        damping[bottom, bottom] += [slab.base.tangential_Pa_s_m, slab.base.normal_Pa_s_m]
    kept = np.ones(2 * count, dtype=bool)
    kept[bottom] = slab.base not in ("bonded",), slab.base not in ("bonded", "free_slip")
    if k == 0.0:
        kept[:count] = False
    where = np.ix_(kept, kept)
    return DepthProblem(
        mass[where],
        damping[where],
        stiffness[where],
        tuple(Relaxing(term.matrix[where], term.ratio, term.time_s) for term in relaxing),
        normal=int(kept[:count].sum()),
        lateral=0 if k > 0.0 else None,
    )
