"""One MuJoCo step of the sound and the skins: drive -> emitted -> field -> ARP -> skin load -> skin.

What a step keeps from one to the next (buffers, the last fields, loads computed ahead) lies in a Workspace, which
belongs to one state. Forces and sensors are read at the step's beginning, by `palmfield.simulation.forces` and
`palmfield.simulation.sensors`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.drive.transducer_response import EmittedCourse
from palmfield.simulation.device_sound import DeviceSound, SkinStart, pattern_weights, serves
from palmfield.simulation.emission import Emission
from palmfield.simulation.forces import BodyForces
from palmfield.simulation.model import HapticModel
from palmfield.simulation.path_sound import PathSound
from palmfield.simulation.posed_scene import PosedScene, reference_scene
from palmfield.simulation.prefetch import LoadPrefetch
from palmfield.simulation.radiation import Radiation, Role
from palmfield.simulation.small_models.leaving import (
    OutsideClass,
    continue_on_whole_layer,
    leaves_class,
    leaves_small_model,
    loudest_load,
)
from palmfield.simulation.state import WHOLE, HapticState, at_rest, claim, stepper_of
from palmfield.skin.stepper import Outside, Reader, SkinStepper, SurfaceLoads
from palmfield.stimulus.schedule import Moments
from palmfield.types import Complex, Float, Float32, Int


@dataclass(frozen=True)
class StepTrace:
    """What happened in a step, for those who watch. Arrays are valid until the next step.

    times: ends of the substeps [s], shape (s,); posed: where everything was
    course, moments: what was emitted at the moments of the load
    begun, emitted: what is emitted at the beginning and at the end, shape (N,)
    motion: of each skin what is watched of it, displacement [m] and velocity [m/s] after each substep, (s, 2, m)
    """

    times: Float
    posed: PosedScene
    moments: Moments
    course: EmittedCourse
    begun: Complex
    emitted: Complex
    motion: tuple[Float | None, ...]


class Workspace:
    """What one state's steps keep: emission, radiation, forces and prefetched loads, and who watches.

    unit_forces: of one drive, and of steps on the CPU; device_sound: what computes steps where the device is a GPU
    outside: of each skin what of its load has been outside the class that its modes serve
    served: the pose in which a skin's small model was last found to serve
    observe: what is watched of each skin, an operator (m, unknowns) or None; observer: told of each step
    """

    def __init__(self, model: HapticModel, beside: "Workspace | None" = None):
        """beside: of another world with the same bodies, stepped by the same thread: buffers are shared with it."""
        self.reference: PosedScene = reference_scene(model) if beside is None else beside.reference
        self.emission = Emission(model)
        self.radiation: Radiation = Radiation(model, None if beside is None else beside.radiation)
        self.device_sound = DeviceSound(model, self.reference) if serves(model) else None
        self.path_sound: PathSound = PathSound(
            model, self.radiation, self.reference, None if beside is None else beside.path_sound
        )
        self.unit_forces = BodyForces(model, self.radiation, self.path_sound)
        self.prefetch = LoadPrefetch(model, self.emission, self.radiation, self.path_sound)
        self.outside = [OutsideClass() for _ in model.skins]
        self.served: list[PosedScene | None] = [None] * len(model.skins)
        self.amplitudes: Complex = np.zeros(len(model.arrays), np.complex128)
        self.observe: tuple[sparse.csr_matrix | None, ...] = (None,) * len(model.skins)
        self.observer: Callable[[StepTrace], None] | None = None
        # Of the worlds beside as well: a reader of many vectors is as large as they are
        self._readers: dict[tuple[int, SkinStepper], tuple[sparse.csr_matrix, Reader]]
        self._readers = {} if beside is None else beside._readers

    def by_device(
        self, model: HapticModel, state: HapticState, posed: PosedScene, t0: float
    ) -> list[tuple[Float, Float]]:
        """Mean forces over the step that begins at t0 [s], as `palmfield.simulation.forces.BodyForces.over`.

        The device computes the step's load with them, and steps the skins over it where nobody watches all substeps.
        """
        device, skins = self.device_sound, {}
        assert device is not None
        for number, watched in enumerate(self.observe):
            # One that nothing has stepped yet may have no stepper: to look at forces doesn't make it
            if watched is None and (model.begin[number].made or not at_rest(state, number)):
                stepper, numbers = stepper_of(model, state, number)
                skins[number] = SkinStart(stepper, numbers[0])
        watched_by_any = self.observer is not None or any(operator is not None for operator in self.observe)
        return device.over(self.emission, posed, gather(state, self), t0, skins, watched_by_any)

    def begin_run(self) -> None:
        """Forget what was of another run."""
        self.prefetch.forget()
        self.served = [None] * len(self.served)
        self.outside = [OutsideClass() for _ in self.outside]

    def outside_share(self, model: HapticModel, skin: int, stepper: SkinStepper, seen: Outside) -> float:
        """What of a step's load on a skin lies outside the class of its modes, see OutsideClass.add."""
        outside = self.outside[skin]
        if outside.loudest is None:
            outside.loudest = loudest_load(model, skin, stepper, self.reference, self.radiation)
        return outside.add(seen)

    def reader(self, skin: int, stepper: SkinStepper) -> Reader | None:
        """Reads what is watched of a skin off this stepper's states; a run may leave a small model in any step."""
        operator = self.observe[skin]
        if operator is None:
            return None
        known = self._readers.get((skin, stepper))
        if known is None or known[0] is not operator:
            known = self._readers[skin, stepper] = operator, stepper.reader(operator)
        return known[1]


def step(model: HapticModel, state: HapticState, posed: PosedScene, t0: float, t1: float, work: Workspace) -> None:
    """Carry transducers and skins from t0 to t1 [s], one MuJoCo step, in place.

    Raises SceneError for a state of another solver and where a small model that is asked for can't go on.
    """
    begun = gather(state, work)
    if work.device_sound is None:
        work.prefetch.predict_drives(posed, begun, t0)
    device = work.device_sound
    known = None if device is None or work.observer is not None else device.course(posed, begun, t0)
    moments, course = known or work.emission.over(posed, begun, t0, model.substeps)
    motions = []
    for number in range(len(model.skins)):
        motions.append(_step_skin(model, state, number, posed, begun, moments, course, t0, t1, work))
    if model.response_on:
        scatter(state, course.end)
    if work.observer is not None:
        times = t0 + model.step_s * np.arange(1, model.substeps + 1, dtype=np.float64)
        work.observer(StepTrace(times, posed, moments, course, begun, course.end, tuple(motions)))


def step_sound(model: HapticModel, state: HapticState, posed: PosedScene, t0: float, work: Workspace) -> None:
    """Carry the transducers alone over the MuJoCo step from t0 [s] on, in place; skins stay as they are."""
    if model.response_on:
        _, course = work.emission.over(posed, gather(state, work), t0, model.substeps)
        scatter(state, course.end)


def _step_skin(
    model: HapticModel,
    state: HapticState,
    number: int,
    posed: PosedScene,
    begun: Complex,
    moments: Moments,
    course: EmittedCourse,
    t0: float,
    t1: float,
    work: Workspace,
) -> Float | None:
    """Carry a skin from t0 to t1 [s], in place; what is watched of it, (s, 2, m)."""
    emission, device = work.emission, work.device_sound
    stepper, numbers = stepper_of(model, state, number)
    if work.served[number] is not posed and state.skins[number][0, 0] != WHOLE:
        if leaves_small_model(model, state, number, posed, work.reference, emission, t0):
            stepper, numbers = continue_on_whole_layer(model, state, number, posed, emission, work.radiation, begun, t0)
        # One that serves only from the beginning of the sound on must be asked again, and so where points are held
        elif not emission.holds and stepper.any_course:
            work.served[number] = posed
    reader = None if work.observe[number] is None else work.reader(number, stepper)
    end = None
    if device is not None and reader is None:
        end = device.stepped(number, stepper, numbers[0], posed, moments, course)
    loads = skin_loads(work, posed, number, stepper.points, moments, course) if end is None else None
    if stepper.of_class:
        seen = end.outside if end is not None else None
        if seen is None:
            assert loads is not None
            seen = stepper.outside(loads)
        if leaves_class(model, number, work.outside_share(model, number, stepper, seen)):
            stepper, numbers = continue_on_whole_layer(model, state, number, posed, emission, work.radiation, begun, t0)
            reader = None if work.observe[number] is None else work.reader(number, stepper)
            end, loads = None, skin_loads(work, posed, number, stepper.points, moments, course)
    motion = None
    if end is not None:
        numbers[0] = end.numbers
    else:
        assert loads is not None
        motion = stepper.step(numbers, loads, t0, t1, reader)
    claim(model, state, number, stepper)
    return motion[0] if motion is not None else None


def skin_loads(
    work: Workspace, posed: PosedScene, skin: int, points: Int | None, moments: Moments, course: EmittedCourse
) -> SurfaceLoads:
    """The ARP over a step's substeps at a skin's quadrature points, or at some of them, by their numbers (p,)."""
    device = work.device_sound
    role: Role = "quadrature"
    if points is not None and device is None:
        work.radiation.choose(skin, points)
        role = "load"
    first, last = (moments.first, moments.last) if course.levels is None else pattern_weights(moments, course)
    if course.levels is not None and course.unit is None:
        count = len(posed.skins[skin].skin.layer.quadrature.points if points is None else points)
        pressures: Float | Float32 = np.zeros((1, count))
    elif device is not None:
        pressures = device.patterns(posed, skin, course, points)
    elif course.unit is not None:
        pressures = work.radiation.on(posed, skin, role, course.unit).arp[None]
    elif course.parts is not None:
        pressures = work.radiation.sums(posed, skin, *course.parts, role)
    else:
        assert course.emitted is not None
        pressures = work.prefetch.pressures(posed, skin, course.emitted, role)
    return SurfaceLoads(pressures[None], first[None], last[None])


def gather(state: HapticState, work: Workspace) -> Complex:
    """What all transducers emit, shape (N,), in the workspace's array."""
    start = 0
    for part in state.emitted:
        work.amplitudes[start : start + part.shape[1]] = part[0]
        start += part.shape[1]
    return work.amplitudes


def scatter(state: HapticState, amplitudes: Complex) -> None:
    """Write what all transducers emit, shape (N,), into the state."""
    start = 0
    for part in state.emitted:
        part[0] = amplitudes[start : start + part.shape[1]]
        start += part.shape[1]
