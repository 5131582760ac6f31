"""What carries a skin layer through a simulation: the whole body, or a small model made for a load known ahead.

Both keep their state in a flat array that is given to them, and both take consistent nodal forces.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.solver import BLAS, SkinSolver
from palmfield.skin.materials.material import stiffening
from palmfield.skin.mesh.ordering import dissection_order
from palmfield.skin.reduction.dynamic_stiffness import Pencil
from palmfield.skin.reduction.krylov import Course, Krylov
from palmfield.skin.reduction.reduced import Projection, Reduced
from palmfield.types import Complex, Float, Int

SHIFT = 0.6
"""Of the highest angular frequency that matters: there answers from 0 to it converge together."""
ROUND = 8
"""Vectors by which two models that are compared differ, at least."""
SAFETY = 1.5
"""Times the last change: with a circle on the palm, on large elements, the true error was up to 1.3 times that."""
MOST_VECTORS = 400


@dataclass(frozen=True)
class KnownLoad:
    """A load whose course is known ahead, F(t) = shapes @ shares(t).

    basis: what the model is made for: the shapes themselves, for any course of each, or one Course
    shapes: [N], shape (n, m); trials: shares at the steps' times, one array of shape (t, m) for each course from rest
        under which models are compared
    spectrum: some of its frequencies [Hz] and, for each, its complex shares there, (m,), under e^{-i w t}
    """

    basis: Float | Course
    shapes: Float
    trials: list[Float]
    spectrum: list[tuple[float, Complex]]


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
        with BLAS.limit(limits=1, user_api="blas"):
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


# Small products only, which several threads of BLAS slow down where other programs run.
@BLAS.wrap(limits=1, user_api="blas")
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
    """Small model of a layer for a load known ahead, from one real factorisation.

    surface: reads the displacement that must be right, csr, (S, n); point: at one place of it, (1, n)
    loaded: unknowns on which a force can act, shape (k,); step_s: [s], also that of the known load's shares
    highest_Hz: highest frequency that matters [Hz]; tolerance: wanted relative error
    The error is the larger of two. First, SAFETY times what the last ROUND vectors or more change in the motion under
    the load from rest: L2 over times, the larger of over the surface and at the point. Second, of the steady motion
    at the load's frequencies, the residual's own displacement by the factors that are there, over the surface. Both
    are of a smaller or a stiffer body than the true one, so they are estimates, no bounds.
    Raises SceneError where MOST_VECTORS don't reach the tolerance.
    """
    pencil = Pencil(system, dissection_order(system))
    krylov = Krylov(pencil, SHIFT * 2.0 * np.pi * highest_Hz, load.basis)
    before, error = _Trial(krylov, load, step_s), np.inf
    while True:
        target = krylov.order + max(ROUND, krylov.order // 6)
        growing = 1
        while growing and krylov.order < target:
            growing = krylov.grow()
        now = _Trial(krylov, load, step_s)
        error = SAFETY * now.change(before, krylov, surface, point)
        if error <= tolerance:
            error = max(error, _defect(krylov, load, surface))
        if error <= tolerance or not growing:
            break
        if now.order > MOST_VECTORS:
            raise SceneError(
                f"reduced model of the skin: error {error:.2g} with {now.order} vectors, {tolerance:.2g} wanted; "
                "use solver 'full'"
            )
        before = now
    small = Projection(krylov.projected, pencil.materials, np.eye(now.order), np.eye(now.order))
    return ReducedSkin(small, krylov.vectors, loaded, step_s, error, krylov.course is None)


class _Trial:
    """The motions of a model of `order` vectors under the known load: coordinates in V, each of shape (t, order)."""

    def __init__(self, krylov: Krylov, load: KnownLoad, step_s: float) -> None:
        self.order = krylov.order
        small = Projection(
            krylov.projected, krylov.pencil.materials, krylov.vectors.T @ load.shapes, np.eye(self.order)
        )
        model = Reduced(small, 0.0)
        self.moved = []
        for shares in load.trials:
            state, moved = model.new_state(), [np.zeros(self.order)]
            for first, last in itertools.pairwise(shares):
                model.step(state, first, last, step_s)
                moved.append(model.displacement(state))
            self.moved.append(np.array(moved))

    def change(self, other: "_Trial", krylov: Krylov, surface: Any, point: Any) -> float:
        """Relative difference to a model of fewer vectors, L2 over times, over the surface and at the point."""
        worst = 0.0
        for operator in (surface, point):
            small = operator @ krylov.vectors[:, : self.order]
            for mine, theirs in zip(self.moved, other.moved, strict=True):
                apart = mine.copy()
                apart[:, : other.order] -= theirs
                size = float(np.linalg.norm(mine @ small.T))
                worst = max(worst, float(np.linalg.norm(apart @ small.T)) / size if size > 0.0 else 0.0)
        return worst


def _defect(krylov: Krylov, load: KnownLoad, surface: Any) -> float:
    """Displacement of the residual over the displacement, of the steady motion, L2 over frequencies and surface."""
    answers, residuals = [], []
    for f_Hz, shares in load.spectrum:
        force = load.shapes @ np.column_stack([shares.real, shares.imag])
        weights = krylov.pencil.weights(np.array([-2j * np.pi * f_Hz]))[0]
        small = sum(w * matrix for w, matrix in zip(weights, krylov.projected, strict=True))
        pushed = krylov.vectors.T @ force
        answer = np.linalg.solve(small, pushed[:, 0] + 1j * pushed[:, 1])
        answers.append(answer)
        for w, product in zip(weights, krylov.products, strict=True):
            moved = w * answer
            force = force - product @ np.column_stack([moved.real, moved.imag])
        residuals.append(force)
    missed = surface @ krylov.factored.solve(np.hstack(residuals))
    seen = (surface @ krylov.vectors) @ np.array(answers).T
    return float(np.linalg.norm(missed) / np.linalg.norm(seen))
