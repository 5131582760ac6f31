"""The middle's older forms of the skin's steppers, which take nodal forces. To go with their last caller."""

from typing import Any

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.solver import SkinSolver
from palmfield.skin.materials.material import stiffening
from palmfield.skin.reduction.reduced import Projection, Reduced
from palmfield.skin.reduction.reduced_stepper import MOST_VECTORS, KnownLoad, known_model
from palmfield.types import Complex, Float, Int

__all__ = ["MOST_VECTORS", "FullSkin", "KnownLoad", "ReducedSkin", "reduced_skin"]


class FullSkin:
    """The whole body, stepped by generalised-alpha (SkinSolver)."""

    error = 0.0

    def __init__(self, solver: SkinSolver) -> None:
        self.solver, self.step_s, self.state_size = solver, solver.step_s, solver.state_size

    def step(self, state: Float, first: Float, last: Float) -> None:
        """Advance a state (state_size,) in place under a force [N], (n,), linear between these two."""
        self.solver.step(state.reshape(self.solver.state_rows, -1), first, last)

    def reader(self, operator: Any) -> Any:
        """What gives of `motion` what an operator (k, n) gives of the unknowns."""
        return operator

    def motion(self, state: Float) -> Float:
        """Displacement [m] and velocity [m/s] of the unknowns, shape (2, n)."""
        return state.reshape(self.solver.state_rows, -1)[:2]

    def read(self, state: Float, operator: Any) -> Float:
        """operator @ displacement [m] and operator @ velocity [m/s] for an operator (k, n), shape (2, k)."""
        return (self.reader(operator) @ self.motion(state).T).T


class ReducedSkin:
    """A small model: Galerkin in the vectors V, exact in time for a force linear over the step.

    Any force may be given, but only for that course of the load for which it was made is the error as estimated.
    small: the body in the vectors, with V^T F as its force and the coordinates in V as what it reads
    vectors: V, (n, r)
    loaded: unknowns on which a force can act, shape (k,)
    any_course: whether the model is made for any course of its load in time, from any moment on
    error: relative, of the surface's displacement under the known load, see `reduced_skin`
    """

    def __init__(
        self, small: Projection, vectors: Float, loaded: Int, step_s: float, error: float, any_course: bool
    ) -> None:
        self.small, self.model = small, Reduced(small, error)
        self.vectors, self.step_s, self.error, self.any_course = vectors, step_s, error, any_course
        self.state_size = self.model.state_size
        self._loaded, self._pushed = loaded, vectors[loaded]

    def project(self, force: Float) -> Float:
        """V^T F, shape (r,)."""
        return force[self._loaded] @ self._pushed

    def step(self, state: Float, first: Float, last: Float) -> None:
        """As FullSkin.step."""
        with one_blas_thread:
            self.model.step(state, self.project(first), self.project(last), self.step_s)

    def reader(self, operator: Any) -> Float:
        """As FullSkin.reader, of the coordinates in V, shape (k, r)."""
        return np.asarray(operator @ self.vectors)

    def motion(self, state: Float) -> Float:
        """Displacement and velocity as coordinates in V, shape (2, r)."""
        return np.stack([self.model.displacement(state), self.model.velocity(state)])

    def read(self, state: Float, operator: Any) -> Float:
        """As FullSkin.read."""
        return self.motion(state) @ self.reader(operator).T

    def harmonic(self, force: Float, f_Hz: float, operator: Any) -> Complex:
        """operator @ displacement under force [N] times e^{-i w t}, shape (k,)."""
        s = -2j * np.pi * f_Hz
        mass, damping, elastic, *parts = self.small.matrices
        matrix: Any = s**2 * mass + s * damping + elastic
        for material, part in zip(self.small.materials, parts, strict=True):
            matrix = matrix + stiffening(material, s) * part
        return np.asarray(self.reader(operator) @ np.linalg.solve(matrix, self.project(force)), dtype=complex)

    def lifted(self, state: Float, force: Float) -> Float:
        """The same motion as a state of FullSkin, flat, under the present force [N], (n,)."""
        model = self.model
        rate = model.rates @ state + model.inputs @ self.project(force)
        small = [model.displacement(state), model.velocity(state), model.velocity(rate)]
        return np.concatenate([self.vectors @ x for x in (*small, *(rows @ state for rows in model.internals))])


def reduced_skin(
    system: SkinSystem,
    load: KnownLoad,
    surface: Any,
    point: Any,
    loaded: Int,
    step_s: float,
    highest_Hz: float,
    tolerance: float,
) -> ReducedSkin:
    """As reduced_stepper, for nodal forces on the `loaded` unknowns, shape (k,)."""
    small, vectors, error, any_course = known_model(system, load, surface, point, step_s, highest_Hz, tolerance)
    return ReducedSkin(small, vectors, loaded, step_s, error, any_course)
