"""factorise(matrix).solve(right): the only module that chooses the library that factorises the matrices of a skin."""

import contextlib
import importlib.util
import os
import threading
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from scipy.sparse.linalg import SuperLU, splu

from palmfield.blas import one_blas_thread
from palmfield.errors import PalmfieldError
from palmfield.phases import phase
from palmfield.skin.fem.cholesky import Cholesky
from palmfield.types import Int

if TYPE_CHECKING:  # imported at first use: most matrices are real, and PARDISO is an optional extra
    from palmfield.skin.fem.complex_factor import ComplexFactor
    from palmfield.skin.fem.pardiso import PardisoFactor

SWITCH = "PALMFIELD_PARDISO"
OFF = ("off", "0", "none")


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
