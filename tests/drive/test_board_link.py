"""The link against a virtual board on a pseudo-terminal that takes bytes no faster than the real line."""

import signal
import socket
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from palmfield.drive.board_link import BoardLink
from palmfield.drive.boards.sonicsurface import BOARD, FRAME_RATE_HZ, LINE, OFF_FRAME, OFF_SEQUENCE
from palmfield.drive.playback import Played, play_frames
from palmfield.drive.ports import open_port
from palmfield.drive.transport import FileTransport
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError, OutputError

pytestmark = pytest.mark.wall_clock

BAUD = 230400
CHANGES = 2
"""That the start sequence, as the stop sequence, makes of what is emitted: a swap, twice."""


def turned(step: int) -> np.ndarray:
    return np.full(256, np.exp(2j * np.pi * step / 32))


def step_of(emitted: np.ndarray) -> int:
    return round(np.angle(emitted[0]) * 32 / (2 * np.pi)) % 32


def open_link(port: str) -> BoardLink:
    return BoardLink(BOARD, open_port(port, BAUD))


@pytest.fixture
def board():
    with VirtualBoard(BOARD) as virtual:
        yield virtual


def encode(amplitudes: np.ndarray) -> bytes:
    return BOARD.encode(amplitudes)


def sounds(board: VirtualBoard) -> list[np.ndarray]:
    """What was emitted between the start sequence and the stop sequence."""
    return [change.amplitudes for change in board.emitted[CHANGES:-CHANGES]]


def schedule(count: int, interval_s: float):
    return [(n * interval_s, encode(numbered(n))) for n in range(count)]


def numbered(number: int) -> np.ndarray:
    """A drive that tells its number, below 1024: the last transducer has the 32s, the others the rest."""
    drive = turned(number % 32)
    drive[-1] = turned(number // 32)[-1]
    return drive


def number_of(emitted: np.ndarray) -> int:
    return step_of(emitted) + 32 * step_of(emitted[::-1])


def test_frames_come_in_order_and_on_time_and_the_board_ends_silent(board):
    with open_link(board.port) as link:
        played = play_frames(link, schedule(30, 0.02))
    board.settle()
    assert (played.frames, played.skipped) == (30, 0)
    assert [step_of(frame) for frame in sounds(board)] == [n % 32 for n in range(30)]
    assert not any(change.amplitudes.any() for change in board.emitted[:CHANGES] + board.emitted[-CHANGES:])
    intervals = np.diff([change.time_s for change in board.emitted[CHANGES:-CHANGES]])
    assert np.median(intervals) == pytest.approx(0.02, abs=0.003)


def test_frames_faster_than_the_line_are_thinned_to_its_rate(board):
    with open_link(board.port) as link:
        played = play_frames(link, schedule(800, 0.001))
    board.settle()
    assert played.frames + played.skipped == 800
    # 0.8 s of line is 71.4 frames, less what a busy machine loses; never more.
    assert 50 <= played.frames <= 0.8 * FRAME_RATE_HZ + 1
    # The newest frame that was due is what went out, so each is newer than the one before.
    assert np.all(np.diff([number_of(frame) for frame in sounds(board)]) > 0)
    assert played.late_s < 0.2
    assert len(board.received) == played.frames * 258 + 2 * len(OFF_SEQUENCE)


def test_a_board_that_stalls_gets_whole_frames_again_and_the_newest(board):
    frames = schedule(120, 1 / 80)
    with open_link(board.port) as link:
        timer_on = threading.Timer(0.2, board.stall)
        timer_off = threading.Timer(1.9, board.stall, (False,))
        timer_on.start()
        timer_off.start()
        playing = play_frames(link, frames)
        board.settle()
    timer_on.join()
    timer_off.join()
    assert playing.skipped > 0
    assert not board.flags
    assert board.received.endswith(OFF_SEQUENCE)
    assert not np.any(board.twin.emitted)


def test_a_board_that_takes_nothing_is_given_up(board, monkeypatch):
    monkeypatch.setattr("palmfield.drive.transport.WRITE_TIMEOUT_S", 0.02)
    board.stall()
    link = open_link(board.port)
    with pytest.raises(DeviceError, match="lost the board on /dev/pts/"):
        play_frames(link, schedule(200, 1 / 80))
    link.close()


def test_unplugged_in_the_middle(board):
    link = open_link(board.port)
    sent: list[int] = []

    def progress(played: Played) -> None:
        sent.append(played.frames)
        if played.frames == 5:
            board.unplug()

    with pytest.raises(DeviceError) as lost:
        play_frames(link, schedule(100, 0.012), on_progress=progress)
    assert sent[-1] < 20
    assert str(lost.value) == (
        f"lost the board on {board.port} after {sent[-1]} frames; the SonicSurface keeps emitting its last frame "
        "until power is cut"
    )
    link.close()


def test_unplugged_before_close(board):
    link = open_link(board.port)
    link.write(encode(turned(1)))
    board.unplug()
    with pytest.raises(DeviceError, match="lost the board"):
        link.close()
    link.close()


def test_an_exception_in_the_schedule_leaves_the_board_off(board):
    def broken():
        yield from schedule(5, 0.012)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), open_link(board.port) as link:
        play_frames(link, broken())
    board.settle()
    assert board.received.endswith(OFF_SEQUENCE)
    assert board.received.count(OFF_SEQUENCE) == 2


def test_closing_silences_a_board_that_was_never_played(board):
    with open_link(board.port):
        pass
    board.settle()
    assert bytes(board.received) == OFF_SEQUENCE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_killed_process_leaves_the_board_off(board, number):
    program = f"""
from palmfield.drive.board_link import BoardLink
from palmfield.drive.playback import play_frames
from palmfield.drive.ports import open_port
from palmfield.drive.boards.sonicsurface import BOARD
import numpy as np
frame = BOARD.encode(np.ones(256))
with BoardLink(BOARD, open_port({board.port!r}, 230400)) as link:
    play_frames(link, ((n * 0.02, frame) for n in range(10_000)))
"""
    # Under nohup, or in a shell's background, the signal would be ignored
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    while len(board.emitted) < 5 + CHANGES:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(number)
    assert process.wait(10) in (128 + number, -number)
    board.settle()
    assert board.received.endswith(OFF_SEQUENCE)
    assert not np.any(board.twin.emitted)


def test_a_port_that_another_program_holds(board):
    with open_link(board.port), pytest.raises(DeviceError, match="another program holds it"):
        open_link(board.port)


@pytest.mark.parametrize("port", ["/dev/no_such_port", "nonsense://x", "socket://127.0.0.1:1"])
def test_a_port_that_is_not_there(port):
    with pytest.raises(DeviceError) as refused:
        open_link(port)
    message = str(refused.value)
    assert message.startswith(f"cannot open {port}: ")
    assert "\n" not in message
    assert "port" in message.split(";")[1]


@pytest.mark.smoke
def test_loop_port():
    link = open_link("loop://")
    frame = encode(turned(3))
    assert link.write(frame)
    assert link.transport._stream.read(258) == frame
    # More than the loop's buffer of 4096 bytes, also where a busy machine skips half: nobody reads the echo.
    played = play_frames(link, schedule(40, 0.03))
    assert played.frames + played.skipped == 40
    assert 258 * played.frames > 4096
    link.close()
    link.close()


def test_socket_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_link(f"socket://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer:
            assert play_frames(link, schedule(3, 0.2)).frames == 3
            link.close()
            received = b"".join(iter(lambda: peer.recv(65536), b""))
    emitted = BOARD.decode(received)
    assert [step_of(frame) for frame in emitted[CHANGES : CHANGES + 3]] == [0, 1, 2]
    assert not np.any(emitted[-2:])


def test_socket_peer_gone():
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_link(f"socket://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        peer.close()
        with pytest.raises(DeviceError, match="lost the board on socket://"):
            play_frames(link, schedule(50, 0.012))
        link.close()


def record(path: Path) -> BoardLink:
    return BoardLink(BOARD, FileTransport(path), simulated=True)


def test_record_holds_what_the_line_would_have_carried(tmp_path):
    path = tmp_path / "run.bin"
    began = time.monotonic()
    with record(path) as link:
        played = play_frames(link, schedule(2000, 0.001))
        assert not path.exists()
        assert link.transport.part.stat().st_size == played.frames * 258 + 2 * len(OFF_SEQUENCE)
    assert time.monotonic() - began < 1.5
    assert not link.transport.part.exists()
    data = path.read_bytes()
    assert len(data) == played.frames * 258 + 2 * len(OFF_SEQUENCE)
    assert data.startswith(OFF_SEQUENCE) and data.endswith(OFF_SEQUENCE)
    assert played.frames == pytest.approx(2.0 * FRAME_RATE_HZ, abs=2)
    assert played.frames + played.skipped == 2000
    # Deterministic, and on time to one line time.
    with record(tmp_path / "again.bin") as link:
        play_frames(link, schedule(2000, 0.001))
    assert (tmp_path / "again.bin").read_bytes() == data
    assert played.late_s <= 1 / FRAME_RATE_HZ


def test_record_is_readable_while_running(tmp_path):
    link = record(tmp_path / "run.bin")
    link.write(OFF_FRAME)
    link.write(encode(turned(5)))
    assert step_of(BOARD.decode(link.transport.part.read_bytes())[-1]) == 5
    link.close()
    link.close()


def test_record_where_nothing_can_be_written(tmp_path):
    with pytest.raises(OutputError, match=r"cannot write .*No such file"):
        record(tmp_path / "missing" / "run.bin")


def test_record_on_a_full_disk(tmp_path):
    (tmp_path / "run.bin.part").symlink_to("/dev/full")
    with pytest.raises(OutputError, match="No space left"), record(tmp_path / "run.bin") as link:
        play_frames(link, schedule(3, 0.0))
    assert not (tmp_path / "run.bin").exists()


class SlowWire:
    """A link without a port, on a clock of its own, whose first `bad` writes time out."""

    line = LINE

    def __init__(self, bad: int) -> None:
        self.clock = 0.0
        self.bad = bad
        self.sent: list[tuple[float, bytes]] = []

    def now(self) -> float:
        return self.clock

    def wait_until(self, when: float) -> None:
        self.clock = max(self.clock, when)

    def start(self) -> None:
        pass

    def write(self, frame: bytes) -> bool:
        if self.bad:
            self.bad -= 1
            self.clock += 0.25
            return False
        self.sent.append((self.clock, frame))
        return True

    def off(self) -> None:
        self.sent.append((self.clock, OFF_FRAME))


def test_after_a_timeout_the_newest_frame_goes_whole():
    wire = SlowWire(bad=1)
    frames = schedule(40, 0.02)
    played = play_frames(wire, frames)
    # The first write ends at 0.25 s; the newest frame due then is number 12 (0.24 s).
    assert wire.sent[0] == (0.25, frames[12][1])
    assert (played.frames, played.skipped) == (28, 12)


def test_after_a_timeout_on_the_last_frame_it_is_sent_again():
    wire = SlowWire(bad=3)
    ((_, frame),) = frames = schedule(1, 0.0)
    assert play_frames(wire, frames).frames == 1
    assert wire.sent[0] == (0.75, frame)


def test_no_two_frames_start_closer_than_the_line_allows():
    wire = SlowWire(bad=0)
    play_frames(wire, schedule(500, 0.003))
    starts = [when for when, _ in wire.sent]
    assert min(b - a for a, b in pairwise(starts)) >= 1 / FRAME_RATE_HZ - 1e-9


def test_an_empty_schedule_only_silences():
    wire = SlowWire(bad=0)
    assert play_frames(wire, []) == Played(0, 0, 0.0)
    assert wire.sent == [(0.0, OFF_FRAME)]
