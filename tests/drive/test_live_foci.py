"""Lines that tell a focus: what they mean, and what is told of those that tell none."""

import json
import socket
import time

import numpy as np
import pytest

from palmfield.drive.live_foci import FocusListener, read_focus
from palmfield.motion.line_listener import BadLine

NO_OFFSET = np.zeros(3)


def line(**told) -> bytes:
    return json.dumps(told).encode()


@pytest.mark.parametrize(
    ("told", "offset", "place", "level"),
    [
        ({"focus_m": [0.01, -0.02, 0.15]}, NO_OFFSET, (0.01, -0.02, 0.15), 1.0),
        ({"focus_m": [0, 0, 0.2], "level": 0.25}, np.ones(3), (0.0, 0.0, 0.2), 0.25),
        # The offset, and a focus_m, are in the frame of a pose: a quarter turn about z takes x to y
        ({"position_m": [0.1, 0, 0.2]}, np.array([0.01, 0, 0]), (0.11, 0.0, 0.2), 1.0),
        ({"position_m": [0.1, 0, 0.2], "quaternion": [0.5**0.5, 0, 0, 0.5**0.5]}, np.array([0.01, 0, 0]),
         (0.1, 0.01, 0.2), 1.0),
        ({"position_m": [0, 0, 0.2], "quaternion": [0, 1, 0, 0], "focus_m": [0, 0.01, 0.02], "level": 0}, np.ones(3),
         (0.0, -0.01, 0.18), 0.0),
    ],
)  # fmt: skip
def test_a_line_tells_a_focus_or_a_pose_that_carries_one(told, offset, place, level):
    read = read_focus(line(**told), offset)
    np.testing.assert_allclose(read.place, place, atol=1e-15)
    assert read.level == level


@pytest.mark.parametrize(
    ("data", "kind", "what"),
    [
        (b"0 0 0.15", "garbled", "not a JSON object"),
        (b'{"focus_m": [0, 0,', "garbled", "not a JSON object"),
        (b"[0, 0, 0.15]", "garbled", "not a JSON object"),
        (b"\xff\xfe", "garbled", "not a JSON object"),
        (line(focus=[0, 0, 0.15]), "keys", "field 'focus' is unknown; allowed: focus_m, level"),
        (line(level=1), "keys", "neither focus_m nor position_m"),
        (line(focus_m=[0, 0, 0.1], quaternion=[1, 0, 0, 0]), "keys", "without position_m"),
        (line(focus_m=[0, 0]), "numbers", "3 finite numbers"),
        (b'{"focus_m": [0, NaN, 0.1]}', "numbers", "3 finite numbers"),
        (line(focus_m=["0", 0, 0.1]), "numbers", "3 finite numbers"),
        (line(focus_m=0.1), "numbers", "3 finite numbers"),
        (line(focus_m=[0, 0, 0.1], level="full"), "numbers", "1 finite numbers"),
        (line(focus_m=[0, 0, 0.1], level=True), "numbers", "1 finite numbers"),
        (line(focus_m=[0, 0, 0.1], level=1.5), "level", "allowed: 0 to 1"),
        (line(position_m=[0, 0, 0.1], quaternion=[0, 0, 0, 0]), "numbers", "length 0; allowed: 1"),
    ],
)
def test_what_tells_no_focus_is_told_by_its_kind(data, kind, what):
    with pytest.raises(BadLine, match=what) as caught:
        read_focus(data, NO_OFFSET)
    assert caught.value.kind == kind


def test_only_the_newest_is_kept_and_bad_lines_are_counted():
    with FocusListener(NO_OFFSET) as listener, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as tracker:
        assert listener.next(0, 0.0) is None
        data = b"\n".join([line(focus_m=[0, 0, 0.1]), b"what?", line(focus_m=[0, 0, 0.2])])
        before = time.monotonic()
        tracker.sendto(data, (listener.host, listener.port))
        ends = before + 10.0
        while listener.received < 2 and time.monotonic() < ends:
            time.sleep(1e-3)
        came = listener.next(0, 0.0)
        assert came is not None and came.number == 2 and came.focus.place[2] == 0.2
        assert before <= came.time_s <= time.monotonic()
        assert listener.next(came.number, 0.0) is None
    assert listener.report() == "2 foci received, 1 lines skipped (1 garbled)" and "what?" in listener.reported[0]
