"""Make frames from the present pose estimate, send them to a board, and reconstruct what it emits and when.

Only this module of a trial sends data. A frame is made just before its first byte is sent. A separate process
(`palmfield.drive.player`) sends frames to ports.
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from palmfield.drive.board import TWIN_DELAY_S, Board, Emitted, Line
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.limits import SoundLimits
from palmfield.drive.player import Player
from palmfield.drive.player.messages import Schedule
from palmfield.drive.player.sources import on_the_line
from palmfield.drive.virtual import VirtualBoard
from palmfield.realtime import undisturbed
from palmfield.types import Complex, Float

VIRTUAL = "virtual"
"""Value of `port` for a virtual board that runs in real time."""
BEFORE_S = 0.1
"""Time for making practice frames before the first frame is sent [s]."""
PRACTICE = 4
"""Number of practice frames."""
HANDING_S = 1.5e-3
"""Time from when a frame is ready until its first byte can be on an idle line [s]."""
REST = 0.2
"""Pause before the next frame is made, as a fraction of the time to make one frame.

Linux stops threads with real-time priority (the player) for 50 ms if other threads get less than 5 % of a second.
"""
MAKING_SHARE = 0.9
LAST_MADE = 50
"""Number of last frames whose computing times determine how early the next frame is computed.

The lead time is the MAKING_SHARE quantile of these times.
"""
STALE_S = 1.0
"""Time without a frame after which the board becomes silent [s]."""
LAST_FRAMES = 4
"""Largest number of frames that are on the line, in buffers, or waiting for a sync before they sound."""


class MadeFrame:
    """A frame for a board.

    data: its bytes, empty for a board without a line
    focus: target position, array frame [m], shape (3,)
    sample_s: time of the last sample from which it was made [s]
    sounds: whether any transducer is on
    target: drive of the transducers before rounding, shape (N,). It is computed at the first use, to save time while
        frames are sent
    """

    def __init__(
        self, data: bytes, focus: Float, sample_s: float, make_target: Callable[[], Complex], sounds: bool = True
    ) -> None:
        self.data, self.focus, self.sample_s, self.sounds = data, focus, sample_s, sounds
        self._make_target: Callable[[], Complex] | None = make_target

    @cached_property
    def target(self) -> Complex:
        assert self._make_target is not None
        # Free the data from which it was made, which are large
        make_target, self._make_target = self._make_target, None
        return make_target()


Make = Callable[[float, float], MadeFrame]
"""Function that makes a frame. Arguments, as times of the trial [s]: time of the estimate, and time of the sound."""


@dataclass(frozen=True)
class SentFrame:
    """A sent frame. All times are times of the trial [s].

    number: number among the due frames
    due_s: when it should sound
    made_s: when it was made
    begun_s: when its first byte was sent
    """

    number: int
    due_s: float
    made_s: float
    begun_s: float
    frame: MadeFrame


@dataclass
class Sent:
    """Result of sending the frames of a trial.

    frames: the sent frames
    due: number of due frames
    emitted: drives with their start times, in the time of the trial [s]
    late_s: largest delay of the last byte of a frame on the line [s]
    flags: errors that a virtual board reported, in words
    interrupted: whether Ctrl-C ended the trial early
    end_s: time of the end [s]
    zero_s: time 0 of the trial on the clock of the sender [s]
    notes: remarks on the sending
    """

    frames: list[SentFrame] = field(default_factory=list)
    due: int = 0
    emitted: list[Emitted] = field(default_factory=list)
    late_s: float = 0.0
    flags: list[str] = field(default_factory=list)
    interrupted: bool = False
    end_s: float = 0.0
    zero_s: float = 0.0
    notes: list[str] = field(default_factory=list)

    @property
    def dropped(self) -> int:
        """Number of frames that were due but not sent."""
        return self.due - len(self.frames)

    def add(self, frame: SentFrame, line_s: float) -> None:
        """Add a sent frame. line_s: times on the line [s]"""
        self.frames.append(frame)
        ends = frame.begun_s + line_s
        self.late_s, self.end_s = max(self.late_s, ends - frame.due_s), ends


@dataclass(frozen=True)
class _Order:
    """Arguments of `send`."""

    board: Board
    times_s: Sequence[float]
    make: Make
    duration_s: float
    show_progress: Callable[[float], None]


def send(
    board: Board,
    times_s: Sequence[float],
    make: Make,
    duration_s: float,
    *,
    port: str | None = None,
    log: FrameLog | None = None,
    limits: SoundLimits | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Sent:
    """Make and send frames for rising due times [s]. If several frames are due, only the newest is sent.

    port: port of a board; VIRTUAL: a virtual board in real time; None: a virtual twin that does not wait, so that a
        trial is fast and exactly repeatable
    duration_s: duration of the last frame [s]
    log: log of the sent frames, which is closed at the end
    limits: limits of the sound energy; above them the player becomes silent
    on_progress: function that is called with the time of the trial [s]
    The twin of a real board computes its emission, from the bytes and their times on the line. Ctrl-C ends the trial
    early; the board is off at the end. Raises DeviceError if the port cannot be opened or is lost, and for a port on a
    system without POSIX.
    """
    order = _Order(board, times_s, make, duration_s, on_progress or (lambda time_s: None))
    if board.exact:
        sent = _play_exactly(order)
    elif port is None:
        sent = _play_on_twin(order, log)
    elif port == VIRTUAL:
        with VirtualBoard(board, decodes=False, realtime=True) as virtual:
            sent = _play_on_port(order, virtual.port, log, limits)
            virtual.settle()
            virtual.decode()
            offset = time.monotonic() - virtual.clock - sent.zero_s
        emitted = [Emitted(one.time_s + offset, one.amplitudes) for one in virtual.emitted]
        sent.emitted = _not_early(board, sent.frames, emitted)
        sent.flags = [f"at {flag.time_s + offset:.3f} s {flag.kind}: {flag.text}" for flag in virtual.flags]
    else:
        sent = _play_on_port(order, port, log, limits)
        _emit_by_twin(board, sent, duration_s)
    for one in sent.frames:
        one.frame.target  # noqa: B018 - computed in the order in which frames were made
    return sent


def _not_early(board: Board, frames: list[SentFrame], emitted: list[Emitted]) -> list[Emitted]:
    """Return the emission of a virtual board, corrected so that no frame sounds before its last byte can have arrived.

    A virtual board estimates arrival times from the times at which it reads bytes. On a busy machine they may be too
    early.
    """
    begin, line_s = len(board.decode(board.start)), board.frame_time_s
    if len(emitted) < begin + len(frames):
        return emitted
    result = list(emitted)
    for number, sent in enumerate(frames, begin):
        emission = emitted[number]
        result[number] = emission._replace(time_s=max(emission.time_s, sent.begun_s + line_s))
    return sorted(result, key=lambda one: one.time_s)


def _play_exactly(order: _Order) -> Sent:
    """Return the emission of a board without limits and without a line. Each frame sounds at its due time."""
    sent = Sent(due=len(order.times_s), end_s=order.duration_s)
    for number, due_s in enumerate(order.times_s):
        frame = order.make(due_s, due_s)
        sent.frames.append(SentFrame(number, due_s, due_s, due_s, frame))
        sent.emitted.append(Emitted(due_s, frame.target))
    return sent


class _Twin:
    """A virtual twin of a board that receives the bytes on the line.

    Times are measured from when it was switched on.
    """

    def __init__(self, board: Board, log: FrameLog | None = None) -> None:
        self.board, self.twin, self.log = board, board.wired_twin(), log
        self.emitted: list[Emitted] = []

    def feed(self, data: bytes, begins_s: float) -> None:
        self.emitted += [*self.twin.until(begins_s), *self.twin.feed(data, begins_s)]
        if self.log is not None:
            self.log.add(begins_s, data)

    def stop(self, begins_s: float, zero_s: float, sent: Sent) -> None:
        """Silence the twin, and fill `sent` with its emission. Time 0 of the trial is `zero_s` of the twin."""
        self.feed(self.board.stop, begins_s)
        self.emitted += self.twin.until(self.twin.time_s + TWIN_DELAY_S)
        sent.emitted = [Emitted(one.time_s - zero_s, one.amplitudes) for one in self.emitted]
        sent.flags = [f"at {flag.time_s - zero_s:.3f} s {flag.kind}: {flag.text}" for flag in self.twin.flags]


def _play_on_twin(order: _Order, log: FrameLog | None) -> Sent:
    """Return the emission of a virtual board whose line takes its real time, without waiting for it."""
    board, times_s = order.board, order.times_s
    line, line_s = _line(board), board.frame_time_s
    sent, twin = Sent(due=len(times_s)), _Twin(board, log)
    twin.feed(board.start, 0.0)
    free_s = line.time_s(len(board.start))
    zero = sent.zero_s = free_s + line_s - (times_s[0] if len(times_s) else 0.0)
    schedule = Schedule(times_s, [bytes(board.frame_bytes)] * len(times_s), 0.0)
    now = free_s
    try:
        for choice in on_the_line(schedule, line.time_s(1), free_s):
            now, due_s = choice.at_s, times_s[choice.number]
            sent.due = choice.number + 1
            made = SentFrame(choice.number, due_s, now - zero, now - zero, order.make(now - zero, due_s))
            twin.feed(made.frame.data, now)
            sent.add(made, line_s)
            order.show_progress(made.made_s)
        now = max(now, zero + sent.end_s, zero + order.duration_s)
        sent.due, sent.end_s = len(times_s), order.duration_s
    except KeyboardInterrupt:
        sent.interrupted = True
    finally:
        twin.stop(now, zero, sent)
        if log is not None:
            log.close()
    return sent


def _line(board: Board) -> Line:
    assert board.line is not None
    return board.line


def _play_on_port(order: _Order, port: str, log: FrameLog | None, limits: SoundLimits | None) -> Sent:
    """Make frames in this process and send them by a player, which reports when each frame was on the line."""
    within = limits or SoundLimits()
    if log is not None:
        log.close()
    path = None if log is None else log.path
    passed: list[tuple[int, float, MadeFrame]] = []
    player = Player(
        order.board, port, log=path, stale_s=STALE_S, refresh_s=10.0 * STALE_S, tells_frames=True,
        on_time_s=within.on_time_s or 0.0, duty=within.duty,
    )  # fmt: skip
    try:
        sent = _make_and_give(order, player, passed)
    finally:
        player.close()
    report = player.played
    ended_s, line_s = sent.end_s, order.board.frame_time_s
    for which, on_line_s in report.on_line:
        number, made_s, frame = passed[which]
        begun_s = on_line_s - sent.zero_s - line_s
        sent.add(SentFrame(number, order.times_s[number], made_s, begun_s, frame), line_s)
    sent.end_s = sent.end_s if sent.interrupted else max(sent.end_s, ended_s)
    late = len(passed) - len(sent.frames)
    sent.notes.append(f"sent by a player at {player.priority}; {late} computed frames were too late for the line")
    if player.log_error:
        sent.notes.append(f"the log ends early: {player.log_error}")
    if player.silent:
        sent.notes.append(f"the player was silenced: {player.silent}")
    return sent


def _make_and_give(order: _Order, player: Player, passed: list[tuple[int, float, MadeFrame]]) -> Sent:
    """Make frames just before they are due, and pass them to a player.

    passed: list that gets, for each frame, its number among the due frames, when it was made [s], and the frame
    """
    times_s = order.times_s
    line_s, making = order.board.frame_time_s, _practised(order.make, times_s)
    first_s = times_s[0] if len(times_s) else 0.0
    sent = Sent(zero_s=time.monotonic() + making.ahead_s + line_s - first_s)
    begins = [*(sent.zero_s + due_s - line_s for due_s in times_s), np.inf]
    with contextlib.suppress(KeyboardInterrupt), undisturbed() as priority:
        sent.interrupted = True
        rested_s = 0.0
        for number, due_s in enumerate(times_s):
            sent.due = number + 1
            if begins[number + 1] < max(rested_s, time.monotonic()) + making.took_s + HANDING_S:
                continue
            time.sleep(max(0.0, max(rested_s, begins[number] - making.ahead_s) - time.monotonic()))
            now = time.monotonic()
            frame = order.make(now - sent.zero_s, due_s)
            player.send([frame.data], float(frame.sounds), made_s=now, due_s=sent.zero_s + due_s)
            passed.append((number, now - sent.zero_s, frame))
            order.show_progress(now - sent.zero_s)
            done_s = time.monotonic()
            making.add(done_s - now)
            rested_s = done_s + REST * (done_s - now)
        time.sleep(max(0.0, sent.zero_s + max(order.duration_s, first_s + line_s) - time.monotonic()))
        sent.interrupted, sent.end_s = False, order.duration_s
    sent.notes.append(f"frames computed at {priority}: {making}")
    return sent


class _Making:
    """Time to make frames.

    took_s: median of the last frames [s]; ahead_s: lead before the first byte at which one begins [s]
    """

    took_s, ahead_s = 0.0, HANDING_S

    def __init__(self) -> None:
        self._seconds: list[float] = []

    def add(self, seconds: float) -> None:
        self._seconds.append(seconds)
        last = sorted(self._seconds[-LAST_MADE:])
        self.took_s = last[len(last) // 2]
        self.ahead_s = last[int(MAKING_SHARE * len(last))] + HANDING_S

    def __str__(self) -> str:
        median, most = float(np.median(self._seconds or [0.0])), max(self._seconds, default=0.0)
        return f"{1e3 * median:.2g} ms each (maximum {1e3 * most:.2g})"


def _practised(make: Make, times_s: Sequence[float]) -> _Making:
    """Make practice frames, because the first frames take longer."""
    making = _Making()
    for number in range(PRACTICE if len(times_s) else 0):
        began = time.monotonic()
        make(times_s[0] - BEFORE_S, times_s[0])
        if number > 0:
            making.add(time.monotonic() - began)
    return making


def _emit_by_twin(board: Board, sent: Sent, duration_s: float) -> None:
    """Return the emission of a real board. Its twin computes it from the times of the bytes on the line."""
    twin = _Twin(board)
    start_s = _line(board).time_s(len(board.start))
    zero = start_s - min([0.0, *(one.begun_s for one in sent.frames[:1])])
    twin.feed(board.start, 0.0)
    for one in sent.frames:
        twin.feed(one.frame.data, zero + one.begun_s)
    twin.stop(zero + max(sent.end_s, duration_s * (not sent.interrupted)), zero, sent)


class Drives:
    """The drive at any time of a trial, with its frame. times: start of each drive [s]"""

    def __init__(self, sent: Sent, board: Board) -> None:
        self.times: Float = np.array([one.time_s for one in sent.emitted])
        self.emitted, self.frames, self._board = sent.emitted, sent.frames, board
        self._begun: Float = np.array([one.begun_s for one in sent.frames])
        self._line_s = board.frame_time_s
        self._played: dict[int, Complex] = {}
        self._of: dict[int, int] = {}

    def at(self, time_s: float) -> tuple[Emitted, SentFrame] | None:
        """Return the drive at a time [s] and its frame; None before the first frame."""
        number = int(np.searchsorted(self.times, time_s + 1e-9, "right")) - 1
        if number < 0:
            return None
        if number not in self._of:
            self._of[number] = self._frame_of(self.emitted[number])
        frame = self._of[number]
        return None if frame < 0 else (self.emitted[number], self.frames[frame])

    def _frame_of(self, emitted: Emitted) -> int:
        """Return the number of the last frame, begun by then, that matches this emission; -1 for no such frame.

        If bytes were lost and no frame matches, return the last frame that could have arrived.
        """
        begun = int(np.searchsorted(self._begun, emitted.time_s + 1e-9, "right")) - 1
        for number in range(begun, max(begun - LAST_FRAMES, -1), -1):
            if np.allclose(self._plays(number), emitted.amplitudes, atol=1e-6):
                return number
        in_by = int(np.searchsorted(self._begun + self._line_s, emitted.time_s + 1e-9, "right")) - 1
        return min(in_by, begun)

    def _plays(self, number: int) -> Complex:
        """Return the emission of a frame if all its bytes arrive."""
        if number not in self._played:
            frame = self.frames[number].frame
            board = self._board
            self._played[number] = frame.target if board.exact else board.decode(board.start + frame.data)[-1]
        return self._played[number]
