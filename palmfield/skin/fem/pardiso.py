"""PARDISO of Intel's MKL for real symmetric positive definite matrices, if the extra `mkl` is installed.

It factorises the layer of a palm in a sixth of the time of SuperLU. Its rounding depends on the processor and the
number of threads (see MKL_CBWR and MKL_NUM_THREADS). The environment variable PALMFIELD_PARDISO=off disables it.
"""

import functools
import os
import sys
import threading
import weakref
from typing import Any

import numpy as np
from scipy import sparse

from palmfield.types import Float

POSITIVE_DEFINITE = 2
"""Matrix type of PARDISO: real symmetric positive definite, given by its upper triangle."""


@functools.cache
def library() -> Any:
    """Return the module of pypardiso that wraps PARDISO; None if pypardiso or MKL is missing.

    Also None on Windows, where a second factor at the same time ends Python.
    """
    if sys.platform == "win32":
        return None
    try:
        from pypardiso import pardiso_wrapper
    except (ImportError, OSError):
        return None
    return pardiso_wrapper


class PardisoFactor:
    """Sparse Cholesky of one real matrix.

    matrix: sparse, (n, n)
    A factor serves one thread at a time: others wait. It serves only the process that made it, because threads of MKL
    do not exist after a fork.
    Raises RuntimeError if the matrix is not positive definite.
    """

    def __init__(self, matrix: Any) -> None:
        package = library()
        self._upper = sparse.csr_matrix(sparse.triu(matrix, format="csr"))
        self._upper.sort_indices()
        self._solver = package.PyPardisoSolver(mtype=POSITIVE_DEFINITE)
        self._process = os.getpid()
        self._lock = threading.Lock()
        # The memory of MKL is not managed by Python
        self._free = weakref.finalize(self, _free, self._solver, self._process)
        try:
            self._solver.factorize(self._upper)
        except (package.PyPardisoError, package.PyPardisoWarning, ValueError) as error:
            self._free()
            raise RuntimeError(f"the matrix of {matrix.shape[0]} unknowns is not positive definite: {error}") from None

    @property
    def fill(self) -> int:
        """Count of numbers in both triangular factors."""
        return 2 * int(self._solver.get_iparm(18))

    def solve(self, right: Any) -> Any:
        """Return the solution, shape (n,) or (n, k), of matrix @ solution = right; complex if `right` is complex.

        Raises RuntimeError in a process that did not make the factor.
        """
        if os.getpid() != self._process:
            raise RuntimeError(
                f"a factor of process {self._process} is used in process {os.getpid()}, which was forked from it; "
                "factorise again there, or set PALMFIELD_PARDISO=off"
            )
        if right.dtype.kind == "c":
            return self.solve(right.real) + 1j * self.solve(right.imag)
        with self._lock:
            result: Float = self._solver.solve(self._upper, np.asarray(right, dtype=np.float64))
        return result


def _free(solver: Any, process: int) -> None:
    if os.getpid() == process:
        solver.free_memory(everything=True)
