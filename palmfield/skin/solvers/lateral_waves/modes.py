"""Motion of the face of a slab from its matrices in depth: u(s) = sum r_j / (s - s_j) under a normal pressure.

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
from scipy.linalg import cholesky, solve_triangular

from palmfield.skin.base import Foundation, Springs
from palmfield.skin.materials.material import Material
from palmfield.skin.problem import Slab
from palmfield.types import Complex, Float

STIFFEST = 1e7
"""K / G_r above which a sheet counts as incompressible: a larger ratio loses digits and does not change the result."""
SLOWEST = 1e-3
"""Phase within the requested time [rad] below which a mode counts as free; this changes t^2/2 by 1e-7."""
RUSH_1_S = 1e4
LONGEST_S = 5e-3
"""Largest time at which the step response of a slow mode is compared with the other modes [s]."""


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
    the squared dilation: shape (2p + 2, 2p + 2). Mass: shape (2p + 2, 2p + 2). Degree 0 is linear with one point of
    integration, as in `Foundation`, so that all rows but the first of both kinds are omitted.
    """
    values, slopes, plain = reference(max(degree, 1))
    if degree == 0:
        values, slopes = values[:1], slopes[:1]
        plain = values.T @ values
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
    base, layers = slab.base, slab.sheets
    if isinstance(base, Foundation):
        layers, degrees, base = (*layers, *base.sheets), (*degrees, *[base.degree] * len(base.sheets)), base.base
    own, degrees = degrees, tuple(max(degree, 1) for degree in degrees)
    sheets = len(layers)
    count = sheets + 1 + sum(p - 1 for p in degrees)
    bottom = np.array([sheets, count + sheets])
    kept = np.ones(2 * count, dtype=bool)
    kept[bottom] = base not in ("bonded",), base not in ("bonded", "free_slip")
    if k == 0.0:
        kept[:count] = False
    mass = np.zeros((2 * count, 2 * count))
    strain, viscous, relaxing = [], [], []

    def spread(rows: Float, places: np.ndarray) -> Float:
        whole = np.zeros((len(rows), 2 * count))
        whole[:, places] = rows
        return whole[:, kept]

    for number, (sheet, degree) in enumerate(zip(layers, own, strict=True)):
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
    if isinstance(base, Springs):
        rates = [base.tangential_Pa_m, base.normal_Pa_m]
        strain.append(spread(np.diag(np.sqrt(rates)), bottom))
        rates = [base.tangential_Pa_s_m, base.normal_Pa_s_m]
        viscous.append(spread(np.diag(np.sqrt(rates)), bottom))
    return DepthProblem(
        mass[np.ix_(kept, kept)],
        np.vstack(strain),
        np.vstack([np.zeros((0, kept.sum())), *viscous]),
        tuple(relaxing),
        normal=int(kept[:count].sum()),
        lateral=0 if k > 0.0 else None,
    )


@dataclass(frozen=True)
class FaceModes:
    """Motion of the face under a unit normal pressure e^{ikx}: u_z = sum normal / (s - poles), u_x = i sum lateral /
    (s - poles).

    poles: with their conjugates [1/s], shape (j,); normal, lateral: residues [m/(Pa s)], shape (j,)
    """

    poles: Complex
    normal: Complex
    lateral: Complex

    def static(self) -> tuple[float, float]:
        """Return the static u_z and u_x / i per unit of pressure [m/Pa]."""
        return float(-np.sum(self.normal / self.poles).real), float(-np.sum(self.lateral / self.poles).real)


@dataclass(frozen=True)
class ModalProblem:
    """A depth problem in coordinates with unit mass. branches: (L, g, tau [s]) with Q = L L^T."""

    stiffness: Float
    damping: Float
    branches: tuple[tuple[Float, float, float], ...]
    normal: Float
    lateral: Float


def reduce(problem: DepthProblem, horizon_s: float, tolerance: float) -> ModalProblem:
    """Return the undamped modes that are relevant for the face, and static shapes that replace all others.

    A mode with the part b in the face adds b^2/w^2 (1 - cos wt) to the step response. The smallest modes are omitted
    as long as the root of their summed squares is below `tolerance` of that of all. Their sum stays as one shape, so
    that the static solution does not change. A second shape does the same for the instantaneous stiffness, which
    includes the branches.
    """
    root = cholesky(problem.mass)
    # Singular values of the factor have errors of 1e-16 of the largest; eigenvalues of the stiffness have more
    values, shapes = np.linalg.svd(solve_triangular(root, problem.strain.T, trans="T").T, full_matrices=False)[1:]
    shapes = solve_triangular(root, shapes.T)
    squares = np.maximum(values**2, (SLOWEST / horizon_s) ** 2)
    normal = shapes[problem.normal]
    lateral = shapes[problem.lateral] if problem.lateral is not None else np.zeros_like(normal)
    share = np.abs(normal) * np.hypot(normal, lateral) / np.maximum(squares, 2.0 / min(horizon_s, LONGEST_S) ** 2)
    order = np.argsort(share)
    omitted = np.sqrt(np.cumsum(share[order] ** 2)) < tolerance * share.sum()
    kept = np.sort(order[~omitted])
    delayed = [r.strain @ shapes for r in problem.relaxing]
    static = [normal / squares]
    if delayed:
        pairs = zip(problem.relaxing, delayed, strict=True)
        added = [math.sqrt(sum(ratio for ratio, _ in r.branches)) * rows for r, rows in pairs]
        static.append(_solved(np.vstack([np.diag(np.sqrt(squares)), *added]), normal))
    basis = np.zeros((len(squares), len(kept) + len(static)))
    basis[kept, np.arange(len(kept))] = 1.0
    used = len(kept)
    for shape in static:
        shape = shape / np.linalg.norm(shape)
        rest = shape - basis[:, :used] @ (basis[:, :used].T @ shape)
        rest -= basis[:, :used] @ (basis[:, :used].T @ rest)
        size = np.linalg.norm(rest)
        if size > 1e-10:
            basis[:, used] = rest / size
            used += 1
    basis = basis[:, :used]
    viscous = problem.viscous @ shapes @ basis
    branches = tuple(
        (factor, ratio, time)
        for rows, r in zip(delayed, problem.relaxing, strict=True)
        for factor in [_factor(rows @ basis)]
        for ratio, time in r.branches
    )
    return ModalProblem((basis.T * squares) @ basis, viscous.T @ viscous, branches, normal @ basis, lateral @ basis)


def _solved(rows: Float, right: Float) -> Float:
    """Return x with rows^T rows x = right."""
    root = np.linalg.qr(rows, mode="r")
    return solve_triangular(root, solve_triangular(root, right, trans="T"))


def _factor(rows: Float) -> Float:
    """Return L with L L^T = rows^T rows, with as many columns as its rank."""
    values, vectors = np.linalg.svd(rows, full_matrices=False)[1:]
    kept = values > 1e-12 * values[0]
    return vectors[kept].T * values[kept]


def face_modes(problem: DepthProblem, horizon_s: float, tolerance: float) -> FaceModes:
    """Return poles and residues for times up to horizon_s [s], to a relative tolerance of the step response.

    The state (u, u', L^T q) satisfies A x' = B x + force. A and B are symmetric, so x^T A x gives the residues.
    """
    model = reduce(problem, horizon_s, tolerance)
    n = len(model.normal)
    inner = [factor.shape[1] for factor, _, _ in model.branches]
    state = np.zeros((2 * n + sum(inner),) * 2)
    weights = np.zeros(len(state))
    state[:n, n : 2 * n] = np.eye(n)
    state[n : 2 * n, :n] = -model.stiffness
    state[n : 2 * n, n : 2 * n] = -model.damping
    start = 2 * n
    for (factor, ratio, time), size in zip(model.branches, inner, strict=True):
        part = slice(start, start + size)
        state[n : 2 * n, :n] -= ratio * factor @ factor.T
        state[n : 2 * n, part] = ratio * factor
        state[part, :n] = factor.T / time
        state[part, part] = -np.eye(size) / time
        weights[part] = ratio * time
        start += size
    poles, vectors = np.linalg.eig(state)
    poles, vectors = poles.astype(complex), vectors.astype(complex)
    u = vectors[:n]
    norm = 2.0 * poles * (u * u).sum(axis=0) + (u * (model.damping @ u)).sum(axis=0) + weights @ vectors**2
    push = -(model.normal @ u) / norm
    normal, lateral = push * (model.normal @ u), push * (model.lateral @ u)
    share = np.hypot(np.abs(normal), np.abs(lateral)) / np.maximum(np.abs(poles), 1.0 / min(horizon_s, LONGEST_S))
    ordered = np.sort(share)
    dropped = np.cumsum(ordered) < 0.1 * tolerance * share.sum()
    # The limit is just below the first kept value, so that conjugates are kept or omitted together
    kept = share >= (1.0 - 1e-6) * ordered[~dropped][0]
    return FaceModes(poles[kept], normal[kept], lateral[kept])


def still_modes(problem: DepthProblem) -> FaceModes:
    """Return one pole that is so fast that the face reaches its static solution in a negligible time."""
    force = np.zeros(len(problem.mass))
    force[problem.normal] = -1.0
    shape = _solved(problem.strain, force)
    lateral = 0.0 if problem.lateral is None else shape[problem.lateral]
    return FaceModes(
        *(
            np.array([value], dtype=complex)
            for value in (-RUSH_1_S, RUSH_1_S * shape[problem.normal], RUSH_1_S * lateral)
        )
    )
