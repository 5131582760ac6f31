"""Response of the transducers to the drive over time: their resonance, and the spread of flight times.

The carrier is not stepped. Each transducer is one complex pole, stepped exactly under a held or linear drive. For a
longer flight time, an earlier drive is used. A common delay of all transducers is omitted: it only shifts results.

`emitted_over` steps the transducers over one MuJoCo step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.config import StimulusConfig
from palmfield.drive.array_drive import ArrayDrive, UnitDrive
from palmfield.drive.response import Pole, pole_weights
from palmfield.drive.response_error import ResponseError, response_errors, shares
from palmfield.locked import next_serial
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.schedule import Moments, first_point, frames_at
from palmfield.types import Complex, Float, Int

DELAY_STEP_S = 20e-6
"""Resolution of flight times [s]: 2 % of a period of an envelope of 1 kHz."""
SILENT = 1e-9
"""Share of full drive below which an emission counts as zero."""
GRAIN_S = 1e-15
"""Resolution of step lengths [s], so that steps that differ only by rounding of the clock have the same weights."""
KEPT = 64
WHOLE: Float = np.ones((1, 1))

Weights = tuple[complex | Complex, complex | Complex, complex | Complex]


class PoleStepper:
    """Step transducers exactly under a linear drive; immutable except for cached weights.

    alike: whether all transducers have the same pole, so that the emission for one unit drive is stepped as a number
    tuned: whether all resonate at the frequency of the drive, so that weights are real, and a number rounds as an array
    """

    def __init__(self, pole: Pole):
        rates, self._index = np.unique(pole.rate, return_inverse=True)
        self.tuned = not rates.imag.any()
        self._rates: Any = rates.real if self.tuned else rates
        self.alike = len(rates) == 1
        self._stored: dict[int, Weights] = {}

    def weights(self, time_s: float) -> Weights:
        """Return weights of the emission before, and of the drive at the beginning and the end, over `time_s` [s].

        They are numbers if all transducers are equal, else arrays of shape (N,).
        """
        grains = round(time_s / GRAIN_S)
        weights = self._stored.get(grains)
        if weights is None:
            decay, held, slope = pole_weights(self._rates * (grains * GRAIN_S))
            parts = decay, held - slope, slope
            before, first, last = map(itemgetter(0 if self.alike else self._index), parts)
            weights = (before.item(), first.item(), last.item()) if self.alike else (before, first, last)
            if len(self._stored) >= KEPT:
                self._stored.clear()
            self._stored[grains] = weights
        return weights


@dataclass(frozen=True)
class TransducerResponse:
    """Whether ring-up and flight time are modelled (on), and the errors of the pressure if they are ignored.

    ring_up, flight_time: error without ring-up, and error with equal flight times of all transducers
    spread_s: longest minus shortest flight time [s]; pole: poles of the N transducers
    delays_s: flight times minus the mean of shortest and longest [s], in the reference pose, shape (N,); 0 if ignored
    """

    on: bool
    ring_up: ResponseError
    flight_time: ResponseError
    spread_s: float
    pole: Pole
    delays_s: Float

    @cached_property
    def stepper(self) -> PoleStepper:
        """Return the stepper of the transducers."""
        return PoleStepper(self.pole)

    @cached_property
    def delayed(self) -> bool:
        """Whether flight times differ."""
        return bool(self.delays_s.any())

    @cached_property
    def alike(self) -> bool:
        """Whether all transducers have the same response, so that any levels of one drive emit multiples of it."""
        return not self.on or (not self.delayed and self.stepper.alike)


def transducer_response(
    stimulus: StimulusConfig,
    drive: ArrayDrive,
    focal_points: FocalPoints,
    instances: Sequence[ArrayInstance],
    accuracy: float,
    *,
    spread: bool = True,
) -> TransducerResponse:
    """Decide which effects are modelled. ARP is quadratic in the pressure, so `auto` allows a quarter of the accuracy.

    focal_points: focal points of the stimulus in the reference pose; instances: instances of `drive.array.parts`
    accuracy: target relative error of the skin displacement; spread: whether flight times may differ
    """
    counts = [len(part) for part in drive.array.parts]
    poles = [one.pole(count) for one, count in zip(instances, counts, strict=True)]
    f0, quality = (np.concatenate(values) for values in zip(*poles, strict=True))
    pole = Pole(f0, quality, drive.array.array.frequency_Hz)
    focus = np.atleast_2d(focal_points.at(first_point(stimulus)))[0]
    chosen, gain = drive.chosen, drive.array.array.gain
    times = drive.flight_times(focus)
    weights = shares(
        drive.unit_drive(focus).amplitudes[chosen], None if gain is None else gain[chosen], times * drive.sound_speed
    )
    ring_up, flight_time = response_errors(
        stimulus, focal_points.along, drive.focusing, weights, pole.rate[chosen], times
    )
    owners = np.repeat(np.arange(len(counts)), counts)[chosen]
    switches = {instances[i].config.response for i in np.unique(owners)}
    on = "on" in switches or ("auto" in switches and ring_up.rms + flight_time.rms > 0.25 * accuracy)
    delayed = on and spread and flight_time.rms > 0.25 * accuracy
    delays = flight_delays(drive, focus) if delayed else np.zeros(len(f0))
    return TransducerResponse(on, ring_up, flight_time, float(np.ptp(times)), pole, delays)


def flight_delays(drive: ArrayDrive, focus: Float) -> Float:
    """Return flight times to a focus minus the mean of shortest and longest, in whole DELAY_STEP_S [s], shape (N,).

    Of several foci, shape (m, 3), the first is used. The value is 0 for transducers that are not chosen.
    """
    times = drive.flight_times(focus if focus.ndim == 1 else focus[0])
    middle = 0.5 * (np.maximum.reduce(times) + np.minimum.reduce(times))
    steps = np.rint((times - middle) / DELAY_STEP_S)
    if drive.everything:
        return DELAY_STEP_S * steps
    delays = np.zeros(drive.count)
    delays[drive.chosen] = DELAY_STEP_S * steps
    return delays


def commanded_drive(
    stimulus: StimulusConfig,
    drive: ArrayDrive,
    delays_s: Float | None,
    times: Float,
    focal_points: FocalPoints,
) -> Complex:
    """Return the drives, (k, N), whose sound arrives at times [s], shape (k,), without the common delay.

    delays_s: delay of each transducer, in whole DELAY_STEP_S [s], shape (N,); None: no delays
    Errors as for `ArrayDrive.unit_drive`, only for active points.
    """
    lags, group = _delay_groups(delays_s)
    points, levels = _points_and_levels(stimulus, times, lags)
    return _commanded(drive, points, levels, group, focal_points)


def _points_and_levels(stimulus: StimulusConfig, times: Float, lags: Float) -> tuple[Float, Float]:
    """Return points of the stimulus, (k, d, 3), and levels of the pressure, (k, d), at times minus lags."""
    when = times[:, None] - lags
    points, factors = frames_at(stimulus, when.reshape(-1))
    return points.reshape(*when.shape, 3), np.sqrt(factors, out=factors).reshape(when.shape)


def _commanded(
    drive: ArrayDrive, points: Float, levels: Float, group: Int | None, focal_points: FocalPoints
) -> Complex:
    """Return unit drives times levels, with points and levels of the group of each transducer, shape (k, N)."""
    audible = levels > 0.0
    if not np.logical_or.reduce(audible, axis=None):
        return np.zeros((len(points), drive.count), np.complex128)
    if len(points) > 1 and np.logical_and.reduce(points == points[:1], axis=None):
        # For a focus at rest, one drive is valid for all moments
        anywhere = np.logical_or.reduce(audible, axis=0, keepdims=True)
        drives = np.tile(drive.unit_drives(points[:1], focal_points, group, anywhere), (len(points), 1))
    else:
        drives = drive.unit_drives(points, focal_points, group, audible)
    # Boards with unrounded levels do not need this call in every step
    if drive.rounds_levels and not len(focal_points.offsets) and (drive.arp_peak_Pa is None or len(points) == 1):
        full = drive.amplitude if drive.arp_peak_Pa is None else drive.unit_drive_at(focal_points, points[0, 0]).level
        levels = drive.played_levels(levels, full)
    drives *= levels if group is None else levels[:, group]
    return drives


NO_LAG: Float = np.zeros(1)


def delays_now(stimulus: StimulusConfig, drive: ArrayDrive, focal_points: FocalPoints) -> tuple[Float, Int | None]:
    """Return `_delay_groups` for the present places of arrays and points of the stimulus; the last result is cached."""
    cached = drive.delays
    if cached is None or cached[0] is not focal_points:
        delays_s = flight_delays(drive, focal_points.at(first_point(stimulus)))
        drive.delays = cached = focal_points, _delay_groups(delays_s)
    return cached[1]


def _delay_groups(delays_s: Float | None) -> tuple[Float, Int | None]:
    """Return the distinct delays [s], (d,), and the index of the delay of each transducer, (N,), or None if d = 1."""
    if delays_s is None or not np.logical_or.reduce(delays_s):
        return NO_LAG, None
    steps = np.rint(delays_s / DELAY_STEP_S)
    first, last = np.minimum.reduce(steps), np.maximum.reduce(steps)
    return DELAY_STEP_S * np.arange(first, last + 1.0), (steps - first).astype(np.int32)


def ring(
    emitted: complex | Complex, commanded: Complex | Float, moments: Moments, stepper: PoleStepper
) -> tuple[Complex, complex | Complex]:
    """Step transducers through all moments; return their emission at each moment and at the end of the last step.

    emitted: emitted drive at the beginning, shape (N,); commanded: drive at the moments, shape (m, N), linear between
    moments; in a held part the moment is in the middle
    If all transducers are equal and emit multiples of one drive, a number and shape (m,) are enough.
    """
    at_moments = np.empty(commanded.shape, np.complex128)
    decay, before, after = stepper.weights(moments.step_s) if True in moments.linear else (0.0, 0.0, 0.0)
    half_s = -1.0
    for j, (linear, held_s) in enumerate(zip(moments.linear, moments.held_s, strict=True)):
        if linear:
            emitted = decay * emitted
            emitted += before * commanded[j - 1]
            emitted += after * commanded[j]
        if held_s > 0.0:
            if held_s != half_s:
                half_s = held_s
                half_decay, half_before, half_after = stepper.weights(0.5 * held_s)
                half_held = half_before + half_after
            push = half_held * commanded[j]
            emitted = half_decay * emitted + push
            at_moments[j] = emitted
            emitted = half_decay * emitted + push
        else:
            at_moments[j] = emitted
    return at_moments, emitted


class Batch(NamedTuple):
    """Drives of several steps whose fields are computed together. drives: shape (M, N)"""

    serial: int
    drives: Complex


class EmittedCourse(NamedTuple):
    """Emission of the transducers by stimuli at m moments: levels @ units.

    units: drives, shape (k, N): k = 0 in silence, 1 for one drive with varying level, number of stimuli, or one drive
        per moment (k = m > 1; then levels are the identity)
    levels: emitted multiple of each unit at each moment, complex, shape (m, k)
    end: complex amplitudes at the end of the last step, shape (N,); without response those at the beginning
    serial: equal for courses with the same patterns of ARP, of one unit or of each moment
    batch, row: drives of this and other steps, None without a batch, and the row of the first drive of this course
    """

    units: Complex
    levels: Complex
    end: Complex
    serial: int
    batch: Batch | None = None
    row: int = 0

    def weights(self, moments: Moments) -> tuple[Float, Float]:
        """Return weights of the patterns of ARP at the beginning and the end of each step of `moments`, shapes (s, p).

        The patterns are that of one unit, with weights proportional to |level|^2, or one for each moment; in silence
        one zero pattern.
        """
        if len(self.units) > 1:
            return moments.first, moments.last
        factors = np.abs(self.levels) ** 2 if len(self.units) else np.zeros((len(self.levels), 1))
        return moments.first @ factors, moments.last @ factors


def silence(moments: int, end: Complex) -> EmittedCourse:
    """Return a course of silence at some moments; end: as in EmittedCourse."""
    return EmittedCourse(np.zeros((0, len(end)), np.complex128), np.zeros((moments, 0), np.complex128), end, 0)


def of_unit(unit: UnitDrive, levels: Complex | Float, end: Complex) -> EmittedCourse:
    """Return the course of one drive at some levels, shape (m,)."""
    return EmittedCourse(unit.amplitudes[None], levels[:, None].astype(np.complex128, copy=False), end, unit.serial)


def of_drives(drives: Complex, end: Complex) -> EmittedCourse:
    """Return the course of one drive for each moment, shape (m, N); the array must not change later."""
    return EmittedCourse(drives, _identity(len(drives)), end, next_serial())


@lru_cache(maxsize=64)
def _identity(size: int) -> Complex:
    """Return the levels for one drive per moment, read-only, shape (m, m)."""
    identity = np.eye(size, dtype=np.complex128)
    identity.flags.writeable = False
    return identity


def emitted_over(
    stimulus: StimulusConfig,
    drive: ArrayDrive,
    response: TransducerResponse,
    emitted: Complex,
    focal_points: FocalPoints,
    moments: Moments,
) -> EmittedCourse:
    """Compute the emission of the transducers at the moments of one MuJoCo step, or of any equal steps.

    emitted: complex amplitudes at the beginning, shape (N,), not changed; not used without response, and not for
        transducers that this stimulus does not drive
    focal_points: places of the points of the stimulus during the step
    moments: `substep_moments` of this stimulus, or of all stimuli of a scene together
    For a stationary focus the result is levels of one unit drive, if this is true to SILENT. If all transducers are
    equal and have equal flight times, no array of shape (m, N) is made. Errors as for `ArrayDrive.unit_drive`.
    """
    if response.on and not drive.everything:
        emitted = _own(emitted, drive)
    lags, group = NO_LAG, None
    if response.on and response.delayed:
        lags, group = delays_now(stimulus, drive, focal_points)
    if group is None:
        points, factors = frames_at(stimulus, moments.times)
        points, levels = points[:, None], np.sqrt(factors, out=factors)[:, None]
    else:
        points, levels = _points_and_levels(stimulus, moments.times, lags)
    silent = not np.logical_or.reduce(levels, axis=None)
    if silent and (not response.on or np.maximum.reduce(np.abs(emitted)) < SILENT):
        return silence(len(levels), np.zeros_like(emitted) if response.on else emitted)
    if stimulus.path == "point":
        unit = drive.unit_drive_at(focal_points, points[0, 0])
        if drive.rounds_levels and not len(focal_points.offsets):
            levels = drive.played_levels(levels, unit.level)
        return _of_one_unit(unit, levels, group, response, emitted, moments)
    commanded = _commanded(drive, points, levels, group, focal_points)
    if not response.on:
        return of_drives(commanded, emitted)
    at_moments, end = ring(emitted, commanded, moments, response.stepper)
    return of_drives(at_moments, np.asarray(end))


def _own(emitted: Complex, drive: ArrayDrive) -> Complex:
    """Return the emission of the chosen transducers, 0 for all others."""
    own = np.zeros(emitted.shape, np.complex128)
    own[drive.chosen] = emitted[drive.chosen]
    return own


def _of_one_unit(
    unit: UnitDrive,
    levels: Float,
    group: Int | None,
    response: TransducerResponse,
    emitted: Complex,
    moments: Moments,
) -> EmittedCourse:
    """Return `emitted_over` for one focus with varying level; levels: levels of the drive, shape (m, d)."""
    if not response.on:
        return of_unit(unit, levels[:, 0], emitted)
    if group is None and response.stepper.alike:
        level = _level_of(unit, emitted)
        if level is not None:
            rung, end = ring(level, levels[:, 0], moments, response.stepper)
            rung *= np.abs(rung) * unit.peak >= SILENT
            return of_unit(unit, rung, end * unit.amplitudes)
    commanded = (levels if group is None else levels[:, group]) * unit.amplitudes
    at_moments, last = ring(emitted, commanded, moments, response.stepper)
    end = np.asarray(last)
    if unit.power > 0.0 and _level_of(unit, at_moments[-1]) is not None:
        rung = at_moments @ unit.conjugate / unit.power
        if np.maximum.reduce(np.abs(at_moments - rung[:, None] * unit.amplitudes), axis=None) < SILENT:
            rung *= np.abs(rung) * unit.peak >= SILENT
            return of_unit(unit, rung, end)
    return of_drives(at_moments, end)


def _level_of(unit: UnitDrive, emitted: Complex) -> complex | None:
    """Return the emitted multiple of a unit drive, or None if the emission is not a multiple."""
    level = complex(unit.conjugate @ emitted) / unit.power if unit.power > 0.0 else 0j
    rest = np.abs(emitted - level * unit.amplitudes)
    return level if np.maximum.reduce(rest) < SILENT else None


def emitted_now(
    stimulus: StimulusConfig,
    drive: ArrayDrive,
    response: TransducerResponse,
    emitted: Complex,
    focal_points: FocalPoints,
    time_s: float,
) -> EmittedCourse:
    """Return the emission of the transducers at the present time [s], as a course of one moment.

    emitted: present complex amplitudes of the state of the transducers, shape (N,). Without response: the drive.
    """
    if not response.on:
        return emitted_over(stimulus, drive, response, emitted, focal_points, instant(time_s))
    if not drive.everything:
        emitted = _own(emitted, drive)
    if np.maximum.reduce(np.abs(emitted)) < SILENT:
        return silence(1, emitted)
    if stimulus.path == "point":
        unit = drive.unit_drive_at(focal_points, first_point(stimulus))
        level = _level_of(unit, emitted)
        if level is not None:
            return of_unit(unit, np.array([level]), emitted)
    # A copy, because the array of the emission may be overwritten, and fields are cached by their drive
    return of_drives(emitted[None].copy(), emitted)


def present_drive(course: EmittedCourse) -> tuple[Complex | None, float]:
    """Return the drive at the first moment of a course, shape (N,), and the factor of its ARP; None in silence."""
    if len(course.units) > 1:
        return rows(course)[0], 1.0
    factor = abs(course.levels[0, 0]) ** 2 if len(course.units) else 0.0
    return (course.units[0], float(factor)) if factor > 0.0 else (None, 0.0)


def instant(time_s: float) -> Moments:
    """Return a single time [s] as moments without a step."""
    return Moments(np.array([time_s]), WHOLE, WHOLE, (False,), (0.0,), 0.0)


def combined(courses: Sequence[EmittedCourse]) -> EmittedCourse:
    """Return the sum over simultaneous stimuli, at the same moments; no transducer belongs to two stimuli.

    If all stimuli except one are silent, the result keeps the levels and the unit drive of that one.
    """
    if len(courses) == 1:
        return courses[0]
    end = courses[0].end
    for course in courses[1:]:
        end = end + course.end
    sounding = [course for course in courses if len(course.units)]
    if not sounding:
        return courses[0]._replace(end=end)
    if len(sounding) == 1:
        return sounding[0]._replace(end=end)
    units = list(map(attrgetter("units"), sounding))
    if len(sounding) >= len(courses[0].levels) or max(map(len, units)) > 1:
        return of_drives(np.add.reduce(list(map(rows, sounding))), end)
    levels = np.concatenate([course.levels for course in sounding], axis=1)
    return EmittedCourse(np.concatenate(units), levels, end, next_serial())


def rows(course: EmittedCourse) -> Complex:
    """Return the amplitudes at each moment, shape (m, N)."""
    if len(course.units) == len(course.levels) > 1:
        return course.units
    return np.asarray(course.levels @ course.units)
