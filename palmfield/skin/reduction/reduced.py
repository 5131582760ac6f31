"""A small model of a viscoelastic body for repeated loads: rational Krylov reduction, exact in time.

Full body: M u'' + C u' + E u + sum_p K_p (u + sum_i g_i (u - q_i) + t u') = B f, q_i' = (u - q_i) / tau_i, y = Y u,
that is Z(s) u = B f with Z(s) = s^2 M + s C + E + sum_p G_p(s)/G_r K_p under e^{st}.

Reduction: u = V a with V real, from Z^-1 B and its first derivatives in s at a few complex s, real and imaginary parts,
and at s = 0 (Grimme 1997; Beattie & Gugercin 2009 for transfer functions that are not rational). All matrices are
projected with V on both sides and stay symmetric and positive semidefinite, so the small body dissipates energy as the
full one does: it is stable whatever V is, and its static answer to the inputs is exact.

Choice of s: where the residual B - Z V a, in the norm of the inverse static stiffness, is largest on a line of s. The
full body is solved there anyway, so its true error at that s is measured before the basis grows.

Time: coordinates x = (w_k a_k, a', sqrt(g) L_p (a - q)) with w_k^2 the relaxed stiffness's eigenvalues and L^T L = K_p
make |x|^2 / 2 the energy, so exp(A h) never lengthens x. Steps use that matrix exponential, with the force held or
linear in between.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import expm

from palmfield.errors import SceneError
from palmfield.skin.fem.factor import Factor
from palmfield.skin.materials.material import Material
from palmfield.skin.problem import Law
from palmfield.skin.reduction.dynamic_stiffness import LinearBody, Pencil
from palmfield.types import Complex, Float, Int

MOST_CONDITION = 1e8
"""Condition of the eigenvectors above which `run` steps by matrix exponentials (free bodies have a double root 0)."""

FLOOR = 0.01
"""Share of the tolerance below which a direction is left out of the basis."""
WEAK = 0.1
"""Part of the largest answer to which the error of weaker ones is related."""
TAYLOR = 20.0
"""Shifts that fill the band, about: a Taylor series in s is asked to reach this part of it."""
MOST_STEPS = 64
"""Step lengths whose exponentials are kept."""


class _Basis:
    """Mass-orthonormal vectors V, the body's matrices times V, and what residual norms need."""

    def __init__(self, pencil: Pencil, inputs: Float, norm: Factor) -> None:
        self.pencil, self.inputs, self.norm = pencil, inputs, norm
        self.vectors = np.zeros((pencil.size, 0))
        self.products = [np.zeros((pencil.size, 0)) for _ in pencil.matrices]
        self.riesz = [np.zeros((pencil.size, 0)) for _ in pencil.matrices]
        self.riesz_inputs = norm.solve(inputs)

    def add(self, found: Any, floor: float) -> int:
        """Take in columns (n, k), real or complex, but for what is new by less than `floor` of the largest column.

        Returns by how many vectors the basis grew.
        """
        new = np.column_stack([found.real, found.imag] if np.iscomplexobj(found) else [found])
        mass, known = self.pencil.matrices[0], self.vectors
        largest = np.sqrt(np.einsum("nk,nk->k", new, mass @ new).max())
        for limit in (floor * largest, 0.5):
            for _ in range(2):
                new = new - known @ (known.T @ (mass @ new))
            squares, turn = np.linalg.eigh(new.T @ (mass @ new))
            kept = squares > limit**2
            new = new @ (turn[:, kept] / np.sqrt(squares[kept]))
        self.vectors = np.column_stack([known, new])
        for number, matrix in enumerate(self.pencil.matrices):
            product = matrix @ new
            self.products[number] = np.column_stack([self.products[number], product])
            lifted = self.norm.solve(product) if product.any() else product
            self.riesz[number] = np.column_stack([self.riesz[number], lifted])
        return new.shape[1]

    def project(self) -> list[Float]:
        """V^T M V, V^T C V, V^T E V and V^T K_p V, symmetric to the last bit."""
        small = [self.vectors.T @ product for product in self.products]
        return [0.5 * (matrix + matrix.T) for matrix in small]

    def answers(self, s: Complex) -> tuple[Any, Float]:
        """Coordinates a (k, r, j) of the reduced answers at rates s (k,), and their residuals' norms (k,)."""
        weights = self.pencil.weights(s)
        small = np.tensordot(weights, np.array(self.project()), axes=1)
        answer = np.linalg.solve(small, (self.vectors.T @ self.inputs)[None].astype(complex))
        there = [n for n, product in enumerate(self.products) if product.any()]
        parts = np.column_stack([self.inputs, *(self.products[n] for n in there)])
        gram = parts.T @ np.column_stack([self.riesz_inputs, *(self.riesz[n] for n in there)])
        scaled = -weights[:, there, None, None] * answer[:, None]
        count, inputs = len(s), self.inputs.shape[1]
        unit = np.broadcast_to(np.eye(inputs), (count, inputs, inputs))
        share = np.concatenate([unit, scaled.reshape(count, -1, inputs)], axis=1)
        square = np.einsum("kaj,kaj->k", share.conj(), np.matmul(gram, share)).real
        return answer, np.sqrt(np.maximum(square, 0.0))


def reduce(
    body: LinearBody,
    inputs: Any,
    outputs: Any,
    band_Hz: tuple[float, float],
    tolerance: float,
    *,
    order: Int | None = None,
    points: int = 160,
    most_shifts: int = 100,
) -> "Reduced":
    """Reduced model of a body between its inputs and outputs.

    body: the full matrices, n unknowns, such as a SkinSystem
    inputs: B, force [N] for one unit of each of j inputs, shape (n, j), sparse or dense
    outputs: Y, shape (k, n): what is read, y = Y u [m]
    band_Hz: lowest and highest frequency at which the model must be right, 0 <= low < high
    tolerance: wanted relative error of y, on a line s = d + i w over the band, 2 d being the spacing of its `points`,
        which is closer at low w: sharper resonances are seen at this width. Relative to the largest answer at this or
        a higher frequency, or WEAK times the largest of all.
    order: elimination order of the unknowns, shape (n,), for the factors; None lets SuperLU choose
    most_shifts: refuse after this many
    Raises SceneError for shapes that do not fit, a tolerance or band outside these ranges, or no end at most_shifts.
    """
    forces = np.asarray(inputs.toarray() if sparse.issparse(inputs) else inputs, dtype=float)
    read = sparse.csr_matrix(outputs)
    low, high = band_Hz
    size = body.mass.shape[0]
    if forces.ndim != 2 or forces.shape[0] != size or read.shape[1] != size:
        raise SceneError(f"inputs {forces.shape}, outputs {read.shape}: give ({size}, j) and (k, {size})")
    if not (0.0 <= low < high < np.inf and 0.0 < tolerance < 1.0 and np.isfinite(forces).all()):
        raise SceneError(f"band {band_Hz} Hz, tolerance {tolerance}: need 0 <= low < high, 0 < tolerance < 1, finite B")
    pencil = Pencil(body, order)
    # Resonances are narrower at low frequencies.
    omega = 2.0 * np.pi * (low + (high - low) * np.linspace(0.0, 1.0, points) ** 2)
    line = 0.5 * np.gradient(omega) + 1j * omega
    anchor = 0.0
    norm = pencil.static()
    if norm is None:
        # Nothing holds the body: its slowest motion in the band takes the static answer's place.
        anchor = line[0].real
        norm = pencil.factor(anchor)
    basis = _Basis(pencil, forces, norm)
    reach = (omega[-1] - omega[0]) / TAYLOR
    basis.add(pencil.moments(norm, forces, anchor, reach), FLOOR * tolerance)
    tried: list[int] = []
    effectivity: list[float] = []
    error = np.inf
    while True:
        answer, residual = basis.answers(line)
        shapes = basis.vectors
        seen = np.linalg.norm(np.matmul(read @ shapes, answer), axis=(1, 2))
        scale = np.maximum(np.maximum.accumulate(seen[::-1])[::-1], WEAK * seen.max())
        if not scale[0] > 0.0:
            raise SceneError("reduced model: the outputs do not move under the inputs: check B and Y")
        worst = residual / scale
        worst[tried] = 0.0
        if len(effectivity) > 1:
            error = max(effectivity[-2:]) * float((residual / scale).max())
            if error <= tolerance:
                break
        if len(tried) >= most_shifts:
            raise SceneError(
                f"reduced model: error {error:.2g} after {most_shifts} shifts, {tolerance:.2g} wanted: narrow the band "
                f"{band_Hz} Hz or allow more error"
            )
        grown = 0
        for place in _peaks(worst, 1 + len(tried) // 4):
            tried.append(place)
            s = complex(line[place])
            moments = pencil.moments(pencil.factor(s), forces, s, reach)
            exact = read @ moments[:, : forces.shape[1]]
            missed = np.linalg.norm(exact - (read @ shapes) @ answer[place])
            effectivity.append(float(missed / residual[place]) if residual[place] > 0.0 else 0.0)
            grown += basis.add(moments, FLOOR * tolerance)
        if grown == 0:
            error = max(effectivity) * float((residual / scale).max())
            break
    small = Projection(basis.project(), pencil.materials, basis.vectors.T @ forces, read @ basis.vectors)
    return Reduced(small, error, len(tried))


def _peaks(values: Float, count: int) -> list[int]:
    """Places of the largest values that lie apart, at most `count`."""
    found: list[int] = []
    for place in np.argsort(-values, kind="stable").tolist():
        if all(abs(place - other) > len(values) // 16 for other in found):
            found.append(place)
            if len(found) == count:
                break
    return found


class Reduced:
    """Small model: y and y' of forces f. Made by `reduce`, or from a Projection.

    order: number r of basis vectors; shifts: at how many complex rates the full body was solved
    error: estimated relative error of y over the band: the residual's norm (inverse static stiffness) on the line,
        times the largest true error per residual seen at the last two shifts; an estimate, not a bound
    A state is one flat array of `state_size` floats; all zeros is rest.
    """

    def __init__(self, small: "Projection", error: float, shifts: int = 0) -> None:
        self.error, self.shifts = error, shifts
        self.rates, self.inputs, self.displaces, self.moves, self.internals = _energy_form(small)
        self.order = len(small.force)
        self._steps: dict[float, tuple[Float, Float, Float]] = {}
        self._modes: tuple[Complex, Complex] | None = None

    @property
    def state_size(self) -> int:
        return self.rates.shape[0]

    def new_state(self) -> Float:
        """A body at rest, shape (state_size,)."""
        return np.zeros(self.state_size)

    def step(self, state: Float, force_start: Float, force_end: Float, step_s: float) -> None:
        """Advance a state by step_s [s], in place, exactly, under forces (j,) linear between these two."""
        advance, start, end = self.propagators(step_s)
        state[:] = advance @ state + start @ force_start + end @ force_end

    def displacement(self, state: Float) -> Float:
        """y [m], shape (k,)."""
        return self.displaces @ state

    def velocity(self, state: Float) -> Float:
        """y' [m/s], shape (k,)."""
        return self.moves @ state

    def transfer(self, f_Hz: float) -> Complex:
        """y per unit force under e^{-i w t}, shape (k, j)."""
        s = -2j * np.pi * f_Hz
        return self.displaces @ np.linalg.solve(s * np.eye(self.state_size) - self.rates, self.inputs)

    def run(self, forces: Any, times: Float, law: Law = "linear") -> tuple[Any, Any]:
        """y [m] and y' [m/s] at times [s], rising, (t,), of a body at rest at the first, both (t, k).

        forces: real or complex, shape (t, j): "linear" between the times, or "held" at the earlier one's
        Exact in time: the modes of A where they are well conditioned, else a matrix exponential for each step length.
        Raises SceneError for shapes that do not fit or times that do not rise.
        """
        forces = np.asarray(forces, dtype=complex if np.iscomplexobj(forces) else float)
        times = np.asarray(times, dtype=float)
        steps = np.diff(times)
        if forces.shape != (len(times), self.inputs.shape[1]) or not np.all(steps > 0.0):
            raise SceneError(f"forces {forces.shape} at {len(times)} times: give (t, {self.inputs.shape[1]}), rising t")
        # Step lengths that differ by round-off only share their exponentials.
        digits = 12 - int(np.floor(np.log10(times[-1] - times[0]))) if len(times) > 1 else 0
        lengths, which = np.unique(np.round(steps, digits), return_inverse=True)
        if self._modes is None:
            self._modes = np.linalg.eig(self.rates)
        roots, vectors = self._modes
        if np.linalg.cond(vectors, 1) < MOST_CONDITION:
            states = _modal_run(roots, forces @ np.linalg.solve(vectors, self.inputs).T, lengths, which, law)
            shape: Any = self.displaces @ vectors
            moves: Any = self.moves @ vectors
        else:
            states = self._stepped_run(forces, lengths, which, law)
            shape, moves = self.displaces, self.moves
        displacement, velocity = states @ shape.T, states @ moves.T
        if np.iscomplexobj(forces):
            return displacement, velocity
        return displacement.real, velocity.real

    def _stepped_run(self, forces: Any, lengths: Float, which: Any, law: Law) -> Any:
        states = np.zeros((len(forces), self.state_size), dtype=forces.dtype)
        for n, length in enumerate(which):
            advance, start, end = self.propagators(float(lengths[length]))
            last = forces[n] if law == "held" else forces[n + 1]
            states[n + 1] = advance @ states[n] + start @ forces[n] + end @ last
        return states

    def propagators(self, step_s: float) -> tuple[Float, Float, Float]:
        """exp(A h) and the integrals that the force at the step's start and end get (Van Loan 1978)."""
        if step_s not in self._steps:
            if len(self._steps) == MOST_STEPS:
                self._steps.clear()
            size, inputs = self.inputs.shape
            block = np.zeros((size + 2 * inputs, size + 2 * inputs))
            block[:size, :size] = step_s * self.rates
            block[:size, size : size + inputs] = step_s * self.inputs
            block[size : size + inputs, size + inputs :] = np.eye(inputs)
            whole = expm(block)
            ramp = whole[:size, size + inputs :]
            self._steps[step_s] = whole[:size, :size], whole[:size, size : size + inputs] - ramp, ramp
        return self._steps[step_s]


@dataclass(frozen=True)
class Projection:
    """A body in a basis V of r vectors.

    matrices: V^T M V, V^T C V, V^T E V and V^T K_p V, symmetric, (r, r); materials: of the parts
    force: V^T B, shape (r, j); read: Y V, shape (k, r)
    """

    matrices: list[Float]
    materials: list[Material]
    force: Float
    read: Any


def _energy_form(small: Projection) -> tuple[Float, Float, Float, Float, list[Float]]:
    """A, B of x' = A x + B f, the rows that read y and y' off x, in coordinates of energy, and rows for each q.

    The last: for each branch of each part, the coordinates in V of its internal displacement.
    """
    _, damping, elastic, *stiffness = small.matrices
    squares, turn = np.linalg.eigh(elastic + sum(stiffness))
    # A free body's rigid motions have no stiffness: they keep their displacement itself as coordinate.
    held = squares > 1e-12 * squares[-1]
    scale = np.where(held, np.sqrt(np.maximum(squares, 0.0)), 1.0)
    force = turn.T @ small.force
    loss = turn.T @ damping @ turn
    rows, fading, behind = [], [], []
    for matrix, material in zip(stiffness, small.materials, strict=True):
        turned = turn.T @ matrix @ turn
        loss = loss + material.viscous_time_s * turned
        values, vectors = np.linalg.eigh(turned)
        kept = values > 1e-14 * values[-1]
        root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
        inverse = vectors[:, kept] / np.sqrt(values[kept])
        for ratio, tau in zip(material.ratios, material.times_s, strict=True):
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


def _modal_run(roots: Complex, forces: Complex, lengths: Float, which: Any, law: Law) -> Complex:
    """Modes (t, m) from rest under modal forces (t, m)."""
    states = np.zeros(forces.shape, dtype=complex)
    tables: dict[int, tuple[Complex, Complex, Complex]] = {}
    for n, length in enumerate(which.tolist()):
        if length not in tables:
            tables[length] = _modal_weights(roots, float(lengths[length]))
        grow, start, end = tables[length]
        states[n + 1] = grow * states[n] + start * forces[n] + end * forces[n if law == "held" else n + 1]
    return states


def _modal_weights(roots: Complex, h: float) -> tuple[Complex, Complex, Complex]:
    """e^{z}, and h (phi_1 - phi_2) and h phi_2 of z = roots h, for the force at the step's start and end."""
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


def pod(loads: Float, tolerance: float) -> tuple[Float, Float]:
    """Basis of load shapes: loads (n, f) = shapes (n, j) @ coordinates (j, f), to `tolerance` of each's scale.

    Proper orthogonal decomposition (truncated singular values): the largest dropped one is below tolerance times the
    largest, at least one is kept.
    """
    left, singular, right = np.linalg.svd(loads, full_matrices=False)
    kept = max(1, int(np.sum(singular > tolerance * singular[0])))
    return left[:, :kept] * singular[:kept], right[:kept]
