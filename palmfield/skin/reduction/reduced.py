"""Reduced model of a viscoelastic body, exact in time for loads that are linear between times.

Full body: M u'' + C u' + E u + sum_p K_p (u + sum_i g_i (u - q_i) + t u') = B f, q_i' = (u - q_i) / tau_i, y = Y u.
Its matrices are projected on both sides with a real V (palmfield.skin.reduction.krylov) and stay symmetric and
positive semidefinite. So the reduced body dissipates energy like the full body, and it is stable for any V.

Time: coordinates are x = (w_k a_k, a', sqrt(g) L_p (a - q)); w_k^2 are the eigenvalues of the relaxed stiffness, and
L^T L = K_p. Then |x|^2 / 2 is the energy, so exp(A h) never makes x longer. Steps use this matrix exponential, with the
force constant or linear in between.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.projection import Projection
from palmfield.types import Complex, Float

if TYPE_CHECKING:
    from palmfield.skin.problem import Law

MOST_CONDITION = 1e8
"""Condition number of the eigenvectors above which `run` uses matrix exponentials (free bodies: double root 0)."""

MOST_STEPS = 64
"""Number of step lengths whose exponentials are stored."""


class Reduced:
    """Reduced model: computes y and y' from forces f.

    small: the body in the basis; order: number r of basis vectors
    error: estimated relative error of y; it is not a bound
    A state is a flat array of `state_size` floats; at rest all are 0.
    """

    def __init__(self, small: Projection, error: float) -> None:
        self.small, self.error = small, error
        self.rates, self.inputs, self.displaces, self.moves, self.internals = _energy_form(small)
        self.order = len(small.force)
        self._steps: dict[float, tuple[Float, Float, Float]] = {}

    @property
    def state_size(self) -> int:
        return self.rates.shape[0]

    def new_state(self) -> Float:
        """Return a body at rest, shape (state_size,)."""
        return np.zeros(self.state_size)

    def step(self, state: Float, force_start: Float, force_end: Float, step_s: float) -> None:
        """Advance a state in place by step_s [s], exactly, under forces (j,) that are linear from start to end."""
        advance, start, end = self.propagators(step_s)
        state[:] = advance @ state + start @ force_start + end @ force_end

    def march(self, state: Float, first: Float, last: Float, step_s: float) -> Float:
        """Return the states (s, state_size) after each of s steps of step_s [s], exactly; `state` does not change.

        first, last: forces at the start and end of each step, linear in between, (s, j)
        If the modes of A are well conditioned, they replace the matrix exponential.
        """
        modes = self._modes
        if modes is None:
            advance, start, end = self.propagators(step_s)
            states = first @ start.T + last @ end.T
            for after in states:
                after += advance @ state
                state = after
            return states
        grow, at_start, at_end = _modal_weights(modes.roots, step_s)
        moved = at_start * (first @ modes.inputs.T) + at_end * (last @ modes.inputs.T)
        before = modes.inverse @ state
        for after in moved:
            after += grow * before
            before = after
        return np.ascontiguousarray((moved @ modes.vectors.T).real)

    @cached_property
    def _modes(self) -> "_Modes | None":
        """Modes of A; None if they are ill conditioned."""
        with one_blas_thread:
            roots, vectors = np.linalg.eig(self.rates)
            if not np.linalg.cond(vectors, 1) < MOST_CONDITION:
                return None
            inverse = np.linalg.inv(vectors)
            return _Modes(roots, vectors, inverse, np.linalg.solve(vectors, self.inputs))

    def decoupled(self, step_s: float) -> "Decoupled | None":
        """Return the same steps in uncoupled coordinates, without a matrix exponential; None if ill conditioned."""
        modes = self._modes
        if modes is None:
            return None
        paired, fading = modes.roots.imag > 0.0, modes.roots.imag == 0.0
        swinging, count = modes.vectors[:, paired].T, 2 * np.count_nonzero(paired)
        back: Float = np.empty((self.state_size, self.state_size))
        back[0:count:2], back[1:count:2] = 2.0 * swinging.real, -2.0 * swinging.imag
        back[count:] = modes.vectors[:, fading].real.T
        with one_blas_thread:
            there: Float = np.linalg.inv(back).astype(np.float64, copy=False)
        weighted = (
            (modes.vectors @ (weights[:, None] * modes.inputs)).real
            for weights in _modal_weights(modes.roots, step_s)[1:]
        )
        start, end = (part.T @ there for part in weighted)
        grow, fall = np.exp(modes.roots[paired] * step_s), np.exp(modes.roots[fading].real * step_s)
        return Decoupled(there, back, grow, fall, start, end)

    def displacement(self, state: Float) -> Float:
        """Return y [m], shape (k,)."""
        return self.displaces @ state

    def velocity(self, state: Float) -> Float:
        """Return y' [m/s], shape (k,)."""
        return self.moves @ state

    def transfer(self, f_Hz: float) -> Complex:
        """Return y per unit force under e^{-i w t}, shape (k, j)."""
        s = -2j * np.pi * f_Hz
        return self.displaces @ np.linalg.solve(s * np.eye(self.state_size) - self.rates, self.inputs)

    def run(self, forces: Any, times: Float, law: "Law" = "linear") -> tuple[Any, Any]:
        """Return y [m] and y' [m/s] at ascending times [s], (t,), both (t, k); the body starts at rest.

        forces: real or complex, shape (t, j): "linear" between the times, or "held" at the earlier value.
        Exact in time: by the modes of A if they are well conditioned, else by a matrix exponential per step length.
        Raises SceneError for shapes that do not fit or times that do not ascend.
        """
        forces = np.asarray(forces, dtype=complex if np.iscomplexobj(forces) else float)
        times = np.asarray(times, dtype=float)
        steps = np.diff(times)
        if forces.shape != (len(times), self.inputs.shape[1]) or not np.all(steps > 0.0):
            raise SceneError(f"forces {forces.shape} at {len(times)} times: give (t, {self.inputs.shape[1]}), rising t")
        # Step lengths that differ only by rounding use the same exponentials.
        digits = 12 - int(np.floor(np.log10(times[-1] - times[0]))) if len(times) > 1 else 0
        lengths, which = np.unique(np.round(steps, digits), return_inverse=True)
        modes = self._modes
        if modes is not None:
            states = _modal_run(modes.roots, forces @ modes.inputs.T, lengths, which, law)
            shape: Any = self.displaces @ modes.vectors
            moves: Any = self.moves @ modes.vectors
        else:
            states = self._stepped_run(forces, lengths, which, law)
            shape, moves = self.displaces, self.moves
        displacement, velocity = states @ shape.T, states @ moves.T
        if np.iscomplexobj(forces):
            return displacement, velocity
        return displacement.real, velocity.real

    def _stepped_run(self, forces: Any, lengths: Float, which: Any, law: "Law") -> Any:
        states = np.zeros((len(forces), self.state_size), dtype=forces.dtype)
        for n, length in enumerate(which):
            advance, start, end = self.propagators(float(lengths[length]))
            last = forces[n] if law == "held" else forces[n + 1]
            states[n + 1] = advance @ states[n] + start @ forces[n] + end @ last
        return states

    def propagators(self, step_s: float) -> tuple[Float, Float, Float]:
        """Return exp(A h) and the integrals for the force at the start and at the end of the step (Van Loan 1978)."""
        found = self._steps.get(step_s)
        if found is None:
            if len(self._steps) >= MOST_STEPS:
                self._steps.clear()
            size, inputs = self.inputs.shape
            block = np.zeros((size + 2 * inputs, size + 2 * inputs))
            block[:size, :size] = step_s * self.rates
            block[:size, size : size + inputs] = step_s * self.inputs
            block[size : size + inputs, size + inputs :] = np.eye(inputs)
            with one_blas_thread:
                whole = scipy.linalg.expm(block)
            ramp = whole[:size, size + inputs :]
            # Another thread may clear the dictionary, so the result is returned without a second look-up
            found = self._steps[step_s] = whole[:size, :size], whole[:size, size : size + inputs] - ramp, ramp
        return found


@dataclass(frozen=True)
class Decoupled:
    """Steps of a reduced model in modal coordinates z: z = x @ there for a state x, and x = z @ back, both (n, n).

    The first numbers of z are real and imaginary parts of oscillating modes; the others are purely decaying modes.
    grow: factor of a step for each oscillating mode. fall: factor for each decaying mode.
    start, end: increment of z by a unit of each force at the start and at the end of a step, shapes (j, n).
    """

    there: Float
    back: Float
    grow: Complex
    fall: Float
    start: Float
    end: Float

    def march(self, before: Float, states: Float) -> None:
        """Do all steps; each overwrites its increment in `states`, (w, s, n), by the new z; before: first z, (w, n)."""
        count = 2 * len(self.grow)
        for i in range(states.shape[1]):
            after = states[:, i]
            after[:, :count].view(np.complex128)[...] += self.grow * before[:, :count].view(np.complex128)
            after[:, count:] += self.fall * before[:, count:]
            before = after


@dataclass(frozen=True)
class _Modes:
    """Modes of A: rates [1/s], vectors as columns, inverse of these, and modal forces for one unit of each input."""

    roots: Complex
    vectors: Complex
    inverse: Complex
    inputs: Complex


def _energy_form(small: Projection) -> tuple[Float, Float, Float, Float, list[Float]]:
    """Return A and B of x' = A x + B f in coordinates of energy, rows that read y and y' from x, and rows for each q.

    The rows for q give the coordinates in V of the internal displacement of each branch of each part.
    """
    _, damping, elastic, *stiffness = small.matrices
    squares, turn = np.linalg.eigh(elastic + sum(stiffness))
    # Rigid motions of a free body have no stiffness, so their coordinate is a displacement.
    held = squares > 1e-12 * squares[-1]
    scale = np.where(held, np.sqrt(np.maximum(squares, 0.0)), 1.0)
    force = turn.T @ small.force
    loss = turn.T @ damping @ turn
    rows, fading, behind = [], [], []
    for matrix, material in zip(stiffness, small.materials, strict=True):
        turned = turn.T @ matrix @ turn
        loss = loss + material.relaxation.viscous_time_s * turned
        values, vectors = np.linalg.eigh(turned)
        kept = values > 1e-14 * values[-1]
        root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
        inverse = vectors[:, kept] / np.sqrt(values[kept])
        for ratio, tau in material.relaxation.branches:
            if ratio > 0.0 and tau > 0.0:
                rows.append(np.sqrt(ratio) * root)
                fading.append(np.full(len(root), 1.0 / tau))
                behind.append(inverse / np.sqrt(ratio))
            else:
                behind.append(np.zeros((len(squares), 0)))
    count = len(squares)
    inner = np.concatenate(rows) if rows else np.zeros((0, count))
    size = 2 * count + len(inner)
    rates = np.zeros((size, size))
    rates[:count, count : 2 * count] = np.diag(scale)
    rates[count : 2 * count, :count] = -np.diag(np.where(held, scale, 0.0))
    rates[count : 2 * count, count : 2 * count] = -loss
    rates[count : 2 * count, 2 * count :] = -inner.T
    rates[2 * count :, count : 2 * count] = inner
    rates[2 * count :, 2 * count :] = -np.diag(np.concatenate(fading)) if fading else 0.0
    driven = np.zeros((size, force.shape[1]))
    driven[count : 2 * count] = force
    shapes = small.read @ turn
    displaces, moves = np.zeros((len(shapes), size)), np.zeros((len(shapes), size))
    displaces[:, :count] = shapes / scale
    moves[:, count : 2 * count] = shapes
    internals, place = [], 2 * count
    for inverse in behind:
        internal = np.zeros((count, size))
        internal[:, :count] = turn / scale
        internal[:, place : place + inverse.shape[1]] = -turn @ inverse
        place += inverse.shape[1]
        internals.append(internal)
    return rates, driven, displaces, moves, internals


def _modal_run(roots: Complex, forces: Complex, lengths: Float, which: Any, law: "Law") -> Complex:
    """Return the modal coordinates (t, m) under modal forces (t, m), from rest."""
    states = np.zeros(forces.shape, dtype=complex)
    tables: dict[int, tuple[Complex, Complex, Complex]] = {}
    for n, length in enumerate(which.tolist()):
        if length not in tables:
            tables[length] = _modal_weights(roots, float(lengths[length]))
        grow, start, end = tables[length]
        states[n + 1] = grow * states[n] + start * forces[n] + end * forces[n if law == "held" else n + 1]
    return states


def _modal_weights(roots: Complex, h: float) -> tuple[Complex, Complex, Complex]:
    """Return e^{z} for z = roots h, and h (phi_1 - phi_2) and h phi_2 for the force at start and end of a step."""
    z = roots * h
    small = np.abs(z) < 0.1
    safe = np.where(small, 1.0, z)
    grow = np.exp(z)
    first: Any = np.expm1(z) / safe
    second: Any = (first - 1.0) / safe
    term = np.ones_like(z[small])
    first[small], second[small] = 0.0, 0.0
    for n in range(1, 11):
        term = term / n
        first[small] += term
        second[small] += term / (n + 1)
        term = term * z[small]
    return grow, h * (first - second), h * second
