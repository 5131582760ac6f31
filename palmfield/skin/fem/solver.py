"""Motion of a skin layer: static, harmonic, and harmonic with the time steps of generalised-alpha."""

import cmath
import math
from collections.abc import Sequence

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.factor import factorise
from palmfield.skin.fem.generalised_alpha import RHO_INF, alpha_weights, branch_weights
from palmfield.skin.materials.material import Material
from palmfield.types import Complex, Float


def static(system: SkinSystem, force: Float) -> Float:
    """Return the static displacement [m], (ndof,), under a constant force [N], with relaxed branches.

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
    """Return the complex displacement [m], (ndof,), under force [N] times e^{-i w t}, exact in time."""
    s = -2j * math.pi * f_Hz
    return _solve_dynamic(system, force, s**2, s, [complex(part.material.stiffening(s)) for part in system.parts])


def harmonic_discrete(system: SkinSystem, force: Float, f_Hz: float, step_s: float) -> Complex:
    """Return the steady state of WedgeStepper under force [N] times e^{-i w t}, complex [m], (ndof,), by its z-symbol.

    |harmonic_discrete - harmonic| is the error of the time step. f_Hz: above 0 and below half the step rate.
    """
    return _solve_dynamic(system, force, *discrete_weights(system.materials, f_Hz, step_s))


def discrete_weights(
    materials: Sequence[Material], f_Hz: float, step_s: float
) -> tuple[complex, complex, list[complex]]:
    """Return the factors of mass, damping and the stiffness of each part, of given material, in the z-symbol."""
    alpha_m, alpha_f, beta, gamma = alpha_weights(RHO_INF)
    z = cmath.exp(-2j * math.pi * f_Hz * step_s)
    # u (z - 1) = h v + h^2 a (1/2 - beta + beta z) and v (z - 1) = h a (1 - gamma + gamma z).
    u_over_a = step_s**2 * ((1.0 - gamma + gamma * z) / (z - 1.0) ** 2 + (0.5 - beta + beta * z) / (z - 1.0))
    v_over_u = step_s * (1.0 - gamma + gamma * z) / (z - 1.0) / u_over_a
    inertia = (alpha_m + (1.0 - alpha_m) * z) / (alpha_f + (1.0 - alpha_f) * z) / u_over_a
    scales = []
    for material in materials:
        branches, viscous = material.relaxation
        scale = 1.0 + viscous * v_over_u
        for ratio, tau in branches:
            e, start, end = branch_weights(step_s, tau)
            scale += ratio * (1.0 - (start + end * z) / (z - e))
        scales.append(scale)
    return inertia, v_over_u, scales


def _solve_dynamic(system: SkinSystem, force: Float, inertia: complex, rate: complex, scales: list[complex]) -> Complex:
    matrix = inertia * system.mass + rate * system.damping + system.elastic
    for part, scale in zip(system.parts, scales, strict=True):
        matrix = matrix + scale * part.stiffness
    return factorise(matrix.astype(complex), system.elimination_order()).solve(np.asarray(force, dtype=complex))
