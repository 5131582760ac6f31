"""One MuJoCo step of sound and skins, in one or more worlds: pose -> drive -> field -> ARP -> load -> skin.

`Steps.begin` reads the poses at the start of a step and computes its forces. `sense` computes sensor readings.
`advance` steps transducers and skins. Backends do the computing, see `backends_of`.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.simulation.backend import Backend, Frames, Observer, serves
from palmfield.simulation.cached import Bool
from palmfield.simulation.emission import Emission
from palmfield.simulation.host_backend import TOGETHER, HostBackend
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.state import HEADER, HapticState
from palmfield.simulation.workspace import Workspace
from palmfield.types import Complex, Float

PARTS, LEAST_WORLDS = 2, 128
"""Largest number of graphs that share the worlds, and number of worlds for each additional graph.

Measured with 1,024 worlds on an H100 and 16 cores, for 1, 2, 3 and 4 graphs: hover_explore 25, 19, 17.5 and 17 us per
world, follow_fingertip 21, 15, 18 and 18 us.
"""


def backends_of(
    models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState, alone: bool
) -> tuple[Sequence[Backend], HostBackend]:
    """Return the backends in the order of calling, and the host backend, which steps all remaining worlds."""
    if not serves(models[0]):
        return (), HostBackend(models, works, state, alone)
    # The kernels of graphs are not loaded for scenes that have none
    from palmfield.simulation.moving_worlds import MovingWorlds
    from palmfield.simulation.scene_graph import SceneGraph

    # Several graphs: the device computes one while MuJoCo moves the bodies of another
    bounds = np.linspace(0, len(models), 1 + min(PARTS, 1 + len(models) // LEAST_WORLDS)).round().astype(int).tolist()
    moving = []
    for begin, end in pairwise(bounds):
        own, room_for = slice(begin, end), 0 if begin else len(models)
        moving.append(MovingWorlds(models[own], works[own], state.of(own), alone, begin, room_for))
    others: Sequence[Backend] = moving if any(part.some for part in moving) else ()
    # The graphs read and write the state too
    host = (SceneGraph if len(models) == 1 else HostBackend)(models, works, state, alone and not others)
    if not others and not alone and len(models) == 1:
        from palmfield.simulation.still_steps import StillSteps

        others = (StillSteps(models, works, state),)
    return others, host


class Steps:
    """The steps of the worlds of a state, one after the other. It belongs to one state and to one thread at a time.

    models, works: one for each world; state: state of all worlds
    host: backend that steps the worlds that no other backend steps
    forces: for each body the mean force on its parts over the present step [N], and the torque about their origins [N
        m], world axes, shape (worlds, 2, b, 3)
    inputs: parts of the state from which `begin` computed the present step; if they change, the step is invalid
    """

    def __init__(
        self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState, alone: bool = False
    ):
        """models, works, state: as in `Steps`; alone: whether no other code writes the state"""
        self.models, self.works, self.state = models, works, state
        others, self.host = backends_of(models, works, state, alone)
        self.backends: tuple[Backend, ...] = (*others, self.host)
        self.forces: list[Float] = [np.zeros((len(models), 2, body.parts, 3)) for body in models[0].bodies]
        self.inputs: list[Complex | Float] = []
        if models[0].rates:
            self.observer = None
        self._free: Bool = np.ones(len(models), dtype=bool)  # worlds that no backend has taken so far

    @property
    def observer(self) -> Observer | None:
        """Return the function that receives the trace of each step of each group of worlds."""
        return self.host.observer

    @observer.setter
    def observer(self, observer: Observer | None) -> None:
        if self.models[0].rates:
            from palmfield.simulation.counting import counting

            observer = counting(self.models[0], self.works, self.state, self.host.steppers, observer)
        for backend in self.backends:
            backend.observer = observer

    @property
    def in_graph(self) -> bool:
        """Whether a graph computes steps, see Backend."""
        return any(backend.in_graph for backend in self.backends)

    @property
    def together(self) -> int:
        """Return the largest number of steps in one pose that `over` can compute together.

        It is 1 if foci stay fixed between control ticks, or if skins use modes: their load is measured in every step.
        """
        model = self.models[0]
        free = not self.works[0].emission.holds and not any(one.value.of_class for one in model.begin)
        return TOGETHER if free else 1

    def forget(self) -> None:
        """Start again, after a reset."""
        for backend in self.backends:
            backend.forget()

    def adopt(self, other: "Steps") -> None:
        """Continue from another Steps object, whose state has been copied, in the same PosedScenes."""
        for work, origin in zip(self.works, other.works, strict=True):
            work.adopt(origin)
        self.host.adopt(other.host)
        self.forces = [force.copy() for force in other.forces]

    def fetch(self) -> None:
        """Copy the state from the device, if the device has a newer one."""
        for backend in self.backends:
            backend.fetch()

    def play(self, emissions: Mapping[int, Emission]) -> None:
        """Use other emissions than those of the stimuli in some worlds. emissions: by number of the world"""
        for world, emission in emissions.items():
            self.works[world].emission = emission
            for backend in self.backends:
                backend.leave_out(world)

    def watch(self, skin: int, place: SensorPlace) -> None:
        """From the first step on, compute the readings of a sensor at this place at the start of each step."""
        for backend in self.backends:
            backend.watch(skin, place)

    def begin(self, frames: Frames, t0: float) -> None:
        """Store the poses of all worlds at the beginning t0 [s] of a step, and compute the forces over the step."""
        graphs = range(len(self.backends) - 1)
        for number in graphs:
            self.start(number, frames, t0)
        for number in graphs:
            self.ready(number)
        self.rest(frames, t0)
        inputs: list[Complex | Float] = [*self.state.emitted]
        for backend in self.backends:
            for skin, size in backend.stepped:
                inputs.append(self.state.skins[skin][:, : HEADER + size])
        self.inputs = inputs

    def start(self, number: int, frames: Frames, t0: float) -> None:
        """Begin a step in one backend, which is not the host. number: its number; call them in ascending order

        This is the first part of `begin`. A device may still compute after this call returns.
        """
        if number == 0:
            self._free[:] = True
        backend = self.backends[number]
        backend.joined = backend.place(frames, self._free, t0)
        if len(backend.joined):
            backend.emit(t0)
            self._free[backend.joined] = False

    def ready(self, number: int) -> bool:
        """Wait for the forces of a backend that has started. Return whether it steps all its worlds."""
        backend = self.backends[number]
        if len(backend.joined):
            self._free[backend.joined] = True
            backend.joined = backend.press()
            backend.push(self.forces)
            self._free[backend.joined] = False
        return len(backend.joined) == len(self._free[backend.own])

    def rest(self, frames: Frames, t0: float) -> None:
        """Compute on the host the forces in all other worlds. This is the last part of `begin`."""
        host = self.host
        if not np.logical_or.reduce(self._free):
            host.joined, host.stepped = host.joined[:0], []
            return
        with one_blas_thread:
            host.joined = host.place(frames, self._free, t0)
            if len(host.joined):
                host.emit(t0)
                host.joined = host.press()
                host.push(self.forces)

    def sense(self, skin: int, place: SensorPlace) -> tuple[Float, Float]:
        """Return the readings of a sensor at the beginning of the step.

        These are the ARP [Pa], shape (worlds,), and displacement [m] and velocity [m/s], shape (worlds, 2).
        """
        count = len(self.models)
        arp, motion = np.zeros(count), np.zeros((count, 2))
        for backend in self.backends:
            if len(backend.joined):
                backend.sense(skin, place, arp, motion)
        return arp, motion

    def advance(self, t0: float, t1: float, skins: bool = True) -> None:
        """Advance transducers and skins of all worlds from t0 to t1 [s]; see `Backend.step_skins`."""
        with one_blas_thread:
            for backend in self.backends:
                if len(backend.joined):
                    backend.step_skins(t0, t1, skins)

    def over(self, posed: PosedScene, t0: float, steps: int, skins: bool = True) -> None:
        """Step the only world several times from t0 [s] on, in one pose, without forces and sensors in between."""
        self.host.hold(posed, t0)
        with one_blas_thread:
            self.host.step_skins(t0, t0 + steps * self.models[0].spec.timestep_s, skins)
