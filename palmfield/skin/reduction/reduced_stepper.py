"""Step a skin by a reduced model for a predicted load, exactly in time; a substep is one dense product."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from palmfield import cache
from palmfield.blas import one_blas_thread
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.course import Course
from palmfield.skin.reduction.load_shapes import LoadShapes
from palmfield.skin.reduction.reduced import Reduced
from palmfield.skin.stepper import (
    DeviceModel,
    Reader,
    SkinStepper,
    StepWork,
    SurfaceLoads,
    check_step,
    checked_operator,
)
from palmfield.threads import cores, share
from palmfield.types import Complex, Float, Float32, Int

if TYPE_CHECKING:
    from palmfield.skin.reduction.krylov import Krylov

MOST_VECTORS = 400
BLOCK = 256
"""Number of worlds in one product."""
LEAP = 16
"""Largest number of substeps in one product. It is small because each new pressure needs new matrices."""
MIXED = 64
"""Largest number of random loads for the displacement of the residual: the error of their mean square is then 10 %."""


@dataclass(frozen=True)
class KnownLoad:
    """A predicted load, F(t) = shapes @ shares(t).

    basis: load for which the model is made: the shapes with any time course, or one Course.
    shapes: [N], shape (n, m).
    trials: courses from rest under which models are compared: shares at the times of the steps, (t, m) each.
    spectrum: some frequencies of the load [Hz], each with its complex shares, (m,), under e^{-i w t}.
    tones: steady motions under the first shape in which models are compared too: the frequencies of the lines of each
        [Hz], (f,), and their complex shares, (f,).
    """

    basis: Float | Course
    shapes: Float
    trials: list[Float]
    spectrum: list[tuple[float, Complex]]
    tones: Sequence[tuple[Float, Complex]] = ()


class ReducedStepper(SkinStepper):
    """Galerkin model in vectors V, exact in time for loads that are linear within a substep; see SkinStepper.

    Any load may be given, but the error estimate is valid only for the course for which the model was made.
    Unlike other steppers it allows substeps of any length; substeps of step_s are the fastest.

    small: reduced model of the body under j shapes of force; its outputs are the coordinates in V.
    vectors: V, (n, r).
    shares: share of each shape of force in a pressure of 1 Pa at each point, shape (p, j).
    points: numbers of the quadrature points whose pressure is used, shape (p,), None for all.
    step_s: length of a substep [s].
    error: relative error of the displacement of the surface under the predicted load, see `reduced_stepper`.
    any_course: whether the model is made for any time course of its load.
    advance, start, end: the next state is advance @ x + f @ start + g @ end, for a state x and shapes of force f, g at
        start and end of a substep; shapes (n, n), (j, n) and (j, n).
    """

    name = "reduced"
    any_pose, exact_in_time = False, True

    def __init__(
        self,
        small: Projection,
        vectors: Float,
        shares: Float,
        points: Int | None,
        step_s: float,
        error: float,
        any_course: bool,
    ) -> None:
        self.small, self.vectors, self.model = small, vectors, Reduced(small, error)
        self.points = points
        self.step_s, self.error, self.any_course = step_s, error, any_course
        self.adds_error, self.made_of = (error, None), (small.matrices, vectors, error, any_course)
        self.state_size, self.order = self.model.state_size, vectors.shape[1]
        self.unknowns = len(vectors)
        self.shares = np.ascontiguousarray(shares)
        # Pressures are in single precision, so shares are too: half the memory takes half the reading time
        self._single_shares = self.shares.astype(np.float32)
        with one_blas_thread:
            self._decoupled = self.model.decoupled(step_s)
        # Results for the last constant pressures
        self._fixed: tuple[Float | Float32, Float] | None = None
        self._leaps: tuple[Float | Float32, dict[int, tuple[Float, Float]]] | None = None
        # Displacement and velocity in V depend only on the first two blocks of a state
        blocks = slice(0, self.order), slice(self.order, 2 * self.order)
        self._moved, self._moves = self.model.displaces[:, blocks[0]], self.model.moves[:, blocks[1]]

    @cached_property
    def advance(self) -> Float:
        return np.ascontiguousarray(self.model.propagators(self.step_s)[0])

    @cached_property
    def start(self) -> Float:
        return np.ascontiguousarray(self.model.propagators(self.step_s)[1].T)

    @cached_property
    def end(self) -> Float:
        return np.ascontiguousarray(self.model.propagators(self.step_s)[2].T)

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | None:
        own = check_step(self, state, loads, len(self.shares), t0, t1, any_length=True)
        worlds, substeps, _ = loads.first.shape
        if own and observe is None and loads.fixed:
            self._leap(state, loads)
            return None
        states = np.empty((worlds, substeps, self.state_size))
        with one_blas_thread:
            if own:
                modes = self._decoupled
                forces = self._forces(loads)
                start, end = (self.start, self.end) if modes is None else (modes.start, modes.end)
                np.matmul(loads.first, forces @ start, out=states)
                states += loads.last @ (forces @ end)
                if modes is None:
                    self._march(state, states)
                    state[:] = states[:, -1]
                else:
                    modes.march(state @ modes.there, states)
                    state[:] = states[:, -1] @ modes.back
                    states = states if observe is None else states @ modes.back
            else:
                forces = np.broadcast_to(self._forces(loads), (worlds, loads.first.shape[2], self.shares.shape[1]))
                for one, after, force, first, last in zip(state, states, forces, loads.first, loads.last, strict=True):
                    after[:] = self.model.march(one, first @ force, last @ force, (t1 - t0) / substeps)
                state[:] = states[:, -1]
            if observe is None:
                return None
            return self._read(states.reshape(-1, self.state_size), observe).reshape(worlds, substeps, 2, -1)

    def _leap(self, state: Float, loads: SurfaceLoads) -> None:
        """Advance by up to LEAP substeps at once, under constant pressures, without the states in between."""
        worlds, substeps, patterns = loads.first.shape
        for begin in range(0, substeps, LEAP):
            count = min(LEAP, substeps - begin)
            weights = np.empty((worlds, 2, count, patterns))
            weights[:, 0], weights[:, 1] = loads.first[:, begin : begin + count], loads.last[:, begin : begin + count]
            leap = partial(self._leap_of, state, weights.reshape(worlds, 1, -1), *self._ways(loads, count))
            with one_blas_thread:
                if worlds <= BLOCK:
                    leap(slice(None))
                    continue
                # Blocks have one size, so that results do not depend on the number of cores
                blocks = [slice(first, first + BLOCK) for first in range(0, worlds, BLOCK)]
                share([(partial(leap, own),) for own in blocks], cores())

    def _ways(self, loads: SurfaceLoads, substeps: int) -> tuple[Float, Float]:
        """Return the change of the state by a unit of each weight over a number of substeps, (w, 2 s, n), and the
        matrix of the state, (n, n)."""
        previous = self._leaps
        if previous is None or previous[0] is not loads.pressure_Pa:
            self._leaps = previous = loads.pressure_Pa, {}
        if substeps not in previous[1]:
            with one_blas_thread:
                forces = self._forces(loads)
                pushes = np.stack([forces @ self.start, forces @ self.end], axis=1)
                steps, power = [pushes], self.advance.T  # of one world if all have equal pressures
                for _ in range(substeps - 1):
                    steps.append(steps[-1] @ self.advance.T)
                    power = power @ self.advance.T
                # The first force acts through the most substeps, (w, start and end, s, k, n)
                ways = np.stack(steps[::-1], axis=2).reshape(len(forces), -1, self.state_size)
                previous[1][substeps] = ways, power
        return previous[1][substeps]

    @staticmethod
    def _leap_of(state: Float, weights: Float, ways: Float, power: Float, own: slice) -> None:
        """Advance some worlds; weights: weights of pressures at starts and ends of substeps, shape (w, 1, 2 s)."""
        after = state[own] @ power
        after += weights[own, 0] @ ways[0] if len(ways) == 1 else np.matmul(weights[own], ways[own])[:, 0]
        state[own] = after

    def _march(self, state: Float, states: Float) -> None:
        """Do all substeps; each overwrites its increment in `states`, (w, s, n), by the new state; state: (w, n)."""
        onwards, before = self.advance.T, state
        for i in range(states.shape[1]):
            after = states[:, i]
            after += before @ onwards
            before = after

    def _forces(self, loads: SurfaceLoads) -> Float:
        """Return shares of force shapes (w, k, j) for patterns (w, k, q); w = 1 if all worlds have equal patterns."""
        pressure, previous = loads.pressure_Pa, self._fixed
        if loads.fixed and previous is not None and previous[0] is pressure:
            return previous[1]
        own = pressure[:1] if pressure.strides[0] == 0 else pressure
        forces = np.asarray(own @ (self._single_shares if pressure.dtype == np.float32 else self.shares))
        if loads.fixed:
            self._fixed = pressure, forces
        return forces

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        matrix = checked_operator(operator, self.unknowns)
        return Reader(matrix.shape[0], np.ascontiguousarray((matrix @ self.vectors).T))

    def coordinates(self, reader: Reader) -> tuple[Reader, Float] | None:
        return (Reader(self.order, None), reader.matrix) if reader.count > self.order else None

    def read(self, state: Float, reader: Reader) -> Float:
        with one_blas_thread:
            return self._read(state, reader)

    def motion(self, states: Float) -> Float:
        """Return displacement and velocity as coordinates in V, (s, 2, r), of states (s, state_size)."""
        result = np.empty((len(states), 2, self.order))
        np.matmul(states[:, : self.order], self._moved.T, out=result[:, 0])
        np.matmul(states[:, self.order : 2 * self.order], self._moves.T, out=result[:, 1])
        return result

    def _read(self, states: Float, reader: Reader) -> Float:
        """See `read`; a reader without a matrix comes from `coordinates`."""
        if reader.matrix is None:
            return self.motion(states)
        if len(states) <= self.order:
            seen = self.motion(states).reshape(-1, self.order) @ reader.matrix
            return seen.reshape(-1, 2, reader.count)
        # This order of products needs less work for many worlds and few output points
        displaced = states[:, : self.order] @ (self._moved.T @ reader.matrix)
        return np.stack([displaced, states[:, self.order : 2 * self.order] @ (self._moves.T @ reader.matrix)], axis=1)

    def projected(self, pressure_Pa: Float, operator: sparse.csr_matrix) -> Projection:
        """Return the model with forces of pressures at its points, (p,) or (k, p), and the readings of an operator."""
        small = self.small
        force = small.force @ np.atleast_2d(pressure_Pa @ self.shares).T
        return Projection(small.matrices, small.materials, force, operator @ self.vectors)

    def harmonic(self, pressure_Pa: Float, f_Hz: float, operator: sparse.csr_matrix) -> Complex:
        return self.projected(pressure_Pa, operator).harmonic(f_Hz)

    def describe(self) -> str:
        return f"{self.name}, {self.order} vectors"

    def device_model(self, substeps: int, points: int, device: str) -> DeviceModel | None:
        """See SkinStepper; None for small models, for which a CPU is as fast."""
        from palmfield.skin.reduction.device_models import DeviceReduced, pays

        worth = pays(self.state_size, self.shares.shape[1], substeps)
        return DeviceReduced(self, substeps, points, device) if worth else None

    def work(self, patterns: int, substeps: int) -> StepWork:
        size, (points, forces) = self.state_size, self.shares.shape
        products, double = points * forces, substeps * size * (size + 2 * forces)
        # A GPU reads the matrix in each substep, as it does for coupled modes
        return StepWork(patterns * products, double, products, substeps * size * size, substeps)

    def lifted(self, state: Float, pressure_Pa: Callable[[], Float]) -> Float:
        model = self.model
        rates = state @ model.rates.T + (pressure_Pa() @ self.shares) @ model.inputs.T
        rows = [state @ model.displaces.T, state @ model.moves.T, rates @ model.moves.T]
        rows += [state @ internal.T for internal in model.internals]
        return np.concatenate([row @ self.vectors.T for row in rows], axis=1)


def reduced_stepper(
    system: SkinSystem,
    load: KnownLoad,
    surface: sparse.csr_matrix,
    point: sparse.csr_matrix,
    inputs: sparse.csr_matrix,
    step_s: float,
    highest_Hz: float,
    tolerance: float,
    pressures: LoadShapes | None = None,
) -> ReducedStepper:
    """Return the stepper of a layer for a predicted load, from one real factorisation.

    surface: operator of the displacement that must be accurate, csr, (S, n). point: operator of one point, (1, n).
    inputs: csr, shape (n, q), from inward pressure [Pa] to consistent nodal force [N].
    step_s: length of a substep [s]; the shares of the predicted load have the same step.
    highest_Hz: highest relevant frequency [Hz]. tolerance: target relative error.
    pressures: shapes that compose the load, so that only their points are evaluated; None for all points.
    The error is the larger of two estimates. The first is SAFETY times the change, by the last ROUND or more vectors,
    of the motion under the load, from rest or in a tone. It is in L2; the larger of the surface and the point counts.
    The second is the error of the steady motion over the surface at the frequencies of the load: the displacement under
    the residual, by the stored factors. Both come from a smaller or stiffer body than the true one, so they are no
    bounds. Raises SceneError if MOST_VECTORS do not reach the tolerance.
    """
    small, vectors, error, any_course = known_model(
        system, cache.digest(load), lambda: load, surface, point, step_s, highest_Hz, tolerance
    )
    if pressures is None:
        return ReducedStepper(small, vectors, inputs.T @ vectors, None, step_s, error, any_course)
    shares: Float = pressures.fit.T @ (pressures.shapes @ (inputs.T @ vectors))
    return ReducedStepper(small, vectors, shares, pressures.points, step_s, error, any_course)


def known_model(
    system: SkinSystem,
    mark: str,
    ask_load: Callable[[], KnownLoad],
    surface: Any,
    point: Any,
    step_s: float,
    highest_Hz: float,
    tolerance: float,
) -> tuple[Projection, Float, float, bool]:
    """Return the body in vectors V, V (n, r), the error, and whether the model is valid for any course of the load.

    mark: digest of the predicted load; the load is made only if the cache (`palmfield.cache`) has no entry
    """

    def make() -> cache.Arrays:
        # Imported here, because cached models do not need these modules
        from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
        from palmfield.skin.reduction.krylov import SHIFT, Krylov, grow_until

        load = ask_load()
        # One BLAS thread, because several slow down these small products when other programs run
        with one_blas_thread:
            dynamics = DynamicStiffness(system, system.elimination_order())
            krylov = Krylov(dynamics, SHIFT * 2.0 * np.pi * highest_Hz, load.basis)
            _, error = grow_until(
                krylov,
                lambda: _Trial(krylov, load, step_s),
                lambda now, before: now.change(before, krylov, surface, point),
                tolerance,
                MOST_VECTORS,
                lambda: _defect(krylov, load, surface),
            )
            facts = np.array([error, krylov.course is None])
            return {"matrices": np.array(krylov.projected), "vectors": krylov.vectors, "facts": facts}

    depends_on = (system.made_of, mark, surface, point, step_s, highest_Hz, tolerance)
    stored = cache.kept("small-model", depends_on, make)
    error, any_course = stored["facts"].tolist()
    unit = np.eye(stored["vectors"].shape[1])
    small = Projection(list(stored["matrices"]), list(system.materials), unit, unit)
    return small, stored["vectors"], error, bool(any_course)


class _Trial:
    """Motions of a model with `order` vectors under the predicted load: coordinates in V, (t, order) each."""

    def __init__(self, krylov: "Krylov", load: KnownLoad, step_s: float) -> None:
        self.order = krylov.order
        small = Projection(
            krylov.projected, krylov.dynamics.materials, krylov.vectors.T @ load.shapes, np.eye(self.order)
        )
        model = Reduced(small, 0.0)
        self.moved = []
        for shares in load.trials:
            state, moved = model.new_state(), [np.zeros(self.order)]
            for first, last in itertools.pairwise(shares):
                model.step(state, first, last, step_s)
                moved.append(model.displacement(state))
            self.moved.append(np.array(moved))
        for frequencies, tone in load.tones:
            lines = tone[:, None] * np.array([small.harmonic(f_Hz) for f_Hz in frequencies])
            self.moved.append(np.concatenate([lines.real, lines.imag]))

    def change(self, other: "_Trial", krylov: "Krylov", surface: Any, point: Any) -> float:
        """Return the relative difference from a model with fewer vectors, L2 over times: surface or point."""
        worst = 0.0
        for operator in (surface, point):
            small = operator @ krylov.vectors[:, : self.order]
            squares = small.T @ small
            for mine, theirs in zip(self.moved, other.moved, strict=True):
                difference = mine.copy()
                difference[:, : other.order] -= theirs
                size, changed = (float(np.vdot(moved @ squares, moved)) for moved in (mine, difference))
                worst = max(worst, np.sqrt(max(changed, 0.0) / size) if size > 0.0 else 0.0)
        return worst


def _defect(krylov: "Krylov", load: KnownLoad, surface: Any) -> float:
    """Return displacement under the residual over displacement, in steady motion, L2 over frequencies and surface."""
    responses, pushes, weights = [], [], []
    projected = krylov.vectors.T @ load.shapes
    for f_Hz, shares in load.spectrum:
        weights.append(krylov.dynamics.weights(np.array([-2j * np.pi * f_Hz]))[0])
        small = sum(w * matrix for w, matrix in zip(weights[-1], krylov.projected, strict=True))
        pushes.append(shares)
        responses.append(np.linalg.solve(small, projected @ shares))
    moved, pushing = np.array(responses).T, np.array(pushes).T
    mixed = _mixing(2 * len(responses))
    residual = load.shapes @ (np.hstack([pushing.real, pushing.imag]) @ mixed)
    for column, matrix in enumerate(krylov.dynamics.matrices):
        if not matrix.nnz:
            continue
        scaled = moved * np.array(weights)[:, column]
        residual -= matrix @ (krylov.vectors @ (np.hstack([scaled.real, scaled.imag]) @ mixed))
    missed = surface @ krylov.factored.solve(residual)
    seen = (surface @ krylov.vectors) @ moved
    return float(np.linalg.norm(missed) / np.linalg.norm(seen))


def _mixing(columns: int) -> Float:
    """Return factors of sums of columns with random signs, (columns, at most MIXED); the norm stays about the same.

    The sums are loads with the same spectrum and other phases (Hutchinson, Commun. Stat. Simul. Comput. 19, 1990).
    """
    if columns <= MIXED:
        return np.eye(columns)
    signs = np.random.default_rng(0).integers(0, 2, (columns, MIXED))
    return (2.0 * signs - 1.0) / np.sqrt(MIXED)
