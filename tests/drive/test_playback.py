"""When frames are due. A line's pace is in player/test_sources.py, what frames hold in tests/hardware/test_play.py."""

import pytest

from palmfield.config import StimulusConfig
from palmfield.drive.boards import BOARDS, playable_board
from palmfield.drive.playback import frame_times
from palmfield.errors import DeviceError


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


def test_frames_of_what_moves_wait_for_the_next_step():
    config = StimulusConfig(control_rate_Hz=80.0)
    assert frame_times([config], 0.05) == pytest.approx([0.0, 0.0125, 0.025, 0.0375])
    assert frame_times([config], 0.05, 0.001) == pytest.approx([0.0, 0.013, 0.025, 0.038])
    assert frame_times([config], 0.05, 0.02) == pytest.approx([0.0, 0.0125, 0.025, 0.0375])


@pytest.mark.parametrize("name", ["ideal", "toaster"])
def test_only_boards_that_take_bytes_can_be_played_on(name):
    others = ", ".join(board for board in BOARDS if board != "ideal")
    with pytest.raises(DeviceError, match=f"board '{name}' is unknown; allowed: {others}"):
        playable_board(name)
