"""Solve with a complex symmetric matrix, such as a harmonic one. Solves are few, so blocks are not rearranged."""

import threading
from typing import Any

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.skin.fem.elimination import branches, eliminate, lower_triangle, supernodes
from palmfield.types import Complex, Int


class ComplexFactor:
    """Factor L L^T of one matrix, sparse (n, n), eliminated in an order (n,). Matrices and errors: see `eliminate`.

    A factor serves one thread at a time: others wait.
    """

    def __init__(self, matrix: Any, order: Int) -> None:
        lower = lower_triangle(matrix, order)
        self._order, self._nodes, self._lock = order, supernodes(lower), threading.Lock()
        blocks: dict[int, tuple[Complex, Complex]] = {}

        def store(number: int, inverse: Complex, below: Complex) -> None:
            blocks[number] = inverse, below

        eliminate(lower, self._nodes, branches(self._nodes), store)
        self._blocks = [blocks[number] for number in range(len(self._nodes))]

    @property
    def fill(self) -> int:
        """Count of numbers in both triangular factors."""
        return 2 * sum(node.stored for node in self._nodes)

    def solve(self, right: Any) -> Any:
        """Return the solution, shape (n,) or (n, k), of matrix @ solution = right."""
        moved = np.asarray(right[self._order], dtype=complex)
        with one_blas_thread, self._lock:
            for node, (inverse, below) in zip(self._nodes, self._blocks, strict=True):
                own = moved[node.first : node.last]
                own[...] = inverse @ own
                moved[node.rows] -= below @ own
            for node, (inverse, below) in zip(reversed(self._nodes), reversed(self._blocks), strict=True):
                own = moved[node.first : node.last]
                own[...] = inverse.T @ (own - below.T @ moved[node.rows])
        result = np.empty_like(moved)
        result[self._order] = moved
        return result
