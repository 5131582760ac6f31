"""Coming steps of one world in one pose, computed together for a recording: on a device, while nothing moves.

The sound and the motion of the skins then depend on time only. MuJoCo still does each step by itself, with the forces
and sensor readings of that step; if its bodies move after all, the rest of the block is dropped.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.drive.transducer_response import EmittedCourse, of_drives, ring, rows
from palmfield.simulation.backend import Backend, Frames, StepTrace
from palmfield.simulation.emission import LEAST_MEANS, TICK_S, mean_weights
from palmfield.simulation.kept import Bool, Rows
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.skin_sound import Role
from palmfield.simulation.small_models.leaving import leaves_small_model
from palmfield.simulation.state import HapticState, at_rest, claim, stepper_of
from palmfield.simulation.workspace import Workspace
from palmfield.skin.stepper import SkinStepper, SurfaceLoads
from palmfield.stimulus.schedule import Moments, frames_at, mean_arp_factor, substep_moments
from palmfield.types import Complex, Float, Float32

NOBODY: Rows = np.zeros(0, np.intp)
ONE: Rows = np.zeros(1, np.intp)
CARRIED = 4
"""Number of steps in one call of a stepper, whose products grow as its square."""


class Carried(NamedTuple):
    """Motion of a skin in the steps. patterns: ARP, (1, p, q); first, last: their weights, (1, N s, p)

    before, after: the state, (1, state_size)
    seen: what is observed after each substep, as coordinates, (N s, 2, r)
    """

    stepper: SkinStepper
    patterns: Float32
    first: Float
    last: Float
    before: Float
    after: Float
    seen: Float


class Block(NamedTuple):
    """N steps. starts: starts of each, and the end of the last [s], N + 1 numbers

    emitted: emission at `starts`, (N + 1, n). course: emission at all moments, with one drive or one for each moment.
    forces: on each body in each step, (N, 2, b, 3); read: ARP (N,) and motion (N, 2) at sensors, by skin and place
    """

    posed: PosedScene
    starts: list[float]
    emitted: Complex
    course: EmittedCourse
    forces: list[Float]
    skins: list[Carried]
    read: dict[tuple[int, SensorPlace], tuple[Float, Float]]


class StillSteps(Backend):
    """Backend for one stimulus and free sound on skins with reduced models, from the second step in a pose on.

    The state is that of the beginning of the block until `fetch`.
    """

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState):
        super().__init__(models, works, state)
        model = self.model = models[0]
        self.work = works[0]
        free = all(skin.spec.config.body_sound == "none" for skin in model.skins)
        self._able = free and len(model.stimuli) == 1 and not self.work.emission.holds
        self._block: Block | None = None
        self._done = 0
        self._last: PosedScene | None = None
        self._not_before = -np.inf

    def forget(self) -> None:
        self._block, self._last, self._not_before = None, None, -np.inf

    def leave_out(self, world: int) -> None:
        self.fetch()
        self._able = False

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Do nothing: readings of a whole block are computed when the first is read."""

    def fetch(self) -> None:
        """Write the state after the steps that are done, and end the block."""
        block, self._block = self._block, None
        if block is None or self._done == 0 or not self._here(block):
            return
        self.state.set_emission(slice(None), block.emitted[self._done][None])
        for skin, of in enumerate(block.skins):
            after = of.after
            if self._done < len(block.starts) - 1:
                after = of.before.copy()
                self._carry(of, after, block, 0, self._done)
            claim(self.model, self.state, skin, of.stepper)
            stepper_of(self.model, self.state, skin)[1][:] = after

    def _here(self, block: Block) -> bool:
        """Return whether the state is still that of the beginning of a block."""
        return bool(np.logical_and.reduce(self.state.emission()[0] == block.emitted[0]))

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def place(self, frames: Frames, free: Bool, t0: float) -> Rows:
        if self.most == 1 or not self._able or not free[0]:
            return NOBODY
        posed, block = frames.posed(free)[0], self._block
        if block is not None:
            goes_on = posed is block.posed and self._done < len(block.starts) - 1 and self._here(block)
            if not goes_on or abs(t0 - block.starts[self._done]) > TICK_S:
                self.fetch()
        if self._block is None and posed is self._last and t0 >= self._not_before and self._serves(posed, t0):
            with one_blas_thread:
                self._block, self._done = self._computed(posed, t0), 0
        self._last = posed
        return NOBODY if self._block is None else ONE

    def _serves(self, posed: PosedScene, t0: float) -> bool:
        """Return whether reduced models that are valid here move all skins."""
        work = self.work
        for skin in range(len(self.model.skins)):
            if work.observe[skin] is None or at_rest(self.state, skin):
                return False
            stepper = stepper_of(self.model, self.state, skin)[0]
            work.reader(skin, stepper)
            if work.coordinates(skin, stepper) is None:
                return False
            if leaves_small_model(self.model, self.state, skin, posed, work.reference, work.emission, t0):
                return False
        return True

    def _computed(self, posed: PosedScene, t0: float) -> Block | None:
        """Compute the steps from t0 [s] on; None if the level jumps in them."""
        model, emission, starts = self.model, self.work.emission, [t0]
        while len(starts) <= self.most and starts[-1] < self.end_s - TICK_S:
            starts.append(starts[-1] + model.spec.timestep_s)
        count = len(starts) - 1
        if count == 0:
            return None
        begun = self.state.emission()[0].copy()
        moments, course = emission.over(posed, begun, t0, count * model.substeps)
        means = None if any(moments.held_s) else self._means(starts, course)
        if means is None:
            self._not_before = starts[-1] - TICK_S
            return None
        if len(course.units) > 1:
            course = of_drives(rows(course), course.end)
        emitted = np.tile(begun, (count + 1, 1))
        if model.response_on:
            at_starts = course.levels[:: model.substeps]
            emitted[:] = at_starts @ course.units if len(course.units) < 2 else course.units[:: model.substeps]
            emitted[0], emitted[-1] = begun, course.end
        forces = [self._forces(posed, body, course, means) for body in range(len(model.bodies))]
        block = Block(posed, starts, emitted, course, forces, [], {})
        for skin in range(len(model.skins)):
            block.skins.append(self._carried(block, skin, moments))
        return block

    def _means(self, starts: list[float], course: EmittedCourse) -> Float | None:
        """Return the weights (N, p) of the patterns of ARP in the mean over each step, as in `Emission.mean_drives`;
        None if they do not give it."""
        model, [config] = self.model, self.model.configs
        count, substeps, step_s = len(starts) - 1, model.substeps, model.spec.timestep_s
        parts, steps = max(LEAST_MEANS, substeps), np.arange(count)
        if not model.response_on:
            factors = np.array([mean_arp_factor(config, start, start + step_s, parts) for start in starts[:-1]])
            if len(course.units) < 2:
                return factors[:, None]
            now = frames_at(config, np.array(starts[:-1]))[1]
            if np.logical_or.reduce((now == 0.0) & (factors > 0.0)):
                return None
            weights = np.zeros((count, len(course.levels)))
            weights[steps, steps * substeps] = np.divide(factors, now, out=np.zeros(count), where=now > 0.0)
            return weights
        if config.path == "point":
            # As in `SmoothSound.mean_factors`: each step begins with its own emission, held parts follow
            part, response = model.stimuli[0], model.stimuli[0].response
            if len(course.units) > 1 or response.delayed or not response.stepper.alike:
                return None
            held = substep_moments((), 0.0, step_s / parts, parts, hold=True)
            commanded = np.sqrt(frames_at(part.config, (np.array(starts[:-1])[:, None] + held.times).ravel())[1])
            begins = course.levels[:-1:substeps].sum(axis=1)  # one number each, none in silence
            levels, _ = ring(begins, commanded.reshape(count, parts).T, held, response.stepper)
            return np.asarray(np.mean(np.abs(levels) ** 2, axis=0)[:, None])
        if substeps == 1:
            return None
        weights = np.zeros((count, len(course.levels)))
        own = mean_weights(substep_moments((), starts[0], model.step_s, substeps))
        for step in range(count):
            weights[step, step * substeps : (step + 1) * substeps + 1] = own
        return weights @ np.abs(course.levels) ** 2 if len(course.units) == 1 else weights

    def _forces(self, posed: PosedScene, body: int, course: EmittedCourse, weights: Float) -> Float:
        """Return the mean forces on a body in each step, shape (N, 2, b, 3)."""
        radiation, skin = self.work.radiation, self.model.first_skins[body]
        if len(course.units) < 2:
            of_unit = radiation.force(posed, body, radiation.patterns(posed, skin, "samples", course)[0])
            return np.asarray(weights[:, :, None, None] * of_unit if len(course.units) else 0.0 * of_unit[None])
        counted = np.logical_or.reduce(weights, axis=0)
        arp = weights[:, counted] @ radiation.many(posed, skin, rows(course)[counted], "samples")
        return np.array([radiation.force(posed, body, own) for own in arp])

    def _carried(self, block: Block, skin: int, moments: Moments) -> Carried:
        """Compute the motion of a skin in all steps."""
        stepper, numbers = stepper_of(self.model, self.state, skin)
        if stepper.points is not None:
            self.work.radiation.choose(skin, stepper.points)
        role: Role = "quadrature" if stepper.points is None else "load"
        patterns = self.work.radiation.patterns(block.posed, skin, role, block.course)
        first, last = block.course.weights(moments)
        count, after = len(block.starts) - 1, numbers.copy()
        of = Carried(stepper, patterns, first, last, numbers.copy(), after, np.zeros(0))
        bounds = pairwise([*range(0, count, CARRIED), count])
        return of._replace(seen=np.concatenate([self._carry(of, after, block, *own, skin) for own in bounds]))

    def _carry(
        self, of: Carried, state: Float, block: Block, begin: int, end: int, observed: int | None = None
    ) -> Float:
        """Carry a state through some steps, in place; return what is observed of a skin, by its number."""
        own = slice(begin * self.model.substeps, end * self.model.substeps)
        patterns, counted = of.patterns, slice(None)
        if len(patterns) > 1:  # one for each moment
            counted = slice(own.start, own.stop + 1)
        loads = SurfaceLoads(patterns[None, counted], of.first[None, own, counted], of.last[None, own, counted])
        reader = None if observed is None else self.work.reader(observed, of.stepper)
        seen = of.stepper.step(state, loads, block.starts[begin], block.starts[end], reader)
        return np.zeros(0) if seen is None else np.asarray(seen[0])

    def emit(self, t0: float) -> None:
        """Do nothing: all is computed."""

    def press(self) -> Rows:
        return self.joined

    def push(self, forces: Sequence[Float]) -> None:
        assert self._block is not None
        for own, of_steps in zip(forces, self._block.forces, strict=True):
            own[0] = of_steps[min(self._done, len(of_steps) - 1)]

    def sense(self, skin: int, place: SensorPlace, arp: Float, motion: Float) -> None:
        block = self._block
        assert block is not None
        read = block.read.get((skin, place))
        if read is None:
            read = block.read[skin, place] = self._arp_at(block, skin, place), self._motion_at(block, skin, place)
        arp[0], motion[0] = read[0][self._done], read[1][self._done]

    def _arp_at(self, block: Block, skin: int, place: SensorPlace) -> Float:
        """Return the ARP at a sensor at the beginning of each step [Pa], shape (N,)."""
        radiation, posed, course = self.work.radiation, block.posed, block.course
        body = posed.bodies[self.model.skins[skin].body]
        where = body.moved(place.probe.closest, place.probe.normals, place.binding)
        begins = slice(0, -1, self.model.substeps)
        if len(course.units) < 2:
            arp = radiation.many_at(posed, skin, *where, course.units)[:, 0]
            return np.asarray(np.abs(course.levels[begins]) ** 2 @ arp)
        return radiation.many_at(posed, skin, *where, course.units[begins])[:, 0].astype(np.float64)

    def _motion_at(self, block: Block, skin: int, place: SensorPlace) -> Float:
        """Return displacement [m] and velocity [m/s] at a sensor at the beginning of each step, shape (N, 2)."""
        of = block.skins[skin]
        reader = place.reader(of.stepper)
        later = of.seen[self.model.substeps - 1 :: self.model.substeps] @ reader.matrix
        return np.concatenate([of.stepper.read(of.before, reader)[..., 0], later[:-1, :, 0]])

    # -- its end -------------------------------------------------------------------------------------------------------

    def step_skins(self, t0: float, t1: float, skins: bool) -> None:
        block, step, substeps = self._block, self._done, self.model.substeps
        assert block is not None
        self._done = step + 1
        if self.observer is None:
            return
        own, course = slice(step * substeps, (step + 1) * substeps), block.course
        during, end = slice(own.start, own.stop + 1), block.emitted[step + 1]
        if len(course.units) > 1:
            course = of_drives(course.units[during], end)
        else:
            course = course._replace(levels=course.levels[during], end=end)
        moments = substep_moments((), t0, self.model.step_s, substeps)
        first, last = course.weights(moments)
        self.observer(
            StepTrace(
                t0 + self.model.step_s * np.arange(1.0, substeps + 1),
                ONE,
                (block.posed,),
                np.array([[block.posed.serial, course.serial]]),
                moments,
                course.levels[None],
                lambda _: course,
                lambda _: block.emitted[step],
                first[None],
                last[None],
                tuple(((ONE, of.seen[None, own]),) for of in block.skins),
            )
        )
