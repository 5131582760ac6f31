"""Commanded drive and emission of the transducers over a step.

An Emission belongs to one state and is used by one thread at a time. It stores the drives for the present pose of the
arrays, and the points of each stimulus at the last control tick.
"""

from typing import NamedTuple

import numpy as np

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.board import Board
from palmfield.drive.transducer_response import (
    NO_LAG,
    Batch,
    EmittedCourse,
    combined,
    commanded_drive,
    delays_now,
    emitted_now,
    emitted_over,
    of_drives,
)
from palmfield.locked import next_serial
from palmfield.simulation.model import HapticModel, StimulusModel, about_stimulus
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.modulation import peak_amplitude
from palmfield.stimulus.schedule import Moments, first_point, frames_at, mean_arp_factor, substep_moments
from palmfield.types import Complex, Float, Int

TICK_S = 1e-9
"""Tolerance of control ticks [s]. A tick that is closer in time counts as reached."""
LEAST_MEANS = 4
"""Smallest number of parts of a MuJoCo step for the mean force on bodies: 2 for moving drives, which cost more.

Estimated error with two parts: 5 % in the millisecond of ring-up, then 1 % for a focus that moves at 7 m/s.
"""
BOOLE, BOOLE_SHARES = 4, np.array([7.0, 32.0, 12.0, 32.0, 7.0]) / 90.0
"""Parts of a step in which a course is linear, and the weights of the ends of these parts in the mean."""
AHEAD, WORTHWHILE = 128, 32
"""Number of substeps computed ahead if nothing moves, and number of different drives from which this saves time."""
NEGLIGIBLE = 1e-5
"""Fraction of the emitted power that the mean force may omit."""


class MeanDrives(NamedTuple):
    """Drives and weights for a mean ARP, weights @ ARP(levels @ units). weights: shape (m,), empty in silence

    units: drives, shape (k, N); levels: complex, shape (m, k); serial: serial number, as in EmittedCourse
    """

    units: Complex
    levels: Complex
    weights: Float
    serial: int


SILENCE = MeanDrives(np.zeros((0, 0), np.complex128), np.zeros((0, 0), np.complex128), np.zeros(0), 0)


class PathStep(NamedTuple):
    """A focus that moves during a MuJoCo step.

    moments: moments of the step
    foci: foci of each of d groups of transducers at each moment, then at the beginning of the step, frame of the first
        array [m], shape (m d + 1, 3)
    group: group of each transducer, shape (n,); None for one group
    levels: pressure at the foci relative to the loudest moment, 0 to 1, shape (m d,); now: the same at the beginning
    mean: mean ARP over the step relative to the loudest moment
    weights: weights of the moments in the mean emission of transducers with ring-up, shape (m,)
    """

    moments: Moments
    foci: Float
    group: Int | None
    levels: Float
    now: float
    mean: float
    weights: Float


class _Coming(NamedTuple):
    """A step that was computed ahead. pose: serial number of its pose; begun: emission at t0 [s], shape (N,)"""

    pose: int
    t0: float
    begun: Complex
    moments: Moments
    course: EmittedCourse


Ticks = tuple[float | None, ...]


class PlacedStimulus(NamedTuple):
    """A stimulus, its drive for the present pose of the arrays, and its points."""

    stimulus: StimulusModel
    drive: ArrayDrive
    points: FocalPoints


class HeldPoints(NamedTuple):
    """Points of a stimulus at a control tick, and the time of this tick [s]. They stay fixed until the next tick."""

    time_s: float
    points: FocalPoints


class Emission:
    """Drives and emission of the transducers of a model.

    held: points of each stimulus with a control rate at its last tick, None before its first step; holds: whether any
        has
    ahead: whether steps are computed ahead (`coming`) while nothing moves; one matrix product computes all their fields
    """

    ahead = False

    def __init__(self, model: HapticModel):
        self.model = model
        self.held: list[HeldPoints | None] = [None] * len(model.stimuli)
        self._drives: tuple[int, list[ArrayDrive]] = (model.arrays.serial, array_drives(model, model.arrays))
        self._placed: tuple[int, list[PlacedStimulus]] = (0, [])
        self._over: tuple[tuple[int, float, int, bytes, Ticks], tuple[Moments, EmittedCourse]] | None = None
        self._now: tuple[tuple[int, float, bytes, Ticks], EmittedCourse] | None = None
        self.coming: list[_Coming] = []
        self._last_pose = 0  # serial number of the pose of the last step
        self.holds = any(config.control_rate_Hz > 0.0 for config in model.configs)
        self._moves_alone = _moves_alone(model, self._drives[1])

    def forget(self) -> None:
        """Reset to the start of a run: drop the points of the last ticks, and the steps computed ahead."""
        self.held = [None] * len(self.model.stimuli)
        self.coming, self._last_pose = [], 0

    def adopt(self, other: "Emission") -> None:
        """Continue from another Emission, for a copy of its state in the same PosedScenes."""
        self.held = list(other.held)
        self.coming, self._last_pose = list(other.coming), other._last_pose

    def begin(self, posed: PosedScene, time_s: float) -> None:
        """At the beginning of a step, store the points of the stimuli whose control tick is due."""
        for number, stimulus in enumerate(self.model.stimuli):
            if stimulus.config.control_rate_Hz > 0.0:
                held = self.held[number]
                if held is not None and time_s <= held.time_s:
                    # After a repeated moment or a reset to an earlier one, held points may lie elsewhere.
                    self.held[number] = None
                points = self.placed(posed, time_s)[number].points
                held = self.held[number]
                if held is None or held.points is not points:
                    self.held[number] = HeldPoints(time_s, points)

    def placed(self, posed: PosedScene, time_s: float) -> list[PlacedStimulus]:
        """Return the stimuli with their drives and points. Between control ticks, points stay as at the last tick."""
        if self._placed[0] != posed.serial:
            if self._drives[0] != posed.arrays.serial:
                self._drives = posed.arrays.serial, array_drives(self.model, posed.arrays)
            drives, placed = self._drives[1], []
            for number, stimulus in enumerate(self.model.stimuli):
                placed.append(PlacedStimulus(stimulus, drives[number], posed.focal_points(stimulus, number)))
            self._placed = posed.serial, placed
        placed = self._placed[1]
        if not self.holds:
            return placed
        return [self._at_tick(one, held, time_s) for one, held in zip(placed, self.held, strict=True)]

    def _at_tick(self, one: PlacedStimulus, held: HeldPoints | None, time_s: float) -> PlacedStimulus:
        if held is None or time_s < held.time_s:
            return one
        rate = one.stimulus.config.control_rate_Hz
        ticks = int((time_s + TICK_S) * rate), int((held.time_s + TICK_S) * rate)
        return one._replace(points=held.points) if ticks[0] == ticks[1] else one

    def over(self, posed: PosedScene, emitted: Complex, t0: float, count: int) -> tuple[Moments, EmittedCourse]:
        """Return the emission at the moments of `count` substeps from t0 [s] on. emitted: emission at t0, shape (N,)"""
        model, last = self.model, self._over
        key = posed.serial, round(t0, 12), count, emitted.tobytes(), self._ticks() if self.holds else ()
        # The mean force and the loads of the skins use the same course
        if last is not None and last[0] == key:
            return last[1]
        result = self._looked_ahead(posed, emitted, t0) if self.ahead and count == model.substeps else None
        if result is None:
            moments = substep_moments(model.configs, t0, model.step_s, count)
            result = moments, self._course(posed, emitted, t0, moments)
        self._over = key, result
        return result

    def _ticks(self) -> Ticks:
        """Return the time of the last control tick of each stimulus [s]."""
        return tuple([held and held.time_s for held in self.held])

    def _looked_ahead(self, posed: PosedScene, emitted: Complex, t0: float) -> tuple[Moments, EmittedCourse] | None:
        """Return this step from the steps computed ahead, if the pose is still that of the last step; else None."""
        still, self._last_pose = posed.serial == self._last_pose, posed.serial
        coming = self.coming.pop(0) if self.coming else None
        if still and (coming is None or not _begins(coming, posed, emitted, t0)):
            self.coming = self._look_ahead(posed, emitted.copy(), t0)
            coming = self.coming.pop(0)
        if not still or coming is None:
            self.coming = []
            return None
        return coming.moments, coming.course

    def _look_ahead(self, posed: PosedScene, begun: Complex, t0: float) -> list[_Coming]:
        """Compute coming steps with AHEAD substeps in all, in one batch of drives."""
        model, steps = self.model, list[_Coming]()
        while not steps or len(steps) * model.substeps < AHEAD:
            moments = substep_moments(model.configs, t0, model.step_s, model.substeps)
            course = self._course(posed, begun, t0, moments)
            steps.append(_Coming(posed.serial, t0, begun, moments, course))
            begun, t0 = course.end, t0 + model.spec.timestep_s
        if not all(len(one.course.units) == len(one.course.levels) > 1 for one in steps):
            return steps
        drives = np.concatenate([one.course.units for one in steps])
        # A focus that rests at a few points has few drives: computing each separately costs less
        changes = np.logical_or.reduce(drives[1:] != drives[:-1], axis=1)
        if np.add.reduce(changes) + 1 < WORTHWHILE:
            return steps
        batch, row, courses = Batch(next_serial(), drives), 0, list[_Coming]()
        for one in steps:
            courses.append(one._replace(course=one.course._replace(batch=batch, row=row)))
            row += len(one.course.units)
        return courses

    def _course(self, posed: PosedScene, emitted: Complex, t0: float, moments: Moments) -> EmittedCourse:
        courses = []
        for part, drive, place in self.placed(posed, t0):
            courses.append(emitted_over(part.config, drive, part.response, emitted, place, moments))
        return courses[0] if len(courses) == 1 else combined(courses)

    def path_step(self, posed: PosedScene, t0: float, count: int) -> PathStep | None:
        """Return the focus over `count` substeps from t0 [s] on, for a device that computes the drives.

        The result is None if the device cannot compute the drives: in silence, for a fixed point, and for several foci.
        A single focus must use all transducers, which must be equal and emit the commanded drive.
        """
        model = self.model
        if not self._moves_alone or (model.response_on and model.substeps == 1):
            return None
        part, drive, place = self.placed(posed, t0)[0]
        moments = substep_moments(model.configs, t0, model.step_s, count)
        lags, group = NO_LAG, None
        if part.response.on and part.response.delayed:
            lags, group = delays_now(part.config, drive, place)
        times = np.append(moments.times[:, None] - lags, t0)
        points, factors = frames_at(part.config, times)
        if not np.logical_or.reduce(factors):
            return None
        means = max(LEAST_MEANS, model.substeps)
        mean = mean_arp_factor(part.config, t0, t0 + model.spec.timestep_s, means)
        levels = np.sqrt(factors)
        weights = mean_weights(moments)
        return PathStep(moments, place.along(points), group, levels[:-1], float(levels[-1]), mean, weights)

    def now(self, posed: PosedScene, emitted: Complex, time_s: float) -> EmittedCourse:
        """Return the emission at the present time [s], as a course of one moment; emitted: shape (N,)."""
        # Stored because the sensors of several skins need it
        last, key = self._now, (posed.serial, time_s, emitted.tobytes(), self._ticks() if self.holds else ())
        if last is not None and last[0] == key:
            return last[1]
        first = None if self.model.response_on else self._first(posed, emitted, time_s)
        if first is not None:
            result = of_drives(first, emitted)
        else:
            courses = []
            for part, drive, place in self.placed(posed, time_s):
                courses.append(emitted_now(part.config, drive, part.response, emitted, place, time_s))
            result = courses[0] if len(courses) == 1 else combined(courses)
        self._now = key, result
        return result

    def _first(self, posed: PosedScene, emitted: Complex, t0: float) -> Complex | None:
        """Return the emission at t0 [s], shape (1, N), if `over` has computed the step that begins at t0; else None.

        This works only for a focus that moves on a straight line from there, and for transducers without ring-up.
        """
        if self._over is None or self.holds:
            return None
        (pose, begin, _, before, _), (moments, course) = self._over
        same = (pose, begin, before) == (posed.serial, round(t0, 12), emitted.tobytes())
        if not same or moments.held_s[0] > 0.0 or not len(course.units) == len(course.levels) > 1:
            return None
        return course.units[:1]

    def commanded(self, posed: PosedScene, times: Float) -> Complex:
        """Return the commanded drive at some times [s], shape (k, N), before the response of the transducers."""
        total = np.zeros((len(times), len(posed.arrays)), np.complex128)
        for part, drive, place in self.placed(posed, float(times[0])):
            total += commanded_drive(part.config, drive, None, times, place)
        return total

    def foci(self, posed: PosedScene, times: Float) -> list[Float]:
        """Return the foci of each stimulus at some times [s], array frame [m], shapes (k, foci, 3)."""
        result = []
        for part, _, place in self.placed(posed, float(times[0])):
            points, _ = frames_at(part.config, times)
            if len(part.offsets):
                result.append(np.array([place.at(point) for point in points]))
            else:
                result.append(place.along(points)[:, None])
        return result

    def mean_drives(self, posed: PosedScene, emitted: Complex, t0: float) -> MeanDrives:
        """Return the drives and weights of the mean ARP over the MuJoCo step that begins at t0 [s].

        The mean is over the emission at the moments of the step. For a single stimulus without ring-up, the focus at
        the beginning of the step is used. The result is None in silence.
        """
        model = self.model
        timestep_s = model.spec.timestep_s
        count = max(LEAST_MEANS, model.substeps)
        part = model.stimuli[0]
        if model.response_on or len(model.stimuli) > 1:
            hold = len(model.stimuli) == 1 and part.config.path == "point"
            if model.substeps > 1 and not hold:
                count = model.substeps
                moments, course = self.over(posed, emitted, t0, count)
            else:
                moments = substep_moments(model.configs, t0, timestep_s / count, count, hold=hold)
                course = self._course(posed, emitted, t0, moments)
            return of_moments(course, mean_weights(moments))
        level = mean_arp_factor(part.config, t0, t0 + timestep_s, count)
        if part.silent or level == 0.0:
            return SILENCE
        _, drive, place = self.placed(posed, t0)[0]
        if part.config.path == "point":
            point = first_point(part.config)
        else:
            points, factors = frames_at(part.config, np.array([t0]))
            first = self._first(posed, emitted, t0)
            if first is not None and factors[0] > 0.0:
                return of_one(first, level / factors[0], next_serial())
            point = points[0]
        unit = drive.unit_drive_at(place, point)
        return of_one(unit.amplitudes[None], level, unit.serial)


def mean_weights(moments: Moments) -> Float:
    """Return the weight of each moment in the mean over all steps, shape (m,); 0 for omitted moments.

    On a linear course, five moments are as exact as all, by Boole's rule (Abramowitz and Stegun 25.4.14). In
    `hover_explore` the forces differ by 0.077 % from those of eight times as many moments; with all 13 by 0.084 %.
    """
    steps = len(moments.first)
    if steps > BOOLE and steps % BOOLE == 0 and True not in moments.linear[:1] and all(moments.linear[1:]):
        weights = np.zeros(steps + 1)
        weights[:: steps // BOOLE] = BOOLE_SHARES
        return weights
    return np.asarray(0.5 * np.add.reduce(moments.first + moments.last, axis=0) / len(moments.first))


def of_one(unit: Complex, weight: float, serial: int) -> MeanDrives:
    """Return the mean ARP of one drive, shape (1, N), with a level that varies."""
    return MeanDrives(unit, np.ones((1, 1), np.complex128), np.array([weight]), serial)


def of_moments(course: EmittedCourse, weights: Float) -> MeanDrives:
    """Return the mean ARP over a course, by the fewest drives that span its moments. weights: of the moments, (m,)

    Moments are computed separately, because the lit points of each moment depend on its own energy flux.
    """
    if len(course.units) < 2:
        level = float(np.add.reduce(weights @ np.abs(course.levels) ** 2))
        return SILENCE if level == 0.0 else of_one(course.units, level, course.serial)
    if len(course.units) < len(course.levels):
        return MeanDrives(course.units, course.levels, weights, next_serial())
    counted = weights > 0.0
    roots = np.sqrt(weights[counted])[:, None]
    scaled = roots * course.units[counted]
    powers, shares = np.linalg.eigh(scaled @ scaled.conj().T)
    strong = powers > NEGLIGIBLE * powers[-1]
    if not np.logical_or.reduce(strong):
        return SILENCE
    levels = np.asarray(shares[:, strong] / roots, np.complex128)
    return MeanDrives(shares.conj().T[strong] @ scaled, levels, weights[counted], next_serial())


def _begins(step: _Coming, posed: PosedScene, emitted: Complex, t0: float) -> bool:
    """Return whether a step begins with this pose and emission."""
    here = step.pose == posed.serial and abs(step.t0 - t0) < TICK_S
    return here and not np.logical_or.reduce(step.begun != emitted)


def looks_ahead(model: HapticModel) -> bool:
    """Return whether coming drives differ, and one matrix product can compute the loads of many of them."""
    changing = any(part.config.path != "point" or part.response.delayed for part in model.stimuli)
    alike = len(model.arrays.groups) == 1 and model.arrays.wall_m is None
    return changing and model.free and alike and model.arrays.precision == "fast"


def _moves_alone(model: HapticModel, drives: list[ArrayDrive]) -> bool:
    """Return whether the only sound is one moving focus of equal transducers."""
    if len(model.stimuli) != 1:
        return False
    stimulus, drive = model.stimuli[0], drives[0]
    response = stimulus.response
    alike = not response.on or response.stepper.alike
    single = stimulus.config.path != "point" and len(stimulus.offsets) == 0
    return single and alike and drive.everything and drive.board.exact and drive.correction is None


def array_drives(model: HapticModel, arrays: PhasedArray, board: Board | None = None) -> list[ArrayDrive]:
    """Return each stimulus's drive for one relative pose of the arrays. board: None for that of the model"""
    board = model.board if board is None else board
    drives = []
    for part in model.stimuli:
        about, config = about_stimulus(part.spec), part.config
        level = peak_amplitude(config)
        drives.append(ArrayDrive(arrays, part.transducers, config.arp_peak_Pa, level, board, about[:1], about))
    return drives
