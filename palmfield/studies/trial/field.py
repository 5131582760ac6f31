"""Compute the sound at the true position of the hand, with and without latency, rounding and calibration error."""

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
from palmfield.studies.trial.sending import Drives
from palmfield.types import Complex, Float

GOOD_RAD = 1.0
"""Largest phase error [rad] at which a sound counts as a focus."""
LEAST_LEVEL = 0.3
"""Smallest level at which pressures are compared, relative to the level of the loudest frame."""


class Pressures(NamedTuple):
    """Pressure amplitudes at the target position on the hand [Pa], at full level.

    target: with the drive for the true position
    late: with the drive for the estimated position
    rounded: as late, after rounding by the board
    played: as rounded, with the true transducers
    """

    target: float
    late: float
    rounded: float
    played: float


@dataclass(frozen=True)
class TrialMoment:
    """Results at one time of a trial. Positions are in the array frame, shape (3,).

    true: position of the focus on the hand [m]
    believed: its position as estimated from the tracker [m]
    sounding: position of the focus of the sound [m], NaN if there is no focus
    age_s: time since the tracker sample of this sound [s]
    frame: number of the frame
    level: mean amplitude of the drive, 0 to 1
    pressures: pressures at `true`, NaN if the level is too low to compare
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
    """The sound of a trial over time.

    number: number of the followed stimulus; if it has several foci, the first is used
    flight: whether the flight time of sound to the hand is included
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
        """truth: true properties of the transducers of the only array; None: those of the scene
        share: function that returns the amplitude factor of a frame due at a time [s], from the ramp of the driver
        Raises SceneError for a truth with several arrays or another layout.
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
        """Return the arrays with their true properties, at their present poses."""
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
        """Return the flight time from the centre of the transducers to a focus [s]."""
        if not self.flight:
            return 0.0
        return math.dist(focus.tolist(), self._middle) / self.speed_m_s

    def focus(self, posed_s: float, due_s: float) -> Float:
        """Return the focus that is due at `due_s`, for the pose at `posed_s` [s], array frame [m], shape (3,)."""
        return focus_in(self.model, self.number, self.course.posed(posed_s), due_s)

    def ideal(self, time_s: float, due_s: float) -> Complex:
        """Return the drive due at `due_s` for the true hand at `time_s`, without the limits of a board, shape (N,).

        It is silent if no focus is possible, for instance for a live hand behind the array.
        """
        try:
            return self.share(due_s) * self._exact.target(self.course.posed(time_s), due_s)
        except SceneError:
            return np.zeros(len(self.model.arrays), np.complex128)

    def moment(self, time_s: float, due_times: Sequence[float], drives: Drives, loudest: float) -> TrialMoment | None:
        """Return the sound at the hand at a time [s]; None before the first frame.

        due_times: due times of all frames; loudest: highest level of all frames, 0..1
        """
        emitted_s = time_s - self.flight_s(self.focus(time_s, time_s))
        found = drives.at(emitted_s)
        if found is None:
            return None
        emitted, sent = found
        due = last_due(due_times, emitted_s)
        true = self.focus(time_s, due)
        posed = self.course.posed(time_s)
        ideal = self.ideal(time_s, due)
        level, level_ideal = level_of(sent.frame.target), level_of(ideal)
        believed = sent.frame.focus
        pressures = [np.nan] * 4
        if min(level, level_ideal) >= LEAST_LEVEL * loudest > 0.0:
            model, real = posed.arrays, self.true_arrays(posed.arrays)
            point = true[None]
            played = emitted.amplitudes / level
            cases = (model, ideal / level_ideal), (model, sent.frame.target / level), (model, played), (real, played)
            pressures = [float(np.abs(arrays.pressure64(point, drive)[0])) for arrays, drive in cases]
        sounding = self._sounding(posed.arrays, emitted.amplitudes, believed)
        age_s = time_s - sent.frame.sample_s
        return TrialMoment(time_s, true, believed, sounding, age_s, sent.number, level, Pressures(*pressures))

    def _sounding(self, arrays: PhasedArray, amplitudes: Complex, near: Float) -> Float:
        """Fit a focus to the sound near the target. With several arrays, the first one is used."""
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
    """Return the focus of a stimulus that is due at a time [s] in a pose, array frame [m], shape (3,).

    If the stimulus has several foci, return the first.
    """
    part = model.stimuli[number]
    points, _ = frames_at(part.config, np.array([due_s]))
    focus: Float = np.atleast_2d(posed.focal_points(part, number).at(points[0]))[0]
    return focus


def last_due(due_times: Sequence[float], time_s: float) -> float:
    """Return the last of some rising times [s] that is not after `time_s`, or the first time if there is none."""
    return due_times[max(int(np.searchsorted(due_times, time_s + 1e-9, "right")) - 1, 0)]


def same_level(truth: Calibration, modelled: Calibration | None) -> Calibration:
    """Return a true calibration with the p0 of the scene. An error of p0 then does not count as a loss."""
    return truth.model_copy(update={"p0": None if modelled is None else modelled.p0})


def level_of(drive: Complex) -> float:
    """Return the mean amplitude of the transducers that are on, 0 in silence."""
    size = np.abs(drive)
    on = size > 1e-9
    return float(size[on].mean()) if on.any() else 0.0
