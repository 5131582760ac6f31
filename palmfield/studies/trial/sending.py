"""Frames made of what is known at the moment, sent to a board, and what it emits of them and when.

This is the only place of a trial that sends. A frame is made just before its first byte goes out.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from palmfield.drive.board import HELD_BACK_S, Board, Emitted, Twin
from palmfield.drive.board_link import BoardLink
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.playback import signals_as_exit
from palmfield.drive.ports import open_port
from palmfield.drive.transport import Transport
from palmfield.drive.virtual import VirtualBoard
from palmfield.types import Complex, Float

VIRTUAL = "virtual"
"""Instead of a port: a virtual board that is paced in real time."""
BEFORE_S = 0.1
"""A frame is made so long before the first one that is sent, for practice."""
LAST_FRAMES = 4
"""So many frames at most are on the line, in buffers or waiting for a sync before they sound."""


class MadeFrame(NamedTuple):
    """A frame for a board.

    data: its bytes, none for a board without a line; wanted: what is asked of the transducers before bytes, shape (N,)
    focus: that it is for, array frame [m], shape (3,); seen_s: time of the last sample that it was made from [s]
    """

    data: bytes
    wanted: Complex
    focus: Float
    seen_s: float


Make = Callable[[float, float], MadeFrame]
"""Makes, of what is known at one time, the frame that is to sound from another on, both in the trial's time [s]."""


@dataclass(frozen=True)
class SentFrame:
    """number: among those that are due; due_s: when it should sound; made_s: when it was made; begun_s: when its first
    byte went out, all of the trial's time [s]"""

    number: int
    due_s: float
    made_s: float
    begun_s: float
    frame: MadeFrame


@dataclass
class Sent:
    """What a trial's sending gives.

    frames: those that went out; due: how many were due; emitted: what sounds from when on, in the trial's time [s]
    late_s: worst delay of a frame's last byte on the line [s]; flags: what a virtual board noticed, in words
    interrupted: whether Ctrl-C ended it early; end_s: until when it went [s]
    zero_s: the trial's time 0 on the link's clock [s]
    """

    frames: list[SentFrame] = field(default_factory=list)
    due: int = 0
    emitted: list[Emitted] = field(default_factory=list)
    late_s: float = 0.0
    flags: list[str] = field(default_factory=list)
    interrupted: bool = False
    end_s: float = 0.0
    zero_s: float = 0.0

    @property
    def dropped(self) -> int:
        """Frames that were due and not sent."""
        return self.due - len(self.frames)


class _Tap:
    """A transport that also feeds a board's twin with what goes through it, at the times when it is written."""

    def __init__(self, twin: Twin, through: Transport | None) -> None:
        self.twin, self.through = twin, through
        self.name = "its virtual twin" if through is None else through.name
        self.clock: Callable[[], float] = time.monotonic
        self.emitted: list[Emitted] = []

    def write(self, data: bytes) -> bool:
        now = self.clock()
        whole = True if self.through is None else self.through.write(data)
        if whole:
            self.emitted += [*self.twin.until(now), *self.twin.feed(data, now)]
        return whole

    def waiting(self) -> int:
        return 0 if self.through is None else self.through.waiting()

    def flush(self) -> None:
        if self.through is not None:
            self.through.flush()

    def close(self) -> None:
        if self.through is not None:
            self.through.close()
        self.emitted += self.twin.until(self.twin.time_s + HELD_BACK_S)


def send(
    board: Board,
    times_s: Sequence[float],
    make: Make,
    duration_s: float,
    *,
    port: str | None = None,
    log: FrameLog | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Sent:
    """Make and send the frames that are due at some times [s], rising; the newest that is due wins.

    port: of a board; VIRTUAL for a virtual one, paced in real time; None for a virtual twin that takes no time, so that
        a trial is quick and repeats to the last digit
    duration_s: how long the last frame goes on [s]; on_progress: told the trial's time [s]
    What a real board emits is what its twin makes of the bytes at the times when they were written. Ctrl-C ends it
    early, and the board is off in the end. Raises DeviceError where the port can't be opened or is lost.
    """
    sent = Sent()
    if board.exact:
        _play_exactly(sent, times_s, make)
        sent.end_s = duration_s
        return sent
    if port is not None and len(times_s):
        # What is made for the first time takes long, and a board that is on waits for its frames
        make(times_s[0] - BEFORE_S, times_s[0])
    if port == VIRTUAL:
        with VirtualBoard(board) as virtual:
            line = board.line
            assert line is not None
            link = BoardLink(board, open_port(virtual.port, line.baud), log=log)
            with closing(link):
                _play(link, sent, times_s, make, duration_s, on_progress)
            virtual.settle()
            offset = time.monotonic() - virtual.clock - sent.zero_s
            sent.emitted = _not_early(
                board, sent.frames, [Emitted(one.time_s + offset, one.amplitudes) for one in virtual.emitted]
            )
            sent.flags = [f"at {flag.time_s + offset:.3f} s {flag.kind}: {flag.text}" for flag in virtual.flags]
        return sent
    assert board.line is not None
    tap = _Tap(board.wired_twin(), None if port is None else open_port(port, board.line.baud))
    link = BoardLink(board, tap, simulated=port is None, log=log)
    # Twins count from when they are switched on
    zero = link.now()
    tap.clock = lambda: link.now() - zero
    with closing(link):
        _play(link, sent, times_s, make, duration_s, on_progress)
    offset = zero - sent.zero_s
    sent.emitted = [Emitted(one.time_s + offset, one.amplitudes) for one in tap.emitted]
    sent.flags = [f"at {flag.time_s + offset:.3f} s {flag.kind}: {flag.text}" for flag in tap.twin.flags]
    return sent


def _not_early(board: Board, frames: list[SentFrame], emitted: list[Emitted]) -> list[Emitted]:
    """What a virtual board emitted, none of it before its frame's last byte can have been there.

    A virtual board knows when it looked, and not when bytes came: where this machine is busy that is long before.
    """
    begin = len(board.decode(board.start))
    if len(emitted) < begin + len(frames):
        return emitted
    result = list(emitted)
    for number, sent in enumerate(frames, begin):
        known = emitted[number]
        result[number] = known._replace(time_s=max(known.time_s, sent.begun_s + board.frame_time_s))
    return sorted(result, key=lambda one: one.time_s)


def _play_exactly(sent: Sent, times_s: Sequence[float], make: Make) -> None:
    """What a board without limits and without a line emits: each frame at its time."""
    sent.due = len(times_s)
    for number, due_s in enumerate(times_s):
        frame = make(due_s, due_s)
        sent.frames.append(SentFrame(number, due_s, due_s, due_s, frame))
        sent.emitted.append(Emitted(due_s, frame.wanted))


def _play(
    link: BoardLink,
    sent: Sent,
    times_s: Sequence[float],
    make: Make,
    duration_s: float,
    on_progress: Callable[[float], None] | None,
) -> None:
    """Start the board, send what is due, and switch it off, also on errors and signals."""
    sent.zero_s = link.now()
    try:
        with signals_as_exit():
            link.start()
            _send_due(link, sent, times_s, make, on_progress)
            link.wait_until(max(sent.zero_s + sent.end_s, sent.zero_s + duration_s))
            sent.end_s = duration_s
    except KeyboardInterrupt:
        sent.interrupted = True
    finally:
        link.off()


def _send_due(
    link: BoardLink,
    sent: Sent,
    times_s: Sequence[float],
    make: Make,
    on_progress: Callable[[float], None] | None,
) -> None:
    takes_s = link.board.frame_time_s
    line_free = link.now() + link.line.time_s(len(link.board.start))
    zero = sent.zero_s = line_free + takes_s - (times_s[0] if len(times_s) else 0.0)
    for number, due_s in enumerate(times_s):
        sent.due = number + 1
        newer_due = zero + times_s[number + 1] - takes_s if number + 1 < len(times_s) else np.inf
        if newer_due <= max(line_free, link.now()):
            continue
        through = False
        while not through and newer_due > link.now():
            link.wait_until(max(zero + due_s - takes_s, line_free))
            made = link.now()
            frame = make(made - zero, due_s)
            begun = link.now()
            through = link.write(frame.data)
        if not through:
            continue
        line_free = max(line_free, begun) + takes_s
        sent.frames.append(SentFrame(number, due_s, made - zero, begun - zero, frame))
        sent.late_s = max(sent.late_s, line_free - zero - due_s)
        sent.end_s = line_free - zero
        if on_progress is not None:
            on_progress(made - zero)


class Heard:
    """What sounds at any time of a trial, and the frame that it is of. times: from when on each sounds [s]"""

    def __init__(self, sent: Sent, board: Board) -> None:
        self.times: Float = np.array([one.time_s for one in sent.emitted])
        self.emitted, self.frames, self._board = sent.emitted, sent.frames, board
        self._begun: Float = np.array([one.begun_s for one in sent.frames])
        self._played: dict[int, Complex] = {}
        self._of: dict[int, int] = {}

    def at(self, time_s: float) -> tuple[Emitted, SentFrame] | None:
        """What sounds at a time [s] and the frame that it is of; None before the first frame."""
        number = int(np.searchsorted(self.times, time_s + 1e-9, "right")) - 1
        if number < 0:
            return None
        if number not in self._of:
            self._of[number] = self._frame_of(self.emitted[number])
        frame = self._of[number]
        return None if frame < 0 else (self.emitted[number], self.frames[frame])

    def _frame_of(self, emitted: Emitted) -> int:
        """Number of the frame that makes the board emit this, -1 for none: the last one begun by then that does.

        Where bytes were lost on the way none does, and it is the last one that could be in.
        """
        begun = int(np.searchsorted(self._begun, emitted.time_s + 1e-9, "right")) - 1
        for number in range(begun, max(begun - LAST_FRAMES, -1), -1):
            if np.allclose(self._plays(number), emitted.amplitudes, atol=1e-6):
                return number
        in_by = int(np.searchsorted(self._begun + self._board.frame_time_s, emitted.time_s + 1e-9, "right")) - 1
        return min(in_by, begun)

    def _plays(self, number: int) -> Complex:
        """What the board emits of a frame whose bytes all arrive."""
        if number not in self._played:
            frame = self.frames[number].frame
            board = self._board
            self._played[number] = frame.wanted if board.exact else board.decode(board.start + frame.data)[-1]
        return self._played[number]
