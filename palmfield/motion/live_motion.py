"""Motion of a scene that follows a tracked hand, without jumps between its samples."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from palmfield.hand.articulated import ArticulatedHand
from palmfield.motion.live_hand import LivePose
from palmfield.motion.pose import HandPose
from palmfield.motion.quaternions import inverse, of_turns, product, turns_of, unit
from palmfield.types import Float

LEAST_s, MOST_s = 0.001, 0.1
"""Shortest and longest time in which the hand moves to a new sample, if it is near [s]."""
FASTEST_m_s, FASTEST_rad_s = 3.0, 20.0
"""Largest speed of the hand and largest rate of its rotation. They limit the motion to a first sample far away, and
that of a scene that is slower than real time."""


class LiveMotion:
    """Motion that moves to each new pose of a tracked hand in the time between samples.

    So it is up to one period of the samples late, but its speed has no jumps to infinity. It stays where it is while
    the hand is lost.
    """

    def __init__(self, hand: ArticulatedHand, newest: Callable[[], LivePose | None], first: HandPose) -> None:
        """newest: function that returns the last pose of the hand, None before the first; first: pose until then"""
        angles = {joint.name: first.angles_deg.get(joint.name, joint.rest_deg) for joint in hand.joints}
        first = replace(first, angles_deg=angles)
        self._newest = newest
        self._seen: LivePose | None = None
        self._begun_s, self._ends_s, self._last_s = 0.0, 0.0, 0.0
        self._arrivals_s = math.nan, math.nan  # of the poses between which the hand moves
        self._from, self._to = first, first

    @property
    def age_s(self) -> float:
        """Age of the pose of the hand: time since its sample arrived [s]; NaN before the first."""
        return time.monotonic() - self._arrived_s(self._last_s)

    def _arrived_s(self, time_s: float) -> float:
        begin_s, end_s = self._arrivals_s
        return begin_s + self._share(time_s) * (end_s - begin_s)

    def __call__(self, time_s: float) -> HandPose:
        """Return the pose at the present time of the scene [s], or at a time shortly before or after it."""
        newest = self._newest()
        if newest is not None and newest is not self._seen:
            self._begin(newest, time_s)
        elif time_s < self._last_s - MOST_s:
            # The scene was reset
            self._begun_s = self._ends_s = time_s
        self._last_s = time_s
        return self._at(time_s)

    def _begin(self, newest: LivePose, time_s: float) -> None:
        """Begin to move to a new pose."""
        now, then = self._at(time_s), newest.pose
        distance_m = float(np.linalg.norm(then.position - now.position))
        turn_rad = float(np.linalg.norm(_turn(now, then)))
        passed_s = min(max(time_s - self._begun_s, LEAST_s), MOST_s)
        took_s = max(passed_s, distance_m / FASTEST_m_s, turn_rad / FASTEST_rad_s)
        first_s = newest.arrived_s if self._seen is None else self._arrived_s(time_s)
        self._arrivals_s = first_s, newest.arrived_s
        self._from, self._to, self._seen = now, then, newest
        self._begun_s, self._ends_s = time_s, time_s + took_s

    def _share(self, time_s: float) -> float:
        """Return the passed share of the way."""
        length_s = self._ends_s - self._begun_s
        return 1.0 if length_s <= 0.0 else min(max((time_s - self._begun_s) / length_s, 0.0), 1.0)

    def _at(self, time_s: float) -> HandPose:
        share, begin, end = self._share(time_s), self._from, self._to
        if share == 1.0:
            return end
        turned = unit(product(of_turns(share * _turn(begin, end)[None]), begin.quaternion[None]))[0]
        bent = begin.angles_deg
        angles = {name: (1.0 - share) * bent[name] + share * angle for name, angle in end.angles_deg.items()}
        return HandPose((1.0 - share) * begin.position + share * end.position, turned, angles)


def _turn(begin: HandPose, end: HandPose) -> Float:
    """Return the rotation vector from one orientation to the other [rad], world axes, shape (3,)."""
    return turns_of(product(end.quaternion[None], inverse(begin.quaternion[None])))[0]
