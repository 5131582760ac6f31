"""Hands over a socket: replayed, with bad samples between, against the recording retargeted at once."""

import json
import socket
import threading
import time

import numpy as np
import pytest

from palmfield.errors import DeviceError, SceneError
from palmfield.hand.articulated import articulate
from palmfield.hand.preset import load_preset
from palmfield.motion.listening import Listener
from palmfield.motion.live_hand import LiveHand
from palmfield.motion.replaying import address, replay
from palmfield.motion.retarget import retarget
from palmfield.motion.tracking import Stream, stream_of
from palmfield.motion.wire import Sample, write_sample
from palmfield.transforms import IDENTITY

pytestmark = pytest.mark.wall_clock


@pytest.fixture(scope="module")
def stream(median, swing):
    return stream_of(median, swing, np.arange(0.0, 0.5, 1 / 60))


def line_of(stream, n, **changes):
    sample = Sample(
        float(stream.times_s[n]), stream.positions[n], stream.quaternions[n], stream.radii[n], stream.flags[n]
    )
    return json.dumps(json.loads(write_sample(sample)) | changes)


def settled(listener, count):
    end = time.monotonic() + 20.0
    while listener.received + sum(listener.bad.values()) < count and time.monotonic() < end:
        time.sleep(0.005)


@pytest.mark.parametrize(("by", "convention"), [("udp", "openxr"), ("tcp", "leapc")])
def test_a_recording_that_is_replayed_comes_as_it_was(stream, by, convention):
    with Listener(by=by) as listener:
        began = time.monotonic()
        assert replay(stream, (listener.host, listener.port), by=by, convention=convention, speed=2.0) == len(stream)
        assert time.monotonic() - began > 0.9 * 0.5 * (stream.times_s[-1] - stream.times_s[0])
        settled(listener, len(stream))
        heard = listener.stream()
    np.testing.assert_allclose(heard.times_s, stream.times_s, atol=1e-6)
    np.testing.assert_allclose(heard.positions, stream.positions, atol=1e-9)
    assert not listener.bad


def test_bad_samples_are_counted_told_and_skipped(stream):
    lost = {name: one for name, one in json.loads(line_of(stream, 5))["joints"].items() if name == "wrist"}
    lines = [
        line_of(stream, 0), line_of(stream, 1), "{", line_of(stream, 2, time_s=float("nan")),
        line_of(stream, 3, hand=None), line_of(stream, 1), line_of(stream, 4, convention="x"),
        line_of(stream, 5, joints=lost), line_of(stream, 6),
    ]  # fmt: skip
    with Listener() as listener, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        for text in lines:
            line.sendto(text.encode(), (listener.host, listener.port))
        settled(listener, len(lines))
    assert dict(listener.bad) == {"garbled": 1, "numbers": 1, "lost": 1, "late": 1, "convention": 1, "joints": 1}
    np.testing.assert_allclose(listener.stream().times_s, stream.times_s[[0, 1, 6]])
    assert listener.report().startswith("3 samples taken, 6 skipped (1 convention, 1 garbled,")
    assert any("26" in text and "1 joints" in text for text in listener.reported)


def test_a_live_hand_is_where_the_recording_puts_it(stream, median):
    """Samples one by one, each with what is known by then, against all of the recording retargeted together."""
    meant = retarget(median, stream)
    poses = []
    with LiveHand(median, IDENTITY) as hand, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        for n in range(len(stream)):
            line.sendto(line_of(stream, n).encode(), (hand.listener.host, hand.listener.port))
            # Of the first five the palm's shape is taken, and more where some came together
            end = time.monotonic() + (0.4 if poses else 0.03)
            while time.monotonic() < end:
                newest = hand.newest
                if newest is not None and newest.sample_s == stream.times_s[n]:
                    poses.append((stream.times_s[n], newest.pose))
                    break
                time.sleep(0.001)
        assert not hand.stale
        time.sleep(0.15)
        assert hand.stale
    assert len(poses) > 15
    for time_s, pose in poses:
        np.testing.assert_allclose(pose.position, meant(time_s).position, atol=0.3e-3)
        for name, angle in meant(time_s).angles_deg.items():
            assert pose.angles_deg[name] == pytest.approx(angle, abs=2.0)


def test_a_live_hand_is_predicted(stream, median):
    """At constant speed a hand is where it will be 30 ms later, and not where it was."""
    speed, ahead_s = np.array([0.3, -0.2, 0.1]), 0.03
    times = np.arange(0.0, 0.6, 1 / 90)
    one = [np.repeat(part[:1], len(times), axis=0) for part in list(vars(stream).values())[1:]]
    moving = Stream(times, one[0] + (times[:, None] * speed)[:, None], *one[1:])
    with LiveHand(median, IDENTITY, ahead_s=ahead_s) as hand, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        for n in range(len(times)):
            line.sendto(line_of(moving, n).encode(), (hand.listener.host, hand.listener.port))
            time.sleep(0.004)
        end = time.monotonic() + 20.0
        while (hand.newest is None or hand.newest.sample_s < times[-1]) and time.monotonic() < end:
            time.sleep(0.01)
        found = hand.newest.pose.position
    at_rest = retarget(median, Stream(times[:2], *(part[:2] for part in one)))(0.0).position
    np.testing.assert_allclose(found - at_rest, speed * (times[-1] + ahead_s), atol=0.5e-3)


def test_a_hand_of_the_other_side_and_no_hand_are_refused(stream):
    with (
        LiveHand(articulate(load_preset("open_men_p50")), IDENTITY) as hand,
        pytest.raises(SceneError, match=r"no hand was tracked within 0\.05 s at udp 127\.0\.0\.1:\d+: 0 samples taken"),
    ):
        hand.wait(0.05)
    mirrored = Stream(
        stream.times_s, stream.positions * [-1.0, 1.0, 1.0], stream.quaternions, stream.radii, stream.flags
    )
    with LiveHand(articulate(load_preset("open_men_p50")), IDENTITY) as hand:
        sending = threading.Thread(target=replay, args=(mirrored, (hand.listener.host, hand.listener.port)))
        sending.start()
        with pytest.raises(SceneError, match="use a hand of the other side"):
            hand.wait(5.0)
        sending.join()


def test_addresses_and_speeds_are_checked(stream):
    assert address("9100") == ("127.0.0.1", 9100) and address("lab:80") == ("lab", 80)
    for text in ("", "lab", ":80", "lab:x", "70000"):
        with pytest.raises(DeviceError, match="is not an address"):
            address(text)
    with pytest.raises(DeviceError, match="speed has value 0; allowed"):
        replay(stream, ("127.0.0.1", 9), speed=0.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        with pytest.raises(DeviceError, match="cannot listen at"):
            Listener(port=number, by="tcp")
    with pytest.raises(DeviceError, match="accepts no samples by tcp after 0"):
        replay(stream, ("127.0.0.1", number), by="tcp")
