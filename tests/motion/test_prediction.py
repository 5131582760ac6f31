from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.motion.joints import ALL_FLAGS, JOINTS, POSITION_TRACKED, POSITION_VALID
from palmfield.motion.prediction import Noise, Predictor, resample
from palmfield.motion.tracking import Stream, stream_of

RATE_Hz = 90.0


@pytest.fixture(scope="module")
def tracked(median, swing, disturbed):
    """A swing of two seconds as a tracker of 90 packets a second with 1 ms of jitter sees it."""
    times = np.arange(0.0, 2.0, 1.0 / RATE_Hz)
    times = times + np.random.default_rng(3).normal(0.0, 0.001, len(times))
    return disturbed(stream_of(median, swing, times), 5e-4, 0.01)


def straight(times, speed, spin):
    """All joints at one speed [m/s] and turning about x at a rate [rad/s]."""
    n = len(times)
    positions = np.tile(np.outer(times, speed)[:, None], (1, 26, 1))
    turns = Rotation.from_rotvec(np.outer(times, [spin, 0.0, 0.0])).as_quat(scalar_first=True)
    flags = np.full((n, 26), ALL_FLAGS, dtype=np.int32)
    return Stream(times, positions, np.tile(turns[:, None], (1, 26, 1)), np.full((n, 26), 0.01), flags)


@pytest.mark.parametrize("ahead", [0.01, 0.02, 0.03])
def test_prediction_is_several_times_nearer_than_holding(median, swing, tracked, ahead):
    clock = np.arange(0.5, 1.9, 1.0 / 120.0)
    true = stream_of(median, swing, clock + ahead)
    found = resample(tracked, clock, ahead).stream
    last = np.searchsorted(tracked.times_s, clock, side="right") - 1

    def miss(positions):
        return np.sqrt(np.mean(np.sum((positions - true.positions) ** 2, axis=2)))

    def turn(quaternions):
        seen, meant = (Rotation.from_quat(q.reshape(-1, 4), scalar_first=True) for q in (quaternions, true.quaternions))
        return np.sqrt(np.mean((seen * meant.inv()).magnitude() ** 2))

    assert found.times_s == pytest.approx(clock + ahead)
    assert miss(found.positions) < 0.3 * miss(tracked.positions[last])
    assert miss(found.positions) < {0.01: 0.0015, 0.02: 0.0021, 0.03: 0.0027}[ahead]
    assert turn(found.quaternions) < 0.6 * turn(tracked.quaternions[last])


def test_gains_settle_at_those_of_the_alpha_beta_filter():
    """Kalata (1984), The tracking index, IEEE Trans. Aerosp. Electron. Syst. 20(2)."""
    noise, period = Noise(), 1.0 / RATE_Hz
    for sigma, acceleration, step in (
        (noise.position_m, noise.accel_m_s2, "position"),
        (noise.angle_rad, noise.accel_rad_s2, "turn"),
    ):
        index = acceleration * period**2 / sigma
        r = (4.0 + index - np.sqrt(8.0 * index + index**2)) / 4.0
        alpha = 1.0 - r**2
        beta = 2.0 * (2.0 - alpha) - 4.0 * np.sqrt(1.0 - alpha)
        predictor = Predictor(noise, 1.0)
        still = straight(np.arange(200) * period, [0.0, 0.0, 0.0], 0.0)
        for n in range(199):
            predictor.add(
                still.times_s[n],
                *(part[n] for part in (still.positions, still.quaternions, still.radii)),
                still.flags[n],
            )
        off = 1e-3
        moved = still.positions[199] + [off, 0.0, 0.0]
        turned = np.tile(Rotation.from_rotvec([off, 0.0, 0.0]).as_quat(scalar_first=True), (26, 1))
        predictor.add(still.times_s[199], moved, turned, still.radii[199], still.flags[199])
        now, later = predictor.at(still.times_s[199]), predictor.at(still.times_s[199] + period)
        if step == "position":
            here, there = now[0][:, 0], later[0][:, 0]
        else:
            here, there = (Rotation.from_quat(p[1], scalar_first=True).as_rotvec()[:, 0] for p in (now, later))
        assert here == pytest.approx(np.full(26, alpha * off), rel=1e-4)
        assert there - here == pytest.approx(np.full(26, beta * off), rel=1e-4)


def test_steady_motion_is_predicted_without_error():
    speed, spin = np.array([0.3, -0.2, 0.1]), 2.0
    times = np.sort(np.random.default_rng(1).uniform(0.0, 2.0, 180))
    found = resample(straight(times, speed, spin), [1.7, 1.9], 0.02).stream
    expected = straight(np.array([1.72, 1.92]), speed, spin)
    assert found.positions == pytest.approx(expected.positions, abs=2e-5)
    turns = [Rotation.from_quat(q.reshape(-1, 4), scalar_first=True) for q in (found.quaternions, expected.quaternions)]
    assert (turns[0] * turns[1].inv()).magnitude().max() < 1e-3


def test_gaps_are_predicted_for_the_stated_time_then_held_and_left_afresh():
    speed = np.array([0.2, 0.0, 0.0])
    times = np.arange(0.0, 2.0, 0.01)
    gap = (times > 1.0) & (times < 1.5)
    stream = straight(times[~gap], speed, 0.0)
    last = float(times[~gap & (times < 1.2)][-1])
    found = resample(stream, [-0.1, last + 0.05, last + 0.09, last + 0.3, 1.6], 0.0, predict_s=0.1)
    x = found.stream.positions[:, 0, 0]
    assert x[1:] == pytest.approx(0.2 * np.array([last + 0.05, last + 0.09, last + 0.1, 1.6]), abs=1e-4)
    flags = found.stream.flags[:, 0]
    assert flags[0] == 0 and np.isinf(found.age_s[0]).all()
    assert [bool(f & POSITION_TRACKED) for f in flags[1:]] == [True, True, False, True]
    assert np.all(flags[1:] & POSITION_VALID)
    assert found.held == pytest.approx(0.25)
    assert found.age_s[3, 0] == pytest.approx(0.3)
    assert found.report.dropouts == 1
    # Not a trace of the jump over the gap is left in the speed.
    after = float(stream.times_s[stream.times_s > 1.2][0])
    later = resample(stream, [after, after + 0.02], 0.0).stream.positions[:, 0, 0]
    assert later[0] == pytest.approx(0.2 * after, abs=1e-9)


def test_one_lost_joint_is_predicted_alone():
    times = np.arange(0.0, 1.0, 0.01)
    stream = straight(times, np.array([0.2, 0.0, 0.0]), 0.0)
    tip = JOINTS.index("index_tip")
    stream.flags[90:, tip] = 0
    stream.positions[90:, tip] = 9.0
    found = resample(stream, [0.5, 0.97])
    assert found.stream.positions[1, :, 0] == pytest.approx(np.full(26, 0.2 * 0.97), abs=1e-4)
    assert found.age_s[1, tip] == pytest.approx(0.08) and found.age_s[1, 0] == pytest.approx(0.0)


def test_packets_out_of_order_are_left_out_and_the_future_is_not_used():
    times = np.arange(0.0, 1.0, 0.01)
    stream = straight(times, np.array([0.2, 0.0, 0.0]), 0.0)
    order = np.arange(100)
    order[[40, 41]] = order[[41, 40]]
    mixed = Stream(times[order], stream.positions[order], stream.quaternions[order], stream.radii, stream.flags)
    found = resample(mixed, [0.6, 0.7])
    assert found.skipped == found.report.reordered == 1
    assert found.stream.positions[:, 0, 0] == pytest.approx([0.12, 0.14], abs=1e-4)
    other = replace(stream, positions=np.where(times[:, None, None] > 0.5, 7.0, stream.positions))
    early = [0.3, 0.5]
    assert np.array_equal(resample(stream, early, 0.03).stream.positions, resample(other, early, 0.03).stream.positions)


@pytest.mark.parametrize(
    ("clock", "ahead", "predict", "words"),
    [
        ([0.0], 0.0, 0.1, "tracking clock: times are .*two or more that rise"),
        ([0.0, 1.0], -0.1, 0.1, "ahead_s is -0.1; give 0 or more seconds"),
        ([0.0, 1.0], 0.0, np.inf, "predict_s is inf; give 0 or more seconds"),
    ],
)
def test_wrong_requests_are_refused(clock, ahead, predict, words):
    stream = straight(np.arange(0.0, 1.0, 0.1), np.zeros(3), 0.0)
    with pytest.raises(SceneError, match=words):
        resample(stream, clock, ahead, predict)
