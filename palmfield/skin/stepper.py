"""Protocol of a stepper, which advances the motion of a skin in time, for scenes and for `palmfield.skin.solve`.

A stepper is made once for a layer and never changes, so threads can share it. The state belongs to the caller. All
arrays have a leading axis for worlds: one call steps several equal bodies, each with its own state and loads.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.projection import Projection
from palmfield.threads import Calls
from palmfield.types import Complex, Float, Float32, Int

CLOCK = 1e-6
"""Tolerance of t1 - t0 against the substeps of the loads, as a share of a substep: the time of MuJoCo is rounded."""


@dataclass(frozen=True)
class SurfaceLoads:
    """Inward pressure on a skin over s substeps: a sum of k patterns with weights linear in each substep.

    pressure_Pa: patterns at the quadrature points of the layer [Pa], shape (w, k, q).
    first, last: weight of each pattern at the start and at the end of each substep, shape (w, s, k).
    fixed: whether `pressure_Pa` never changes, so that a stepper may cache results computed from it.
    """

    pressure_Pa: Float | Float32
    first: Float
    last: Float
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class Reader:
    """Operator from states to displacement and velocity; only the stepper that made it can use it.

    count: number m of values read; matrix: the operator in the form of the stepper
    single: the same in single precision, if the stepper uses it to observe all substeps
    """

    count: int
    matrix: Any
    single: Any = None


class Outside(NamedTuple):
    """Squares of the part of a load outside the class of a stepper, and of the whole load, summed over substeps.

    energy, energy_of_all: squared energy norms on the skin.
    plain, plain_of_all: sums of squares of the pressures at the points [Pa^2].
    """

    energy: float
    energy_of_all: float
    plain: float
    plain_of_all: float


class StepMemory(NamedTuple):
    """Arrays on a device: input and output of a step of a skin in w worlds, with up to m pressure patterns.

    counts: used numbers of drives and of pressure patterns, int32, shape (w, 2).
    pressure: patterns [Pa], float32, shape (w m, q); q: points of the stepper if `chosen`, else all points.
    weights: of the patterns, float64, (w, `DeviceModel.weight_rows`, m). before, after: states, float64, (w, n).
    squares: parts of the sums of `Outside` in each of s substeps, float64, shape (w, SECTIONS, s, `kernels.LANES`).
    """

    counts: Any
    pressure: Any
    weights: Any
    before: Any
    after: Any
    squares: Any
    chosen: bool = False


class StepWork(NamedTuple):
    """Work of all substeps as dense products: operations, numbers read in each precision, and kernels."""

    single: float
    double: float
    single_read: float
    double_read: float
    kernels: int


DeviceStep = Callable[[Float, SurfaceLoads, float, float, Reader | None], Float | Float32 | None]
"""Function like `SkinStepper.step`."""


class SkinStepper(Protocol):
    """Stepper of one skin. Immutable, and safe to use from several threads. Other code needs only the attributes below,
    not the names of subclasses. The defaults are those of a solver for any load anywhere.

    name: name of the solver. step_s: length of a substep [s]. state_size: size of a state; at rest all numbers are 0.
    unknowns: number of unknowns of its mesh.
    points: numbers of the quadrature points of the layer whose pressure is used, shape (p,); None: all points.
    error: estimated relative error of the displacement that the stepper adds, 0 for none. For a stepper with its own
        mesh, the error of this mesh is included, and the estimate may take as long as a short run.
    any_pose: whether it is valid after body, arrays or focus have moved.
    any_course: whether it is valid for any time course of the load, also if it starts from rest while sound is on.
    of_class: whether it is valid only for a class of loads.
    adds_error: relative errors of displacement and velocity that a reduced model adds to those of its layer. The second
        is None without an estimate. None for other steppers.
    exact_in_time: whether its substeps add no error. factorises: whether it has the factors of the whole layer.
    made_of: all inputs that determine the results of a reduced model.
    """

    name: str
    step_s: float
    state_size: int
    unknowns: int
    error: float
    points: Int | None
    any_pose: bool = True
    any_course: bool = True
    of_class: bool = False
    adds_error: tuple[float, float | None] | None = None
    exact_in_time: bool = False
    factorises: bool = False
    made_of: tuple[Any, ...] = ()

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | Float32 | None:
        """Advance a state (w, state_size) in place from t0 to t1 [s], by all substeps of `loads`.

        Returns displacement [m] and velocity [m/s] through the reader `observe` after each substep, (w, s, 2, m), or
        None without a reader. Raises SceneError for other shapes, and if t1 - t0 is not s substeps.
        """
        ...

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """Return the Reader of an operator (m, ndof) on unknowns of the layer. Raises SceneError for other shapes."""
        ...

    def coordinates(self, reader: Reader) -> tuple[Reader, Float] | None:
        """Return a reader of r < m numbers and the matrix (r, m) that converts them to the readings of `reader`.

        With it, the product can be computed for many steps together. None for steppers without coordinates.
        """
        return None

    def read(self, state: Float, reader: Reader) -> Float:
        """Return the displacement [m] and velocity [m/s] through a reader, shape (w, 2, m)."""
        ...

    def describe(self) -> str:
        """Return a description in words for the summary of a run."""
        return self.name

    def device_model(self, substeps: int, points: int, device: str) -> "DeviceModel | None":
        """Return the stepper on a device, or None if it stays on the CPU.

        substeps: number of substeps of a step; points: number of quadrature points of the layer"""
        return None

    def device_worlds(self, most: int, device: str) -> "DeviceStep | None":
        """Return a stepper on a device that replaces `step` for up to `most` worlds, or None."""
        return None

    def work(self, patterns: int, substeps: int) -> StepWork | None:
        """Return the work of substeps for a number of patterns, or None without dense products."""
        return None

    def outside(self, loads: SurfaceLoads) -> Outside:
        """For a stepper of a class: return the part of loads outside the class."""
        raise TypeError(f"solver '{self.name}' accepts any load")

    def mixed(self, loads: SurfaceLoads) -> Float32:
        """For a stepper of a class: return the weights of patterns at the time of the force in substeps, (w, s, k)."""
        raise TypeError(f"solver '{self.name}' accepts any load")

    def lifted(self, state: Float, pressure_Pa: Callable[[], Float]) -> Float:
        """For a reduced model: convert its state to a state of WedgeStepper with the same motion, (w, size).

        pressure_Pa: returns the present inward pressure at the points of the stepper [Pa], shape (p,)
        """
        raise TypeError(f"solver '{self.name}' is not a reduced model")

    def harmonic(self, pressure_Pa: Float, f_Hz: float, operator: sparse.csr_matrix) -> Complex:
        """For a reduced model: return operator @ harmonic displacement [m], shape (m,).

        pressure_Pa: amplitude of the pressure times e^{-i w t} at the points of the stepper [Pa], (p,)"""
        raise TypeError(f"solver '{self.name}' is not a reduced model")

    def projected(self, pressure_Pa: Float, operator: sparse.csr_matrix) -> Projection:
        """For a reduced model of a predicted load: return the body projected on its vectors, see ReducedStepper."""
        raise TypeError(f"solver '{self.name}' is not made for a predicted load")


class DeviceModel(Protocol):
    """Data of a stepper on a device, for steps with a fixed number of substeps.

    stepper: owner of the state; weight_rows: number of rows of `weights`
    """

    @property
    def stepper(self) -> SkinStepper: ...
    @property
    def substeps(self) -> int: ...
    @property
    def weight_rows(self) -> int: ...

    def weights(self, first: Float, last: Float) -> Float:
        """Return the weights of the patterns in the form of the kernels, from those of SurfaceLoads, shape (s, m)."""
        ...

    def calls(self, memory: StepMemory) -> Calls:
        """Return the kernel launches for all substeps."""
        ...

    def outside(self, sums: Sequence[Any]) -> Outside | None:
        """Return the part of the load outside the class of the stepper, if it has a class.

        sums: sums of squares from the launches, SECTIONS numbers or SECTIONS arrays with one number per world"""
        ...


def check_step(
    stepper: SkinStepper, state: Float, loads: SurfaceLoads, points: int, t0: float, t1: float, any_length: bool = False
) -> bool:
    """Return whether the substeps have the length of the stepper; points: number q of quadrature points of the layer.

    Raises SceneError for other shapes, and for substeps of another length unless `any_length`.
    """
    worlds, substeps, patterns = loads.first.shape
    if state.shape != (worlds, stepper.state_size) or worlds == 0 or state.strides[1] != state.itemsize:
        raise SceneError(
            f"skin state has shape {state.shape} for loads of {worlds} worlds; solver '{stepper.name}' needs shape "
            f"({worlds or 'w'}, {stepper.state_size}), w >= 1, contiguous rows"
        )
    shape = worlds, patterns, points
    if loads.last.shape != loads.first.shape or loads.pressure_Pa.shape != shape or substeps == 0:
        raise SceneError(
            f"skin loads: pressure {loads.pressure_Pa.shape}, first {loads.first.shape}, last {loads.last.shape}; give "
            f"({worlds}, k, {points}), ({worlds}, s, k) and ({worlds}, s, k), s >= 1"
        )
    own = abs(t1 - t0 - substeps * stepper.step_s) <= CLOCK * stepper.step_s
    if not own and not (any_length and t1 > t0):
        raise SceneError(
            f"skin step from {t0:g} to {t1:g} s: the given loads cover {substeps} substeps of {stepper.step_s:g} s"
        )
    return own


def world_by_world(
    stepper: SkinStepper, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None
) -> Float | None:
    """Call `SkinStepper.step` of a stepper for one world for each of several worlds, and return the joined records."""
    records = []
    for world in range(len(state)):
        one = slice(world, world + 1)
        own = SurfaceLoads(loads.pressure_Pa[one], loads.first[one], loads.last[one])
        records.append(stepper.step(state[one], own, t0, t1, observe))
    return None if observe is None else np.concatenate([part for part in records if part is not None])


def checked_operator(operator: sparse.csr_matrix, unknowns: int) -> sparse.csr_matrix:
    """Return the operator in float64. Raises SceneError unless it is (m, unknowns)."""
    if operator.ndim != 2 or operator.shape[1] != unknowns:
        raise SceneError(f"skin reader: the operator is {operator.shape}; the layer has {unknowns} unknowns")
    return sparse.csr_matrix(operator, dtype=np.float64)
