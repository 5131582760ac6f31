"""What carries a skin through simulated time: one protocol for scenes and for `palmfield.skin.solve`.

A stepper is made once for a layer and never changes, so that threads share it; the state is the caller's. All arrays
have a leading axis for worlds: several bodies alike, each with its own state and loads, are stepped in one call.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.threads import Calls
from palmfield.types import Complex, Float, Float32, Int

CLOCK = 1e-6
"""Of a substep, by which t1 - t0 may differ from the substeps that the loads are for: MuJoCo adds up its time."""


@dataclass(frozen=True)
class SurfaceLoads:
    """Inward pressure on a skin over s substeps, as sums of k patterns that change linearly within each substep.

    pressure_Pa: the patterns at the layer's quadrature points [Pa], shape (w, k, q)
    first, last: weight of each pattern at the start and at the end of each substep, shape (w, s, k)
    fixed: whether `pressure_Pa` is never written again, so that a stepper may keep what it has made of it
    """

    pressure_Pa: Float | Float32
    first: Float
    last: Float
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class Reader:
    """What reads displacement and velocity off the states of the one stepper that made it (SkinStepper.reader).

    count: numbers read, m; matrix: the operator as that stepper uses it
    single: the same in single precision, if that stepper takes it for what is observed of all substeps
    """

    count: int
    matrix: Any
    single: Any = None


class Outside(NamedTuple):
    """Squares of what of a load lies outside its class, and of the whole load, summed over substeps.

    energy, energy_of_all: in the energy norm of the skin; plain, plain_of_all: of the pressures at the points [Pa^2]
    """

    energy: float
    energy_of_all: float
    plain: float
    plain_of_all: float


class StepMemory(NamedTuple):
    """Where a step of a skin in w worlds finds its numbers on a device, and where it leaves them.

    counts: drives and patterns, int32, shape (w, 2); pressure: patterns at all the layer's quadrature points [Pa],
        float32, shape (w m, q), or, if `chosen`, at the stepper's own
    weights: of each pattern, float64, shape (w, `DeviceModel.weight_rows`, m)
    before, after: the state, float64, shape (w, n); squares: float64, shape (w, SECTIONS, s, `kernels.LANES`)
    """

    counts: Any
    pressure: Any
    weights: Any
    before: Any
    after: Any
    squares: Any
    chosen: bool = False


class StepWork(NamedTuple):
    """What all substeps take as dense products: operations and numbers read in either precision, and kernels."""

    single: float
    double: float
    single_read: float
    double_read: float
    kernels: int


DeviceStep = Callable[[Float, SurfaceLoads, float, float, Reader | None], Float | Float32 | None]
"""As `SkinStepper.step`."""


class SkinStepper(Protocol):
    """Steps one skin in time. Immutable, and safe to use from several threads. A class of it need not be known by name:
    what others want to know is here, and what it doesn't say itself is as of a solver that takes any load anywhere.

    name: the solver; step_s: length of a substep [s]; state_size: numbers of a state, all 0 at rest
    unknowns: of the mesh that it moves
    points: numbers of the layer's quadrature points at which it takes pressure, shape (p,), None for all of them
    error: what the stepper itself adds to the displacement's relative error by its own estimate; 0 where it adds none.
        One with a mesh of its own counts all that this mesh does, and may take as long as a short run to tell
    any_pose, any_course: whether it serves where body, arrays or focus have moved, and from rest in the midst of sound
    of_class: whether it serves a class of loads only
    adds_error: relative errors of displacement and velocity that a small model adds to its layer's for what it serves,
        the second None where it states none; None for what is no small model
    exact_in_time: whether its substeps add no error
    made_of: all that a small model's answers follow from
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
    made_of: tuple[Any, ...] = ()

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | Float32 | None:
        """Carry a state (w, state_size), in place, from t0 to t1 [s]: all substeps of `loads`.

        Returns displacement [m] and velocity [m/s] after each substep as `observe` reads them, shape (w, s, 2, m), or
        None without it. Raises SceneError for other shapes and where t1 - t0 is not s substeps.
        """
        ...

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """Prepare an operator (m, ndof) on the layer's unknowns. Raises SceneError for another number of columns."""
        ...

    def read(self, state: Float, reader: Reader) -> Float:
        """Displacement [m] and velocity [m/s] through a reader, shape (w, 2, m)."""
        ...

    def describe(self) -> str:
        """What it is, in words, for a run's summary."""
        return self.name

    def device_model(self, substeps: int, points: int, device: str) -> "DeviceModel | None":
        """It on a device; None where it stays on the CPU. substeps: of a step; points: of the layer's quadrature."""
        return None

    def device_worlds(self, most: int, device: str) -> "DeviceStep | None":
        """What steps so many worlds on a device in place of `step`, None where that does."""
        return None

    def work(self, patterns: int, substeps: int) -> StepWork | None:
        """What substeps under some patterns of pressure at its points take, None where they are no dense products."""
        return None

    def outside(self, loads: SurfaceLoads) -> Outside:
        """Of one for a class: what of loads lies outside it."""
        raise TypeError(f"solver '{self.name}' serves any load")

    def mixed(self, loads: SurfaceLoads) -> Float32:
        """Of one for a class: each pattern's weight where the scheme takes the force in a substep, shape (w, s, k)."""
        raise TypeError(f"solver '{self.name}' serves any load")

    def lifted(self, state: Float, pressure_Pa: Callable[[], Float]) -> Float:
        """Of a small model: the same motion as a state of WedgeStepper, (w, its state_size).

        pressure_Pa: gives the present inward pressure at its points, shape (p,)
        """
        raise TypeError(f"solver '{self.name}' is no small model")

    def harmonic(self, pressure_Pa: Float, f_Hz: float, operator: sparse.csr_matrix) -> Complex:
        """Of a small model: operator @ displacement [m], shape (m,), under a pressure at its points, (p,), times
        e^{-i w t}."""
        raise TypeError(f"solver '{self.name}' is no small model")


class DeviceModel(Protocol):
    """A stepper's numbers on a device, for steps of so many substeps.

    stepper: whose state it carries; weight_rows: of `weights`
    """

    @property
    def stepper(self) -> SkinStepper: ...
    @property
    def substeps(self) -> int: ...
    @property
    def weight_rows(self) -> int: ...

    def weights(self, first: Float, last: Float) -> Float:
        """Weights of the patterns as the launches take them, from those of SurfaceLoads, shape (s, m)."""
        ...

    def calls(self, memory: StepMemory) -> Calls:
        """Launches that do all substeps."""
        ...

    def outside(self, sums: Sequence[Any]) -> Outside | None:
        """What of the load lies outside the class that the stepper serves, from the launches' sums of squares, if it
        has one; sums: SECTIONS numbers, or arrays of one for each world."""
        ...


def check_step(
    stepper: SkinStepper,
    state: Float,
    loads: SurfaceLoads,
    points: int,
    t0: float,
    t1: float,
    any_length: bool = False,
) -> bool:
    """Raise SceneError for other shapes, and for substeps of another length unless that may be any.

    points: at which a layer takes pressure, q

    Returns whether the substeps have the stepper's own length.
    """
    worlds, substeps, patterns = loads.first.shape
    if state.shape != (worlds, stepper.state_size) or worlds == 0 or state.strides[1] != state.itemsize:
        raise SceneError(
            f"skin state {state.shape} under loads of {worlds} worlds: solver '{stepper.name}' takes a state of "
            f"({worlds or 'w'}, {stepper.state_size}), w >= 1, each world's numbers side by side"
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
            f"skin step from {t0:g} to {t1:g} s: loads for {substeps} substeps of {stepper.step_s:g} s are given"
        )
    return own


def world_by_world(
    stepper: SkinStepper, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None
) -> Float | None:
    """`SkinStepper.step` of several worlds, one after the other, for a stepper whose arrays are those of one."""
    seen = []
    for world in range(len(state)):
        one = slice(world, world + 1)
        own = SurfaceLoads(loads.pressure_Pa[one], loads.first[one], loads.last[one])
        seen.append(stepper.step(state[one], own, t0, t1, observe))
    return None if observe is None else np.concatenate([part for part in seen if part is not None])


def checked_operator(operator: sparse.csr_matrix, unknowns: int) -> sparse.csr_matrix:
    """The operator in float64. Raises SceneError unless it is (m, unknowns)."""
    if operator.ndim != 2 or operator.shape[1] != unknowns:
        raise SceneError(f"skin reader: the operator is {operator.shape}; the layer has {unknowns} unknowns")
    return sparse.csr_matrix(operator, dtype=np.float64)
