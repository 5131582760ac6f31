"""Motion of a skin layer: static, harmonic, and harmonic by generalised-alpha."""

import cmath
import math
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.factor import factorise
from palmfield.skin.fem.generalised_alpha import RHO_INF, alpha_weights, branch_weights
from palmfield.types import Complex, Float

ITERATED, MOST_ITERATIONS = 1e-9, 24
"""Relative residual to which `harmonic_both` iterates, and for how long: a factorisation takes as long as some 50."""


def static(system: SkinSystem, force: Float) -> Float:
    """Displacement [m], (ndof,), under a force [N] that has acted for ever: the branches are relaxed.

    Raises SceneError for a body without support.
    """
    if not system.supported:
        raise SceneError(
            "a static solution needs a support: base and sides leave this body free to move; bond the base, give "
            "it Springs, or fix a side"
        )
    matrix = system.elastic + sum(part.stiffness for part in system.parts)
    return factorise(matrix, system.elimination_order()).solve(np.asarray(force, dtype=float))


def harmonic(system: SkinSystem, force: Float, f_Hz: float) -> Complex:
    """Complex displacement [m], (ndof,), under force [N] times e^{-i w t}, exact in time."""
    s = -2j * math.pi * f_Hz
    return _solve_dynamic(system, force, s**2, s, [complex(part.material.stiffening(s)) for part in system.parts])


def harmonic_discrete(system: SkinSystem, force: Float, f_Hz: float, step_s: float) -> Complex:
    """The steady state that WedgeStepper itself reaches under force [N] times e^{-i w t}: its z-symbol.

    |harmonic_discrete - harmonic| is the error of the time step. f_Hz > 0, below half the step rate.
    """
    return _solve_dynamic(system, force, *discrete_weights(system, f_Hz, step_s))


def harmonic_both(system: SkinSystem, force: Float, f_Hz: float, step_s: float) -> tuple[Complex, Complex]:
    """`harmonic` and `harmonic_discrete`, by one factorisation for both.

    The two matrices differ little, so that the factors of the one precondition the other; where that doesn't get to
    ITERATED in MOST_ITERATIONS, the other is factorised as well.
    """
    s = -2j * math.pi * f_Hz
    exact = _dynamic(system, s**2, s, [complex(part.material.stiffening(s)) for part in system.parts])
    factor = factorise(exact, system.elimination_order())
    right = np.asarray(force, dtype=complex)
    continuous = factor.solve(right)
    weights = discrete_weights(system, f_Hz, step_s)
    other = _dynamic(system, *weights)
    undo = LinearOperator(other.shape, factor.solve, dtype=complex)
    discrete, failed = gmres(other, right, continuous, rtol=ITERATED, restart=MOST_ITERATIONS, maxiter=1, M=undo)
    if failed:
        discrete = _solve_dynamic(system, force, *weights)
    return continuous, discrete


def discrete_weights(system: SkinSystem, f_Hz: float, step_s: float) -> tuple[complex, complex, list[complex]]:
    """Factors of mass, damping and the stiffnesses of the parts in the z-symbol of the scheme."""
    alpha_m, alpha_f, beta, gamma = alpha_weights(RHO_INF)
    z = cmath.exp(-2j * math.pi * f_Hz * step_s)
    # u (z - 1) = h v + h^2 a (1/2 - beta + beta z) and v (z - 1) = h a (1 - gamma + gamma z).
    u_over_a = step_s**2 * ((1.0 - gamma + gamma * z) / (z - 1.0) ** 2 + (0.5 - beta + beta * z) / (z - 1.0))
    v_over_u = step_s * (1.0 - gamma + gamma * z) / (z - 1.0) / u_over_a
    inertia = (alpha_m + (1.0 - alpha_m) * z) / (alpha_f + (1.0 - alpha_f) * z) / u_over_a
    scales = []
    for part in system.parts:
        branches, viscous = part.material.relaxation
        scale = 1.0 + viscous * v_over_u
        for ratio, tau in branches:
            e, start, end = branch_weights(step_s, tau)
            scale += ratio * (1.0 - (start + end * z) / (z - e))
        scales.append(scale)
    return inertia, v_over_u, scales


def _solve_dynamic(system: SkinSystem, force: Float, inertia: complex, rate: complex, scales: list[complex]) -> Complex:
    matrix = _dynamic(system, inertia, rate, scales)
    return factorise(matrix, system.elimination_order()).solve(np.asarray(force, dtype=complex))


def _dynamic(system: SkinSystem, inertia: complex, rate: complex, scales: list[complex]) -> Any:
    matrix = inertia * system.mass + rate * system.damping + system.elastic
    for part, scale in zip(system.parts, scales, strict=True):
        matrix = matrix + scale * part.stiffness
    return matrix.astype(complex)
