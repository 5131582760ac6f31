"""Motion of a skin layer: static, harmonic, and in time.

Time: generalised-alpha (Chung & Hulbert 1993). A branch's internal displacement q, q' = (u - q) / tau, is integrated
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
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.materials.material import stiffening
from palmfield.skin.mesh.ordering import dissection_order
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


class Scheme:
    """One step of generalised-alpha for a system, as numbers: what is solved, and what goes in and out.

    A state S has a row of n numbers each for displacement u [m], velocity v [m/s], acceleration a [m/s^2] and the
    internal displacement q [m] of every branch of every part. Over a step the new displacement x solves
    effective @ x = (1 - alpha_f) force_end + alpha_f force_start + sum over terms of matrix @ (row @ S),
    then the new state is advance @ S + follow x.

    step_s, rho_inf: as for SkinSolver; state_rows: rows of a state
    effective: csr (n, n) [N/m]; terms: (csr (n, n), row (state_rows,)); advance: (r, r); follow: (r,)
    """

    def __init__(self, system: SkinSystem, step_s: float, rho_inf: float) -> None:
        if not (math.isfinite(step_s) and step_s > 0.0) or not 0.0 <= rho_inf <= 1.0:
            raise SceneError(f"step {step_s} s, rho_inf {rho_inf}: the step must be above 0 and rho_inf in 0..1")
        self.system, self.step_s, self.rho_inf = system, step_s, rho_inf
        alpha_m, self.alpha_f, beta, gamma = alpha_weights(rho_inf)
        before, after = self.alpha_f, 1.0 - self.alpha_f
        self.state_rows = 3 + sum(len(part.material.times_s) for part in system.parts)
        u, v, a, *internal = np.eye(self.state_rows)
        # New acceleration and velocity are a share of x and a row of the old state.
        a_of_x = 1.0 / (beta * step_s**2)
        a_of_state = -a_of_x * (u + step_s * v) - (0.5 / beta - 1.0) * a
        v_of_x = step_s * gamma * a_of_x
        v_of_state = v + step_s * ((1.0 - gamma) * a + gamma * a_of_state)
        self.follow = np.zeros(self.state_rows)
        self.follow[:3] = 1.0, v_of_x, a_of_x
        self.advance = np.zeros((self.state_rows, self.state_rows))
        self.advance[1], self.advance[2] = v_of_state, a_of_state
        self.effective = (1.0 - alpha_m) * a_of_x * system.mass + after * (v_of_x * system.damping + system.elastic)
        self.terms = [
            (system.mass, -((1.0 - alpha_m) * a_of_state + alpha_m * a)),
            (system.elastic, -before * u),
        ]
        if system.damping.nnz:
            self.terms.append((system.damping, -(after * v_of_state + before * v)))
        row = 3
        for part in system.parts:
            viscous = part.material.viscous_time_s
            of_x, old, new = 1.0 + viscous * v_of_x, u + viscous * v, viscous * v_of_state
            for ratio, tau in zip(part.material.ratios, part.material.times_s, strict=True):
                q = internal[row - 3]
                e, start, end = branch_weights(step_s, tau)
                self.follow[row] = end
                self.advance[row] = e * q + start * u
                of_x += ratio * (1.0 - end)
                old = old + ratio * (u - q)
                new = new - ratio * self.advance[row]
                row += 1
            self.effective = self.effective + after * of_x * part.stiffness
            self.terms.append((part.stiffness, -(before * old + after * new)))


class SkinSolver:
    """Steps a system in time; the effective matrix is factored once.

    step_s: time step h [s]
    rho_inf: spectral radius at infinite frequency, 0 (L-stable: what the step cannot resolve is gone at once) to 1
        (none is lost, the trapezoid rule's sibling); 0.8 takes unresolved pressure waves to a tenth in ten steps
    A state is described at Scheme.
    Raises SceneError for a step <= 0 or rho_inf outside 0..1.
    """

    def __init__(self, system: SkinSystem, step_s: float, rho_inf: float = 0.8) -> None:
        self.scheme = Scheme(system, step_s, rho_inf)
        self.system, self.step_s, self.rho_inf = system, step_s, rho_inf
        begin = time.perf_counter()
        self.factor = Factor(self.scheme.effective, dissection_order(system))
        self.factor_seconds = time.perf_counter() - begin

    @property
    def state_rows(self) -> int:
        """Rows of a state: three, and one for each branch of each part."""
        return self.scheme.state_rows

    @property
    def state_size(self) -> int:
        """Numbers in a state."""
        return self.state_rows * self.system.ndof

    def new_state(self) -> Float:
        """A layer at rest, shape (state_rows, ndof)."""
        return np.zeros((self.state_rows, self.system.ndof))

    def step(self, state: Float, force_start: Float, force_end: Float) -> None:
        """Advance a state by one step, in place, under a force [N], (ndof,), linear between its two values."""
        scheme = self.scheme
        right = (1.0 - scheme.alpha_f) * force_end + scheme.alpha_f * force_start
        for matrix, row in scheme.terms:
            right += matrix @ (row @ state)
        moved = self.factor.solve(right)
        state[:] = scheme.advance @ state + np.multiply.outer(scheme.follow, moved)


def alpha_weights(rho_inf: float) -> tuple[float, float, float, float]:
    """(alpha_m, alpha_f, beta, gamma) of Chung & Hulbert (1993), equations 17, 18 and 25."""
    alpha_m = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0)
    alpha_f = rho_inf / (rho_inf + 1.0)
    return alpha_m, alpha_f, 0.25 * (1.0 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f


def static(system: SkinSystem, force: Float) -> Float:
    """Displacement [m], (ndof,), under a force [N] that has acted for ever: the branches are relaxed.

    Raises SceneError for a body that nothing holds.
    """
    if not system.supported:
        raise SceneError(
            "a static answer needs a support: this body's base and sides leave it free to move away; bond the base, "
            "give it Springs, or fix a side"
        )
    matrix = system.elastic + sum(part.stiffness for part in system.parts)
    return Factor(matrix, dissection_order(system)).solve(np.asarray(force, dtype=float))


def harmonic(system: SkinSystem, force: Float, f_Hz: float) -> Complex:
    """Complex displacement [m], (ndof,), under force [N] times e^{-i w t}, exact in time."""
    s = -2j * math.pi * f_Hz
    return _solve_dynamic(system, force, s**2, s, [complex(stiffening(part.material, s)) for part in system.parts])


def harmonic_discrete(system: SkinSystem, force: Float, f_Hz: float, step_s: float, rho_inf: float = 0.8) -> Complex:
    """The steady state that SkinSolver itself reaches under force [N] times e^{-i w t}: its z-symbol.

    |harmonic_discrete - harmonic| is the error of the time step. f_Hz > 0, below half the step rate.
    """
    alpha_m, alpha_f, beta, gamma = alpha_weights(rho_inf)
    z = cmath.exp(-2j * math.pi * f_Hz * step_s)
    # u (z - 1) = h v + h^2 a (1/2 - beta + beta z) and v (z - 1) = h a (1 - gamma + gamma z).
    u_over_a = step_s**2 * ((1.0 - gamma + gamma * z) / (z - 1.0) ** 2 + (0.5 - beta + beta * z) / (z - 1.0))
    v_over_u = step_s * (1.0 - gamma + gamma * z) / (z - 1.0) / u_over_a
    inertia = (alpha_m + (1.0 - alpha_m) * z) / (alpha_f + (1.0 - alpha_f) * z) / u_over_a
    scales = []
    for part in system.parts:
        scale = 1.0 + part.material.viscous_time_s * v_over_u
        for ratio, tau in zip(part.material.ratios, part.material.times_s, strict=True):
            e, start, end = branch_weights(step_s, tau)
            scale += ratio * (1.0 - (start + end * z) / (z - e))
        scales.append(scale)
    return _solve_dynamic(system, force, inertia, v_over_u, scales)


def _solve_dynamic(system: SkinSystem, force: Float, inertia: complex, rate: complex, scales: list[complex]) -> Complex:
    matrix = inertia * system.mass + rate * system.damping + system.elastic
    for part, scale in zip(system.parts, scales, strict=True):
        matrix = matrix + scale * part.stiffness
    return Factor(matrix.astype(complex), dissection_order(system)).solve(np.asarray(force, dtype=complex))
