"""Where a system believes a hand to be: what its tracker has told by now, some time ago, and how it moves on."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palmfield.errors import SceneError
from palmfield.motion.joints import ORIENTATION_VALID, POSITION_VALID
from palmfield.motion.prediction import Noise, Predictor
from palmfield.motion.quaternions import matrices
from palmfield.simulation.posed_scene import PosedScene
from palmfield.studies.trial.course import Frames, SceneCourse

LONGEST_AHEAD_S = 0.2
"""A hand is not known farther ahead."""
BEFORE_S = 0.5
"""For so long a tracker was on before the trial begins."""
MOST_AHEAD = 10_000
"""So many of its samples at most are computed before the trial begins."""


@dataclass(frozen=True)
class Tracker:
    """A tracker and what is made of its samples.

    rate_Hz: samples a second, 0 for one whenever it is asked; latency_s: from a sample's moment until it is there [s]
    noise_m: of each coordinate, standard deviation [m]; seed: of the noise
    ahead_s: by how much the hand is predicted beyond the last sample [s], 0 to take that as it is; None: to the middle
        of the time in which the frame will sound
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
            raise SceneError(
                "tracker rate has value 0, a sample whenever it is asked, from which nothing can be predicted; allowed "
                "with it: ahead 0"
            )


class Believed(NamedTuple):
    """posed: the scene as the system thinks it is; seen_s: time of the last sample that it knows [s]"""

    posed: PosedScene
    seen_s: float


class Belief:
    """A tracker that watches a scene's course."""

    def __init__(self, course: SceneCourse, tracker: Tracker) -> None:
        self.course, self.tracker = course, tracker
        noise = Noise(position_m=max(tracker.noise_m, Noise().position_m))
        self._filter = Predictor(noise, LONGEST_AHEAD_S, len(course.frames(0.0).positions))
        self._draws = np.random.default_rng(tracker.seed)
        stimuli = [part.spec.frame_moves for part in course.model.stimuli]
        self._tracked = np.array(stimuli + [True] * len(course.model.bodies))[:, None]
        self._next = -round(BEFORE_S * tracker.rate_Hz)
        self._last: tuple[float, Frames] | None = None
        # What the tracker is going to see takes no time from the frames that are made of it
        count = min(MOST_AHEAD, math.floor(course.end_s * tracker.rate_Hz) - self._next + 1) if tracker.rate_Hz else 0
        self._coming = deque(self._seen((self._next + number) / tracker.rate_Hz) for number in range(count))

    def at(self, now_s: float, heard_s: float) -> Believed:
        """What the system knows at a time of the trial [s], which must not fall.

        heard_s: the middle of the time in which the frame that is made now will sound [s]
        """
        rate, known_s = self.tracker.rate_Hz, now_s - self.tracker.latency_s
        if rate == 0.0:
            frames = self._seen(known_s)
            return Believed(self.course.posed(known_s, frames), known_s)
        while self._last is None or self._next <= math.floor(known_s * rate + 1e-9):
            sample_s = self._next / rate
            self._last = sample_s, self._coming.popleft() if self._coming else self._seen(sample_s)
            if self.tracker.ahead_s != 0.0:
                self._add(*self._last)
            self._next += 1
        sample_s, frames = self._last
        if self.tracker.ahead_s != 0.0:
            until_s = heard_s if self.tracker.ahead_s is None else sample_s + self.tracker.ahead_s
            positions, turned = self._filter.frames(min(until_s, sample_s + LONGEST_AHEAD_S))
            frames = Frames(positions, matrices(turned), turned)
        return Believed(self.course.posed(sample_s, frames), sample_s)

    def _seen(self, time_s: float) -> Frames:
        """A sample of the tracker at a time [s]. What can't move is known without a tracker."""
        frames = self.course.frames(time_s)
        if self.tracker.noise_m == 0.0:
            return frames
        # The tracker errs by the same for all that hangs on the hand
        noise = self._tracked * self._draws.normal(0.0, self.tracker.noise_m, 3)
        return frames._replace(positions=frames.positions + noise)

    def _add(self, time_s: float, frames: Frames) -> None:
        count = len(frames.positions)
        flags = np.full(count, POSITION_VALID | ORIENTATION_VALID, np.int32)
        self._filter.add(time_s, frames.positions, frames.quaternions, np.ones(count), flags)
