"""factorise(matrix).solve(right): the only module that chooses the solver of the matrices of a skin, and our own.

Kernels solve a single column, at the speed of reading the factor. Dense products solve many columns together, at about
fifteen times the rate. Two threads share the work in both cases.
"""

import contextlib
import importlib.util
import os
import threading
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import warp as wp
from scipy.sparse.linalg import SuperLU, splu

from palmfield.blas import one_blas_thread
from palmfield.device import filled, recorded
from palmfield.errors import PalmfieldError
from palmfield.phases import phase
from palmfield.skin.fem.elimination import Part, block_factor
from palmfield.threads import cores, share
from palmfield.types import Float, Int
from warp_kernels import block_solves as kernels
from warp_kernels.supernodes import WIDTH, lanes

if TYPE_CHECKING:  # imported at first use: most matrices are real, and PARDISO is an optional extra
    from palmfield.skin.fem.complex_factor import ComplexFactor
    from palmfield.skin.fem.pardiso import PardisoFactor

SWITCH = "PALMFIELD_PARDISO"
OFF = ("off", "0", "none")
FEW, CHUNK = 4, 128
"""Largest number of columns that are solved separately, and largest number that are solved together."""


class Factor:
    """Sparse LU of one matrix; made by `superlu`.

    order: elimination order, old index at each new place, shape (n,)
    A factor serves one thread at a time: others wait.
    """

    def __init__(self, lu: SuperLU, diagonal: Any, order: Int | None) -> None:
        self._lu, self._diagonal, self._order = lu, diagonal, order
        self._lock = threading.Lock()

    @property
    def order(self) -> Int:
        if self._order is None:
            return np.argsort(self._lu.perm_c).astype(np.int32)
        return self._order

    @property
    def fill(self) -> int:
        """Count of numbers in both triangular factors."""
        return int(self._lu.nnz)

    def solve(self, right: Any) -> Any:
        """Return the solution, (n,) or (n, k), of matrix @ solution = right; complex if either of them is complex."""
        order = self._order
        with one_blas_thread, self._lock:
            if order is None:
                return self._lu.solve(np.ascontiguousarray(right, dtype=self._common(right)))
            moved = self._lu.solve(right[order].astype(self._common(right), copy=False))
        result = np.empty_like(moved)
        result[order] = moved
        return result

    def _common(self, right: Any) -> Any:
        return complex if right.dtype.kind == "c" or self._diagonal.dtype.kind == "c" else float


AnyFactor: TypeAlias = "Factor | Cholesky | ComplexFactor | PardisoFactor"


@phase("factors")
def factorise(matrix: Any, order: Int | None = None) -> AnyFactor:
    """Return the solver of a symmetric matrix; allowed matrices and arguments as for `superlu`.

    Real matrices use PARDISO if it is installed and not switched off. Other matrices use our own blocks if an order is
    given. SuperLU is used without an order, and for matrices that the others refuse.
    Raises RuntimeError if a pivot is exactly 0.
    """
    lossy = matrix.dtype.kind == "c"
    if not lossy and switched_on() and importlib.util.find_spec("pypardiso") is not None:
        from palmfield.skin.fem.pardiso import PardisoFactor, library

        if library() is not None:
            with contextlib.suppress(RuntimeError):
                return PardisoFactor(matrix)
    if order is not None:
        with contextlib.suppress(RuntimeError):
            return _of_blocks(matrix, order) if lossy else Cholesky(matrix, order)
    return superlu(matrix, order)


def switched_on() -> bool:
    """Return whether PARDISO may be used. Raises PalmfieldError if PALMFIELD_PARDISO is neither on nor off."""
    named = os.environ.get(SWITCH, "on").strip().lower()
    if named not in (*OFF, "on", "1", ""):
        raise PalmfieldError(f"environment variable {SWITCH} is '{named}'; allowed: on, or {', '.join(OFF)}")
    return named not in OFF


def _of_blocks(matrix: Any, order: Int) -> "ComplexFactor":
    from palmfield.skin.fem.complex_factor import ComplexFactor

    return ComplexFactor(matrix, order)


def superlu(matrix: Any, order: Int | None = None) -> Factor:
    """Return the SuperLU factors of a symmetric matrix.

    matrix: sparse, (n, n), real or complex; its real part, perhaps times a phase factor, must be positive definite
    order: elimination order, old index at each new place, shape (n,); None: SuperLU finds one (minimum degree)
    Raises RuntimeError if a pivot is exactly 0.
    """
    columns = matrix if order is None else matrix[order][:, order]
    columns = columns.tocsc()
    with one_blas_thread:
        lu = splu(
            columns,
            permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
            # Such a matrix needs no pivoting, and pivoting would undo the order.
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    return Factor(lu, columns.diagonal(), order)


class Cholesky:
    """Factor of one matrix, sparse (n, n), eliminated in an order (n,); errors like `block_factor`.

    A factor serves one thread at a time: others wait.
    """

    def __init__(self, matrix: Any, order: Int) -> None:
        factor = self._factor = block_factor(matrix, order, multiplied=False)
        self._parts = (*factor.branches, factor.trunk)
        self._lock = threading.Lock()
        padded = factor.size + WIDTH
        self._rights = np.zeros((len(self._parts), padded))
        self._solution = np.zeros(padded)
        solved = wp.zeros(padded, dtype=wp.float64, device="cpu")
        solves = [
            filled(
                kernels.Solve(),
                nodes=factor.nodes,
                right=wp.array(right, dtype=wp.float64, device="cpu", copy=False),
                solved=solved,
                solution=wp.array(self._solution, dtype=wp.float64, device="cpu", copy=False),
                work=wp.zeros(factor.widest, dtype=lanes, device="cpu"),
                **part._asdict(),
            )
            for part, right in zip(self._parts, self._rights, strict=True)
        ]
        *branches, trunk = solves
        self._down = [[recorded(kernels.go_down, 1, [branch], "cpu")] for branch in branches]
        self._turn = recorded(kernels.pass_trunk, 1, [trunk, *(branch.right for branch in branches)], "cpu")
        self._up = [[recorded(kernels.go_up, 1, [branch], "cpu")] for branch in branches]
        nodes = factor.nodes
        self._nodes = [array.numpy() for array in (nodes.column, nodes.size, nodes.below, nodes.value, nodes.row)]
        self._rows, self._values = nodes.rows.numpy(), nodes.values.numpy().reshape(-1, WIDTH)

    @property
    def fill(self) -> int:
        """Count of numbers in both triangular factors."""
        return 2 * self._factor.stored

    def solve(self, right: Any) -> Any:
        """Return the solution, shape (n,) or (n, k), of matrix @ solution = right; complex if `right` is complex."""
        if right.dtype.kind == "c":
            return self.solve(right.real) + 1j * self.solve(right.imag)
        columns = right[:, None] if right.ndim == 1 else right
        result: Float = np.empty(columns.shape)
        with self._lock:
            if columns.shape[1] <= FEW:
                for number, column in enumerate(columns.T):
                    result[:, number] = self._one(column)
            else:
                for start in range(0, columns.shape[1], CHUNK):
                    result[:, start : start + CHUNK] = self._many(columns[:, start : start + CHUNK])
        return result.reshape(right.shape)

    def _one(self, column: Float) -> Float:
        factor, threads = self._factor, min(cores(), len(self._down))
        placed = np.zeros(factor.size)
        placed[factor.place] = column
        for part, right in zip(self._parts, self._rights, strict=True):
            right[part.first : part.last] = placed[part.first : part.last]
        share(self._down, threads)
        self._turn()
        share(self._up, threads)
        return self._solution[factor.place]

    def _many(self, columns: Float) -> Float:
        factor, trunk, threads = self._factor, self._factor.trunk, min(cores(), len(self._down))
        moved = np.zeros((factor.size + 1, columns.shape[1]))
        moved[factor.place] = columns
        # Contribution of each branch to the right side of the trunk, separate because branches run in parallel
        updates = [np.zeros((factor.size + 1 - trunk.first, columns.shape[1])) for _ in factor.branches]
        with one_blas_thread:
            pairs = zip(factor.branches, updates, strict=True)
            share([(partial(self._down_many, part, moved, away),) for part, away in pairs], threads)
            for away in updates:
                moved[trunk.first :] += away
            self._down_many(trunk, moved, moved[trunk.first :])
            moved[factor.size] = 0.0
            self._up_many(trunk, moved)
            share([(partial(self._up_many, part, moved),) for part in factor.branches], threads)
        return moved[factor.place]

    def _down_many(self, part: Part, moved: Float, trunk: Float) -> None:
        """Do the forward pass of a part, in place; add its contribution to the right side of the trunk to `trunk`."""
        first = self._factor.trunk.first
        for number in range(part.first_node, part.last_node):
            column, inverse, below, rows = self._block(number)
            solved = inverse @ moved[column : column + inverse.shape[1]]
            moved[column : column + inverse.shape[1]] = solved
            away = below @ solved
            cut = int(np.searchsorted(rows, first))
            moved[rows[:cut]] -= away[:cut]
            trunk[rows[cut:] - first] -= away[cut:]

    def _up_many(self, part: Part, moved: Float) -> None:
        """Do the backward pass of a part, in place."""
        for number in reversed(range(part.first_node, part.last_node)):
            column, inverse, below, rows = self._block(number)
            own = moved[column : column + inverse.shape[1]]
            own[...] = inverse.T @ (own - below.T @ moved[rows])

    def _block(self, number: int) -> tuple[int, Float, Float, Int]:
        """Return the first place of a supernode, the inverse of its own part, the part below, and its places."""
        column, size, groups, value, row = (int(values[number]) for values in self._nodes)
        own = -(-size // WIDTH)
        lines = self._values[value : value + (own + groups) * size].reshape(own + groups, size, WIDTH)
        block = lines.transpose(0, 2, 1).reshape(-1, size)
        return column, block[:size], block[own * WIDTH :], self._rows[row : row + groups * WIDTH]
