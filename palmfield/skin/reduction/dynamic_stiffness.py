"""Z(s) = s^2 M + s C + E + sum_p G_p(s)/G_r K_p of a viscoelastic body under e^{st}, and its factors."""

import numpy as np
from scipy import sparse

from palmfield.skin.fem.factor import AnyFactor, factorise
from palmfield.skin.fem.linear_body import LinearBody
from palmfield.types import Complex, Int


class DynamicStiffness:
    """Z(s) of a body. order: elimination order for its factors, shape (n,); None: SuperLU finds one."""

    def __init__(self, body: LinearBody, order: Int | None = None) -> None:
        self.materials = [part.material for part in body.parts]
        matrices = [body.mass, body.damping, body.elastic, *(part.stiffness for part in body.parts)]
        self.order = order
        self.matrices = [sparse.csr_matrix(matrix) for matrix in matrices]
        self.size = self.matrices[0].shape[0]

    def weights(self, s: Complex) -> Complex:
        """Return the factors of mass, damping, elastic and parts in Z at rates s [1/s], (k,); shape (k, 3 + p)."""
        one = np.ones_like(s)
        laws = (material.relaxation.stiffening(s) * one for material in self.materials)
        return np.stack([s**2, s, one, *laws], axis=-1)

    def factor(self, s: complex) -> AnyFactor:
        """Return the factors of Z(s). For Re s > 0 the real part of conj(s) Z(s) is positive definite: no pivoting."""
        weights = self.weights(np.array([s if s.imag else s.real]))[0]
        return factorise(sum(w * m for w, m in zip(weights, self.matrices, strict=True)), self.order)
