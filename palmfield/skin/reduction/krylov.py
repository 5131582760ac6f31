"""Basis for a reduced viscoelastic body from one real factorisation: block Arnoldi of the first-order form.

With v = u' and q_i' = (u - q_i) / tau_i a body is T x' = A x + b f, x = (u, v, q_1, ..). The Krylov space of
(sigma T - A)^-1 T from (sigma T - A)^-1 b contains the s-derivatives, at s = sigma, of the solutions Z(s)^-1 B. Each
new block needs one solve with Z(sigma). A prime marks the new x:

    Z(sigma) u' = M (v + sigma u) + C u + sum_p K_p (t u + sum_i g_i tau_i / (1 + sigma tau_i) q_i) + F w'
    v' = sigma u' - u,    q_i' = (u' + tau_i q_i) / (1 + sigma tau_i)

So u, v and q all lie in the space of u, and x is stored as coordinates in a basis of this space (two-level orthogonal
Arnoldi: Lu, Su & Bai, SIAM J. Matrix Anal. Appl. 37, 2016). If sigma > 0 is about the highest frequency w, the
solutions for all s from 0 to i w converge together, in real arithmetic.

A load with a predicted course needs a smaller basis than a load with any course. If the load is F w with w' = S w from
w(0) = w_0, the space begins with the single vector for w_0. The equation w' = (sigma - S)^-1 w is then added. A focus
on a circle then needs some tens of vectors instead of hundreds.

A space grows until the result stops changing (`grow_until`): the motion under a predicted load (reduced_stepper and
solvers.reduced), or the transfer functions over a band (`palmfield.skin.reduction.reducer.reduce`).
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.reduction.course import Course
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.threads import cores, share
from palmfield.types import Float

ROOM = 64
"""Number of vectors per memory allocation."""
PARALLEL = 1e-13
SMALLEST = 1e-10
"""Share of a vector below which its new part is round-off."""
SHIFT = 0.6
"""Sigma over the highest relevant angular frequency; solutions from 0 to this frequency then converge together."""
ROUND = 8
"""Least difference between the numbers of vectors of two compared models."""
SAFETY = 1.5
"""Factor on the last change. For a circle on the palm, on large elements, the error was up to 1.3 times the change."""

T = TypeVar("T")


class _Columns:
    """Columns of length n; memory is allocated for ROOM more columns at a time."""

    def __init__(self, length: int) -> None:
        self._room: Float = np.empty((length, ROOM), order="F")
        self.count = 0

    @property
    def value(self) -> Float:
        return self._room[:, : self.count]

    def append(self, new: Float) -> None:
        after = self.count + new.shape[1]
        if after > self._room.shape[1]:
            wider: Float = np.empty((len(new), after + ROOM), order="F")
            wider[:, : self.count] = self.value
            self._room = wider
        self._room[:, self.count : after] = new
        self.count = after


class Krylov:
    """Vectors V, (n, r), orthonormal in the mass; `grow` adds a block.

    dynamics: the body; shift: sigma [1/s], > 0, at which Z is factorised once
    load: force for one unit of each of j inputs, shape (n, j), for any time course; or a Course
    """

    def __init__(self, dynamics: DynamicStiffness, shift: float, load: Float | Course) -> None:
        self.dynamics, self.shift = dynamics, shift
        self.factored = dynamics.factor(shift)
        self._columns = _Columns(dynamics.size)
        # Products of mass, damping and parts with V are stored, because they take longer than products of vectors
        numbers = [number for number, matrix in enumerate(dynamics.matrices) if number != 2 and matrix.nnz]
        self._products = {number: _Columns(dynamics.size) for number in numbers}
        self._halves = {number: _halves(dynamics.matrices[number]) for number in numbers}
        self._small = np.zeros((len(dynamics.matrices), 0, 0))
        self.laws = [
            (part, ratio, time_s)
            for part, material in enumerate(dynamics.materials)
            for ratio, time_s in material.relaxation.active
        ]
        count = 2 + len(self.laws)
        self._scales = np.array([shift, 1.0, *(shift for _ in self.laws)])
        self.course = load if isinstance(load, Course) else None
        self._projected = np.zeros((count, 0, 0))
        self._projected_load = np.zeros((0 if self.course is None else len(self.course.rates), 0))
        if isinstance(load, Course):
            drive = self._driven(load.starts)
            force = load.shapes @ (load.mix @ drive)
        else:
            drive, force = np.zeros((0, load.shape[1])), load
        first = self._take(self.factored.solve(force))
        self._block = np.stack([first, shift * first, *(first / (1.0 + shift * tau) for _, _, tau in self.laws)])
        self._load = drive
        self._trim()

    @property
    def order(self) -> int:
        return self._columns.count

    @property
    def vectors(self) -> Float:
        return self._columns.value

    @property
    def projected(self) -> list[Float]:
        """Matrices of the dynamics projected on these vectors, symmetric."""
        self._project()
        return list(self._small)

    def _driven(self, load: Float) -> Float:
        assert self.course is not None
        rates = self.course.rates
        return np.asarray(np.linalg.solve(self.shift * np.eye(len(rates)) - rates, load), dtype=float)

    def grow(self) -> int:
        """Apply the operator to the last block and return the number of new vectors; 0 at the end of the space."""
        before, shift = self.order, self.shift
        u, v, *internal = self._block
        shares = {0: v + shift * u, 1: u}
        for part, material in enumerate(self.dynamics.materials):
            share_of_part = material.relaxation.viscous_time_s * u
            for (owner, ratio, tau), q in zip(self.laws, internal, strict=True):
                if owner == part:
                    share_of_part = share_of_part + ratio * tau / (1.0 + shift * tau) * q
            shares[3 + part] = share_of_part
        right: Float = np.zeros((self.dynamics.size, u.shape[1]))
        for number, product in self._products.items():
            right += _times(_halves(product.value), shares[number])
        if self.course is not None:
            self._load = self._driven(self._load)
            right += self.course.shapes @ (self.course.mix @ self._load)
        new = self._take(self.factored.solve(right))
        old = _padded(self._block, self.order)
        moved = [(new + tau * q) / (1.0 + shift * tau) for (_, _, tau), q in zip(self.laws, old[2:], strict=True)]
        self._block = np.stack([new, shift * new - old[0], *moved])
        self._trim()
        return self.order - before

    def _take(self, result: Float) -> Float:
        """Add the new parts of columns (n, k) to the basis and return the coordinates of the columns, (r, k)."""
        mass = self._halves[0]
        heavy = _times(mass, result)
        size = np.sqrt(np.einsum("nk,nk->k", result, heavy)).max(initial=0.0)
        coordinates = np.zeros((self.order, result.shape[1]))
        rest = result
        for _ in range(2):
            basis = _adjoint(self.vectors, heavy)
            coordinates += basis
            rest = rest - _times(_halves(self.vectors), basis)
            heavy = _times(mass, rest)
        squares, turn = np.linalg.eigh(rest.T @ heavy)
        # For nearly parallel columns the difference is a rounding error of the squares.
        kept = squares > max((SMALLEST * size) ** 2, PARALLEL * squares.max(initial=0.0))
        scale = turn[:, kept] / np.sqrt(squares[kept])
        new = rest @ scale
        self._columns.append(new)
        for number, product in self._products.items():
            product.append(heavy @ scale if number == 0 else _times(self._halves[number], new))
        return np.concatenate([coordinates, new.T @ heavy])

    def _project(self) -> None:
        """Update the projected matrices to the present order; many vectors together cost little more than one."""
        before, after = self._small.shape[1], self.order
        if before == after:
            return
        grown = np.zeros((len(self.dynamics.matrices), after, after))
        grown[:, :before, :before] = self._small
        for number, matrix in enumerate(self.dynamics.matrices):
            if matrix.nnz:
                product = self._products.get(number)
                moved = matrix @ self.vectors[:, before:] if product is None else product.value[:, before:]
                share = self.vectors.T @ moved
                grown[number, :, before:] = share
                grown[number, before:, :before] = share[:before].T
        inner = grown[:, before:, before:]
        grown[:, before:, before:] = 0.5 * (inner + inner.transpose(0, 2, 1))
        self._small = grown

    def _trim(self) -> None:
        """Make the block orthonormal, and orthogonal to all previous vectors."""
        count, order = len(self._scales), self.order
        block = (self._scales[:, None, None] * self._block).reshape(count * order, -1)
        block = np.concatenate([block, self._load])
        self._projected = _padded(self._projected, order)
        basis = np.concatenate([self._projected.reshape(count * order, -1), self._projected_load])
        for _ in range(2):
            block = block - basis @ (basis.T @ block)
        left, singular, _ = np.linalg.svd(block, full_matrices=False)
        left = left[:, singular > SMALLEST * singular.max(initial=0.0)]
        result = left[: count * order].reshape(count, order, -1)
        self._load = left[count * order :]
        self._projected = np.concatenate([self._projected, result], axis=2)
        self._projected_load = np.concatenate([self._projected_load, self._load], axis=1)
        self._block = result / self._scales[:, None, None]


class TooManyVectorsError(SceneError):
    """The model of the largest allowed size does not reach the tolerance; reached: trial of this model."""

    def __init__(self, message: str, reached: object = None) -> None:
        super().__init__(message)
        self.reached = reached


def grown(krylov: Krylov, vectors: int) -> bool:
    """Grow a space by at least this number of vectors; return False if it cannot grow."""
    target, growing = krylov.order + vectors, True
    while growing and krylov.order < target:
        growing = krylov.grow() > 0
    return growing


def grow_until(
    krylov: Krylov,
    trial: Callable[[], T],
    change: Callable[[T, T], float],
    tolerance: float,
    most_vectors: int,
    residual: Callable[[], float] | None = None,
) -> tuple[T, float]:
    """Grow a Krylov space until models of two sizes agree; return the last trial and its estimated relative error.

    trial: returns the result of the model of the present size.
    change: (trial, trial with fewer vectors) -> relative difference.
    residual: second estimate, computed if the first is small enough; the larger of the two is returned.
    The error is SAFETY times the change by the last ROUND or more vectors. It is above the tolerance only if the space
    cannot grow any more. Raises TooManyVectorsError if most_vectors do not reach the tolerance.
    """
    before = trial()
    while True:
        growing = grown(krylov, max(ROUND, krylov.order // 6))
        now = trial()
        error = SAFETY * change(now, before)
        if error <= tolerance and residual is not None:
            error = max(error, residual())
        if error <= tolerance or not growing:
            return now, error
        if krylov.order > most_vectors:
            raise TooManyVectorsError(
                f"reduced model of the skin: error {error:.2g} with {krylov.order} vectors, target "
                f"{tolerance:.2g}; use solver 'wedges'",
                now,
            )
        before = now


def steady_change(changes: Sequence[Any]) -> Float:
    """Return the last of the changes by ROUND or more vectors, or a larger one if they fall irregularly.

    Velocities after a jump converge in pairs of changes: .37, .052, .17 under a Traction whose model of 32 vectors had
    the error .16 after the second. So a change is at least the one before, times the mean ratio of the last three.
    """
    last = np.asarray(changes[-1], dtype=float)
    if len(changes) < 3:
        return last
    before, first = np.asarray(changes[-2], dtype=float), np.asarray(changes[-3], dtype=float)
    return np.maximum(last, before * np.sqrt(np.minimum(last / np.where(first > 0.0, first, np.inf), 1.0)))


def _halves(matrix: Any) -> list[Any]:
    """Return the upper and lower halves of the rows of an array or a csr matrix, without a copy."""
    half, rows = matrix.shape[0] // 2, matrix.shape[0]
    if isinstance(matrix, np.ndarray):
        return [matrix[:half], matrix[half:]]
    parts = []
    for first, last in ((0, half), (half, rows)):
        ends = matrix.indptr[first : last + 1]
        values, columns = (numbers[ends[0] : ends[-1]] for numbers in (matrix.data, matrix.indices))
        shape = last - first, matrix.shape[1]
        parts.append(sparse.csr_matrix((values, columns, ends - ends[0]), shape=shape, copy=False))
    return parts


def _times(halves: Sequence[Any], columns: Float) -> Float:
    """Return matrix @ columns, (n, r) and (r, k), one thread for each half; two threads use more memory bandwidth."""
    results: list[Any] = [None, None]

    def product(number: int) -> None:
        results[number] = halves[number] @ columns

    share([(partial(product, number),) for number in range(2)], min(cores(), 2))
    return np.concatenate(results)


def _adjoint(vectors: Float, columns: Float) -> Float:
    """Return vectors.T @ columns, (n, r) and (n, k), by two threads."""
    parts: list[Any] = [None, None]
    of_vectors, of_columns = _halves(vectors), _halves(columns)

    def product(number: int) -> None:
        parts[number] = of_vectors[number].T @ of_columns[number]

    share([(partial(product, number),) for number in range(2)], min(cores(), 2))
    return np.asarray(parts[0] + parts[1], dtype=np.float64)


def _padded(rows: Any, count: int) -> Any:
    """Return coordinates (c, r, k) padded with 0 for a basis that has grown to `count` vectors."""
    missing = count - rows.shape[1]
    return np.concatenate([rows, np.zeros((rows.shape[0], missing, rows.shape[2]))], axis=1)
