"""Step a whole layer of quadratic wedges by generalised-alpha (Chung & Hulbert 1993), with one solve per substep.

A substep (see Scheme) solves A x = f + sum_i K_i z_i for the new displacement x. A is sum_i c_i K_i; z_i are sums of
rows of the old state. With z_0 = c_0 y, one product with a K_i is saved:

    x = y + A^-1 (f + sum over i > 0 of K_i (z_i - c_i y)).

K_0 is the largest matrix. It would be a third of the data that a substep of a small layer reads.

An ordinary sparse product reads the column of each number. With groups of ROWS rows, each column is read once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from scipy import sparse

# These functions of SciPy compute y += A x in place; the public products make ten more Python calls.
from scipy.sparse._sparsetools import csr_matvec
from scipy.sparse.csgraph import connected_components

from palmfield.device import filled, recorded, whole_numbers
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.elimination import BlockFactor, block_factor
from palmfield.skin.fem.generalised_alpha import RHO_INF, Scheme
from palmfield.skin.stepper import Reader, SkinStepper, SurfaceLoads, check_step, checked_operator
from palmfield.threads import Calls, cores, share
from palmfield.types import Float, Float32, Int
from warp_kernels import supernodes as kernels
from warp_kernels.supernodes import ROWS, GroupedRows, rows_of_group

STORED_PER_THREAD = 250_000
"""Least count of numbers in the blocks for each thread."""


@dataclass(frozen=True)
class _Room:
    """Work arrays of a call, and the kernel launches on them. Unknowns are numbered by the places of the factor.

    rows: state, (r, size). forces: forces of patterns, (k, size). weights: of patterns in the next substep, (k,).
    add_up: computes the sums of rows for the first substep.
    begin: pass of each branch down to the trunk; trunk: passes in the trunk; turn: pass of each branch up, and down
    again; end: last pass up.
    """

    rows: Float
    forces: Float
    weights: Float
    add_up: Callable[[], object]
    begin: list[Calls]
    trunk: Callable[[], object]
    turn: list[Calls]
    end: list[Calls]


class WedgeStepper(SkinStepper):
    """Step the whole layer; see SkinStepper.

    inputs: csr, shape (n, q), from inward pressure [Pa] to consistent nodal force [N].
    step_s: length of a substep [s]; rho_inf: spectral radius at infinite frequency, from 0 (L-stable: unresolved motion
        disappears at once) to 1 (no damping); 0.8 reduces unresolved pressure waves to a tenth in ten steps.
    A state has rows of n numbers: displacement [m], velocity [m/s], acceleration [m/s^2] and the internal displacement
    [m] of every branch of every part.
    Raises SceneError for a step <= 0 or rho_inf outside 0..1.
    """

    name = "wedges"
    factorises = True
    error = 0.0
    points = None

    def __init__(self, system: SkinSystem, inputs: sparse.csr_matrix, step_s: float, rho_inf: float = RHO_INF) -> None:
        scheme = Scheme(system, step_s, rho_inf)
        self.step_s, self.unknowns, self.state_rows = step_s, system.ndof, scheme.state_rows
        self.state_size = self.state_rows * self.unknowns
        factor = self._factor = block_factor(scheme.effective(), system.elimination_order())
        self._threads = min(cores(), max(1, factor.stored // STORED_PER_THREAD))
        self._alpha_f = scheme.alpha_f
        largest, *others = sorted(scheme.terms, key=lambda term: -term.matrix.nnz)
        offset = largest.row / largest.coefficient
        self._into_sums = np.array([*(term.row - term.coefficient * offset for term in others), offset])
        parts = [(part.first, part.last) for part in (*factor.branches, factor.trunk)]
        matrices = [_placed(term.matrix, factor, rows=True) for term in others]
        # Each thread computes a branch and must not read data that another thread changes
        assert not any(_coupled(matrix, parts[:-1]) for matrix in matrices)
        self._others = grouped_rows(matrices, parts)
        self._inputs = _placed(sparse.csr_matrix(inputs, dtype=np.float64), factor, rows=True, columns=False)
        self._advance, self._follow = scheme.advance, scheme.follow
        self._rooms: list[_Room] = []

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | None:
        check_step(self, state, loads, self._inputs.shape[1], t0, t1)
        mix = self._alpha_f * loads.first + (1.0 - self._alpha_f) * loads.last
        worlds, substeps, _ = mix.shape
        record = None if observe is None else np.zeros((worlds, substeps, 2, observe.count))
        # One world after another: in any order, each world reads the matrices through the cache once per substep
        for i in range(worlds):
            self._step_one(state[i], loads.pressure_Pa[i], mix[i], observe, None if record is None else record[i])
        return record

    def _step_one(
        self, state: Float, patterns_Pa: Float | Float32, mix: Float, observe: Reader | None, record: Float | None
    ) -> None:
        """Do all substeps of one world; mix: weights of patterns in each substep, (s, k); record: output, (s, 2, m)."""
        rows, place = state.reshape(self.state_rows, self.unknowns), self._factor.place
        substeps, patterns = mix.shape
        room, threads = self._room(patterns), self._threads
        room.rows[:, place] = rows
        room.add_up()
        inputs, pressure = self._inputs, patterns_Pa.astype(np.float64, copy=False)
        room.forces[:patterns] = 0.0
        for pattern, force in zip(pressure, room.forces, strict=False):
            csr_matvec(len(force), len(pattern), inputs.indptr, inputs.indices, inputs.data, pattern, force)
        room.weights[patterns:] = 0.0
        room.weights[:patterns] = mix[0]
        share(room.begin, threads)
        for i in range(substeps):
            room.trunk()
            if i + 1 < substeps:
                room.weights[:patterns] = mix[i + 1]
                share(room.turn, threads)
            else:
                share(room.end, threads)
            if record is not None and observe is not None:
                _read(observe.matrix[1], room.rows, record[i])
        rows[...] = room.rows[:, place]
        self._rooms.append(room)

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        matrix = checked_operator(operator, self.unknowns)
        return Reader(matrix.shape[0], (matrix, _placed(matrix, self._factor)))

    def read(self, state: Float, reader: Reader) -> Float:
        result = np.zeros((len(state), 2, reader.count))
        for one, out in zip(state, result, strict=True):
            _read(reader.matrix[0], one.reshape(self.state_rows, self.unknowns), out)
        return result

    def _room(self, patterns: int) -> _Room:
        """Return work arrays, reused from an earlier call if no other thread has them; list operations are atomic."""
        try:
            room = self._rooms.pop()
        except IndexError:
            return self._new_room(patterns)
        return room if len(room.weights) >= patterns else self._new_room(patterns)

    def _new_room(self, patterns: int) -> _Room:
        factor, size = self._factor, self._factor.size
        matrix, groups = self._others
        rows, sums = _Numbers((self.state_rows, size)), _Numbers((len(self._into_sums), size))
        forces, weights = _Numbers((patterns, size)), _Numbers((patterns,))
        # Rows below a supernode are padded with the index after the last; only zeros are written and read there
        padded = size + kernels.WIDTH
        solution = _Numbers((padded,))
        step = filled(
            kernels.Substep(),
            weights=weights.plain,
            forces=forces.plain,
            matrix=matrix,
            nodes=factor.nodes,
            solved=_Numbers((size,)).plain,
            solution=solution.plain,
            in_lanes=solution.lanes,
            rows=rows.lanes,
            carry=_Numbers.of(self._advance).plain,
            follow=_Numbers.of(self._follow).plain,
            into_sums=_Numbers.of(self._into_sums).plain,
            sums=sums.lanes,
            flat_sums=sums.flat,
        )
        parts = []
        for part, (first_group, last_group) in zip((*factor.branches, factor.trunk), groups, strict=True):
            members = {"first_group": first_group, "last_group": last_group, **part._asdict()}
            work = wp.zeros(factor.widest, dtype=kernels.lanes, device="cpu")
            old = wp.zeros(self.state_rows, dtype=kernels.lanes, device="cpu")
            parts.append(filled(kernels.Part(), right=_Numbers((padded,)).plain, work=work, old=old, **members))
        *branches, trunk = parts
        begin, turn, end = (
            [[recorded(kernel, 1, [branch, step], "cpu")] for branch in branches]
            for kernel in (kernels.go_down, kernels.turn_round, kernels.go_up)
        )
        add_up = recorded(kernels.begin_substeps, 1, [step], "cpu")
        pass_trunk = recorded(kernels.pass_trunk, 1, [trunk, *(branch.right for branch in branches), step], "cpu")
        return _Room(rows.host, forces.host, weights.host, add_up, list(begin), pass_trunk, list(turn), list(end))


class _Numbers:
    """Float64 numbers in one memory, for NumPy and for kernels that read one number or WIDTH numbers at a time."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.host: Any = np.zeros(shape)

    @classmethod
    def of(cls, values: Any) -> "_Numbers":
        """Return the given values in this form."""
        result = cls(())
        result.host = np.ascontiguousarray(values)
        return result

    @property
    def plain(self) -> Any:
        return wp.array(self.host, dtype=wp.float64, device="cpu", copy=False)

    @property
    def flat(self) -> Any:
        return wp.array(self.host.reshape(-1), dtype=wp.float64, device="cpu", copy=False)

    @property
    def lanes(self) -> Any:
        wide = self.host.reshape(*self.host.shape[:-1], -1, kernels.WIDTH)
        return wp.array(wide, dtype=kernels.lanes, device="cpu", copy=False)


def _placed(
    matrix: sparse.csr_matrix, factor: BlockFactor, *, rows: bool = False, columns: bool = True
) -> sparse.csr_matrix:
    """Return the matrix with columns, rows or both numbered by the places of the factor."""
    parts, place = sparse.coo_matrix(matrix), factor.place
    row, count = (place[parts.row], factor.size) if rows else (parts.row, matrix.shape[0])
    column, width = (place[parts.col], factor.size) if columns else (parts.col, matrix.shape[1])
    return sparse.csr_matrix((parts.data, (row, column)), shape=(count, width))


def _coupled(matrix: sparse.csr_matrix, ranges: list[tuple[int, int]]) -> bool:
    """Return whether a matrix couples unknowns of two ranges (first, and the one after the last)."""
    parts = sparse.coo_matrix(matrix)
    of_row, of_column = np.zeros((2, parts.nnz), np.int8)
    for number, (first, last) in enumerate(ranges, 1):
        of_row[(parts.row >= first) & (parts.row < last)] = number
        of_column[(parts.col >= first) & (parts.col < last)] = number
    return bool(((of_row != of_column) & (of_row > 0) & (of_column > 0)).any())


def _read(matrix: sparse.csr_matrix, rows: Float, out: Float) -> None:
    """Add displacement and velocity to `out`, shape (2, m)."""
    for row, result in zip(rows, out, strict=False):
        csr_matvec(len(result), len(row), matrix.indptr, matrix.indices, matrix.data, row, result)


def grouped_rows(
    matrices: Sequence[sparse.csr_matrix], ranges: Sequence[tuple[int, int]]
) -> tuple[GroupedRows, list[tuple[int, int]]]:
    """Return the matrices side by side, shape (n, m n), with the groups of each range of rows together.

    matrices: m matrices, csr (n, n); ranges: first row, and row after the last, of each; they contain each non-zero row
        once.
    Also returns the first group of each range and the group after its last.
    """
    n = matrices[0].shape[0]
    rows, starts, columns, values, groups = [], [np.zeros(1, np.int64)], [], [], []
    count, ended = 0, 0
    for first, last in ranges:
        begin = count
        for number, matrix in enumerate(matrices):
            part = matrix[first:last].tocoo()
            order = _alike(matrix, first, last)
            members = -(-len(order) // ROWS)
            padded = np.full(members * ROWS, n, np.int32)
            padded[: len(order)] = order
            place = np.empty(last - first, np.int64)
            place[order - first] = np.arange(len(order))
            row = place[part.row]
            pairs, where = np.unique((row // ROWS) * n + part.col, return_inverse=True)
            block = np.zeros((len(pairs), ROWS))
            block[where, row % ROWS] = part.data
            ends = np.searchsorted(pairs, n * np.arange(1, members + 1))
            rows.append(padded)
            starts.append(ended + ends)
            ended += len(pairs)
            columns.append(pairs % n + number * n)
            values.append(block)
            count += members
        groups.append((begin, count))
    result = GroupedRows()
    result.rows, result.start = whole_numbers(np.concatenate(rows)), whole_numbers(np.concatenate(starts))
    result.columns = whole_numbers(np.concatenate(columns))
    result.values = wp.array(np.concatenate(values), dtype=rows_of_group, device="cpu")
    return result, groups


def _alike(matrix: sparse.csr_matrix, first: int, last: int) -> Int:
    """Return the rows first..last - 1, sorted so that rows with equal columns are adjacent (mass couples no x to y)."""
    _, part = connected_components(matrix, directed=False)
    return (first + np.argsort(part[first:last], kind="stable")).astype(np.int32)
