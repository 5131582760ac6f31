"""Coming steps of one world in one pose, for a recording on a device. The sound of all of them is computed together.

While nothing moves, the sound depends only on time. All other stages of each step are those of `HostBackend`. If
anything moves, or other code writes the state, the rest of the block is dropped.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.drive.transducer_response import Batch, EmittedCourse, of_drives, ring, rows
from palmfield.locked import next_serial
from palmfield.simulation.backend import Frames
from palmfield.simulation.cached import Bool, Rows
from palmfield.simulation.emission import LEAST_MEANS, TICK_S, mean_weights
from palmfield.simulation.host_backend import HostBackend, Sounding
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.state import HapticState
from palmfield.simulation.workspace import Workspace
from palmfield.stimulus.schedule import Moments, frames_at, mean_arp_factor, substep_moments
from palmfield.types import Complex, Float, Float32

NOBODY: Rows = np.zeros(0, np.intp)
ONE: Rows = np.zeros(1, np.intp)
STEPS = 16
"""Number of steps in a block. In the last block of a run, some steps are computed but not used."""


class Block(NamedTuple):
    """The sound of N steps.

    starts: start of each step, and end of the last step [s], N + 1 numbers
    emitted: emission at `starts`, shape (N + 1, n)
    course: emission at all moments, with one drive or with one for each moment
    means: weights of the ARP patterns in the mean over each step, shape (N, p)
    pressed: mean ARP at the samples of each body in each step, shape (N, n); empty with one drive
    """

    posed: PosedScene
    starts: list[float]
    emitted: Complex
    course: EmittedCourse
    means: Float
    pressed: list[Float]


class StillSteps(HostBackend):
    """Backend for one stimulus in the free field, if every substep is observed.

    It works from the second step in a pose on.
    """

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState):
        super().__init__(models, works, state, alone=False)
        self._able = models[0].free and len(models[0].stimuli) == 1 and not works[0].emission.holds
        self._block: Block | None = None
        self._number = 0
        self._last = 0  # serial number of the pose of the last step
        self._not_before = -np.inf

    def forget(self) -> None:
        super().forget()
        self._block, self._last, self._not_before = None, 0, -np.inf

    def leave_out(self, world: int) -> None:
        self._able = False

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def place(self, frames: Frames, free: Bool, t0: float) -> Rows:
        if not (self._able and self.watched and free[0]):
            return NOBODY
        posed = frames.posed(free)[0]
        if not self._goes_on(posed, t0):
            still, self._last, self._block = posed.serial == self._last, posed.serial, None
            if still and t0 >= self._not_before:
                with one_blas_thread:
                    self._block, self._number = self._computed(posed, t0), 0
        if self._block is None:
            return NOBODY
        self._begin({0: posed})
        self._apart, self._emitted[0] = [0], self._block.emitted[self._number]
        return ONE

    def _goes_on(self, posed: PosedScene, t0: float) -> bool:
        """Return whether the step from t0 [s] on is the next step of the block."""
        block, step = self._block, self._number
        if block is None or step == STEPS or posed.serial != block.posed.serial:
            return False
        in_time = abs(t0 - block.starts[step]) <= TICK_S
        return in_time and bool(np.logical_and.reduce(self.state.emission()[0] == block.emitted[step]))

    def _computed(self, posed: PosedScene, t0: float) -> Block | None:
        """Compute the steps from t0 [s] on. Returns None if the level jumps in them."""
        model, starts = self.models[0], [t0]
        while len(starts) <= STEPS:
            starts.append(starts[-1] + model.spec.timestep_s)
        begun = self.state.emission()[0]
        moments, course = self.works[0].emission.over(posed, begun, t0, STEPS * model.substeps)
        means = None if any(moments.held_s) else self._weights(starts, course)
        if means is None:
            self._not_before = starts[-1] - TICK_S
            return None
        if len(course.units) > 1:
            course = of_drives(rows(course), course.end)
            course = course._replace(batch=Batch(course.serial, course.units))
        emitted = np.tile(begun, (STEPS + 1, 1))
        if model.response_on:
            at_starts = course.levels[:: model.substeps]
            emitted[:] = at_starts @ course.units if len(course.units) < 2 else course.units[:: model.substeps]
            emitted[0], emitted[-1] = begun, course.end
        block = Block(posed, starts, emitted, course, means, [])
        if len(course.units) > 1:
            block.pressed.extend(self._mean_arp(block, skin) for skin in model.first_skins)
        return block

    def _mean_arp(self, block: Block, skin: int) -> Float:
        """Return the mean ARP at the samples of the body of a skin in each step, shape (N, n)."""
        counted = np.logical_or.reduce(block.means, axis=0)
        arp = self.works[0].radiation.many(block.posed, skin, block.course.units[counted], "samples")
        return np.asarray(block.means[:, counted] @ arp)

    def _weights(self, starts: list[float], course: EmittedCourse) -> Float | None:
        """Return `Block.means`, as in `Emission.mean_drives`. None if they cannot be computed from the course."""
        model, [config] = self.models[0], self.models[0].configs
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
            if len(course.units) > 1 or not response.alike:
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

    def emit(self, t0: float) -> None:
        assert self._block is not None
        course = self._block.course
        for pressed, arp in zip(self._pressed, self._block.pressed, strict=False):
            pressed[0] = arp[self._number]
        if len(course.units) == 1:
            mean = self._single(0, self._block.means[self._number], course.units[0], course.serial)
            for singles in self._singles:
                singles.append(mean)

    def push(self, forces: Sequence[Float]) -> None:
        with one_blas_thread:
            super().push(forces)

    def _sounds_now(self, world: int) -> list[Sounding]:
        assert self._block is not None
        course, moment = self._block.course, self._number * self.models[0].substeps
        if len(course.units) > 1:
            return [self._single(0, np.ones(1), course.units[moment], next_serial())]
        return [self._single(0, np.abs(course.levels[moment]) ** 2, unit, course.serial) for unit in course.units]

    def _probe(self, world: int, skin: int, place: SensorPlace, one: Sounding) -> float:
        assert self._block is not None
        course = self._block.course
        if len(course.units) < 2:
            return super()._probe(world, skin, place, one)
        arp = self._own.of(("probe", place), course.serial, self._probed, self._block, skin, place)
        return float(arp[self._number])

    def _probed(self, block: Block, skin: int, place: SensorPlace) -> Float32:
        """Return the ARP at a sensor at the beginning of each step [Pa], shape (N,)."""
        drives, body = block.course.units[: -1 : self.models[0].substeps], self.models[0].skins[skin].body
        where = block.posed.bodies[body].moved(place.probe.closest, place.probe.normals, place.binding)
        return self.works[0].radiation.many_at(block.posed, skin, *where, drives)[:, 0]

    # -- its end -------------------------------------------------------------------------------------------------------

    def step_skins(self, t0: float, t1: float, skins: bool) -> None:
        super().step_skins(t0, t1, skins)
        self._number += 1

    def _course(self, world: int, begun: Complex, t0: float, count: int) -> tuple[Moments, EmittedCourse]:
        assert self._block is not None
        course, row = self._block.course, self._number * count
        during, end = slice(row, row + count + 1), self._block.emitted[self._number + 1]
        if len(course.units) > 1:
            part = of_drives(course.units[during], end)._replace(batch=course.batch, row=row)
        else:
            part = course._replace(levels=course.levels[during], end=end)
        return substep_moments((), t0, self.models[0].step_s, count), part
