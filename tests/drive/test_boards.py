"""Boards: what they play and what they refuse."""

import numpy as np
import pytest

from palmfield.config import DriverConfig, allowed
from palmfield.drive.boards import BOARDS, board_named, check, play
from palmfield.errors import DeviceError

BOARD = BOARDS["sonicsurface"]
IDEAL = BOARDS["ideal"]


def test_the_ideal_board_plays_anything():
    asked = np.array([0.3 + 0.1j, 0, 1, -2j])
    played = play(IDEAL, asked)
    np.testing.assert_array_equal(played, asked)
    played[0] = 0
    assert asked[0] != 0
    check(IDEAL, frame_rate_Hz=1e6, points_per_turn=1e4, modulated=True, element="any")


def test_the_board_plays_the_nearest_of_32_phases():
    asked = np.exp(1j * np.linspace(-3, 3, 256))
    error = np.angle(play(BOARD, asked) / asked)
    assert 0.08 < np.abs(error).max() <= np.pi / 32


def test_the_board_plays_no_amplitude_between():
    with pytest.raises(DeviceError, match="50 % duty"):
        play(BOARD, np.full(256, 0.4))


def test_an_unknown_board():
    with pytest.raises(DeviceError, match="'toaster' is not known; allowed: ideal, sonicsurface"):
        board_named("toaster")


def test_the_scenes_key_takes_the_boards_that_there_are():
    assert allowed(DriverConfig, "board").split(" | ") == list(BOARDS)


def test_silence_in_bytes_is_silence():
    for board in BOARDS.values():
        if not board.exact:
            assert not board.decode(board.off_frame)[-1].any()
            np.testing.assert_array_equal(board.encode(np.zeros(256)), board.off_frame)


def test_a_still_focus_and_a_slow_path_fit_the_board():
    check(BOARD, frame_rate_Hz=0.0, modulated=False, element="still")
    check(BOARD, frame_rate_Hz=89.0, points_per_turn=8, modulated=False, element="slow")


def test_modulation_is_refused_with_both_sides_said():
    with pytest.raises(DeviceError) as refusal:
        check(BOARD, frame_rate_Hz=4000.0, modulated=True, element="am")
    message = str(refusal.value)
    assert "stimulus 'am' needs continuous amplitude at 4000 frames/s" in message
    assert "sonicsurface gives on/off amplitude at 89.3 frames/s" in message
    assert "44.7 Hz" in message
    assert "board ideal" in message
    assert "\n" not in message


def test_a_fast_circle_is_refused_with_the_points_that_are_left():
    with pytest.raises(DeviceError) as refusal:
        check(BOARD, frame_rate_Hz=3500.0, points_per_turn=50, modulated=False, element="circle")
    # 89.3 frames/s over 70 turns/s
    assert "1.3 points a turn" in str(refusal.value)
    assert "continuous" not in str(refusal.value)


def test_a_pulsed_device_of_any_rate_still_refuses_amplitude():
    with pytest.raises(DeviceError, match="continuous amplitude"):
        check(BOARD, frame_rate_Hz=10.0, modulated=True, element="slow am")
