"""The player's process and its caller, on virtual boards."""

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from palmfield.drive.boards import BOARDS
from palmfield.drive.frame_log import FrameLog, LogHead, read_log
from palmfield.drive.player import Player
from palmfield.drive.player.report import PlayReport
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError, OutputError
from palmfield.hardware.play import check_log

BOARD = BOARDS["sonicsurface"]
pytestmark = [pytest.mark.skipif(os.name != "posix", reason="the player needs POSIX"), pytest.mark.wall_clock]


def frame(step: int = 0, board=BOARD) -> bytes:
    if board.takes == "focus":
        return board.encode_focus((0.0, 0.0, 0.2 + 1e-3 * step), 1.0)
    return board.encode(np.full(board.transducers, np.exp(2j * np.pi * step / 32)))


def until(holds, within_s: float = 20.0) -> None:
    ends = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < ends
        time.sleep(1e-3)


def test_the_process_loads_neither_numpy_nor_warp_nor_mujoco():
    code = "import sys, palmfield.drive.player.process; print(sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for name in ("numpy", "warp", "mujoco", "scipy", "pydantic"):
        assert f"'{name}'" not in loaded


@pytest.mark.parametrize(("name", "by"), [("sonicsurface", "tcp"), ("autd2018", "pty"), ("ultraino", "pty")])
def test_frames_come_whole_and_the_board_ends_silent(name, by):
    board = BOARDS[name]
    with VirtualBoard(board, by=by) as virtual:
        with Player(board, virtual.port) as player:
            report = player.play([(0.05 * n, frame(n, board)) for n in range(4)], duration_s=0.2)
        virtual.settle()
        assert (report.frames, report.skipped, report.cut) == (4, 0, 0)
        sent = b"".join(frame(n, board) for n in range(4))
        assert bytes(virtual.received) == board.start + sent + board.stop
        assert virtual.flags == [] and not virtual.twin.emitted.any()


def test_several_schedules_one_after_the_other_with_silence_between():
    with VirtualBoard(BOARD) as virtual:
        with Player(BOARD, virtual.port) as player:
            for _ in range(2):
                assert player.play([(0.0, frame(3)), (0.05, frame(4))], duration_s=0.1).frames == 2
                virtual.settle(0.05)
                assert not virtual.twin.emitted.any()
        once = frame(3) + frame(4) + BOARD.stop
        assert bytes(virtual.received) == BOARD.start + once + once


def test_the_log_tells_what_was_sent_and_when(tmp_path):
    path = tmp_path / "sent.jsonl"
    FrameLog(path, LogHead("sonicsurface", 256, "sonicsurface")).close()
    with VirtualBoard(BOARD) as virtual:
        with Player(BOARD, virtual.port, log=path) as player:
            player.play([(0.1 * n, frame(n)) for n in range(4)])
        virtual.settle()
        _, pieces = read_log(path)
        assert b"".join(piece.data for piece in pieces) == bytes(virtual.received)
    times = [piece.time_s for piece in pieces[1:-1]]
    assert np.diff(times) == pytest.approx(0.1, abs=0.02)
    assert all(piece.whole for piece in pieces)


def test_an_exception_in_the_block_silences_the_board():
    with VirtualBoard(BOARD) as virtual:
        with pytest.raises(ZeroDivisionError), Player(BOARD, virtual.port) as player:
            # Sent again and again: a live frame is silent once it is old, and may be before it is read
            until(lambda: player.send([frame(1)]) or virtual.twin.emitted.all())
            raise ZeroDivisionError
        virtual.settle()
        assert virtual.received.endswith(BOARD.stop) and not virtual.twin.emitted.any()


def test_live_frames_sound_at_once_fall_silent_when_old_and_sound_again():
    with VirtualBoard(BOARD, realtime=True) as virtual, Player(BOARD, virtual.port) as player:
        made = []

        def sounds_after_another():
            made.append(time.monotonic())
            player.send([frame(len(made) % 32)])
            return virtual.twin.emitted.all()

        for _ in range(2):
            until(sounds_after_another)
            until(lambda: not virtual.twin.emitted.any())
            assert time.monotonic() - made[-1] > 0.05
        until(lambda: player.send([frame(0)]) or virtual.twin.emitted.all())
        player.mute()
        until(lambda: not virtual.twin.emitted.any(), 0.09)


def test_it_tells_when_each_live_frame_was_on_the_line():
    with VirtualBoard(BOARD, realtime=True, decodes=False) as virtual:
        with Player(BOARD, virtual.port, tells_frames=True, stale_s=5.0, refresh_s=50.0) as player:
            begin = time.monotonic() + 0.05
            due = [begin + 0.05 * n for n in range(8)]
            for number, due_s in enumerate(due):
                player.send([frame(number)], due_s=due_s)
            until(lambda: time.monotonic() > due[-1] + 0.05)
        virtual.settle()
        assert not virtual.emitted
        virtual.decode()
        offset = time.monotonic() - virtual.clock
    told = dict(player.report.on_line)
    assert player.report.frames == len(told)
    assert len(told) >= 1 and len(told) + player.report.skipped == 8
    heard = [one for one in virtual.emitted if one.amplitudes.any()]
    assert len(heard) == len(told)
    for (number, on_line_s), one in zip(told.items(), heard, strict=True):
        np.testing.assert_allclose(one.amplitudes, BOARD.decode(frame(number))[-1])
        assert on_line_s > due[number] - 1e-3
        # What the player tells and when the board has heard it are two clocks' opinions of one moment
        assert abs(one.time_s + offset - on_line_s) < 0.5


@pytest.mark.parametrize("ramp_s", [0.0, 0.4])
def test_a_live_source_that_ends_early_falls_within_its_ramp(ramp_s):
    """By AUTD, which has levels: none but full and silence without a ramp."""
    board = BOARDS["autd2018"]
    steps = [board.encode_focus((0.0, 0.0, 0.2), level) for level in (0.2, 0.4, 0.6, 0.8, 1.0)]
    with VirtualBoard(board, realtime=True) as virtual:
        with Player(board, virtual.port, ramp_s=ramp_s, stale_s=60.0) as player:
            player.send(steps)
            until(lambda: abs(virtual.twin.emitted).max() > 0.99)
            full, began = len(virtual.emitted), time.monotonic()
        ended_s = time.monotonic() - began
        virtual.settle()
        levels = [round(float(abs(one.amplitudes).max()), 1) for one in virtual.emitted[full:]]
    assert levels[-1] == 0.0
    between = [level for level in levels if 0.0 < level < 0.9]
    if ramp_s:
        assert set(between) >= {0.6, 0.4} and between == sorted(between, reverse=True) and ended_s > 0.2
    else:
        assert not between


def test_without_posix_it_says_what_else_there_is(monkeypatch):
    monkeypatch.setattr("palmfield.drive.player.caller.POSIX", False)
    with pytest.raises(DeviceError, match="needs Linux or macOS; on this system write the bytes to a file"):
        Player(BOARD, "COM3")


@pytest.mark.parametrize("port", ["/dev/no_such_port", "nonsense://x", "socket://127.0.0.1:1"])
def test_a_port_that_is_not_there_is_told_in_a_sentence(port):
    with pytest.raises(DeviceError, match=f"cannot open {port}: "):
        Player(BOARD, port)
    with pytest.raises(DeviceError, match="takes no bytes, so it has no port"):
        Player(BOARDS["ideal"], port)


def test_a_port_that_is_held_is_told_in_a_sentence():
    with VirtualBoard(BOARD) as virtual, Player(BOARD, virtual.port) as player:
        with pytest.raises(DeviceError, match="another program uses it"):
            Player(BOARD, virtual.port)
        assert player.play([(0.0, frame())]).frames == 1


def test_more_than_a_hundredth_unsent_is_a_warning():
    assert PlayReport(99, 1, 0.0).warning == ""
    assert PlayReport(98, 2, 0.0).warning == "2 of 100 due frames were not sent (2.0 %)"
    assert PlayReport(0, 0, 0.0).warning == ""


def test_drive_ends_with_code_4_where_frames_were_left_out(tmp_path):
    """A log of frames at twice the line's rate, played again."""
    path = tmp_path / "fast.jsonl"
    log = FrameLog(path, LogHead("sonicsurface", 256, "sonicsurface"))
    for n in range(60):
        log.add(n * 0.5 * BOARD.frame_time_s, frame(n % 32))
    log.close()
    with VirtualBoard(BOARD) as virtual:
        command = [sys.executable, "-m", "palmfield", "replay", str(path), "--port", virtual.port]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 4, done.stderr
    assert "warning: " in done.stderr and "due frames were not sent" in done.stderr
    assert json.loads(path.read_text().splitlines()[1])["t"] == 0.0


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_a_log_that_a_full_disk_ends_is_told_after_the_play(tmp_path):
    log = tmp_path / "full.jsonl"
    log.symlink_to("/dev/full")
    with VirtualBoard(BOARD) as virtual:
        with Player(BOARD, virtual.port, log=log) as player:
            assert player.play([(0.0, frame(1)), (0.05, frame(2))], duration_s=0.1).frames == 2
        virtual.settle()
        assert "No space left" in player.log_error
        assert bytes(virtual.received) == BOARD.start + frame(1) + frame(2) + BOARD.stop
        with pytest.raises(OutputError, match=r"played 2; the log .*full.jsonl ends early: No space left"):
            check_log(player, log, "played 2; ")
