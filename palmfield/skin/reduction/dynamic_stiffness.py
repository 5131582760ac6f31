"""Z(s) = s^2 M + s C + E + sum_p G_p(s)/G_r K_p of a viscoelastic body under e^{st}, its factors and its moments."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from palmfield.skin.fem.factor import Factor, factorise
from palmfield.skin.materials.material import Material, stiffening
from palmfield.types import Complex, Float, Int


class RelaxingPart(Protocol):
    @property
    def stiffness(self) -> Any: ...
    @property
    def material(self) -> Material: ...


class LinearBody(Protocol):
    """mass [kg], damping [N s/m], elastic and parts' stiffness [N/m]: symmetric, sparse or dense, shape (n, n)."""

    @property
    def mass(self) -> Any: ...
    @property
    def damping(self) -> Any: ...
    @property
    def elastic(self) -> Any: ...
    @property
    def parts(self) -> Sequence[RelaxingPart]: ...


class Pencil:
    """Z(s) of a body and its factors; all matrices lie on one sparsity pattern, in one elimination order."""

    def __init__(self, body: LinearBody, order: Int | None = None) -> None:
        self.materials = [part.material for part in body.parts]
        size = body.mass.shape[0]
        matrices = [body.mass, body.damping, body.elastic, *(part.stiffness for part in body.parts)]
        self.order = order
        self.matrices = [sparse.csr_matrix(matrix) for matrix in matrices]
        placed = [(m if order is None else m[order][:, order]).tocsc() for m in self.matrices]
        pattern = sum(abs(m) for m in placed)
        keys = [_places(m) for m in (pattern, *placed)]
        self.indices, self.starts = pattern.indices, pattern.indptr
        self.data = np.zeros((len(placed), pattern.nnz))
        for row, key, matrix in zip(self.data, keys[1:], placed, strict=True):
            row[np.searchsorted(keys[0], key)] = matrix.data
        self.size = size

    def weights(self, s: Complex, derivative: int = 0) -> Complex:
        """Factors of mass, damping, elastic and parts in the d-th derivative of Z at rates s (k,); shape (k, 3 + p)."""
        one, zero = np.ones_like(s), np.zeros_like(s)
        front = ([s**2, s, one], [2.0 * s, one, zero], [2.0 * one, zero, zero])[derivative]
        return np.stack([*front, *(_stiffening(material, s, derivative) for material in self.materials)], axis=-1)

    def apply(self, weights: Complex, u: Any) -> Any:
        return sum(w * (matrix @ u) for w, matrix in zip(weights, self.matrices, strict=True) if w != 0.0)

    def moments(self, factored: Factor, forces: Float, s: complex, reach: float) -> Any:
        """Terms u, u' d and u'' d^2 / 2 of the Taylor series of Z(s)^-1 B at a distance d [1/s], columns (n, 3 j).

        A factor costs much more than two further solves.
        """
        first = factored.solve(forces.astype(complex) if s.imag else forces)
        slope, bend = (self.weights(np.array([s if s.imag else s.real]), d)[0] for d in (1, 2))
        second = factored.solve(-self.apply(slope, first))
        third = factored.solve(-2.0 * self.apply(slope, second) - self.apply(bend, first))
        return np.column_stack([first, reach * second, 0.5 * reach**2 * third])

    def static(self) -> Factor | None:
        """Factors of Z(0), or None where nothing holds the body."""
        try:
            factored = self.factor(0.0)
        except RuntimeError:
            # SuperLU met a pivot that is exactly 0.
            return None
        return None if factored.singular() else factored

    def factor(self, s: complex) -> Factor:
        """Factors of Z(s). With Re s > 0 conj(s) Z(s) has a positive definite real part: no pivoting is needed."""
        weights = self.weights(np.array([s if s.imag else s.real]))[0]
        matrix = sparse.csc_matrix((weights @ self.data, self.indices, self.starts), shape=(self.size, self.size))
        found = factorise(matrix, self.order, placed=True)
        if self.order is None:
            self._place(found.order)
        return found

    def _place(self, order: Int) -> None:
        """Take the elimination order that SuperLU found: looking for it costs a third of a factorisation."""
        numbers = sparse.csc_matrix((np.arange(self.data.shape[1]), self.indices, self.starts), (self.size, self.size))
        placed = numbers[order][:, order].tocsc()
        placed.sort_indices()
        self.data, self.indices, self.starts = self.data[:, placed.data], placed.indices, placed.indptr
        self.order = order


def _places(matrix: Any) -> Int:
    """Rising number of each element of a csc matrix, by column, then row."""
    matrix.sum_duplicates()
    size = matrix.shape[0]
    return np.repeat(np.arange(size, dtype=np.int64), np.diff(matrix.indptr)) * size + matrix.indices


def _stiffening(material: Material, s: Complex, derivative: int) -> Complex:
    """d-th derivative in s of G(s) / G_r."""
    if derivative == 0:
        return stiffening(material, s) + 0.0 * s
    total = material.viscous_time_s * (derivative == 1) + 0.0 * s
    for ratio, tau in zip(material.ratios, material.times_s, strict=True):
        first = ratio * tau / (1.0 + s * tau) ** 2
        total = total + (first if derivative == 1 else -2.0 * first * tau / (1.0 + s * tau))
    return total
