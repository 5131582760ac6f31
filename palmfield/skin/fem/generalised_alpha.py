"""Coefficients of one step of generalised-alpha (Chung & Hulbert 1993) for a viscoelastic body.

The internal displacement q of a branch, q' = (u - q) / tau, is integrated exactly for u linear over the step:
q1 = e q0 + a u0 + b u1 with e = exp(-h/tau), b = 1 - (1 - e) tau/h and a = 1 - e - b. This is stable for every h/tau.
For h/tau -> infinity, q1 -> u1: the branch then simply relaxes.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.linear_body import LinearBody
from palmfield.types import Float

RHO_INF = 0.8
"""Default spectral radius at infinite frequency: it reduces unresolved pressure waves to a tenth in ten steps."""


def branch_weights(step_s: float, tau_s: float) -> tuple[float, float, float]:
    """Return (e, a, b) of q1 = e q0 + a u0 + b u1 over a step [s] at relaxation time tau [s]."""
    if tau_s == 0.0:
        return 0.0, 0.0, 1.0
    x = step_s / tau_s
    e = math.exp(-x)
    # Below x = 1e-3 the closed form loses digits; three terms of its series are then exact to 1e-13.
    b = 1.0 + math.expm1(-x) / x if x > 1e-3 else x / 2.0 - x**2 / 6.0 + x**3 / 24.0
    return e, -math.expm1(-x) - b, b


def alpha_weights(rho_inf: float) -> tuple[float, float, float, float]:
    """Return (alpha_m, alpha_f, beta, gamma) of Chung & Hulbert (1993), equations 17, 18 and 25."""
    alpha_m = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0)
    alpha_f = rho_inf / (rho_inf + 1.0)
    return alpha_m, alpha_f, 0.25 * (1.0 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f


@dataclass(frozen=True)
class Term:
    """One matrix of a body, csr (n, n): the effective matrix contains coefficient * matrix, and the right-hand side
    matrix @ (row @ S), row of shape (r,)."""

    matrix: sparse.csr_matrix
    coefficient: float
    row: Float


class Scheme:
    """Coefficients of one step of generalised-alpha for a system: matrix to solve, right-hand side and new state.

    A state S has r rows of n numbers: displacement u [m], velocity v [m/s], acceleration a [m/s^2] and the internal
    displacement q [m] of every branch of every part. The displacement x at the end of a step solves
    (sum over terms of coefficient * matrix) @ x
        = (1 - alpha_f) force_end + alpha_f force_start + sum over terms of matrix @ (row @ S).
    The new state is advance @ S + follow x.

    step_s [s], rho_inf: as for WedgeStepper; state_rows: r; terms: only non-zero matrices.
    advance: (r, r); follow: (r,).
    Raises SceneError for a step <= 0 or rho_inf outside 0..1.
    """

    def __init__(self, system: LinearBody, step_s: float, rho_inf: float) -> None:
        if not (math.isfinite(step_s) and step_s > 0.0) or not 0.0 <= rho_inf <= 1.0:
            raise SceneError(f"step {step_s} s, rho_inf {rho_inf}: the step must be above 0 and rho_inf in 0..1")
        alpha_m, self.alpha_f, beta, gamma = alpha_weights(rho_inf)
        before, after = self.alpha_f, 1.0 - self.alpha_f
        self.state_rows = 3 + sum(len(part.material.relaxation.branches) for part in system.parts)
        u, v, a, *internal = np.eye(self.state_rows)
        # New acceleration and velocity are a factor times x plus a row of coefficients times the old state.
        a_of_x = 1.0 / (beta * step_s**2)
        a_of_state = -a_of_x * (u + step_s * v) - (0.5 / beta - 1.0) * a
        v_of_x = step_s * gamma * a_of_x
        v_of_state = v + step_s * ((1.0 - gamma) * a + gamma * a_of_state)
        self.follow = np.zeros(self.state_rows)
        self.follow[:3] = 1.0, v_of_x, a_of_x
        self.advance = np.zeros((self.state_rows, self.state_rows))
        self.advance[1], self.advance[2] = v_of_state, a_of_state
        terms = [
            Term(system.mass, (1.0 - alpha_m) * a_of_x, -((1.0 - alpha_m) * a_of_state + alpha_m * a)),
            Term(system.elastic, after, -before * u),
            Term(system.damping, after * v_of_x, -(after * v_of_state + before * v)),
        ]
        row = 3
        for part in system.parts:
            branches, viscous = part.material.relaxation
            of_x, old, new = 1.0 + viscous * v_of_x, u + viscous * v, viscous * v_of_state
            for ratio, tau in branches:
                q = internal[row - 3]
                e, start, end = branch_weights(step_s, tau)
                self.follow[row] = end
                self.advance[row] = e * q + start * u
                of_x += ratio * (1.0 - end)
                old = old + ratio * (u - q)
                new = new - ratio * self.advance[row]
                row += 1
            terms.append(Term(part.stiffness, after * of_x, -(before * old + after * new)))
        self.terms = [term for term in terms if term.matrix.nnz]

    def stiffened(self, parts: int) -> list[float]:
        """Return the factor G / G_r in a step for each of the last terms, which belong to the parts of a body.
        The solved matrix contains these terms stiffer by this factor than terms without relaxation."""
        return [term.coefficient / (1.0 - self.alpha_f) for term in self.terms[-parts:]]

    def effective(self) -> sparse.csr_matrix:
        """Return the matrix of the equation of a step, (n, n) [N/m]."""
        return sum(term.coefficient * term.matrix for term in self.terms)
