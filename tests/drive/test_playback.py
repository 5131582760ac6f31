"""Frames with their times, and files of them. The pace on a line is in test_link.py."""

import numpy as np
import pytest

from palmfield.config import StimulusConfig
from palmfield.drive.boards import BOARDS
from palmfield.drive.boards.sonicsurface import FRAME_BYTES, OFF_FRAME, decode
from palmfield.drive.playback import REFRESH_S, frame_times, playable_board, record, timed_frames
from palmfield.errors import DeviceError

BOARD = BOARDS["sonicsurface"]


def test_what_rests_is_sent_again():
    assert frame_times([], 0.35) == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert frame_times([StimulusConfig()], 0.1) == [0.0]


def test_frames_are_due_at_points_and_where_sound_begins_and_ends():
    config = StimulusConfig(
        path="circle", path_diameter_m=0.03, path_rate_Hz=5, path_points=8, start_s=0.033, stop_s=0.09
    )
    times = frame_times([config], 0.1)
    assert 0.033 in times and 0.09 in times and times == sorted(set(times))
    assert {k / 40 for k in range(4)} <= {round(t, 9) for t in times}


def test_silence_is_the_off_frame_and_so_is_the_end():
    sound = np.exp(2j * np.pi * np.arange(256) / 32)
    frames = list(timed_frames(BOARD, [0.0, 0.1], lambda t: sound if t > 0 else 0 * sound, 0.2))
    assert [frame.time_s for frame in frames] == [0.0, 0.1, 0.2]
    assert frames[0].data == frames[2].data == OFF_FRAME
    np.testing.assert_allclose(decode(frames[1].data)[-1], sound, atol=1e-9)


def test_a_record_holds_the_frames_and_ends_silent(tmp_path):
    sound = np.ones(256, complex)
    played = record(timed_frames(BOARD, frame_times([], 0.3), lambda t: sound, 0.3), tmp_path / "x.bin")
    data = (tmp_path / "x.bin").read_bytes()
    assert played.frames == 4 and played.skipped == 0 and REFRESH_S == 0.1
    assert len(data) == FRAME_BYTES * (4 + 2) and data.endswith(OFF_FRAME * 2)


@pytest.mark.parametrize("name", ["ideal", "toaster"])
def test_only_boards_that_take_bytes_can_be_played_on(name):
    with pytest.raises(DeviceError, match=f"board '{name}' is not known; allowed: sonicsurface"):
        playable_board(name)
    with pytest.raises(DeviceError, match=r"takes no bytes; use board sonicsurface"):
        next(timed_frames(BOARDS["ideal"], [0.0], lambda t: np.ones(1, complex), 1.0))
