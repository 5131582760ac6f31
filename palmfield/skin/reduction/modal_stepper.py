"""Step a skin by modes for all loads of a class: any time course of any sum of its shapes.

Modes and the whole layer use the same scheme (palmfield.skin.fem.generalised_alpha), so the whole layer can continue
from a state of the modes without change. With one relaxation law the modes are uncoupled. Several laws couple them.
The modes are then eigenvectors of the matrix of a substep, and the coupling is a force from the motion before the
substep: one dense product for each law except one. The pressure is evaluated at few points of the skin.
"""

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from scipy import sparse

from palmfield import cache
from palmfield.blas import one_blas_thread
from palmfield.device import filled, recorded
from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.generalised_alpha import RHO_INF, Scheme
from palmfield.skin.fem.linear_body import Matrices, Part
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.reduction.load_shapes import POINTS, LoadShapes, load_shapes
from palmfield.skin.reduction.ritz import RitzModes, laws_at, refusal, ritz_modes, shifted
from palmfield.skin.stepper import (
    DeviceModel,
    DeviceStep,
    Outside,
    Reader,
    SkinStepper,
    StepWork,
    SurfaceLoads,
    check_step,
    checked_operator,
)
from palmfield.threads import cores, share
from palmfield.types import Complex, Float, Float32, Int
from warp_kernels import modes as kernels

MOST_SHARE = 0.4
"""Largest number of vectors over unknowns of a layer; with more vectors, modes save no time."""
COMPLIANCE_LEFT_OUT = 1e-4
"""Share of the compliance of the points that its low-rank form omits; it is 1 % of a norm."""


@dataclass(frozen=True)
class ModalBody:
    """The data of a ModalStepper that are expensive to compute.

    modes: see RitzModes; shapes: shapes of the class; forces: force of each shape on each mode, shape (m, r)
    compliance: the norm of pressure @ compliance is the energy norm of a pressure at the points of the shapes, (p, k)
    readers: readers of all steppers with their operators, stored because each is a product of all modes
    """

    modes: RitzModes
    shapes: LoadShapes
    forces: Float
    compliance: Float
    readers: list[tuple[weakref.ref[sparse.csr_matrix], Reader]] = field(default_factory=list, repr=False)


def modal_body(
    system: SkinSystem,
    quadrature: SurfaceQuadrature,
    surface: sparse.csr_matrix,
    examples: Callable[[], Float],
    depends_on: Sequence[Any],
    tolerance: float,
    blocks: int,
    omitted: float,
    step_s: float,
    points: int = POINTS,
) -> ModalBody:
    """Return the modes of a layer for the class of loads given by examples, from one real factorisation.

    surface: operator of the displacement that must be accurate, csr, (S, n).
    examples: returns pressures at the quadrature points [Pa], shape (t, q). depends_on: all data on which they depend.
    tolerance: relative share of the examples that the shapes may omit. points: number of points per shape.
    blocks: blocks of the space of the modes, at least 2. omitted: share of the motion to omit, see `ritz_modes`.
    step_s: length of a substep [s]; coupled modes depend on it.
    The result is stored in the cache (`palmfield.cache`).
    Raises SceneError if modes are impossible for the layer, or if it has too few unknowns.
    """

    def make() -> cache.Arrays:
        # Imported here, because cached modes need no factorisation
        from palmfield.skin.fem.factor import factorise

        reason = refusal(system)
        if reason is not None:
            raise SceneError(f"no modes for this skin: {reason}")
        with one_blas_thread:
            shapes = load_shapes(examples(), quadrature.weights, tolerance, points)
            fitting, least = int(MOST_SHARE * system.ndof / len(shapes.sizes)), 2 if len(system.parts) == 1 else 4
            if fitting < least:
                raise SceneError(
                    f"no modes for this skin: {least} blocks of {len(shapes.sizes)} load shapes exceed "
                    f"{MOST_SHARE:g} of its {system.ndof} unknowns, so the full model costs no more"
                )
            stiffened = Scheme(system, step_s, RHO_INF).stiffened(len(system.parts))
            nodal: Float = quadrature.operator @ shapes.shapes.T
            relaxed = np.zeros((system.ndof, 0))
            if len(system.parts) > 1:
                loose = factorise(shifted(system, relaxed=True), system.elimination_order())
                relaxed = loose.solve(nodal * shapes.sizes)
                del loose
            factor = factorise(shifted(system), system.elimination_order())
            block_count = max(min(blocks, fitting), least)
            modes = ritz_modes(system, factor, nodal, shapes.sizes, block_count, omitted, surface, stiffened, relaxed)
            seen = quadrature.operator[:, shapes.points].toarray()
            values, vectors = np.linalg.eigh(seen.T @ factor.solve(seen))
            kept = np.cumsum(values) > COMPLIANCE_LEFT_OUT * values.sum()
            compliance = vectors[:, kept] * np.sqrt(values[kept])
            forces = nodal.T @ modes.vectors
        return vars(modes) | vars(shapes) | {"forces": forces, "compliance": compliance}

    options = tolerance, blocks, omitted, points, step_s
    stored = cache.kept("modes", (system.made_of, quadrature.operator, surface, *depends_on, *options), make)
    modes = RitzModes(**{one.name: stored[one.name] for one in fields(RitzModes)})
    shapes = LoadShapes(**{one.name: stored[one.name] for one in fields(LoadShapes)})
    return ModalBody(modes, shapes, stored["forces"], stored["compliance"])


@dataclass(frozen=True)
class _Room:
    """Work arrays of a call.

    forces: forces on the modes in each substep, (w, s, r); rows: state, (w, rows, r); launch: runs all substeps;
    seen: displacement and velocity after each substep, (w, s, 2, r)"""

    forces: Float
    rows: Float
    seen: Float
    launch: Callable[[], object]


class ModalStepper(SkinStepper):
    """Step a layer by modes; see SkinStepper.

    body: see ModalBody. system: the layer. step_s: length of a substep [s].
    corner_Hz: frequency above which the spectrum of the load falls as 1/f; the errors depend on it.
    points: numbers of the quadrature points whose pressure is used, shape (p,).
    error, velocity_error: estimated relative errors due to omitted modes, for loads of the class.
    advance, inputs: matrix of a substep for each mode, (r', rows, rows), and increment by a force, (r', rows).
    padded: number r' >= r of modes in a state with padding.
    coupling, feedback: the coupling force in a substep is feedback @ state, (c, rows) @ (rows, r'), as one row, times
        coupling, (c * r', r'); c is 0 if the modes are uncoupled.
    A state has rows of r' numbers: displacement, velocity, acceleration and the internal displacement of every branch.
    Several worlds may be stepped together.
    """

    name = "modal"
    of_class = True

    def __init__(self, body: ModalBody, system: SkinSystem, step_s: float, corner_Hz: float) -> None:
        modes, shapes = body.modes, body.shapes
        self.body, self.step_s, self.order, self.unknowns = body, step_s, len(modes.elastic), system.ndof
        self.adds_error = self.error, self.velocity_error = modes.errors(corner_Hz)
        self.points: Int = shapes.points
        self.made_of = modes.elastic, modes.stiffness, modes.coupling, modes.shares, body.forces, self.error
        self._materials = system.materials
        parts = [Part(sparse.diags(own).tocsr(), of) for own, of in zip(modes.stiffness, self._materials, strict=True)]
        mass, elastic = sparse.identity(self.order, format="csr"), sparse.diags(modes.elastic).tocsr()
        scheme = Scheme(Matrices(mass, sparse.csr_matrix(mass.shape), elastic, parts), step_s, RHO_INF)
        self.state_rows, self._alpha_f = scheme.state_rows, scheme.alpha_f
        self.padded = -(-self.order // kernels.WIDTH) * kernels.WIDTH
        self.state_size = self.state_rows * self.padded
        self.advance, self.inputs = _propagators(scheme, self.padded)
        self._modes = filled(kernels.Modes(), advance=_in_groups(self.advance), inputs=_in_groups(self.inputs))
        self.coupling, self.feedback = _coupling(modes, scheme, len(parts), self.padded)
        self._fit: Float32 = np.ascontiguousarray(shapes.fit.T, dtype=np.float32)
        self._back: Float32 = np.ascontiguousarray(shapes.shapes[:, shapes.points], dtype=np.float32)
        self._forces: Float32 = np.zeros((len(body.forces), self.padded), np.float32)
        self._forces[:, : self.order] = body.forces
        self._compliance: Float32 = np.ascontiguousarray(body.compliance, dtype=np.float32)
        # A least-squares fit with one number per shape also reduces the part of the load outside the span
        count = len(shapes.points)
        self._hidden = count / max(count - len(shapes.sizes), 1)
        self._rooms: dict[tuple[int, int], list[_Room]] = {}
        # Results for the last constant pressures
        self._pushed: tuple[Float | Float32, Float32] | None = None

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float32 | None:
        """See SkinStepper; observed motion is returned in single precision."""
        check_step(self, state, loads, len(self.points), t0, t1)
        worlds, substeps, _ = loads.first.shape
        seen = None if observe is None else np.empty((worlds, substeps, 2, observe.count), np.float32)
        mixed = self.mixed(loads)
        # The number of BLAS threads applies to the whole process, including the helper threads
        with one_blas_thread:
            pushes = self.pushes(loads)
            if worlds == 1:
                self._step_some(slice(0, 1), state, mixed, pushes, observe, seen)
                return seen
            threads = min(cores(), worlds)
            size = -(-worlds // threads)
            parts = [slice(first, first + size) for first in range(0, worlds, size)]
            share([(partial(self._step_some, part, state, mixed, pushes, observe, seen),) for part in parts], threads)
        return seen

    def _step_some(
        self, part: slice, states: Float, mixed: Float32, pushes: Float32, observe: Reader | None, seen: Float32 | None
    ) -> None:
        """Do all substeps of some worlds; pushes: forces of patterns, see `pushes`."""
        state, mixed, pushes = states[part], mixed[part], pushes[part]
        rooms = self._rooms.setdefault(mixed.shape[:2], [])
        try:
            room = rooms.pop()
        except IndexError:
            room = self._new_room(*mixed.shape[:2])
        rows = state.reshape(len(state), self.state_rows, self.padded)
        forces = mixed @ pushes
        if forces.shape[2] != self.padded:
            forces = (forces.reshape(-1, forces.shape[2]) @ self._forces).reshape(*forces.shape[:2], -1)
        room.forces[...] = forces
        room.rows[...] = rows
        room.launch()
        rows[...] = room.rows
        if seen is not None and observe is not None:
            # One product is seven times faster than the product of a stack, which NumPy computes one by one
            motion = room.seen.reshape(-1, self.padded).astype(np.float32)
            np.matmul(motion, observe.single, out=seen[part].reshape(-1, observe.count))
        rooms.append(room)

    def pushes(self, loads: SurfaceLoads) -> Float32:
        """Return the force of one pattern on the modes, (w, 1, r), or the shares of k patterns in shapes, (w, k, m)."""
        cached = self._pushed
        if loads.fixed and cached is not None and cached[0] is loads.pressure_Pa:
            return cached[1]
        shares: Float32 = loads.pressure_Pa.astype(np.float32, copy=False) @ self._fit
        if loads.first.shape[2] > 1:
            return shares
        pushes: Float32 = shares @ self._forces
        if loads.fixed:
            self._pushed = loads.pressure_Pa, pushes
        return pushes

    def describe(self) -> str:
        return f"{self.name}, {self.order} modes"

    def device_model(self, substeps: int, points: int, device: str) -> DeviceModel:
        from palmfield.skin.reduction.device_models import DeviceModes

        return DeviceModes(self, substeps, device)

    def device_worlds(self, most: int, device: str) -> DeviceStep | None:
        if device == "cpu" or self.coupled:
            return None
        from palmfield.skin.reduction.device_models import DeviceWorlds

        return DeviceWorlds(self, most, device).step

    def work(self, patterns: int, substeps: int) -> StepWork:
        points, shapes, modes, rows = len(self.points), len(self.body.shapes.sizes), self.order, self.state_rows
        dense = 2 * points * shapes + shapes * modes + points * self.body.compliance.shape[1]
        # The matrix of coupled modes is too large for the memory of a multiprocessor, so each substep reads it again
        coupling = substeps * self.coupling.size
        own = modes * (rows * rows + rows)
        single, double = patterns * (dense + substeps * modes), substeps * own + coupling
        launches = 4 * substeps if self.coupled else 0
        return StepWork(single, double, dense, own + 2 * modes * rows + coupling, launches)

    def outside(self, loads: SurfaceLoads) -> Outside:
        pressure = loads.pressure_Pa.astype(np.float32, copy=False)
        residual = pressure - (pressure @ self._fit) @ self._back
        mixed = self.mixed(loads)
        squares = []
        for part in (residual @ self._compliance, pressure @ self._compliance, residual, pressure):
            numbers = (mixed @ part).ravel()
            squares.append(float(numbers @ numbers))
        return self.weighed(squares)

    def weighed(self, squares: Sequence[float]) -> Outside:
        """Return the part of the load outside the class.

        squares: sums over substeps, of the remainder and the whole load, in the energy norm and as pressure [Pa^2]"""
        outside, whole, plain, plain_whole = squares
        return Outside(self._hidden * outside, whole, self._hidden * plain, plain_whole)

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        for reference, made in self.body.readers:
            if reference() is operator:
                return made
        matrix = checked_operator(operator, self.unknowns)
        seen = np.zeros((self.padded, matrix.shape[0]))
        # Only unknowns of the reader, because the product copies them in double precision
        read = np.unique(matrix.indices)
        seen[: self.order] = (matrix[:, read] @ self.body.modes.vectors[read]).T
        made = Reader(matrix.shape[0], seen, seen.astype(np.float32))
        present = [one for one in self.body.readers if one[0]() is not None]
        self.body.readers[:] = [*present, (weakref.ref(operator), made)]
        return made

    def read(self, state: Float, reader: Reader) -> Float:
        rows = state.reshape(len(state), self.state_rows, self.padded)
        with one_blas_thread:
            result: Float = rows[:, :2] @ reader.matrix
        return result

    def harmonic(self, pressure_Pa: Float, f_Hz: float, operator: sparse.csr_matrix) -> Complex:
        modes, s = self.body.modes, -2j * np.pi * f_Hz
        force = (self.body.shapes.fit @ pressure_Pa) @ self.body.forces
        laws = laws_at(self._materials, s)
        rigidity = s**2 + laws @ np.array([modes.elastic, *modes.stiffness])
        if not self.coupled:
            return np.asarray((operator @ modes.vectors) @ (force / rigidity), dtype=complex)
        with one_blas_thread:
            together = np.diag(rigidity) + np.tensordot(modes.shares @ laws, modes.coupling, axes=1)
            return np.asarray((operator @ modes.vectors) @ np.linalg.solve(together, force), dtype=complex)

    @property
    def coupled(self) -> bool:
        return len(self.feedback) > 0

    def lifted(self, state: Float, pressure_Pa: Callable[[], Float]) -> Float:
        """See SkinStepper; the pressure is not used."""
        rows = state.reshape(len(state), self.state_rows, self.padded)[..., : self.order]
        with one_blas_thread:
            whole = rows @ self.body.modes.vectors.T
        return whole.reshape(len(state), -1)

    def mixed(self, loads: SurfaceLoads) -> Float32:
        alpha = self._alpha_f
        return (alpha * loads.first + (1.0 - alpha) * loads.last).astype(np.float32)

    def _new_room(self, worlds: int, substeps: int) -> _Room:
        rows, old = np.zeros((2, worlds, self.state_rows, self.padded))
        dim = worlds, self.padded // kernels.WIDTH

        def launch(forces: Float, seen: Float) -> Callable[[], object]:
            inputs = [self._modes, *(_lanes(part) for part in (forces, rows, old, seen))]
            return recorded(kernels.step_modes, dim, inputs, "cpu")

        if not self.coupled:
            forces, seen = np.zeros((worlds, substeps, self.padded)), np.zeros((worlds, substeps, 2, self.padded))
            return _Room(forces, rows, seen, launch(forces, seen))
        # Substeps are the outermost axis, because each substep is a launch
        forces, seen = np.zeros((substeps, worlds, 1, self.padded)), np.zeros((substeps, worlds, 1, 2, self.padded))
        ends = [(force[:, 0], launch(force, after)) for force, after in zip(forces, seen, strict=True)]

        def all_substeps() -> None:
            for force, substep in ends:
                feedback: Float32 = (self.feedback @ rows).reshape(worlds, -1).astype(np.float32)
                force += feedback @ self.coupling
                substep()

        return _Room(forces[:, :, 0].swapaxes(0, 1), rows, seen[:, :, 0].swapaxes(0, 1), all_substeps)


def _propagators(scheme: Scheme, padded: int) -> tuple[Float, Float]:
    """Return the matrix of a substep for each mode, (padded, rows, rows), and increment by a force, (padded, rows)."""
    diagonals = [term.matrix.diagonal() for term in scheme.terms]
    count, rows = len(diagonals[0]), scheme.state_rows
    rigidity = sum(term.coefficient * diagonal for term, diagonal in zip(scheme.terms, diagonals, strict=True))
    of_state = sum(np.outer(diagonal, term.row) for term, diagonal in zip(scheme.terms, diagonals, strict=True))
    advance, inputs = np.zeros((padded, rows, rows)), np.zeros((padded, rows))
    advance[:count] = scheme.advance + scheme.follow[:, None] * (of_state / rigidity[:, None])[:, None, :]
    inputs[:count] = scheme.follow / rigidity[:, None]
    return advance, inputs


def _coupling(modes: RitzModes, scheme: Scheme, laws: int, padded: int) -> tuple[Float32, Float]:
    """Return stacked coupling matrices, (c * padded, padded), and the state rows to which they apply, (c, rows).

    Coupled modes are those that make `scheme.effective` diagonal, so that a substep solves uncoupled equations. The
    matrices are in single precision to halve the reading time; a device computes the product in double precision. On
    discs of two and three laws this changed displacements by up to 4e-7, and velocities by up to 2e-6, of the largest.
    """
    count, order = len(modes.coupling), len(modes.elastic)
    coupling = np.zeros((count, padded, padded), np.float32)
    coupling[:, :order, :order] = modes.coupling
    elastic = [-scheme.alpha_f * np.eye(scheme.state_rows)[0]]
    feedback: Float = modes.shares @ np.array([*elastic, *(term.row for term in scheme.terms[-laws:])])
    return coupling.reshape(count * padded, padded), feedback


def _in_groups(values: Float) -> Any:
    """Return values of modes, (r, ...), as vectors of WIDTH lanes, (r / WIDTH, ...)."""
    grouped = values.reshape(-1, kernels.WIDTH, *values.shape[1:])
    return wp.array(np.ascontiguousarray(np.moveaxis(grouped, 1, -1)), dtype=kernels.lanes, device="cpu")


def _lanes(values: Float) -> Any:
    """Return a view of memory, (..., r), as vectors of WIDTH lanes, (..., r / WIDTH)."""
    wide = values.reshape(*values.shape[:-1], -1, kernels.WIDTH)
    return wp.array(wide, dtype=kernels.lanes, device="cpu", copy=False)
