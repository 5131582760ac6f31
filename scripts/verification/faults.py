"""Faults of a line, a host and its processes, on a virtual SonicSurface, and the reaction of the player.

check_faults.py makes a table of them; the tests assert it.
"""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.drive.boards import BOARDS
from palmfield.drive.player import Player
from palmfield.drive.player.report import PlayReport
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError

BOARD = BOARDS["sonicsurface"]
RATE_HZ = 88.0
FRAME_S = BOARD.frame_time_s
START, SWAP = 254, 253


@dataclass
class Outcome:
    """Result of a fault.

    off: whether the board was silent at the end; torn: number of played frames with too few or too many bytes
    message: message for the caller; report: report of the player, if it ended without error
    emitted_s, late_s: times of numbered frames on the clock of the board and their delays [s]
    """

    off: bool
    torn: int
    message: str = ""
    report: PlayReport | None = None
    emitted_s: list[float] = field(default_factory=list)
    late_s: list[float] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)

    def late_between(self, start_s: float, end_s: float) -> float:
        """Return the largest delay of the frames emitted in an interval, on the clock of the board [s]."""
        return max(late for at, late in zip(self.emitted_s, self.late_s, strict=True) if start_s <= at < end_s)


def turned(step: int) -> np.ndarray:
    return np.full(256, np.exp(2j * np.pi * step / 32))


def numbered(number: int) -> bytes:
    """Return a frame that contains its number, below 1024."""
    drive = turned(number % 32)
    drive[-1] = turned(number // 32)[-1]
    return BOARD.encode(drive)


def number_of(emitted: np.ndarray) -> int:
    steps = np.rint(np.angle(emitted[[0, -1]]) * 32 / (2 * np.pi)).astype(int) % 32
    return int(steps[0] + 32 * steps[1])


def frames(seconds: float, rate_Hz: float = RATE_HZ) -> list[tuple[float, bytes]]:
    return [(n / rate_Hz, numbered(n)) for n in range(round(seconds * rate_Hz))]


def torn_frames(received: bytes) -> int:
    """Count swaps of buffers after another number of bytes than that of a frame: half or resumed frames."""
    count = 0
    data = -1
    for byte in received:
        if byte == START:
            data = 0
        elif byte == SWAP:
            count += data != 256
            data = -1
        elif data >= 0 and byte <= 32:
            data += 1
    return count


def outcome(board: VirtualBoard, rate_Hz: float = RATE_HZ, **more: Any) -> Outcome:
    """Return the result of a run, once the line is quiet."""
    board.settle(0.2)
    emitted = [(change.time_s, number_of(change.amplitudes)) for change in board.emitted if change.amplitudes.all()]
    emitted = emitted[1 if emitted and emitted[0][1] == 0 and len(emitted) > 1 and emitted[1][1] == 0 else 0 :]
    when = [at for at, _ in emitted]
    offsets = [at - number / rate_Hz for at, number in emitted]
    late = [offset - min(offsets) for offset in offsets]
    return Outcome(
        not board.twin.emitted.any(), torn_frames(bytes(board.received)), emitted_s=when, late_s=late, **more
    )  # fmt: skip


@contextmanager
def at(moments: list[tuple[float, Callable[[], None]]]) -> Iterator[None]:
    """Call functions after some seconds, on another thread."""
    timers = [threading.Timer(when, what) for when, what in moments]
    for timer in timers:
        timer.start()
    yield
    for timer in timers:
        timer.join()


def play(board: VirtualBoard, seconds: float, rate_Hz: float = RATE_HZ, **settings: Any) -> dict[str, Any]:
    """Play with the player of this process; return its message and report."""
    try:
        with Player(BOARD, board.port, **settings) as player:
            return {"report": player.play(frames(seconds, rate_Hz))}
    except DeviceError as error:
        return {"message": str(error)}


# -- the line ----------------------------------------------------------------------------------------------------------


def stall(length_s: float, seconds: float) -> Outcome:
    """Stop the line from 1 s on; `stood_s` is the pause of the machine itself after that."""
    with VirtualBoard(BOARD, realtime=True) as board:
        Player(BOARD, board.port).close()  # so that what is loaded once is
        goes_on: list[float] = []

        def go_on() -> None:
            board.stall(False)
            goes_on.extend((board.clock, time.monotonic()))

        with machine_pauses() as pauses:
            with at([(1.0, board.stall), (1.0 + length_s, go_on)]):
                done = play(board, seconds)
            stood = stood_s(pauses(), goes_on[1])
        result = outcome(board, **done)
        result.numbers |= {"stalled_until_s": goes_on[0], "stood_s": stood}
        return result


def full_buffer() -> Outcome:
    """Stop the line for 1.5 s without an error: the buffer of the system fills up."""
    with VirtualBoard(BOARD, tells=False, realtime=True) as board:
        with at([(1.0, board.stall), (2.5, lambda: board.stall(False))]):
            done = play(board, 2.5)
        return outcome(board, **done)


def half_frame_lost() -> Outcome:
    """Lose a hundred bytes of a frame."""
    with VirtualBoard(BOARD, realtime=True) as board:
        with at([(0.9, lambda: board.lose(100))]):
            done = play(board, 1.2)
        result = outcome(board, **done)
        sounding = [change.amplitudes for change in board.emitted if change.amplitudes.all()]
        # All but the last transducer of a numbered frame have one phase
        mixed = [bool(np.ptp(np.abs(one[:-1] - one[0])) > 1e-6) for one in sounding]
        result.numbers |= {"mixed": sum(mixed), "frames": len(mixed), "last": mixed[-1]}
        return result


def unplugged(back_after_s: float | None) -> Outcome:
    """Remove the port; it returns under its name, or never."""
    with (
        tempfile.TemporaryDirectory() as folder,
        VirtualBoard(BOARD, link=Path(folder) / "port", realtime=True) as board,
    ):
        moments = [(1.0, board.unplug)]
        if back_after_s is not None:
            moments.append((1.0 + back_after_s, board.plug))
        with at(moments):
            done = play(board, 3.0, replug_s=1.5)
        return outcome(board, **done)


# -- processes ---------------------------------------------------------------------------------------------------------

CALLER = """
import sys
sys.path.insert(0, {here!r})
import faults
from palmfield.drive.player import Player
with Player(faults.BOARD, {port!r}) as player:
    print(player._process.pid, flush=True)
    {work}
"""
BUSY = "player.play(faults.frames(10.0))"
IN_C = """
    import numpy
    from palmfield.drive.player.messages import Schedule
    times, data = zip(*faults.frames(10.0))
    player._send(b'S', Schedule(times, data, 10.0).packed())
    matrix = numpy.random.default_rng(0).random((3000, 3000))
    numpy.linalg.svd(matrix)
"""
"""Python handlers of signals wait until this computation in C ends, about ten seconds."""


@contextmanager
def caller(board: VirtualBoard, work: str = BUSY) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Start a program that plays for 10 s, and return its player's process number when it sounds."""
    here = str(Path(__file__).parent)
    program = CALLER.format(here=here, port=board.port, work=work)

    def heed_signals() -> None:
        # Under nohup, or in a shell's background, they would be ignored
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
            signal.signal(number, signal.SIG_DFL)

    # In a group of its own: one whose parents are all of it or of another session can't be stopped by SIGTSTP
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=heed_signals, process_group=0,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        player = int(process.stdout.readline() or 0)
        ends = time.monotonic() + 10.0
        while not board.twin.emitted.any() and time.monotonic() < ends:
            time.sleep(0.01)
        time.sleep(0.3)
        yield process, player
    finally:
        process.kill()
        process.communicate()


def silent_after(board: VirtualBoard, within_s: float = 5.0) -> float:
    """Return the time until silence [s], inf if sound never stops."""
    began = time.monotonic()
    while time.monotonic() - began < within_s:
        if not board.twin.emitted.any():
            return time.monotonic() - began
        time.sleep(2e-3)
    return float("inf")


def caller_gets(number: int, work: str = BUSY) -> Outcome:
    """Send a signal to the caller alone."""
    with VirtualBoard(BOARD, realtime=True) as board:
        board.emitted.clear()
        with caller(board, work) as (process, _):
            process.send_signal(number)
            after = silent_after(board)
            code = process.wait(20) if work == BUSY else 0
        result = outcome(board)
        result.numbers |= {"silent_after_s": after, "code": code}
        return result


def caller_pauses(number: int) -> Outcome:
    """Stop and continue the caller: silent in between, then sounding again."""
    with VirtualBoard(BOARD, realtime=True) as board:
        with caller(board) as (process, _):
            process.send_signal(number)
            after = silent_after(board)
            time.sleep(0.3)
            still = not board.twin.emitted.any()
            process.send_signal(signal.SIGCONT)
            time.sleep(0.5)
            again = bool(board.twin.emitted.any())
            process.send_signal(signal.SIGTERM)
            process.wait(10)
        result = outcome(board)
        result.numbers |= {"silent_after_s": after, "stayed_silent": still, "sounds_again": again}
        return result


def player_killed() -> Outcome:
    """Kill the player (kill -9)."""
    with VirtualBoard(BOARD, realtime=True) as board:
        message = ""
        try:
            with Player(BOARD, board.port) as player:
                kill = lambda: os.kill(player._process.pid, signal.SIGKILL)  # noqa: E731
                with at([(0.7, kill)]):
                    player.play(frames(3.0))
        except DeviceError as error:
            message = str(error)
        return outcome(board, message=message)


@contextmanager
def busy_host() -> Iterator[None]:
    """Run two computing processes of normal priority per core."""
    count = 2 * (os.cpu_count() or 1)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: sum(range(10**6))"]) for _ in range(count)]
    try:
        time.sleep(0.3)
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def host_at_100(seconds: float = 2.0, realtime: bool = True) -> Outcome:
    """Load all cores with twice as many processes of normal priority; the board is its own process."""
    with board_process() as (port, ended), busy_host(), machine_pauses() as pauses:
        with Player(BOARD, port, realtime=realtime) as player:
            report = player.play(frames(seconds))
        emitted = ended()
        numbers = {"pauses": float(sum(pause > 0.5 * FRAME_S for _, pause in pauses()))}
        return Outcome(
            emitted["off"], emitted["torn"], "", report, emitted["emitted_s"], emitted["late_s"], numbers
        )  # fmt: skip


PROBE = """
import json, os, select, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(80))
pauses, due = [], time.monotonic()
while not select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
    now = time.monotonic()
    pauses.append((due, now - due))
    due = now + 1e-3
print(json.dumps(pauses))
"""


@contextmanager
def machine_pauses() -> Iterator[Callable[[], list[tuple[float, float]]]]:
    """Measure the delays with which the machine wakes processes of highest priority at 1000 wake-ups per second.

    There is one process on each core. The result is for the core with the longest pause: the due time of each wake-up
    on `time.monotonic`, and its delay [s]. A virtual machine pauses while its host does other work. Empty if no
    priority is permitted.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROBE, str(core)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )
        for core in cores
    ]  # fmt: skip

    def ended() -> list[tuple[float, float]]:
        outputs = [process.communicate("\n")[0] if process.poll() is None else "" for process in processes]
        return max((json.loads(one) for one in outputs if one), key=stood_s, default=[])

    try:
        yield ended
    finally:
        for process in processes:
            process.kill()
            process.wait()


def stood_s(pauses: list[tuple[float, float]], start_s: float = -math.inf, end_s: float = math.inf) -> float:
    """Return the total pause of a core between two times on `time.monotonic`, from pauses over 1 ms [s]."""
    return sum(late for due, late in pauses if late > 1e-3 and due + late > start_s and due < end_s)


REAL_BOARD = """
import contextlib, json, os, sys
sys.path.insert(0, {here!r})
import faults
with contextlib.suppress(OSError, AttributeError):
    # A real board takes its bytes whatever the host does
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
with faults.VirtualBoard(faults.BOARD) as board:
    print(board.port, flush=True)
    sys.stdin.readline()
    result = faults.outcome(board)
    told = {{"off": bool(result.off), "torn": result.torn, "emitted_s": result.emitted_s, "late_s": result.late_s}}
    print(json.dumps(told), flush=True)
"""


@contextmanager
def board_process() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """Run a virtual board in its own process, with priority if permitted; return its port and its result."""
    program = REAL_BOARD.format(here=str(Path(__file__).parent))
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None

    def ended() -> dict[str, Any]:
        process.stdin.write("\n")
        process.stdin.flush()
        return json.loads(process.stdout.readline())

    try:
        yield process.stdout.readline().strip(), ended
    finally:
        process.kill()
        process.communicate()
