"""Stages of a step on the host, for all worlds that no graph steps.

Worlds in which the sound of a step is one number times one drive are computed together, the others one after the other.
Both use the same form of drives, forces and loads. Their keys for later steps are serial numbers of poses and drives.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import call
from typing import Any, NamedTuple, TypeVar

import numpy as np

from palmfield.device import resolve
from palmfield.drive.transducer_response import EmittedCourse, present_drive, rows
from palmfield.errors import naming_world
from palmfield.simulation.backend import Backend, Frames, StepTrace
from palmfield.simulation.cached import Bool, Cached, Rows, Serials
from palmfield.simulation.emission import MeanDrives
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.skin_sound import Role
from palmfield.simulation.small_models.leaving import (
    continue_on_whole_layer,
    leaves_class,
    leaves_small_model,
    loudest_load,
)
from palmfield.simulation.smooth_sound import SmoothSound
from palmfield.simulation.state import (
    BEGUN,
    HEADER,
    WHOLE,
    HapticState,
    check_arrays,
    claim,
    stepper_of,
    untouched,
)
from palmfield.simulation.workspace import Workspace
from palmfield.skin.stepper import DeviceStep, Outside, SkinStepper, SurfaceLoads
from palmfield.stimulus.schedule import Moments, substep_moments
from palmfield.types import Complex, Float, Float32

T = TypeVar("T")
ONE: Float = np.ones((1, 1, 1))
Loaded = list[tuple[SkinStepper, Rows, SurfaceLoads]]
"""Steppers of a skin, with the numbers of their worlds (w,) and the loads in these worlds."""
TOGETHER = 16
"""Largest number of steps in one pose that are computed together. More steps would not reduce the cost per step."""
MOST_STORED = 64
"""Largest number of cached assignments of worlds to steppers."""


class Sounding(NamedTuple):
    """One drive in each of some worlds, with a factor on its ARP.

    worlds: numbers of the worlds, ascending, shape (g,); keys: serial numbers of pose and drive, shape (g, 2)
    factors: factors on the ARP of the drive, (g,); unit: function that returns the drive of a world by number, (N,)
    """

    worlds: Rows
    keys: Serials
    factors: Float
    unit: Callable[[int], Complex]


class HostBackend(Backend):
    """Computes the stages for all worlds, or for those that no other backend steps.

    smooth: object that computes the worlds whose sound is one number times one drive
    """

    moves_smoothly = True
    """Whether `smooth` may include worlds whose pose changes in every step."""

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState, alone: bool):
        """models, works, state: as in `Steps`; alone: whether no other code writes the state"""
        super().__init__(models, works, state)
        worlds, first = len(models), models[0]
        able = [self.moves_smoothly or all(skin.settles for skin in model.skins) for model in models]
        self.smooth = SmoothSound(models, [work.emission for work in works], state, able, alone)
        self._several, self._device = worlds > 1, resolve(first.spec.device)
        self._after: Float = first.step_s * np.arange(1, TOGETHER * first.substeps + 1, dtype=np.float64)
        self._states = [state.world(world) for world in range(worlds)] if worlds > 1 else [state]
        ways: tuple[Callable[..., Any], ...] = call, self._named
        self._in = ways[self._several]
        self._force, self._reading = partial(self._in, self._unit_force), partial(self._in, self._probe)
        self._posed: list[PosedScene] = [work.reference for work in works]
        self._poses: Serials = np.zeros(worlds, np.int64)
        self._apart: list[int] = []
        self._emitted: dict[int, Complex] = {}  # by world of `_apart`, at the beginning of its step
        self._smooth_keys: Serials = np.zeros((0, 2), np.int64)
        # Means over the step: drives of a world with several; by body, its single drive or its ARP at the samples
        self._means: dict[int, MeanDrives] = {}
        self._singles: list[list[Sounding]] = [[] for _ in first.bodies]
        self._pressed: list[dict[int, Float]] = [{} for _ in first.bodies]
        # Drives at the start of the step, set when the first sensor is read
        self._present: list[Sounding] | None = None
        # For worlds with one drive: forces by body, load outside the class of modes, and stacks of patterns by skin
        self._cached = Cached(worlds)
        # Not shared with copies of the state: ARP by sensor for worlds with one drive, and steppers on a device
        self._own = Cached(worlds)
        # Last pose in which the reduced model was valid, by skin and world
        self._served: Serials = np.zeros((len(first.skins), worlds), np.int64)
        # Whether the first stepper of a skin is valid for any pose and course; None before anything has moved
        self._anywhere: list[bool | None] = [None] * len(first.skins)
        self._shared_out: dict[tuple[int, bytes, bytes], list[tuple[SkinStepper, Rows]]] = {}

    def forget(self) -> None:
        self._served[:] = 0
        self.smooth.forget()

    def fetch(self) -> None:
        self.smooth.fetch()

    def leave_out(self, world: int) -> None:
        self.smooth.leave_out(world)

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Do nothing, because the host computes a reading only when it is read."""

    def adopt(self, other: "HostBackend") -> None:
        """Continue from another HostBackend, whose state has been copied, in the same PosedScenes."""
        self.smooth.adopt(other.smooth)
        self._posed, self._poses, self._served = list(other._posed), other._poses.copy(), other._served.copy()
        self._cached.adopt(other._cached)

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def place(self, frames: Frames, free: Bool, t0: float) -> Rows:
        posed = frames.posed(free)
        self._begin(posed)
        self._apart = self.smooth.begin(posed, t0)
        for world in self._apart:
            emission = self.works[world].emission
            if emission.holds or emission.coming:
                self._in(self._hold_world, world, t0)
        if not self._apart:
            return self.smooth.joined
        apart = np.array(self._apart, np.intp)
        return np.sort(np.concatenate([self.smooth.joined, apart])) if self._several else apart

    def _begin(self, posed: Mapping[int, PosedScene]) -> None:
        """Store the poses of some worlds, and drop the sound of the last step."""
        for world, now in posed.items():
            self._posed[world], self._poses[world] = now, now.serial
        self._present = None
        self._means.clear()
        for singles, pressed in zip(self._singles, self._pressed, strict=True):
            singles.clear()
            pressed.clear()

    def hold(self, posed: PosedScene, t0: float) -> None:
        """Use one pose of the only world for several steps from t0 [s] on."""
        self._posed[0], self._poses[0], self._apart = posed, posed.serial, [0]
        self.smooth.forget()
        self.smooth.joined = self.smooth.joined[:0]
        self._hold_world(0, t0)
        self.works[0].look_ahead(posed)
        self._emitted[0] = self.state.emission()[0]

    def _hold_world(self, world: int, t0: float) -> None:
        """Update foci whose control tick is due. After a reset, drop old foci and steps computed ahead."""
        emission = self.works[world].emission
        if untouched(self._states[world]):
            emission.forget()
        if emission.holds:
            emission.begin(self._posed[world], t0)

    def emit(self, t0: float) -> None:
        self._begun_s = t0
        joined = self.smooth.joined
        if len(joined):
            # Serial numbers of poses and unit drives
            self._smooth_keys = np.array([self._poses[joined], self.smooth.serials[joined]]).T
            mean = self._loud(self.smooth.mean_factors())
            for singles in self._singles:
                singles.append(mean)
        for world in self._apart:
            self._in(self._emit_one, world, t0)

    def _loud(self, factors: Float) -> Sounding:
        """Return the worlds of `smooth` with sound. factors: factors on the ARP of their unit drives, shape (g,)"""
        loud = factors > 0.0
        return Sounding(self.smooth.joined[loud], self._smooth_keys[loud], factors[loud], self.smooth.unit)

    def _emit_one(self, world: int, t0: float) -> None:
        """Compute the mean drives of a world that is stepped separately."""
        work, posed = self.works[world], self._posed[world]
        work.look_ahead(posed)
        emitted = self._emitted[world] = self._states[world].emission()[0]
        mean = work.emission.mean_drives(posed, emitted, t0)
        if len(mean.weights):
            self._means[world] = mean

    def press(self) -> Rows:
        for world, mean in self._means.items():
            self._in(self._press_one, world, mean)
        return self.joined

    def _press_one(self, world: int, mean: MeanDrives) -> None:
        """Compute the mean ARP of a world at the samples of each body. For a single drive, `push` does this."""
        work, posed = self.works[world], self._posed[world]
        for body, pressed in enumerate(self._pressed):
            skin, arp = self.models[0].first_skins[body], None
            if work.path_sound is not None:
                arp = work.path_sound.arp(posed, skin, "samples", mean.levels @ mean.units)
            if arp is None and len(mean.weights) > 1:
                arp = work.radiation.sums(posed, skin, mean.units, mean.levels, "samples")
            if arp is not None:
                pressed[world] = np.asarray(mean.weights @ arp, np.float64)
            else:
                self._singles[body].append(self._single(world, mean.weights, mean.units[0], mean.serial))

    def _single(self, world: int, factors: Float, drive: Complex, serial: int) -> Sounding:
        """Return the Sounding for one drive in one world."""
        keys = np.array([[self._poses[world], serial]])
        return Sounding(np.array([world]), keys, factors, {world: drive}.__getitem__)

    def push(self, forces: Sequence[Float]) -> None:
        for body, own in enumerate(forces):
            own[self.joined] = 0.0
            for one in self._singles[body]:
                made = self._cached.rows(body, own.shape[1:], one.worlds, one.keys, self._force, body, one)
                own[one.worlds] = one.factors[:, None, None, None] * made
            for world, arp in self._pressed[body].items():
                own[world] = self.works[world].radiation.force(self._posed[world], body, arp)

    def _unit_force(self, world: int, body: int, one: Sounding) -> Float:
        """Return the force of the drive of a world on a body, world axes, shape (2, b, 3)."""
        arp = self._unit_arp(world, body, one)
        return self.works[world].radiation.force(self._posed[world], body, arp)

    def _unit_arp(self, world: int, body: int, one: Sounding) -> Float32:
        """Return the ARP of the drive of a world at the samples of a body [Pa], shape (n,)."""
        radiation, serial = self.works[world].radiation, int(one.keys[one.worlds.searchsorted(world), 1])
        skin = self.models[0].first_skins[body]
        return radiation.on(self._posed[world], skin, "samples", one.unit(world), serial).arp

    def pressed(self, world: int, body: int) -> Float | None:
        """Return the mean ARP [Pa] at the samples of a body in the present step, shape (n,); None in silence."""
        for one in self._singles[body]:
            for factor in one.factors[one.worlds == world].tolist():
                return np.asarray(factor * self._unit_arp(world, body, one).astype(np.float64))
        return self._pressed[body].get(world)

    def sense(self, skin: int, place: SensorPlace, arp: Float, motion: Float) -> None:
        self._read_arp(skin, place, arp)
        part, here = self.state.skins[skin], self.joined
        begun = here[part[here, 0] != 0.0]
        if self._several or not len(begun):
            steppers = self.steppers(skin, begun)
        else:
            steppers = [(stepper_of(self.models[0], self.state, skin)[0], begun)]
        for stepper, own in steppers:
            read = stepper.read(part[own, HEADER : HEADER + stepper.state_size], place.reader(stepper))
            motion[own] = read[..., 0]

    def _read_arp(self, skin: int, place: SensorPlace, arp: Float) -> None:
        """Fill the rows of the joined worlds with the ARP at a sensor [Pa], shape (worlds,)."""
        if self._present is None:
            self._present = [self._loud(self.smooth.present_factors())] if len(self.smooth.joined) else []
            for world in self._apart:
                self._present += self._in(self._sounds_now, world)
        for one in self._present:
            made = self._own.rows(place, (), one.worlds, one.keys, self._reading, skin, place, one)
            arp[one.worlds] = one.factors * made

    def _sounds_now(self, world: int) -> list[Sounding]:
        """Return the drives at the start of the step, in a world that is stepped separately; empty in silence."""
        work, posed = self.works[world], self._posed[world]
        course = work.emission.now(posed, self._emitted[world], self._begun_s)
        drive, factor = present_drive(course)
        return [] if drive is None else [self._single(world, np.array([factor]), drive, course.serial)]

    def _probe(self, world: int, skin: int, place: SensorPlace, one: Sounding) -> float:
        """Return the ARP at a sensor [Pa] that the drive of a world causes."""
        posed = self._posed[world]
        body = posed.bodies[self.models[0].skins[skin].body]
        points, normals = body.moved(place.probe.closest, place.probe.normals, place.binding)
        radiation = self.works[world].radiation
        return float(radiation.at(posed, skin, "probe", points, normals, one.unit(world)).arp[0])

    # -- its end -------------------------------------------------------------------------------------------------------

    def step_skins(self, t0: float, t1: float, skins: bool) -> None:
        joined = self.smooth.joined
        new = joined[self.state.arrays[0][joined, 0] != BEGUN] if self._several else joined
        for world in [*new.tolist(), *self._apart]:
            self._in(self._check, world)
        if len(joined):
            self._step_smooth(t0, t1, skins)
        for world in self._apart:
            self._in(self._step_one, world, t0, t1, skins)

    def _check(self, world: int) -> None:
        """Start a run if the state has no writer. Raises SceneError for the state of another model."""
        if check_arrays(self.models[world], self._states[world]):
            self.works[world].begin_run()
            self._served[:, world] = 0

    def _step_smooth(self, t0: float, t1: float, skins: bool) -> None:
        """Run `step_skins` in the worlds of `smooth`."""
        model, smooth = self.models[0], self.smooth
        worlds, moments = smooth.joined, substep_moments((), t0, model.step_s, model.substeps)
        levels, end = smooth.over(moments)
        if skins:
            factors = levels.real**2 + levels.imag**2
            keys = self._smooth_keys.copy()
            keys[:, 1] *= np.logical_or.reduce(factors, axis=1)
            begun = smooth.now[worlds]
            trace = StepTrace(
                t0 + self._after[: model.substeps],
                worlds,
                tuple(map(self._posed.__getitem__, worlds.tolist())),
                keys,
                moments,
                levels[..., None],
                lambda i: smooth.course(int(worlds[i]), levels[i], end[i]),
                lambda i: begun[i] * smooth.unit(int(worlds[i])),
                (factors @ moments.first.T)[..., None],
                (factors @ moments.last.T)[..., None],
            )
            self._step_all(trace, t0, t1)
        smooth.advance(end)

    def _step_one(self, world: int, t0: float, t1: float, skins: bool) -> None:
        """Run `step_skins` in a world that is stepped separately."""
        model, posed, state = self.models[world], self._posed[world], self._states[world]
        begun = self._emitted[world]
        count = round((t1 - t0) / model.step_s)
        moments, course = self._course(world, begun, t0, count)
        if skins:
            first, last = course.weights(moments)
            keys, times = np.array([[posed.serial, course.serial]]), t0 + self._after[:count]
            emission = moments, course.levels[None], lambda _: course, lambda _: begun
            trace = StepTrace(times, np.array([world]), (posed,), keys, *emission, first[None], last[None])
            self._step_all(trace, t0, t1)
        if model.response_on:
            state.set_emission(slice(None), course.end[None])

    def _course(self, world: int, begun: Complex, t0: float, count: int) -> tuple[Moments, EmittedCourse]:
        """Return the emission of a world that is stepped separately. begun: emission at t0 [s], shape (N,)"""
        return self.works[world].emission.over(self._posed[world], begun, t0, count)

    def _step_all(self, group: StepTrace, t0: float, t1: float) -> None:
        """Step all skins of some worlds in place, and pass the observed motion to the observer."""
        motion = []
        for skin in range(len(self.models[0].skins)):
            if not self._anywhere[skin]:
                self._leave_small_models(group, skin, t0)
            loaded = self._loads(group, skin)
            if self._leave_class(group, skin, loaded, t0):
                loaded = self._loads(group, skin)
            watched = []
            for stepper, own, loads in loaded:
                observed = self._step(skin, stepper, own, loads, (t0, t1))
                if observed is not None:
                    watched.append((own, observed))
            motion.append(tuple(watched))
        if self.observer is not None:
            self.observer(group._replace(motion=tuple(motion)))

    def _leave_small_models(self, group: StepTrace, skin: int, t0: float) -> None:
        """Replace reduced models by the full layer in worlds in which something has moved."""
        worlds, served = group.worlds, self._served[skin]
        moved = (served[worlds] != self._poses[worlds]) & (self.state.skins[skin][worlds, 0] != WHOLE)
        if not np.logical_or.reduce(moved):
            return
        if self._anywhere[skin] is None:
            steppers = [model.begin[skin].value for model in self.models]
            self._anywhere[skin] = all(one.any_pose and one.any_course for one in steppers)
        for i in moved.nonzero()[0].tolist():
            world = int(worlds[i])
            if self._in(self._leaves, world, skin, t0):
                self._continue_whole(group, i, skin, t0)
            # Check again if the model is valid only from the start of the sound, or if
            # points are held
            elif not self.works[world].emission.holds and self.models[world].begin[skin].value.any_course:
                served[world] = self._poses[world]

    def _leaves(self, world: int, skin: int, t0: float) -> bool:
        """Return whether the reduced model of a skin has become invalid."""
        work, state = self.works[world], self._states[world]
        return leaves_small_model(
            self.models[world], state, skin, self._posed[world], work.reference, work.emission, t0
        )

    def _continue_whole(self, group: StepTrace, i: int, skin: int, t0: float) -> None:
        """Continue with the full layer, from the present motion of a skin in the i-th world."""
        world = int(group.worlds[i])
        work, state = self.works[world], self._states[world]
        continue_on_whole_layer(
            self.models[world], state, skin, self._posed[world], work.emission, work.radiation, group.begun(i), t0
        )

    def _leave_class(self, group: StepTrace, skin: int, loaded: Loaded, t0: float) -> bool:
        """Measure the part of the loads outside the class of the modes of a skin; if large, the full layer takes over.

        Returns whether this happened in any world.
        """
        left = False
        for stepper, own, loads in loaded:
            if not stepper.of_class:
                continue
            at = group.worlds.searchsorted(own)
            for i, load in zip(at.tolist(), self._outside(skin, stepper, own, group.keys[at], loads), strict=True):
                world = int(group.worlds[i])
                model, outside = self.models[world], self.works[world].outside[skin]
                if outside.loudest is None:
                    work = self.works[world]
                    outside.loudest = loudest_load(model, skin, stepper, work.reference, work.radiation)
                if leaves_class(model, skin, outside.add(load)):
                    self._continue_whole(group, i, skin, t0)
                    left = True
        return left

    def _outside(
        self, skin: int, stepper: SkinStepper, worlds: Rows, keys: Serials, loads: SurfaceLoads
    ) -> list[Outside]:
        """Return the part of the loads on a skin outside the class of its modes. keys: as in StepTrace, (w, 2)"""
        if not loads.fixed or not self._several:
            return [stepper.outside(loads)]
        squares = np.add.reduce(stepper.mixed(loads) ** 2, axis=(1, 2))

        def of_unit(world: int) -> Float:
            i = worlds.searchsorted(world)
            return np.array(stepper.outside(SurfaceLoads(loads.pressure_Pa[i : i + 1], ONE, ONE)))

        units = self._cached.rows(("outside", skin), (len(Outside._fields),), worlds, keys, of_unit)
        return [Outside(*row) for row in (squares[:, None] * units).tolist()]

    def _step(
        self, skin: int, stepper: SkinStepper, worlds: Rows, loads: SurfaceLoads, times: tuple[float, float]
    ) -> Float | Float32 | None:
        """Step a skin in some worlds by one stepper. The points observed in the first world are observed in all."""
        part, numbers = self.state.skins[skin], slice(HEADER, HEADER + stepper.state_size)
        self._claim(skin, stepper, worlds)
        together = self._several and int(worlds[0]) not in self._apart
        step = (self._on_device(skin, stepper) if together else None) or stepper.step
        work = self.works[worlds[0]]
        reader = None if work.observe[skin] is None else work.reader(skin, stepper)
        if len(worlds) == len(part):
            return step(part[:, numbers], loads, *times, reader)
        states = part[worlds, numbers]
        observed = step(states, loads, *times, reader)
        part[worlds, numbers] = states
        return observed

    def _claim(self, skin: int, stepper: SkinStepper, worlds: Rows) -> None:
        """Write a stepper's mark into the states of a skin. Raises an error for a moving state without a writer."""
        part = self.state.skins[skin]
        for world in worlds.tolist() if not self._several else worlds[part[worlds, 0] == 0.0].tolist():
            claim(self.models[world], self._states[world], skin, stepper)

    def _loads(self, group: StepTrace, skin: int) -> Loaded:
        """Return the steppers of a skin with their worlds and loads. Patterns stay one array while pose and drive do.

        If the load is one pattern, steppers may cache results that they compute from it.
        """
        loaded = []
        for stepper, own in self.steppers(skin, group.worlds):
            at = group.worlds.searchsorted(own)
            key = own.tobytes() + group.keys[at].tobytes()
            pressure = self._cached.of((skin, stepper), key, self._stacked, group, skin, stepper, at)
            loads = SurfaceLoads(pressure, group.first[at], group.last[at], group.first.shape[2] == 1)
            loaded.append((stepper, own, loads))
        return loaded

    def _stacked(self, group: StepTrace, skin: int, stepper: SkinStepper, at: Rows) -> Float32:
        """Return ARP patterns in some worlds [Pa], shape (w, p, n). Equal poses and drives are computed once.

        at: indices of the worlds in the group
        """
        made: dict[bytes, Float32] = {}
        patterns = []
        for i in at.tolist():
            own = group.keys[i].tobytes()
            if own not in made:
                made[own] = self._patterns(int(group.worlds[i]), skin, stepper, group.course(i))
            patterns.append(made[own])
        if len(patterns) == 1:
            return patterns[0][None]
        if len(made) == 1:  # one array for all worlds
            return np.broadcast_to(patterns[0], (len(patterns), *patterns[0].shape))
        return np.stack(patterns)

    def _patterns(self, world: int, skin: int, stepper: SkinStepper, course: EmittedCourse) -> Float32:
        """Return the ARP patterns [Pa] to which the `weights` of a course apply, at a stepper's points, (p, n)."""
        work, posed = self.works[world], self._posed[world]
        path = work.path_sound
        role: Role = "quadrature" if stepper.points is None else "load"
        if stepper.points is not None:
            work.radiation.choose(skin, stepper.points)
        if path is not None and len(course.units) > 1:
            on_path = path.arp(posed, skin, role, rows(course))
            path.off = 0 if on_path is not None else path.off + 1
            if on_path is not None:
                return on_path
        return work.radiation.patterns(posed, skin, role, course)

    def steppers(self, skin: int, worlds: Rows) -> list[tuple[SkinStepper, Rows]]:
        """Return the steppers of a skin, each with those of `worlds` that it steps."""
        whole = self.state.skins[skin][worlds, 0] == WHOLE
        key = skin, worlds.tobytes(), whole.tobytes()
        cached = self._shared_out.get(key)
        if cached is not None:
            return cached
        steppers: dict[int, tuple[SkinStepper, list[int]]] = {}
        for world, left in zip(worlds.tolist(), whole.tolist(), strict=True):
            model = self.models[world]
            stepper: SkinStepper = (model.whole if left else model.begin)[skin].value
            steppers.setdefault(id(stepper), (stepper, []))[1].append(world)
        if len(self._shared_out) >= MOST_STORED:
            self._shared_out.clear()
        found = self._shared_out[key] = [(one, np.array(own, dtype=np.intp)) for one, own in steppers.values()]
        return found

    def _on_device(self, skin: int, stepper: SkinStepper) -> DeviceStep | None:
        """Return the GPU version of a stepper of a skin, cached. None without a GPU or without such a version."""
        return self._own.of((skin, stepper), (), stepper.device_worlds, len(self.models), self._device)

    def _named(self, function: Callable[..., T], world: int, *arguments: Any) -> T:
        """Return the result of a function for one of several worlds. Its errors name the world."""
        with naming_world(world):
            return function(world, *arguments)
