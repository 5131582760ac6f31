"""Steps a whole layer of quadratic wedges by generalised-alpha (Chung & Hulbert 1993): one triangular solve a substep.

The substep (see Scheme) solves A x = f + sum_i K_i z_i for the new displacement x, where A = sum_i c_i K_i and z_i are
sums of rows of the old state. One of the K_i need not be multiplied: with z_0 = c_0 y,

    x = y + A^-1 (f + sum over i > 0 of K_i (z_i - c_i y)).

The matrix with the most numbers is left out in this way, which is a third of all that a substep of a small layer reads.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

# SciPy's products take ten Python calls around these, which add to what is there: y += A x.
from scipy.sparse._sparsetools import csr_matvec

from palmfield.blas import one_blas_thread
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.factor import factorise
from palmfield.skin.fem.generalised_alpha import Scheme
from palmfield.skin.stepper import Reader, SurfaceLoads, check_step, checked_operator
from palmfield.types import Float


@dataclass
class _Room:
    """Work arrays of a call: right-hand side and solution (n,), sums of state rows (i, n), two states, forces of
    patterns (k, n)."""

    right: Float
    moved: Float
    sums: Float
    next: Float
    change: Float
    forces: Float


class WedgeStepper:
    """The whole layer; see SkinStepper.

    inputs: csr, shape (n, q): consistent nodal force [N] = inputs @ inward pressure [Pa]
    step_s: length of a substep [s]; rho_inf: spectral radius at infinite frequency, 0 (L-stable: what the step cannot
        resolve is gone at once) to 1 (none is lost); 0.8 takes unresolved pressure waves to a tenth in ten steps
    A state has a row of n numbers each for displacement [m], velocity [m/s], acceleration [m/s^2] and the internal
    displacement [m] of every branch of every part.
    Raises SceneError for a step <= 0 or rho_inf outside 0..1.
    """

    name = "wedges"
    error = 0.0

    def __init__(self, system: SkinSystem, inputs: sparse.csr_matrix, step_s: float, rho_inf: float = 0.8) -> None:
        scheme = Scheme(system, step_s, rho_inf)
        self.step_s, self.ndof, self.state_rows = step_s, system.ndof, scheme.state_rows
        self.state_size = self.state_rows * self.ndof
        self.inputs = sparse.csr_matrix(inputs, dtype=np.float64)
        self.factor = factorise(scheme.effective(), system.elimination_order())
        self._alpha_f = scheme.alpha_f
        left_out, *others = sorted(scheme.terms, key=lambda term: -term.matrix.nnz)
        offset = left_out.row / left_out.coefficient
        self._sums = np.array([*(term.row - term.coefficient * offset for term in others), offset])
        self._others = sparse.hstack([term.matrix for term in others], format="csr")
        self._advance, self._follow = scheme.advance, scheme.follow[:, None]
        self._rooms: list[_Room] = []

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | None:
        """See SkinStepper."""
        check_step(self, state, loads, t0, t1)
        rows = state[0].reshape(self.state_rows, self.ndof)
        first, last = loads.first[0], loads.last[0]
        mix = self._alpha_f * first + (1.0 - self._alpha_f) * last
        substeps = len(mix)
        seen = None if observe is None else np.zeros((1, substeps, 2, observe.count))
        room = self._room(mix.shape[1])
        matrix, size, solve = self._others, self.ndof, self.factor.solve_vector
        others = room.sums[:-1].reshape(-1)
        with one_blas_thread:
            forces = self._forces(room, loads.pressure_Pa[0])
            for i in range(substeps):
                np.matmul(self._sums, rows, out=room.sums)
                np.matmul(mix[i], forces, out=room.right)
                csr_matvec(size, len(others), matrix.indptr, matrix.indices, matrix.data, others, room.right)
                moved = solve(room.right, room.moved)
                np.add(moved, room.sums[-1], out=moved)
                np.matmul(self._advance, rows, out=room.next)
                np.multiply(self._follow, moved, out=room.change)
                np.add(room.next, room.change, out=rows)
                if seen is not None:
                    self._read(rows, observe, seen[0, i])
        self._rooms.append(room)
        return seen

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """See SkinStepper."""
        matrix = checked_operator(operator, self.ndof)
        return Reader(matrix.shape[0], matrix)

    def read(self, state: Float, reader: Reader) -> Float:
        """See SkinStepper."""
        result = np.zeros((len(state), 2, reader.count))
        for one, out in zip(state, result, strict=True):
            self._read(one.reshape(self.state_rows, self.ndof), reader, out)
        return result

    def _read(self, rows: Float, reader: Any, out: Float) -> None:
        matrix = reader.matrix
        for row, result in zip(rows, out, strict=False):
            csr_matvec(reader.count, self.ndof, matrix.indptr, matrix.indices, matrix.data, row, result)

    def _forces(self, room: _Room, pressure: Float) -> Float:
        """Nodal forces [N] of each pattern, shape (k, n)."""
        forces, inputs = room.forces[: len(pressure)], self.inputs
        pressure = pressure.astype(np.float64, copy=False)
        forces[:] = 0.0
        for pattern, force in zip(pressure, forces, strict=True):
            csr_matvec(self.ndof, len(pattern), inputs.indptr, inputs.indices, inputs.data, pattern, force)
        return forces

    def _room(self, patterns: int) -> _Room:
        """Work arrays: those of an earlier call if no other thread has them. Appended to and taken from atomically."""
        try:
            room = self._rooms.pop()
        except IndexError:
            state = np.empty((self.state_rows, self.ndof))
            sums = np.empty((len(self._sums), self.ndof))
            room = _Room(np.empty(self.ndof), np.empty(self.ndof), sums, state, state.copy(), np.empty((0, self.ndof)))
        if len(room.forces) < patterns:
            room.forces = np.empty((patterns, self.ndof))
        return room
