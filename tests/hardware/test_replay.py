"""Bytes that are sent again, and the limits that they are held against before."""

from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.drive.boards import BOARDS
from palmfield.drive.frame_log import FrameLog, LogHead, read_log
from palmfield.drive.virtual import VirtualBoard
from palmfield.hardware.play import Target, play_focus, play_scene
from palmfield.hardware.replay import replay

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
POINT = (0.02, -0.01, 0.15)
NOWHERE = "/dev/no_such_port"


@pytest.fixture
def recorded(tmp_path):
    """A quarter of a second of a focus, as log and as bytes."""
    log, raw = tmp_path / "x.jsonl", tmp_path / "x.bin"
    play_focus(POINT, "sonicsurface", Target(record=raw, log=log), 0.25)
    return log, raw


@pytest.mark.wall_clock
def test_what_was_sent_is_sent_again(recorded):
    for path in recorded:
        with VirtualBoard(BOARDS["sonicsurface"]) as virtual:
            told = replay(path, virtual.port, "sonicsurface")
            virtual.settle()
            assert bytes(virtual.received) == recorded[1].read_bytes()
            assert told.text.startswith("played 3 frames") and not virtual.twin.emitted.any()


def test_what_sounds_too_long_or_too_often_is_refused_before_a_port_is_opened(recorded):
    for path in recorded:
        with pytest.raises(palmfield.DeviceError, match=r"limit on_time_s allows 0\.01"):
            replay(path, NOWHERE, "sonicsurface", keys={"driver.on_time_s": "0.01"})
        with pytest.raises(palmfield.DeviceError, match="limit duty_limit allows 50 %"):
            replay(path, NOWHERE, "sonicsurface", keys={"driver.duty_limit": "0.5"})
    with pytest.raises(palmfield.DeviceError, match="cannot open /dev/no_such_port"):
        replay(recorded[0], NOWHERE, keys={"driver.on_time_s": "5"})


def test_a_log_knows_the_limits_of_its_scene(tmp_path):
    """A log whose scene allows 0.1 s holds frames for 1 s."""
    board, path = BOARDS["sonicsurface"], tmp_path / "long.jsonl"
    log = FrameLog(path, LogHead("sonicsurface", 256, "sonicsurface", limits={"on_time_s": 0.1}))
    for n in range(11):
        log.add(0.1 * n, board.encode(np.ones(256)))
    log.close()
    with pytest.raises(palmfield.DeviceError, match=r"the play has 1 s of sound; limit on_time_s allows 0\.1"):
        replay(path, NOWHERE)
    with pytest.raises(palmfield.DeviceError, match="cannot open"):
        replay(path, NOWHERE, keys={"driver.on_time_s": "2"})
    scene, made = SCENES / "palm_circle_sonicsurface.xml", tmp_path / "scene.jsonl"
    keys = {"driver.head_m": "0 -0.4 0.5", "driver.head_limit_dB": "150", "driver.ramp_s": "0.01"}
    play_scene(scene, None, Target(record=tmp_path / "s.bin", log=made), 0.05, keys=keys)
    head, _ = read_log(made)
    assert head.limits == {"head_m": [0.0, -0.4, 0.5], "head_limit_dB": 150.0, "ramp_s": 0.01}
    assert head.p0_high_Pa_m > head.p0_Pa_m > 0.0


def test_what_is_too_loud_at_the_head_is_refused_with_the_level_that_drive_gives(recorded, tmp_path):
    keys = {"head_m": "0 0 0.5", "head_limit_dB": "90"}
    with pytest.raises(palmfield.DeviceError) as drive:
        play_focus(POINT, "sonicsurface", Target(record=tmp_path / "y.bin"), 0.25, keys=keys)
    with pytest.raises(palmfield.DeviceError) as again:
        replay(recorded[0], NOWHERE, keys={f"driver.{key}": value for key, value in keys.items()})
    assert str(again.value) == str(drive.value)


def test_a_level_that_is_not_known_is_refused_where_there_is_a_limit(tmp_path):
    board, path = BOARDS["sonicsurface_pair"], tmp_path / "pair.jsonl"
    log = FrameLog(path, LogHead("sonicsurface_pair", 512, "sonicsurface"))
    log.add(0.0, board.encode(np.ones(512)))
    log.add(0.1, board.encode(np.ones(512)))
    log.close()
    with pytest.raises(palmfield.DeviceError, match="not their positions, so head_limit_dB cannot be checked"):
        replay(path, NOWHERE, keys={"driver.head_m": "0 -0.4 0.5", "driver.head_limit_dB": "120"})


def test_only_limits_can_be_given(recorded):
    with pytest.raises(palmfield.SceneError, match=r"driver\.dither has no effect on a replay, .*; allowed: "):
        replay(recorded[0], NOWHERE, keys={"driver.dither": "on"})
    with pytest.raises(palmfield.SceneError, match="on_time_s"):
        replay(recorded[0], NOWHERE, keys={"driver.on_time_s": "-1"})
