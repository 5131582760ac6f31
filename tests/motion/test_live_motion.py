"""A hand that moves to the poses of a tracker, on a clock of its own."""

import math
import time

import numpy as np
import pytest

from palmfield.hand.articulated import articulate
from palmfield.hand.preset import load_preset
from palmfield.motion.live_hand import LivePose
from palmfield.motion.live_motion import FASTEST_m_s, FASTEST_rad_s, LiveMotion
from palmfield.motion.pose import HandPose

STEP_s, PERIOD_s = 1e-3, 1 / 90


@pytest.fixture(scope="module")
def hand():
    return articulate(load_preset("open_men_p50"))


def pose(hand, x=0.0, turn_rad=0.0, bend_deg=0.0):
    angles = {joint.name: joint.rest_deg for joint in hand.joints}
    angles["index_pip_flexion"] = bend_deg
    turned = np.array([math.cos(0.5 * turn_rad), 0.0, 0.0, math.sin(0.5 * turn_rad)])
    return HandPose(np.array([x, 0.0, 0.2]), turned, angles)


class Tracked:
    """A tracker whose newest pose is set by hand."""

    def __init__(self, hand):
        self.newest = None
        self.motion = LiveMotion(hand, lambda: self.newest, pose(hand))

    def arrive(self, one, ago_s=0.0):
        self.newest = LivePose(one, time.monotonic() - ago_s, 0.0)


def test_it_follows_a_constant_speed_one_period_late(hand):
    tracked, speed = Tracked(hand), 0.4
    places, steps = [], int(1.0 / STEP_s)
    for n in range(steps):
        if n % 11 == 0:
            tracked.arrive(pose(hand, speed * n * STEP_s, 0.5 * n * STEP_s, 30.0 * n * STEP_s))
        at = tracked.motion(n * STEP_s)
        places.append([at.position[0], 2.0 * math.asin(at.quaternion[3]), at.angles_deg["index_pip_flexion"]])
    late = np.arange(steps)[:, None] * STEP_s - np.array(places) / (speed, 0.5, 30.0)
    np.testing.assert_allclose(late[100:], 11 * STEP_s, atol=1.1e-3)
    np.testing.assert_allclose(np.diff(places, axis=0)[100:, 0], speed * STEP_s, rtol=0.2)


def test_a_first_sample_far_away_is_reached_at_the_largest_speed(hand):
    tracked = Tracked(hand)
    tracked.arrive(pose(hand, 0.6))
    places = np.array([tracked.motion(n * STEP_s).position[0] for n in range(300)])
    assert np.diff(places).max() <= FASTEST_m_s * STEP_s * (1.0 + 1e-9)
    assert places[199] < 0.6 and places[-1] == 0.6
    tracked.arrive(pose(hand, 0.6, math.pi / 2))
    turns = np.array([2.0 * math.asin(tracked.motion(0.3 + n * STEP_s).quaternion[3]) for n in range(200)])
    assert np.diff(turns).max() <= FASTEST_rad_s * STEP_s * (1.0 + 1e-6) and turns[-1] == pytest.approx(math.pi / 2)


def test_it_stays_where_it_is_after_the_last_sample_and_a_reset(hand):
    tracked = Tracked(hand)
    assert math.isnan(tracked.motion.age_s)
    tracked.arrive(pose(hand, 0.01))
    for n in range(200):
        last = tracked.motion(n * STEP_s)
    assert last.position[0] == 0.01
    assert tracked.motion(0.0).position[0] == 0.01
    tracked.arrive(pose(hand, 0.02))
    np.testing.assert_allclose([tracked.motion(n * STEP_s).position[0] for n in (1, 200)], (0.01, 0.02), atol=3.1e-3)


def test_the_age_is_that_of_the_pose_on_the_way(hand):
    tracked = Tracked(hand)
    tracked.arrive(pose(hand, 0.0), ago_s=0.3)
    tracked.motion(0.0)
    tracked.motion(0.05)
    assert tracked.motion.age_s == pytest.approx(0.3, abs=0.05)
    tracked.arrive(pose(hand, 0.15), ago_s=0.1)  # on its way for 50 ms
    tracked.motion(0.06)
    tracked.motion(0.085)
    assert tracked.motion.age_s == pytest.approx(0.2, abs=0.05)
