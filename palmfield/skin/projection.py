"""A viscoelastic body projected on a basis of a few vectors, for reduced models and steppers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.skin.materials.material import Material
from palmfield.types import Complex, Float


@dataclass(frozen=True)
class Projection:
    """A body projected on a basis V of r vectors.

    matrices: V^T M V, V^T C V, V^T E V and V^T K_p V, symmetric, (r, r); materials: materials of the parts
    force: V^T B, shape (r, j), for input matrix B; read: Y V, shape (k, r), for output matrix Y
    """

    matrices: list[Float]
    materials: list[Material]
    force: Float
    read: Any

    def harmonic(self, f_Hz: float) -> Complex:
        """Return the harmonic readings under the first force times e^{-i w t}, exact in time, shape (k,)."""
        s = -2j * np.pi * f_Hz
        return self.moved(s**2, s, [complex(material.relaxation.stiffening(s)) for material in self.materials])

    def moved(self, inertia: complex, rate: complex, scales: Sequence[complex]) -> Complex:
        """Return the readings under the first force, (k,), for these factors of mass, damping and parts."""
        mass, damping, elastic, *stiffness = self.matrices
        matrix: Any = inertia * mass + rate * damping + elastic
        for scale, part in zip(scales, stiffness, strict=True):
            matrix = matrix + scale * part
        with one_blas_thread:
            return np.asarray(self.read @ np.linalg.solve(matrix, self.force[:, 0]), dtype=complex)
