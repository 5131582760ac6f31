"""Foci that come in over a socket, on a virtual board."""

import json
import os
import socket
import threading
import time

import numpy as np
import pytest

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.drive.boards import BOARDS
from palmfield.drive.frame_log import read_log
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError, OutputError, SceneError
from palmfield.hardware.focus_board import FocusSound, focus_board
from palmfield.hardware.live_focus import LiveInput, play_live
from palmfield.hardware.play import Target
from palmfield.types import Air

needs_posix = pytest.mark.skipif(os.name != "posix", reason="the player needs POSIX")


class Teller:
    """Tells lines, again and again, from when it is called with the address."""

    def __init__(self, lines, by, every_s=0.02):
        self.lines, self.by, self.every_s = lines, by, every_s
        self.thread = None

    def __call__(self, host, port):
        self.thread = threading.Thread(target=self.tell, args=(host, port))
        self.thread.start()

    def tell(self, host, port):
        kind = socket.SOCK_DGRAM if self.by == "udp" else socket.SOCK_STREAM
        with socket.socket(socket.AF_INET, kind) as out:
            out.connect((host, port))
            for line in self.lines:
                out.sendall(line.encode() + b"\n")
                time.sleep(self.every_s)


def moving(count):
    """A pose that goes along x, a centimetre under the focus."""
    return [json.dumps({"position_m": [0.001 * n, 0.0, 0.14], "quaternion": [1, 0, 0, 0]}) for n in range(count)]


@needs_posix
@pytest.mark.wall_clock
@pytest.mark.parametrize(("board", "by"), [("sonicsurface", "udp"), ("openmpd", "tcp")])
def test_the_board_emits_the_foci_that_come_and_is_silent_when_none_does(board, by, tmp_path):
    made, array = focus_board(board, FocusSound(), {}).board, layout(BOARDS[board].layouts[0])
    # Half a level is none of a SonicSurface's: it is told, and what came before goes on
    odd = ['{"focus_m": [0, 0, -0.1]}', '{"focus_m": [0.0, 0.0, 0.12], "level": 0.5}']
    lines = moving(20) + [one for line in odd for one in (line, *moving(1))]
    tell = Teller(lines, by, 0.03)
    with VirtualBoard(made, realtime=True) as virtual:
        live = LiveInput(by=by, offset_m=(0.0, 0.0, 0.01), on_listening=tell)
        log = tmp_path / "live.jsonl"
        done = play_live(live, board, Target(port=virtual.port, log=log), 1.6)
        tell.thread.join()
        virtual.settle()
    assert virtual.flags == [] and not virtual.twin.emitted.any()
    assert f"{len(lines)} foci received" in str(done)
    assert "is behind array" in str(done) and (made.levels or "only 0 (off) and 1 (full)" in str(done))
    wavenumber = 2 * np.pi * 40e3 / sound_speed(Air())
    sent = np.array([(0.001 * n, 0.0, 0.15) for n in range(20)] + [(0.0, 0.0, 0.12)][: made.levels])
    ways = np.linalg.norm(array.positions[:, None] - sent, axis=2)
    found = set()
    for one in virtual.emitted:
        if one.amplitudes.any():
            # All in phase at one of the foci that were told, but for the rounding of phases
            shares = np.abs(one.amplitudes @ np.exp(1j * wavenumber * ways)) / np.abs(one.amplitudes).sum()
            assert shares.max() > 0.99
            found.add(int(shares.argmax()))
    assert len(found) >= 4
    head, pieces = read_log(log)
    assert head.board == board and b"".join(piece.data for piece in pieces) == bytes(virtual.received)


@needs_posix
@pytest.mark.wall_clock
def test_a_modulated_focus_rises_and_falls_at_the_boards_rate():
    board = BOARDS["autd3"]
    tell = Teller(moving(1) * 20, "udp", 0.02)
    with VirtualBoard(board, realtime=True) as virtual:
        target = Target(port=virtual.port)
        play_live(LiveInput(on_listening=tell), "autd3", target, 0.6, sound=FocusSound(am_frequency_Hz=50.0, level=0.8))
        tell.thread.join()
        virtual.settle()
    levels = np.array([np.abs(one.amplitudes).mean() for one in virtual.emitted])
    assert len(np.unique(levels.round(2))) > 8 and 0.7 < levels.max() < 0.81 and levels[-1] == 0.0


def test_the_limit_at_a_head_counts_the_focus_at_its_loudest_place(tmp_path):
    """By itself: the loudest place of the ball, were the focus there, on a finer grid of its own."""
    array, air = layout("sonicsurface", 0.5), Air()
    grid = np.stack(np.meshgrid(*3 * [np.linspace(-0.05, 0.05, 11)], indexing="ij"), -1).reshape(-1, 3)
    ball = grid[np.linalg.norm(grid, axis=1) <= 0.05] + [0.0, 0.0, 0.4]
    loudest = max(abs(pressure64(p[None], array, focus(array, air, p), air)[0][0]) for p in ball)
    level_dB = 20 * np.log10(loudest / np.sqrt(2) / 20e-6)
    sound = FocusSound(p0_Pa_m=0.5)

    def keys(limit_dB):
        return {"head_m": "0 0 0.4", "head_radius_m": "0.05", "head_limit_dB": str(limit_dB)}

    file = tmp_path / "no_port"
    file.touch()
    with pytest.raises(DeviceError, match="head_limit_dB allows"):
        play_live(LiveInput(), "sonicsurface", Target(port=str(file)), 0.1, sound=sound, keys=keys(level_dB - 0.2))
    with pytest.raises(DeviceError, match="cannot open"):
        play_live(LiveInput(), "sonicsurface", Target(port=str(file)), 0.1, sound=sound, keys=keys(level_dB + 0.2))


def test_what_can_not_be_played_live_is_refused_at_once(tmp_path):
    with pytest.raises(DeviceError, match="need a port"):
        play_live(LiveInput(), "autd3", Target(record=tmp_path / "x.bin"))
    with pytest.raises(DeviceError, match="there is no such port; "):
        play_live(LiveInput(), "autd3", Target(port=str(tmp_path / "ttyUSB9")))
    with pytest.raises(OutputError, match="there is no folder"):
        play_live(LiveInput(), "autd3", Target(port="loop://", log=tmp_path / "no" / "x.jsonl"))
    with pytest.raises(SceneError, match="drives 2 arrays"):
        play_live(LiveInput(), "sonicsurface_pair", Target(port="loop://"))
