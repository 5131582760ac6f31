"""Motion of a skin layer: static, harmonic, and in time.

Time: generalised-alpha (Chung & Hulbert 1993). The branch's internal displacement q, q' = (u - q) / tau, is integrated
exactly for u linear over the step, so that q1 = e q0 + a u0 + b u1 with e = exp(-h/tau), b = 1 - (1 - e) tau/h and
a = 1 - e - b. It is stable for every h/tau, and q1 -> u1 as h/tau -> infinity: the branch then simply relaxes.
"""

import cmath
import math
import time
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu
from threadpoolctl import ThreadpoolController

from palmfield.errors import SceneError
from palmfield.skin.assembly import SkinSystem
from palmfield.skin.material import complex_shear
from palmfield.skin.ordering import dissection_order
from palmfield.types import Complex, Float, Int

# SuperLU asks BLAS for blocks so small that its threads wait for each other: up to 200 times slower than one thread.
BLAS = ThreadpoolController()


class Factor:
    """Sparse LU of a symmetric matrix in a given elimination order."""

    def __init__(self, matrix: Any, order: Int) -> None:
        self.order = order
        # A symmetric positive real part needs no pivoting, and pivoting would undo the order.
        with BLAS.limit(limits=1, user_api="blas"):
            self.lu = splu(
                matrix[order][:, order].tocsc(),
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )

    def solve(self, right: Any) -> Any:
        result = np.empty_like(right)
        with BLAS.limit(limits=1, user_api="blas"):
            result[self.order] = self.lu.solve(right[self.order])
        return result


def branch_weights(step_s: float, tau_s: float) -> tuple[float, float, float]:
    """(e, a, b) of q1 = e q0 + a u0 + b u1 over a step [s] at relaxation time tau [s]."""
    if tau_s == 0.0:
        return 0.0, 0.0, 1.0
    x = step_s / tau_s
    e = math.exp(-x)
    # Below x = 1e-3 the closed form loses digits; three terms of its series are then exact to 1e-13.
    b = 1.0 + math.expm1(-x) / x if x > 1e-3 else x / 2.0 - x**2 / 6.0 + x**3 / 24.0
    return e, -math.expm1(-x) - b, b


class SkinSolver:
    """Steps a system in time; the effective matrix is factored once.

    step_s: time step h [s]
    rho_inf: spectral radius at infinite frequency, 0 (strongest damping of what the step cannot resolve) to 1 (none,
        the trapezoid rule's sibling); 0.8 takes unresolved pressure waves to a tenth in ten steps
    A state has shape (4, ndof): displacement u [m], velocity v [m/s], acceleration a [m/s^2], internal
    displacement q [m].
    Raises SceneError for a step <= 0 or rho_inf outside 0..1.
    """

    def __init__(self, system: SkinSystem, step_s: float, rho_inf: float = 0.8) -> None:
        if not (math.isfinite(step_s) and step_s > 0.0) or not 0.0 <= rho_inf <= 1.0:
            raise SceneError(f"step {step_s} s, rho_inf {rho_inf}: the step must be above 0 and rho_inf in 0..1")
        self.system = system
        self.step_s = step_s
        self.rho_inf = rho_inf
        self.alpha_m, self.alpha_f, self.beta, self.gamma = alpha_weights(rho_inf)
        self.weights = branch_weights(step_s, system.material.relaxation_time_s)
        ratio = system.material.branch_ratio
        implicit = 1.0 - self.alpha_f
        begin = time.perf_counter()
        effective = (
            (1.0 - self.alpha_m) / (self.beta * step_s**2) * system.mass
            + implicit * system.k_vol
            + implicit * (1.0 + ratio * (1.0 - self.weights[2])) * system.k_dev
        )
        self.factor = Factor(effective, dissection_order(system))
        self.factor_seconds = time.perf_counter() - begin

    @property
    def state_size(self) -> int:
        """Numbers in a state: 4 * ndof."""
        return 4 * self.system.ndof

    def new_state(self) -> Float:
        """A layer at rest, shape (4, ndof)."""
        return np.zeros((4, self.system.ndof))

    def step(self, state: Float, force_start: Float, force_end: Float) -> None:
        """Advance a state by one step, in place, under a force [N], (ndof,), linear between its two values."""
        system, h = self.system, self.step_s
        u, v, a, q = state
        e, weight_start, weight_end = self.weights
        ratio = system.material.branch_ratio
        implicit = 1.0 - self.alpha_f
        predicted = u + h * v
        inertia = (1.0 - self.alpha_m) / (self.beta * h**2) * predicted
        inertia += ((1.0 - self.alpha_m) * (0.5 / self.beta - 1.0) - self.alpha_m) * a
        known_q = e * q + weight_start * u
        # Without the new displacement: what the old one carries, less the pull of the new q's known part.
        right = implicit * force_end + self.alpha_f * force_start
        right += system.mass @ inertia - self.alpha_f * (system.k_vol @ u)
        right -= system.k_dev @ (self.alpha_f * (u + ratio * (u - q)) - implicit * ratio * known_q)
        new_u = self.factor.solve(right)
        new_a = (new_u - predicted) / (self.beta * h**2) - (0.5 / self.beta - 1.0) * a
        state[1] = v + h * ((1.0 - self.gamma) * a + self.gamma * new_a)
        state[3] = known_q + weight_end * new_u
        state[0] = new_u
        state[2] = new_a


def alpha_weights(rho_inf: float) -> tuple[float, float, float, float]:
    """(alpha_m, alpha_f, beta, gamma) of Chung & Hulbert (1993), equations 17, 18 and 25."""
    alpha_m = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0)
    alpha_f = rho_inf / (rho_inf + 1.0)
    return alpha_m, alpha_f, 0.25 * (1.0 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f


def static(system: SkinSystem, force: Float) -> Float:
    """Displacement [m], (ndof,), under a force [N] that has acted for ever: the branch is relaxed."""
    return Factor(system.k_vol + system.k_dev, dissection_order(system)).solve(np.asarray(force, dtype=float))


def harmonic(system: SkinSystem, force: Float, f_Hz: float) -> Complex:
    """Complex displacement [m], (ndof,), under force [N] times e^{-i w t}, exact in time."""
    scale = complex_shear(system.material, f_Hz) / system.material.shear_relaxed_Pa
    return _solve_dynamic(system, force, -((2.0 * math.pi * f_Hz) ** 2), scale)


def harmonic_discrete(system: SkinSystem, force: Float, f_Hz: float, step_s: float, rho_inf: float = 0.8) -> Complex:
    """The steady state that SkinSolver itself reaches under force [N] times e^{-i w t}: its z-symbol.

    |harmonic_discrete - harmonic| is the error of the time step. f_Hz > 0, below half the step rate.
    """
    alpha_m, alpha_f, beta, gamma = alpha_weights(rho_inf)
    e, start, end = branch_weights(step_s, system.material.relaxation_time_s)
    z = cmath.exp(-2j * math.pi * f_Hz * step_s)
    # u (z - 1) = h v + h^2 a (1/2 - beta + beta z) and v (z - 1) = h a (1 - gamma + gamma z).
    u_over_a = step_s**2 * ((1.0 - gamma + gamma * z) / (z - 1.0) ** 2 + (0.5 - beta + beta * z) / (z - 1.0))
    inertia = (alpha_m + (1.0 - alpha_m) * z) / (alpha_f + (1.0 - alpha_f) * z) / u_over_a
    branch = 1.0 - (start + end * z) / (z - e)
    return _solve_dynamic(system, force, inertia, 1.0 + system.material.branch_ratio * branch)


def _solve_dynamic(system: SkinSystem, force: Float, inertia: complex, shear_scale: complex) -> Complex:
    matrix = inertia * system.mass + system.k_vol + shear_scale * system.k_dev
    return Factor(matrix.astype(complex), dissection_order(system)).solve(np.asarray(force, dtype=complex))
