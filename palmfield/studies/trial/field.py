"""Sound at the hand's true place: with and without latency, rounding and calibration error."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.calibration_file import Calibration
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.drive.focus_fit import fitted_focus
from palmfield.errors import SceneError
from palmfield.simulation.emission import Emission
from palmfield.simulation.frames import Frames
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import frames_at
from palmfield.studies.trial.course import SceneCourse
from palmfield.studies.trial.sending import Heard
from palmfield.types import Complex, Float

GOOD_RAD = 1.0
"""Phases that fit a focus worse than this on average make none."""
HEARD = 0.3
"""Pressures are compared where the level is at least this share of the loudest frame's."""


class Pressures(NamedTuple):
    """|p| where the focus should be on the hand [Pa], at full level.

    wanted: had the drive been for that place; late: by the drive for where the system thought it was; rounded: by what
    the board made of that; heard: with transducers as they really are
    """

    wanted: float
    late: float
    rounded: float
    heard: float


@dataclass(frozen=True)
class TrialMoment:
    """What happens at a time of a trial [s].

    true: where the focus should be on the hand [m], believed: where the system thought so, sounding: where that of the
        sound is, NaN where there is none; array frame, shapes (3,)
    age_s: since the sample from which the sound was made; frame: its number; level: of the drive, 0..1
    pressures: at `true`, NaN where it is too silent to compare
    """

    time_s: float
    true: Float
    believed: Float
    sounding: Float
    age_s: float
    frame: int
    level: float
    pressures: Pressures


class TrueSound:
    """The sound of a trial at its course.

    number: of the stimulus whose focus is followed; its first focus where it has several
    flight: whether the time that sound takes to the hand counts
    """

    def __init__(
        self,
        course: SceneCourse,
        number: int,
        truth: Calibration | None,
        *,
        flight: bool = True,
        share: Callable[[float], float] = lambda due_s: 1.0,
    ) -> None:
        """truth: what the transducers of the scene's only array really do; None: what the scene says of them

        share: of all amplitudes, of a frame that is due at a time [s], by the driver's ramp
        Raises SceneError for a truth where there are several arrays, and for one of another layout.
        """
        self.course, self.number, self.flight, self.share = course, number, flight, share
        model = self.model = course.model
        self._truth = truth
        self._exact = Frames(model, Emission(model))
        self._arrays: tuple[PhasedArray, PhasedArray] | None = None
        self._fitted: tuple[Complex, Float] | None = None
        if truth is not None and len(model.spec.arrays) > 1:
            raise SceneError(
                f"a true calibration is given for a scene of {len(model.spec.arrays)} arrays; allowed: one array"
            )
        self.speed_m_s = sound_speed(model.arrays.air)
        middle = model.arrays.array.positions[model.stimuli[number].transducers].mean(axis=0)
        self._middle: list[float] = middle.tolist()
        self._wavenumber = 2.0 * np.pi * model.arrays.array.frequency_Hz / self.speed_m_s
        self.true_arrays(model.arrays)

    def true_arrays(self, arrays: PhasedArray) -> PhasedArray:
        """Arrays as they really are, where they stand now."""
        if self._truth is None:
            return arrays
        if self._arrays is None or self._arrays[0] is not arrays:
            instances = [
                replace(one, calibration=same_level(self._truth, one.calibration))
                for one in array_instances(self.model.spec)
            ]
            self._arrays = arrays, PhasedArray(instances, arrays.placements, self.model.spec.device)
        return self._arrays[1]

    def flight_s(self, focus: Float) -> float:
        """Time that sound takes from the middle of the transducers to a focus [s]."""
        if not self.flight:
            return 0.0
        return math.dist(focus.tolist(), self._middle) / self.speed_m_s

    def focus(self, posed_s: float, due_s: float) -> Float:
        """Where the focus of a due time is on the hand at another time [s], array frame [m], shape (3,)."""
        return focus_in(self.model, self.number, self.course.posed(posed_s), due_s)

    def ideal(self, time_s: float, due_s: float) -> Complex:
        """The drive of a due time [s] for where the hand truly is at another, before any board's limits, shape (N,).

        Silence where that can't be made, as a live hand may be behind the array.
        """
        try:
            return self.share(due_s) * self._exact.wanted(self.course.posed(time_s), due_s)
        except SceneError:
            return np.zeros(len(self.model.arrays), np.complex128)

    def moment(self, time_s: float, due_times: Sequence[float], heard: Heard, loudest: float) -> TrialMoment | None:
        """What a hand gets at a time [s]; None before the first frame.

        due_times: of all frames; loudest: level of the loudest of them, 0..1
        """
        emitted_s = time_s - self.flight_s(self.focus(time_s, time_s))
        found = heard.at(emitted_s)
        if found is None:
            return None
        emitted, sent = found
        due = last_due(due_times, emitted_s)
        true = self.focus(time_s, due)
        posed = self.course.posed(time_s)
        ideal = self.ideal(time_s, due)
        level, level_ideal = level_of(sent.frame.wanted), level_of(ideal)
        believed = sent.frame.focus
        pressures = [np.nan] * 4
        if min(level, level_ideal) >= HEARD * loudest > 0.0:
            known, real = posed.arrays, self.true_arrays(posed.arrays)
            point = true[None]
            played = emitted.amplitudes / level
            drives = (known, ideal / level_ideal), (known, sent.frame.wanted / level), (known, played), (real, played)
            pressures = [float(np.abs(arrays.pressure64(point, drive)[0])) for arrays, drive in drives]
        sounding = self._sounding(posed.arrays, emitted.amplitudes, believed)
        age_s = time_s - sent.frame.seen_s
        return TrialMoment(time_s, true, believed, sounding, age_s, sent.number, level, Pressures(*pressures))

    def _sounding(self, arrays: PhasedArray, amplitudes: Complex, near: Float) -> Float:
        """The focus to which the sound fits, if near the one that is meant; of several arrays that of the first."""
        last = self._fitted
        if last is not None and last[0] is amplitudes:
            return last[1]
        array = self.true_arrays(arrays).parts[0]
        gain = np.ones(len(array)) if array.gain is None else array.gain
        sound = amplitudes[: len(array)] * np.where(gain == 0.0, 0.0, np.exp(1j * np.angle(gain)))
        place, misfit = fitted_focus(array.positions, sound, self._wavenumber, near, anywhere=False)
        if not misfit < GOOD_RAD:
            place = np.full(3, np.nan)
        self._fitted = amplitudes, place
        return place


def focus_in(model: HapticModel, number: int, posed: PosedScene, due_s: float) -> Float:
    """The focus of a stimulus, the first of several, for a due time [s] in a pose, array frame [m], shape (3,)."""
    part = model.stimuli[number]
    points, _ = frames_at(part.config, np.array([due_s]))
    focus: Float = np.atleast_2d(posed.focal_points(part, number).at(points[0]))[0]
    return focus


def last_due(due_times: Sequence[float], time_s: float) -> float:
    """The last of some rising times [s] that is not after another; the first one before that."""
    return due_times[max(int(np.searchsorted(due_times, time_s + 1e-9, "right")) - 1, 0)]


def same_level(truth: Calibration, known: Calibration | None) -> Calibration:
    """A true calibration whose p0 is the known one: what is lost is lost for the focus, not for what p0 was thought."""
    return truth.model_copy(update={"p0": None if known is None else known.p0})


def level_of(drive: Complex) -> float:
    """Mean amplitude of the transducers that sound, 0 in silence."""
    size = np.abs(drive)
    on = size > 1e-9
    return float(size[on].mean()) if on.any() else 0.0
