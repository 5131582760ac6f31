"""A slab in depth for one lateral wavenumber: matrices of one polynomial element per sheet.

With the motion u_x = i U(z) e^{ikx}, u_z = W(z) e^{ikx} the strains are -k U, W', (U' + k W) / 2, and every matrix is
real and symmetric. Polynomials of high degree neither lock at Poisson's ratio 0.5 nor disperse. The basis functions are
integrated Legendre polynomials (Szabo & Babuska 1991, ch. 6).

Stiffness and damping are stored as factors: rows of strain whose squares sum to the energy. The softest modes of a
stiff sheet are 1e13 times softer than the stiffest. The singular values of the factor keep their digits; eigenvalues
of the stiffness would lose them.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from palmfield.skin.base import Springs
from palmfield.skin.materials.material import Material
from palmfield.skin.problem import Slab
from palmfield.types import Float

STIFFEST = 1e7
"""K / G_r above which a sheet counts as incompressible: a larger ratio loses digits and does not change the result."""


@dataclass(frozen=True)
class Relaxing:
    """Forces g Q (u - q) of the branches of one sheet, with tau q' = u - q and Q = strain^T strain.

    strain: [Pa^1/2], shape (m, n); branches: (g, tau [s]) of each, both > 0
    """

    strain: Float
    branches: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class DepthProblem:
    """M u'' + D u' + E u + sum g Q (u - q) = force, per area of the face; D = viscous^T viscous, E = strain^T strain.

    mass: M [kg/m^2], shape (n, n). strain: [(Pa/m)^1/2], shape (m, n). viscous: [(Pa s/m)^1/2], shape (l, n).
    relaxing: the terms of the Maxwell branches.
    normal, lateral: places of W and U of the face among the n unknowns; lateral is None at k = 0 (U is not coupled).
    """

    mass: Float
    strain: Float
    viscous: Float
    relaxing: tuple[Relaxing, ...]
    normal: int
    lateral: int | None


@lru_cache(maxsize=8)
def _reference(degree: int) -> tuple[Float, Float, Float]:
    """Return N_j and N_j' as sums of Legendre polynomials of unit norm over [-1, 1], and the integrals of N_i N_j.

    All have shape (degree + 1, degree + 1), the first two by polynomial and j; leading blocks are those of lower
    degrees. N_0 is 1 at the lower end, N_1 at the upper end; the others (integrals of polynomials) are 0 at both.
    """
    values, slopes = np.zeros((degree + 1, degree + 1)), np.zeros((degree + 1, degree + 1))
    values[0, :2], values[1, :2] = np.sqrt(0.5), [-np.sqrt(1.0 / 6.0), np.sqrt(1.0 / 6.0)]
    slopes[0, :2] = [-np.sqrt(0.5), np.sqrt(0.5)]
    j = np.arange(2, degree + 1)
    values[j, j] = 1.0 / np.sqrt((2.0 * j - 1.0) * (2.0 * j + 1.0))
    values[j - 2, j] = -1.0 / np.sqrt((2.0 * j - 1.0) * (2.0 * j - 3.0))
    slopes[j - 1, j] = 1.0
    return values, slopes, values.T @ values


def reference(degree: int) -> tuple[Float, Float, Float]:
    block = slice(degree + 1)
    values, slopes, plain = _reference(64 * math.ceil(degree / 64))
    return values[block, block], slopes[block, block], plain[block, block]


def sheet_matrices(k: float, thickness_m: float, degree: int) -> tuple[Float, Float, Float]:
    """Return mass, dilation rows and shear rows of one sheet for unit density, K and G; unknowns are U, then W.

    Twice the energy is the sum of squares of the rows times u. Dilation: shape (p + 1, 2p + 2). Shear, with a third of
    the squared dilation: shape (2p + 2, 2p + 2). Mass: shape (2p + 2, 2p + 2).
    """
    values, slopes, plain = reference(degree)
    values, slopes = math.sqrt(0.5 * thickness_m) * values, math.sqrt(2.0 / thickness_m) * slopes
    plain = 0.5 * thickness_m * plain
    nothing = np.zeros_like(plain)
    mass = np.vstack([np.hstack([plain, nothing]), np.hstack([nothing, plain])])
    # e_xx + e_zz, then e_xx - e_zz and 2 e_xz: 2 e:e - 2/3 tr^2 is a third of the first squared and the others'
    dilation = np.hstack([-k * values, slopes])
    turned = np.vstack([np.hstack([-k * values, -slopes]), np.hstack([slopes, k * values])])
    return mass, dilation, turned


def _places(sheet: int, sheets: int, degrees: tuple[int, ...]) -> np.ndarray:
    """Return the places of the functions of a sheet among all: interfaces first (the face is 0), then interiors."""
    inside = sheets + 1 + sum(p - 1 for p in degrees[:sheet])
    return np.concatenate([[sheet + 1, sheet], np.arange(inside, inside + degrees[sheet] - 1)])


def _laws(material: Material, dilation: Float, turned: Float) -> tuple[Float, Float]:
    """Return the rows of strain of one sheet: for the whole stiffness, and for the part that relaxes in shear."""
    shear = material.shear_relaxed_Pa
    bulk = min(material.bulk_Pa, STIFFEST * shear)
    sheared = math.sqrt(shear) * turned
    whole = np.vstack([math.sqrt(bulk + shear / 3.0) * dilation, sheared])
    return whole, whole if material.bulk_relaxes else np.vstack([math.sqrt(shear / 3.0) * dilation, sheared])


def depth_problem(slab: Slab, k: float, degrees: tuple[int, ...]) -> DepthProblem:
    """Return the matrices of a slab at lateral wavenumber k [rad/m], >= 0; degrees: polynomial degree >= 2 by sheet."""
    sheets = len(slab.sheets)
    count = sheets + 1 + sum(p - 1 for p in degrees)
    bottom = np.array([sheets, count + sheets])
    kept = np.ones(2 * count, dtype=bool)
    kept[bottom] = slab.base not in ("bonded",), slab.base not in ("bonded", "free_slip")
    if k == 0.0:
        kept[:count] = False
    mass = np.zeros((2 * count, 2 * count))
    strain, viscous, relaxing = [], [], []

    def spread(rows: Float, places: np.ndarray) -> Float:
        whole = np.zeros((len(rows), 2 * count))
        whole[:, places] = rows
        return whole[:, kept]

    for number, (sheet, degree) in enumerate(zip(slab.sheets, degrees, strict=True)):
        places = _places(number, sheets, degrees)
        places = np.concatenate([places, count + places])
        material = sheet.material
        plain, dilation, turned = sheet_matrices(k, sheet.thickness_m, degree)
        mass[np.ix_(places, places)] += material.density_kg_m3 * plain
        still, delayed = (spread(rows, places) for rows in _laws(material, dilation, turned))
        strain.append(still)
        if material.viscosity_Pa_s > 0.0:
            viscous.append(math.sqrt(material.relaxation.viscous_time_s) * delayed)
        if material.relaxation.active:
            relaxing.append(Relaxing(delayed, material.relaxation.active))
    if isinstance(slab.base, Springs):
        rates = [slab.base.tangential_Pa_m, slab.base.normal_Pa_m]
        strain.append(spread(np.diag(np.sqrt(rates)), bottom))
        rates = [slab.base.tangential_Pa_s_m, slab.base.normal_Pa_s_m]
        viscous.append(spread(np.diag(np.sqrt(rates)), bottom))
    return DepthProblem(
        mass[np.ix_(kept, kept)],
        np.vstack(strain),
        np.vstack([np.zeros((0, kept.sum())), *viscous]),
        tuple(relaxing),
        normal=int(kept[:count].sum()),
        lateral=0 if k > 0.0 else None,
    )
