"""Solve with a real symmetric positive definite matrix, for one right-hand side or many.

Kernels solve a single column, at the speed of reading the factor. Dense products solve many columns together, at about
fifteen times the rate. Two threads share the work in both cases.
"""

import threading
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from palmfield.blas import one_blas_thread
from palmfield.device import filled, recorded
from palmfield.skin.fem.block_factor import Part, block_factor
from palmfield.threads import cores, share
from palmfield.types import Float, Int
from warp_kernels import block_solves as kernels
from warp_kernels.supernodes import WIDTH, lanes

FEW, CHUNK = 4, 128
"""Largest number of columns that are solved separately, and largest number that are solved together."""


class Cholesky:
    """Factor of one matrix, sparse (n, n), eliminated in an order (n,); errors as `block_factor`.

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
