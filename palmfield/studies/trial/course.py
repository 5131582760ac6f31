"""Poses of a scene at any time of a trial, and their estimates from tracker samples, with latency and extrapolation."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.drive.playback import ON_STEP
from palmfield.errors import SceneError
from palmfield.motion.joints import ORIENTATION_VALID, POSITION_VALID
from palmfield.motion.prediction import Noise, Predictor
from palmfield.motion.quaternions import inverse, matrices, of_turns, product, turns_of
from palmfield.session.preview import Preview
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface
from palmfield.transforms import Transform, quaternion
from palmfield.types import Float

NO_OBSTACLES = np.zeros((0, 3)), np.zeros((0, 3, 3))
LONGEST_AHEAD_S = 0.2
"""Longest extrapolation of a hand [s]."""
BEFORE_S = 0.5
"""Time for which the simulated tracker runs before the trial begins [s]."""
MOST_AHEAD = 10_000
"""Largest number of tracker samples that are computed before the trial begins."""


class Frames(NamedTuple):
    """Moving frames relative to the first array: those of the stimuli, then those of the bodies.

    positions: [m], shape (m, 3)
    rotations: axes as columns, shape (m, 3, 3)
    quaternions: the same rotations, w first, shape (m, 4)
    """

    positions: Float
    rotations: Float
    quaternions: Float


class SceneCourse:
    """Poses at MuJoCo's steps, interpolated linearly. They are constant before the first step and after the last.

    model: model of the scene
    step_s: time between poses [s]
    end_s: time of the last pose [s]
    refused: reason of an early end
    """

    def __init__(self, view: Preview, duration_s: float, *, as_far_as_it_goes: bool = False) -> None:
        """Step a copy of the scene without its skins. Raises the errors of modules in a step.

        as_far_as_it_goes: whether to end without an error if the hand reaches into the array, as a tracked hand may
        """
        self.refused = ""
        self.step_s = view.runtime.spec.timestep_s
        count = math.ceil(duration_s / self.step_s - ON_STEP) + 1 if view.moves else 1
        self.model: HapticModel = view.runtime.model
        self._rows: list[Frames] = []
        self._turns: dict[int, Float] = {}
        self._bones: list[list[tuple[Float, Float]]] = []
        self._outer: list[tuple[Transform, PhasedArray]] = []
        try:
            for _, runtime, posed in view.posed_at(self.step_s * np.arange(count)):
                self.model = runtime.model
                self._add(posed)
        except SceneError as error:
            if not as_far_as_it_goes or len(self._rows) < 2:
                raise
            count, self.refused = len(self._rows), str(error)
        self.end_s = (count - 1) * self.step_s

    @property
    def moves(self) -> bool:
        """Return whether any part may move."""
        return len(self._rows) > 1

    def frames(self, time_s: float) -> Frames:
        """Return the frames of stimuli and bodies at a time [s]."""
        row, share = self._place(time_s)
        before = self._rows[row]
        if share == 0.0:
            return before
        after = self._rows[row + 1]
        if row not in self._turns:
            self._turns[row] = turns_of(product(after.quaternions, inverse(before.quaternions)))
        quaternions = product(of_turns(share * self._turns[row]), before.quaternions)
        positions = (1.0 - share) * before.positions + share * after.positions
        return Frames(positions, matrices(quaternions), quaternions)

    def posed(self, time_s: float, frames: Frames | None = None) -> PosedScene:
        """Return the scene at a time [s], or with other frames.

        Obstacles are omitted, because foci do not need them.
        """
        row, _ = self._place(time_s)
        positions, rotations, _ = self.frames(time_s) if frames is None else frames
        of_stimuli = len(self.model.stimuli)
        parts = [Transform(*pair) for pair in zip(positions, rotations, strict=True)]
        bodies = []
        for number, frame in enumerate(parts[of_stimuli:]):
            first = self.model.skins[self.model.first_skins[number]]
            bodies.append(PosedSurface(self.model.bodies[number], first, frame, self._bones[row][number]))
        skins = [PosedSkin(skin, bodies[skin.body], NO_OBSTACLES) for skin in self.model.skins]
        outer, arrays = self._outer[row]
        return PosedScene(outer, arrays, parts[:of_stimuli], bodies, skins)

    def _place(self, time_s: float) -> tuple[int, float]:
        """Return the index of the pose before a time [s], and the fraction of the interval to the next pose."""
        at = min(max(time_s / self.step_s, 0.0), float(len(self._rows) - 1))
        nearest = round(at)
        if abs(at - nearest) < ON_STEP:
            return nearest, 0.0
        return int(at), at - int(at)

    def _add(self, posed: PosedScene) -> None:
        parts = [*posed.frames, *(body.frame for body in posed.bodies)]
        positions, rotations = np.array([one.position for one in parts]), np.array([one.rotation for one in parts])
        self._rows.append(Frames(positions, rotations, np.array([quaternion(one) for one in rotations])))
        self._bones.append([(body.bone_positions, body.bone_rotations) for body in posed.bodies])
        self._outer.append((posed.array_frame, posed.arrays))


@dataclass(frozen=True)
class Tracker:
    """A tracker, and how its samples are used.

    rate_Hz: samples per second; 0 for a sample at each call
    latency_s: time from the moment of a sample to its arrival [s]
    noise_m: standard deviation of the noise of each coordinate [m]
    seed: seed of the noise
    ahead_s: extrapolation beyond the last sample [s]; 0 for no extrapolation. None extrapolates to the middle of the
        time in which the frame will sound
    """

    rate_Hz: float = 90.0
    latency_s: float = 0.010
    noise_m: float = 0.0
    seed: int = 0
    ahead_s: float | None = None

    def __post_init__(self) -> None:
        for name, value, most in (
            ("rate", self.rate_Hz, 1e4), ("latency", self.latency_s, 1.0), ("noise", self.noise_m, 0.1),
            ("ahead", self.ahead_s or 0.0, LONGEST_AHEAD_S),
        ):  # fmt: skip
            if not 0.0 <= value <= most:
                raise SceneError(f"tracker {name} has value {value:g}; allowed: 0 to {most:g}")
        if self.rate_Hz == 0.0 and self.ahead_s != 0.0:
            raise SceneError("tracker rate 0 gives no history to predict from; use ahead 0, or a rate above 0")


class EstimatedPose(NamedTuple):
    """Pose from the tracker. posed: estimated scene; sample_s: time of the last sample that has arrived [s]"""

    posed: PosedScene
    sample_s: float


class PoseEstimator:
    """A simulated tracker that samples the poses of a scene over time."""

    def __init__(self, course: SceneCourse, tracker: Tracker) -> None:
        self.course, self.tracker = course, tracker
        noise = Noise(position_m=max(tracker.noise_m, Noise().position_m))
        self._filter = Predictor(noise, LONGEST_AHEAD_S, len(course.frames(0.0).positions))
        self._draws = np.random.default_rng(tracker.seed)
        stimuli = [part.spec.frame_moves for part in course.model.stimuli]
        self._tracked = np.array(stimuli + [True] * len(course.model.bodies))[:, None]
        self._next = -round(BEFORE_S * tracker.rate_Hz)
        self._last: tuple[float, Frames] | None = None
        # Samples are computed in advance, so that they do not delay frames
        count = min(MOST_AHEAD, math.floor(course.end_s * tracker.rate_Hz) - self._next + 1) if tracker.rate_Hz else 0
        self._coming = deque(self._sample((self._next + number) / tracker.rate_Hz) for number in range(count))

    def at(self, now_s: float, sound_s: float) -> EstimatedPose:
        """Return the estimate at a time of the trial [s]. Times must not decrease between calls.

        sound_s: middle of the time in which the frame made now will sound [s]
        """
        rate, arrived_s = self.tracker.rate_Hz, now_s - self.tracker.latency_s
        if rate == 0.0:
            frames = self._sample(arrived_s)
            return EstimatedPose(self.course.posed(arrived_s, frames), arrived_s)
        while self._last is None or self._next <= math.floor(arrived_s * rate + 1e-9):
            sample_s = self._next / rate
            self._last = sample_s, self._coming.popleft() if self._coming else self._sample(sample_s)
            if self.tracker.ahead_s != 0.0:
                self._add(*self._last)
            self._next += 1
        sample_s, frames = self._last
        if self.tracker.ahead_s != 0.0:
            until_s = sound_s if self.tracker.ahead_s is None else sample_s + self.tracker.ahead_s
            positions, turned = self._filter.frames(min(until_s, sample_s + LONGEST_AHEAD_S))
            frames = Frames(positions, matrices(turned), turned)
        return EstimatedPose(self.course.posed(sample_s, frames), sample_s)

    def _sample(self, time_s: float) -> Frames:
        """Return a sample of the tracker at a time [s]. Parts that do not move have no error."""
        frames = self.course.frames(time_s)
        if self.tracker.noise_m == 0.0:
            return frames
        # All parts that move with the hand have the same tracker error
        noise = self._tracked * self._draws.normal(0.0, self.tracker.noise_m, 3)
        return frames._replace(positions=frames.positions + noise)

    def _add(self, time_s: float, frames: Frames) -> None:
        count = len(frames.positions)
        flags = np.full(count, POSITION_VALID | ORIENTATION_VALID, np.int32)
        self._filter.add(time_s, frames.positions, frames.quaternions, np.ones(count), flags)
