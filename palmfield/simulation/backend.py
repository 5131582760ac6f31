"""Interface of the backends. A backend computes the steps of worlds, on the host or on a device."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from itertools import repeat
from operator import is_not
from typing import NamedTuple

import numpy as np

from palmfield.device import resolve
from palmfield.drive.transducer_response import EmittedCourse
from palmfield.simulation.cached import Bool, Rows, Serials
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.state import HapticState
from palmfield.simulation.workspace import Workspace
from palmfield.stimulus.schedule import Moments
from palmfield.types import Complex, Float, Float32


class Frames(NamedTuple):
    """Poses of all worlds at the beginning of a step.

    places, axes: origins [m] and axes of the frames in the rows of PoseLayout, (worlds, rows, 3) and (worlds, rows, 9)
    posed: function that returns the PosedScenes of the selected worlds, (worlds,); only backends that need them call it
    """

    places: Float
    axes: Float
    posed: Callable[[Bool], Mapping[int, PosedScene]]


class StepTrace(NamedTuple):
    """One step of one world, or of several worlds whose loads have the same form. Valid until the next step.

    times: ends of the substeps [s], shape (s,); worlds: their numbers, ascending, shape (g,); posed: pose of each
    keys: serial numbers of pose and course, shape (g, 2), 0 for silence
    moments: times at which the load is computed [s], shape (m,)
    levels: levels of the drives at these moments, complex, shape (g, m, k), as in EmittedCourse
    course: function that returns the whole emission of the i-th world; begun: the same at the beginning, shape (N,)
    first, last: weights of the ARP patterns at the start and the end of each substep, shape (g, s, p)
    motion: for each skin and each of its steppers, the numbers of the worlds (w,) and the observed displacement [m] and
        velocity [m/s] after each substep, (w, s, 2, m). The same points are observed in all worlds
    """

    times: Float
    worlds: Rows
    posed: tuple[PosedScene, ...]
    keys: Serials
    moments: Moments
    levels: Complex
    course: Callable[[int], EmittedCourse]
    begun: Callable[[int], Complex]
    first: Float
    last: Float
    motion: tuple[tuple[tuple[Rows, Float | Float32], ...], ...] = ()


Observer = Callable[[StepTrace], None]


class Backend(ABC):
    """Computes steps of the worlds of a state. For each step, `Steps` calls its backends one after the other.

    A step begins with `place`, `emit`, `press` and `push`, in this order. Then `sense` is called for each sensor. When
    MuJoCo has moved its bodies, `step_skins` is called.

    own: worlds whose steps this backend may compute
    joined: numbers of the worlds whose present step this backend computes, ascending, shape (g,)
    stepped: number and state size of each skin whose whole step is computed when the step begins
    observer: function that receives the trace of each step of each group of worlds
    in_graph: whether a graph computes steps. Sensors of a graph must be set before the first step, and the graph keeps
        the ARP of bodies
    """

    in_graph = False

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState):
        self.models, self.works, self.state = models, works, state
        self.own = slice(0, len(models))
        self.observer: Observer | None = None
        self.joined: Rows = np.zeros(0, dtype=np.intp)
        self.stepped: list[tuple[int, int]] = []

    @property
    def watched(self) -> bool:
        """Return whether every substep is observed. Graphs cannot do this, as they return no single substeps."""
        return self.observer is not None or any(map(is_not, self.works[0].observe, repeat(None)))

    @abstractmethod
    def forget(self) -> None:
        """Drop the data of the last step. Call it after a reset and in a copy: other code has written the state."""

    @abstractmethod
    def fetch(self) -> None:
        """Copy newer numbers from the device into the state."""

    @abstractmethod
    def leave_out(self, world: int) -> None:
        """Mark a world whose emission will no longer come from its stimuli."""

    @abstractmethod
    def watch(self, skin: int, place: SensorPlace) -> None:
        """From the next step on, also compute the readings of a sensor at this place."""

    @abstractmethod
    def place(self, frames: Frames, free: Bool, t0: float) -> Rows:
        """Read the poses at the start t0 [s] of a step. Return the numbers of the worlds that it can step, ascending.

        free: the worlds that no other backend steps, shape (worlds,)
        """

    @abstractmethod
    def emit(self, t0: float) -> None:
        """Compute the emission of the transducers over the step, as far as forces and sensors need it.

        A device only starts to compute the step. The host can do other work until `press`.
        """

    @abstractmethod
    def press(self) -> Rows:
        """Compute the ARP for forces and sensors; return the numbers of the worlds in which it is valid."""

    @abstractmethod
    def push(self, forces: Sequence[Float]) -> None:
        """Write the forces on each body into the rows of the joined worlds.

        forces: by body the mean force over the step [N], and the torque about the origins of its parts [N m], world
            axes, shape (worlds, 2, b, 3)
        """

    @abstractmethod
    def sense(self, skin: int, place: SensorPlace, arp: Float, motion: Float) -> None:
        """Fill the rows of the joined worlds with the readings of a sensor at the beginning of the step.

        arp: [Pa], shape (worlds,); motion: displacement [m] and velocity [m/s], (worlds, 2)
        """

    @abstractmethod
    def step_skins(self, t0: float, t1: float, skins: bool) -> None:
        """Advance transducers and skins of the joined worlds from t0 to t1 [s], in place.

        skins: whether to step the skins; False leaves them unchanged
        Raises SceneError for a state of another solver, and if a reduced model selected by key `solver` has become
        invalid.
        """


def serves(model: HapticModel) -> bool:
    """Return whether a graph can compute the sound: on a GPU, without echo, boundary elements or 'accurate' fields."""
    fast = model.arrays.precision == "fast" and model.arrays.wall_m is None
    solved = any(skin.spec.config.body_sound == "scattering" for skin in model.skins)
    return resolve(model.spec.device) != "cpu" and fast and not solved
