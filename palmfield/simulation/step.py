"""One MuJoCo step of the sound and the skins in one world or several: pose -> drive -> field -> ARP -> load -> skin.

`Steps.begin` takes the poses where a step begins and computes the forces over it, `sense` what sensors read there,
and `advance` carries transducers and skins over it. Worlds whose sound one number determines are computed together.
Data that a step hands to the next are stored under serial numbers of poses and drives.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from operator import call, is_not, methodcaller
from typing import Any, NamedTuple, TypeVar

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.device import resolve
from palmfield.drive.transducer_response import EmittedCourse, present_drive
from palmfield.errors import naming_world
from palmfield.simulation.backend import Backend, WorldsBackend, serves
from palmfield.simulation.emission import Emission
from palmfield.simulation.kept import Bool, Kept, Rows, Serials
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.small_models.leaving import (
    continue_on_whole_layer,
    leaves_class,
    leaves_small_model,
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
from palmfield.simulation.workspace import Workspace, gather, scatter
from palmfield.skin.stepper import DeviceStep, Outside, SkinStepper, SurfaceLoads
from palmfield.stimulus.schedule import Moments, substep_moments
from palmfield.types import Complex, Float, Float32

T = TypeVar("T")
ONE: Float = np.ones((1, 1, 1))
TOGETHER = 16
"""Steps in one pose that are taken in one go: more cost as much each."""
KEPT = 64
"""Ways in which worlds were shared out among steppers."""


@dataclass(frozen=True)
class StepTrace:
    """The results of a step, in one world or in several with equal courses. Valid until the next step.

    times: ends of the substeps [s], shape (s,). worlds: their numbers, shape (g,). posed: the pose of each.
    moments: of the load. levels: of the drives then, complex, shape (g, m, k), as of EmittedCourse.
    course: gives the whole emission of the i-th of the worlds.
    begun: gives the emission of the i-th at the beginning, shape (N,).
    motion: of each skin by stepper, numbers of the worlds (w,) and the watched displacement [m] and velocity [m/s]
        after each substep, (w, s, 2, m); all worlds watch the same points.
    """

    times: Float
    worlds: Rows
    posed: tuple[PosedScene, ...]
    moments: Moments
    levels: Complex
    course: Callable[[int], EmittedCourse]
    begun: Callable[[int], Complex]
    motion: tuple[tuple[tuple[Rows, Float | Float32], ...], ...]


class _Group(NamedTuple):
    """Worlds whose loads have the same form over a step.

    worlds: their numbers, shape (g,); keys: serial numbers of pose and course, shape (g, 2), 0 for silence
    levels, course, begun: as of StepTrace; first, last: shares of the patterns at the ends of the substeps, (g, s, p)
    """

    worlds: Rows
    keys: Serials
    moments: Moments
    levels: Complex
    course: Callable[[int], EmittedCourse]
    begun: Callable[[int], Complex]
    first: Float
    last: Float


class Steps:
    """The steps of the worlds of a state, in sequence. Belongs to one state and is used by one thread at a time.

    models, works: of each world. state: of all. observer: gets the trace of each step of each group of worlds.
    forces: by body, mean force on its parts over the step that has begun [N], and torques about their origins [N m],
        world axes, shape (worlds, 2, b, 3).
    """

    def __init__(
        self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState, alone: bool = False
    ):
        """alone: whether no other code writes the state"""
        self.models, self.works, self.state = models, works, state
        worlds, first = len(models), models[0]
        graphs = serves(first)
        # In a graph a pose that is new every step costs less
        able = [worlds > 1 or not graphs or all(skin.settles for skin in model.skins) for model in models]
        self.smooth = SmoothSound(models, [work.emission for work in works], state, able, alone)
        self.forces: list[Float] = [np.zeros((worlds, 2, body.parts, 3)) for body in first.bodies]
        self.observer: Callable[[StepTrace], None] | None = None
        self.moving, self.backend = WorldsBackend(), Backend()
        if graphs:
            # The kernels of graphs are not loaded for scenes that have none
            from palmfield.simulation.moving_worlds import MovingWorlds
            from palmfield.simulation.scene_graph import SceneGraph

            self.moving = MovingWorlds(models, works, state, alone)
            if worlds == 1:
                self.backend = SceneGraph(first, works[0], state)
        self._several, self._device = worlds > 1, resolve(first.spec.device)
        self._states = [state.world(world) for world in range(worlds)] if worlds > 1 else [state]
        self._in: Callable[..., Any] = self._named if worlds > 1 else call
        self._posed: list[PosedScene] = [work.reference for work in works]
        self._poses: Serials = np.zeros(worlds, np.int64)
        self._apart: list[int] = []
        self._joined_keys: Serials = np.zeros((0, 2), np.int64)
        # Of the unit drives: forces by body, and what lies outside the modes' class by skin
        self._kept = Kept(worlds)
        # ARP of the unit drives by sensor, and what steps skins on a device: a copy of the state has its own of both
        self._own = Kept(worlds)
        self._stacks: dict[tuple[int, SkinStepper], tuple[bytes, Float32]] = {}
        # What pushed bodies last: ARP at the samples by world and body, or one drive by world, its share and number
        self._pressed: dict[tuple[int, int], Float] = {}
        self._means: dict[int, tuple[Complex, float, int]] = {}
        # The pose in which a small model was last found to serve, by skin and world
        self._served: Serials = np.zeros((len(first.skins), worlds), np.int64)
        # Whether the first stepper of a skin is valid in any pose and course
        self._anywhere = [False] * len(first.skins)
        self._shared_out: dict[tuple[int, bytes, bytes], list[tuple[SkinStepper, Rows]]] = {}

    def forget(self) -> None:
        """Begin again, after a reset."""
        self._served[:] = 0
        self.smooth.forget()
        self.moving.forget()
        self.backend.forget()

    def adopt(self, other: "Steps") -> None:
        """Continue from another one, in a copy of its state in the same PosedScenes."""
        for work, origin in zip(self.works, other.works, strict=True):
            work.adopt(origin)
        self.smooth.adopt(other.smooth)
        self._posed, self._poses, self._served = list(other._posed), other._poses.copy(), other._served.copy()
        self.forces = [force.copy() for force in other.forces]
        self._kept.adopt(other._kept)
        self._stacks = dict(other._stacks)

    def play(self, emissions: Mapping[int, Emission]) -> None:
        """Let other sound take the place of that of some worlds' stimuli."""
        for world, emission in emissions.items():
            self.works[world].emission = emission
            self.smooth.leave_out(world)

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Let a graph compute what a sensor reads there; before the first step."""
        if self.moving.some:
            self.moving.watch(skin, place)
        self.backend.watch(skin, place)

    def begin_at(
        self, places: Float, axes: Float, t0: float, posed: Callable[[Bool], Mapping[int, PosedScene]]
    ) -> None:
        """Take the frames of all worlds at the beginning of a step, t0 [s], and compute the forces over it.

        places [m], axes: of the rows of the layout, shapes (worlds, rows, 3) and (worlds, rows, 9).
        posed: gives the PosedScenes of some worlds, shape (worlds,): a graph that steps others needs none.
        """
        self.moving.begin(places, axes, t0, self._watched(self.works[0]))
        moving = self.moving.joined
        if len(moving) < len(self.models):
            here = np.ones(len(self.models), dtype=bool)
            here[moving] = False
            self.begin(posed(here), t0)
        else:
            self._apart, self.smooth.joined = [], moving[:0]
            self.backend.forget()
        for forces, own in zip(self.forces, self.moving.mean_forces(), strict=False):
            forces[moving] = own

    def begin(self, posed: Mapping[int, PosedScene], t0: float) -> None:
        """The same for worlds that no graph steps, in their PosedScenes."""
        for world, now in posed.items():
            self._posed[world], self._poses[world] = now, now.serial
        if self.backend.course is not None:
            self.backend.forget()
        with one_blas_thread:
            self._apart = self.smooth.begin(posed, t0)
            joined = self.smooth.joined
            self._pressed.clear()
            self._means.clear()
            if len(joined):
                factors = self.smooth.mean_factors()
                if self.observer is not None:
                    for world, factor in zip(joined.tolist(), factors.tolist(), strict=True):
                        if factor > 0.0:
                            self._means[world] = self.smooth.unit(world), factor, int(self.smooth.serials[world])
                keys = self._joined_keys = self._keys(joined)
                loud = factors > 0.0
                for body, forces in enumerate(self.forces):
                    forces[joined] = 0.0
                    sounding = joined[loud]
                    made = self._kept.rows(body, forces.shape[1:], sounding, keys[loud], self._unit_force, body)
                    forces[sounding] = factors[loud, None, None, None] * made
            for world in self._apart:
                self._in(self._push_one, world, t0)

    def _watched(self, work: Workspace) -> bool:
        """Whether all substeps of a world are watched, which a graph does not give."""
        return self.observer is not None or any(map(is_not, work.observe, repeat(None)))

    def state_now(self) -> bytes:
        """The inputs of the step that has begun, for a state that other code may write: equal while it is valid."""
        parts: tuple[Complex | Float, ...] = self.state.emitted
        for skin, size in [*self.moving.stepped, *self.backend.stepped]:
            parts = *parts, self.state.skins[skin][:, : HEADER + size]
        return b"".join(map(methodcaller("tobytes"), parts))

    def _unit_force(self, world: int, body: int) -> Float:
        """The force of the unit drive of a world on a body, world axes, shape (2, b, 3)."""
        posed, unit, serial = self._posed[world], self.smooth.unit(world), int(self.smooth.serials[world])
        force = self.works[world].unit_forces.under(posed, body, unit, serial)
        return np.asarray(force @ posed.array_frame.rotation.T)

    def _push_one(self, world: int, t0: float) -> None:
        """The forces in a world that is stepped here alone."""
        work, posed, state = self.works[world], self._posed[world], self._states[world]
        if (work.emission.holds or work.emission.coming) and untouched(state):
            work.emission.forget()
        if work.emission.holds:
            work.emission.begin(posed, t0)
        turn, backend = posed.array_frame.rotation.T, self.backend
        if backend.begin(posed, t0, self._watched(work)):
            for body, forces in enumerate(self.forces):
                forces[world] = backend.forces(body) @ turn
            return
        work.look_ahead(posed)
        mean = work.emission.mean_drives(posed, gather(state, work), t0)
        key = np.array([[posed.serial, mean.serial]])
        for body, forces in enumerate(self.forces):
            if len(mean.weights) == 0:
                forces[world] = 0.0
                continue
            arp = work.mean_pressure(posed, body, mean)
            if arp is not None:
                self._pressed[world, body] = np.asarray(arp, np.float64)
                forces[world] = work.unit_forces.pressed(posed, body, arp) @ turn
                continue

            def make(_: int, body: int = body) -> Float:
                return np.asarray(work.unit_forces.under(posed, body, mean.units[0], mean.serial) @ turn)

            self._means[world] = mean.units[0], float(mean.weights[0]), mean.serial
            made = self._kept.rows(body, forces.shape[1:], np.array([world]), key, make)
            forces[world] = mean.weights[0] * made[0]

    def pressed(self, world: int, body: int) -> Float | None:
        """The mean ARP [Pa] at the samples of a body in the step that began last, shape (n,); None in silence."""
        known = self._pressed.get((world, body))
        if known is not None or world not in self._means:
            return known
        unit, factor, serial = self._means[world]
        work, posed = self.works[world], self._posed[world]
        skin = work.unit_forces.skins[body]
        return factor * work.radiation.on(posed, skin, "samples", unit, serial).arp.astype(np.float64)

    def sense(self, skin: int, place: SensorPlace, t0: float) -> tuple[Float, Float]:
        """ARP [Pa], shape (worlds,), displacement [m] and velocity [m/s], (worlds, 2), at the place of a sensor at the
        beginning of a step; 0 in worlds that have not begun one here."""
        count = len(self.models)
        arp, motion = np.zeros(count), np.zeros((count, 2))
        joined = self.smooth.joined
        if len(joined):
            factors = self.smooth.present_factors()
            loud = factors > 0.0
            worlds = joined[loud]
            keys = self._joined_keys[loud]
            arp[worlds] = factors[loud] * self._own.rows(place, (), worlds, keys, self._probe, skin, place)
        for world in self._apart:
            arp[world] = self._in(self._arp_in_one, world, skin, place, t0)
        here = joined
        if self._apart:
            apart = np.array(self._apart, np.intp)
            here = np.sort(np.concatenate([joined, apart])) if self._several else apart
        part = self.state.skins[skin]
        begun = here[part[here, 0] != 0.0]
        if not self._several and len(begun):
            stepper_of(self.models[0], self.state, skin)  # refuses the state of another model
        moving = self.moving.joined
        if len(moving):
            arp[moving], motion[moving] = self.moving.sensed(skin, place)
        for stepper, own in self.steppers(skin, begun):
            read = stepper.read(part[own, HEADER : HEADER + stepper.state_size], place.reader(stepper))
            motion[own] = read[..., 0]
        return arp, motion

    def _probe(self, world: int, skin: int, place: SensorPlace, drive: Complex | None = None) -> float:
        """ARP at a sensor [Pa] of a drive, shape (N,); without one, of the unit drive of a world."""
        posed = self._posed[world]
        body = posed.bodies[self.models[0].skins[skin].body]
        points, normals = body.moved(place.probe.closest, place.probe.normals, place.binding)
        sounding = self.smooth.unit(world) if drive is None else drive
        return float(self.works[world].radiation.at(posed, skin, "probe", points, normals, sounding).arp[0])

    def _arp_in_one(self, world: int, skin: int, place: SensorPlace, t0: float) -> float:
        """ARP at the place of a sensor [Pa] in a world that is stepped here alone."""
        work, posed = self.works[world], self._posed[world]
        if self.backend.course is not None:
            return self.backend.arp(skin, place)
        course = work.emission.now(posed, gather(self._states[world], work), t0)
        drive, factor = present_drive(course)
        if drive is None:
            return 0.0
        key = np.array([[posed.serial, course.serial]])
        known = self._own.rows(place, (), np.array([world]), key, self._probe, skin, place, drive)
        return factor * float(known[0])

    # -- its end -------------------------------------------------------------------------------------------------------

    def advance(self, t0: float, t1: float, skins: bool = True) -> None:
        """Carry transducers and skins of the worlds that have begun from t0 to t1 [s], in place.

        skins: False leaves them as they are. Raises SceneError for a state of another solver and where a small model
        that key `solver` names can't go on.
        """
        with one_blas_thread:
            if len(self.moving.joined):
                self.moving.advance(skins)
            joined = self.smooth.joined
            new = joined[self.state.arrays[0][joined, 0] != BEGUN] if self._several else joined
            for world in [*new.tolist(), *self._apart]:
                self._in(self._check, world)
            if len(joined):
                self._advance_smooth(t0, t1, skins)
            for world in self._apart:
                self._in(self._advance_one, world, t0, t1, skins)

    def over(self, posed: PosedScene, t0: float, steps: int, skins: bool = True) -> None:
        """Step the only world several times from t0 [s] on, in one pose, without forces or sensors in between.

        skins: as of `advance`; so are the errors raised
        """
        work, state = self.works[0], self._states[0]
        self._posed[0], self._poses[0], self._apart = posed, posed.serial, [0]
        self.smooth.forget()
        if untouched(state):
            work.emission.forget()
        if work.emission.holds:
            work.emission.begin(posed, t0)
        work.look_ahead(posed)
        self._check(0)
        with one_blas_thread:
            self._advance_one(0, t0, t0 + steps * self.models[0].spec.timestep_s, skins)

    @property
    def together(self) -> int:
        """How many steps in one pose `over` takes in one go: one where points are held, or where skins serve a class of
        loads, of which every step is measured."""
        model = self.models[0]
        free = not self.works[0].emission.holds and not any(one.value.of_class for one in model.begin)
        return TOGETHER if free else 1

    def _check(self, world: int) -> None:
        """Begin a run in a state without a writer; SceneError for the state of another model."""
        if check_arrays(self.models[world], self._states[world]):
            self.works[world].begin_run()
            self._served[:, world] = 0

    def _advance_smooth(self, t0: float, t1: float, skins: bool) -> None:
        """`advance` in the worlds whose sound one level determines."""
        model, smooth = self.models[0], self.smooth
        worlds, moments = smooth.joined, substep_moments((), t0, model.step_s, model.substeps)
        levels, end = smooth.over(moments)
        if skins:
            factors = levels.real**2 + levels.imag**2
            keys = self._joined_keys.copy()
            keys[:, 1] *= np.logical_or.reduce(factors, axis=1)
            begun = smooth.now[worlds]
            group = _Group(
                worlds,
                keys,
                moments,
                levels[..., None],
                lambda i: smooth.course(int(worlds[i]), levels[i], end[i]),
                lambda i: begun[i] * smooth.unit(int(worlds[i])),
                (factors @ moments.first.T)[..., None],
                (factors @ moments.last.T)[..., None],
            )
            self._step_skins(group, t0, t1)
        smooth.advance(end)

    def _advance_one(self, world: int, t0: float, t1: float, skins: bool) -> None:
        """`advance` in a world that is stepped here alone."""
        model, work, posed, state = self.models[world], self.works[world], self._posed[world], self._states[world]
        begun, known = gather(state, work), self.backend.course
        count = round((t1 - t0) / model.step_s)
        moments, course = known or work.emission.over(posed, begun, t0, count)
        if skins:
            first, last = course.weights(moments)
            keys = np.array([[posed.serial, course.serial]])
            levels = course.levels[None]
            group = _Group(
                np.array([world]), keys, moments, levels, lambda _: course, lambda _: begun, first[None], last[None]
            )
            self._step_skins(group, t0, t1)
        if model.response_on:
            scatter(state, course.end)

    def _step_skins(self, group: _Group, t0: float, t1: float) -> None:
        """Step the skins of a group of worlds, in place, and hand on what is watched."""
        motion = []
        for skin in range(len(self.models[0].skins)):
            self._leave_small_models(group, skin, t0)
            steppers = self.steppers(skin, group.worlds)
            if self._leave_class(group, skin, steppers, t0):
                steppers = self.steppers(skin, group.worlds)
            watched = []
            for stepper, own in steppers:
                seen = self._step(group, skin, stepper, own, (t0, t1))
                if seen is not None:
                    watched.append((own, seen))
            motion.append(tuple(watched))
        if self.observer is not None:
            model, worlds = self.models[0], group.worlds
            times = t0 + model.step_s * np.arange(1, group.first.shape[1] + 1, dtype=np.float64)
            posed = tuple([self._posed[world] for world in worlds.tolist()])
            self.observer(
                StepTrace(times, worlds, posed, group.moments, group.levels, group.course, group.begun, tuple(motion))
            )

    def _leave_small_models(self, group: _Group, skin: int, t0: float) -> None:
        """Turn small models into whole layers where something has moved."""
        if self._anywhere[skin]:
            return
        worlds, served = group.worlds, self._served[skin]
        moved = (served[worlds] != self._poses[worlds]) & (self.state.skins[skin][worlds, 0] != WHOLE)
        if not np.logical_or.reduce(moved):
            return
        steppers = [model.begin[skin].value for model in self.models]
        self._anywhere[skin] = all(one.any_pose and one.any_course for one in steppers)
        for i in moved.nonzero()[0].tolist():
            world = int(worlds[i])
            if self._in(self._leaves, world, skin, t0):
                self._continue_whole(group, i, skin, t0)
            # One that serves only from the beginning of the sound on must be looked at again, and so where points are
            # held
            elif not self.works[world].emission.holds and self.models[world].begin[skin].value.any_course:
                served[world] = self._poses[world]

    def _leaves(self, world: int, skin: int, t0: float) -> bool:
        """Whether the small model of a skin is no longer valid."""
        work, state = self.works[world], self._states[world]
        return leaves_small_model(
            self.models[world], state, skin, self._posed[world], work.reference, work.emission, t0
        )

    def _continue_whole(self, group: _Group, i: int, skin: int, t0: float) -> None:
        """Continue with the whole layer from the motion of a skin in the i-th world."""
        world = int(group.worlds[i])
        work, state = self.works[world], self._states[world]
        continue_on_whole_layer(
            self.models[world], state, skin, self._posed[world], work.emission, work.radiation, group.begun(i), t0
        )

    def _leave_class(
        self,
        group: _Group,
        skin: int,
        steppers: Sequence[tuple[SkinStepper, Rows]],
        t0: float,
    ) -> bool:
        """Measure the part of the loads outside the class of a skin's modes; if large, the whole layer takes over.

        Returns whether any world does so.
        """
        left = False
        for stepper, own in steppers:
            if not stepper.of_class:
                continue
            at = group.worlds.searchsorted(own)
            for i, seen in zip(at.tolist(), self._outside(group, skin, stepper, at), strict=True):
                world = int(group.worlds[i])
                model, work = self.models[world], self.works[world]
                if leaves_class(model, skin, work.outside_share(skin, stepper, seen)):
                    self._continue_whole(group, i, skin, t0)
                    left = True
        return left

    def _outside(self, group: _Group, skin: int, stepper: SkinStepper, at: Rows) -> list[Outside]:
        """The part of the loads on a skin outside the class of its modes, in the worlds at some places of a group."""
        worlds = group.worlds[at]
        known = self.backend.outside(skin, stepper)
        if known is not None:
            return [known]
        first, last = group.first[at], group.last[at]
        pressure, fixed = self._stack(group, skin, stepper, at)
        if not fixed or not self._several:
            return [stepper.outside(SurfaceLoads(pressure, first, last))]
        mixed = stepper.mixed(SurfaceLoads(np.zeros(0), first, last))
        squares = np.add.reduce(mixed**2, axis=(1, 2))

        def of_unit(world: int) -> Float:
            i = worlds.searchsorted(world)
            return np.array(stepper.outside(SurfaceLoads(pressure[i : i + 1], ONE, ONE)))

        units = self._kept.rows(("outside", skin), (len(Outside._fields),), worlds, group.keys[at], of_unit)
        return [Outside(*row) for row in (squares[:, None] * units).tolist()]

    def _patterns(self, group: _Group, skin: int, stepper: SkinStepper, i: int) -> Float32:
        """Patterns of ARP in the i-th world of a group [Pa], shape (p, n)."""
        world = int(group.worlds[i])
        posed, course = self._posed[world], group.course(i)
        if self.backend.course is not None and len(course.units):
            return self.backend.patterns(skin, stepper.points)
        return self.works[world].patterns(posed, skin, stepper, course)

    def _step(
        self,
        group: _Group,
        skin: int,
        stepper: SkinStepper,
        worlds: Rows,
        times: tuple[float, float],
    ) -> Float | Float32 | None:
        """Step a skin in some worlds by one stepper; all of them watch the points that the first one watches."""
        part, numbers = self.state.skins[skin], slice(HEADER, HEADER + stepper.state_size)
        for world in worlds.tolist() if not self._several else worlds[part[worlds, 0] == 0.0].tolist():
            # Refuses a state that is not at rest but has no writer
            stepper_of(self.models[world], self._states[world], skin)
            claim(self.models[world], self._states[world], skin, stepper)
        end = self.backend.after(skin, stepper)
        if end is not None:
            part[:, numbers] = end
            return None
        at = group.worlds.searchsorted(worlds)
        pressure, fixed = self._stack(group, skin, stepper, at)
        loads = SurfaceLoads(pressure, group.first[at], group.last[at], fixed)
        together = int(worlds[0]) not in self._apart
        step = (self._on_device(skin, stepper) if together else None) or stepper.step
        reader = self.works[worlds[0]].reader(skin, stepper)
        if len(worlds) == len(part):
            return step(part[:, numbers], loads, *times, reader)
        states = part[worlds, numbers]
        seen = step(states, loads, *times, reader)
        part[worlds, numbers] = states
        return seen

    def _stack(self, group: _Group, skin: int, stepper: SkinStepper, at: Rows) -> tuple[Float32, bool]:
        """Patterns of ARP in the worlds at some places of a group, shape (w, p, n): the same array while pose and
        drive stay, and whether it may."""
        fixed = group.first.shape[2] == 1
        key = group.worlds[at].tobytes() + group.keys[at].tobytes()
        known = self._stacks.get((skin, stepper))
        if known is None or known[0] != key:
            made: dict[bytes, Float32] = {}
            patterns = []
            for i in at.tolist():
                own = group.keys[i].tobytes()
                if own not in made:
                    made[own] = self._patterns(group, skin, stepper, i)
                patterns.append(made[own])
            if len(patterns) == 1:
                stacked = patterns[0][None]
            elif len(made) == 1:  # there once for all worlds
                stacked = np.broadcast_to(patterns[0], (len(patterns), *patterns[0].shape))
            else:
                stacked = np.stack(patterns)
            known = self._stacks[skin, stepper] = key, stacked
        return known[1], fixed

    def steppers(self, skin: int, worlds: Rows) -> list[tuple[SkinStepper, Rows]]:
        """Some worlds by what steps a skin in them."""
        whole = self.state.skins[skin][worlds, 0] == WHOLE
        key = skin, worlds.tobytes(), whole.tobytes()
        known = self._shared_out.get(key)
        if known is not None:
            return known
        steppers: dict[int, tuple[SkinStepper, list[int]]] = {}
        for world, left in zip(worlds.tolist(), whole.tolist(), strict=True):
            model = self.models[world]
            stepper: SkinStepper = (model.whole if left else model.begin)[skin].value
            steppers.setdefault(id(stepper), (stepper, []))[1].append(world)
        if len(self._shared_out) >= KEPT:
            self._shared_out.clear()
        found = self._shared_out[key] = [(one, np.array(own, dtype=np.intp)) for one, own in steppers.values()]
        return found

    def _on_device(self, skin: int, stepper: SkinStepper) -> DeviceStep | None:
        """The stepper of a skin on the device in place of its stepper, if the device is a GPU and has one; stored."""
        if not self._several:
            return None
        return self._own.of((skin, stepper), (), stepper.device_worlds, len(self.models), self._device)

    def _named(self, function: Callable[..., T], world: int, *arguments: Any) -> T:
        """The result of a function for one of several worlds, which its errors name."""
        with naming_world(world):
            return function(world, *arguments)

    def _keys(self, worlds: Rows) -> Serials:
        """Serial numbers of the poses and unit drives of worlds whose sound one level determines, (g, 2)."""
        keys: Serials = np.empty((len(worlds), 2), np.int64)
        keys[:, 0], keys[:, 1] = self._poses[worlds], self.smooth.serials[worlds]
        return keys
