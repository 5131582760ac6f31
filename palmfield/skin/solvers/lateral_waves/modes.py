"""Motion of the face of a slab from its matrices in depth: u(s) = sum r_j / (s - s_j) under a normal pressure."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from palmfield.skin.solvers.lateral_waves.depth import DepthProblem
from palmfield.types import Complex, Float

SLOWEST = 1e-3
"""Phase within the requested time [rad] below which a mode counts as free; this changes t^2/2 by 1e-7."""
RUSH_1_S = 1e4
LONGEST_S = 5e-3
"""Largest time at which the step response of a slow mode is compared with the other modes [s]."""


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
