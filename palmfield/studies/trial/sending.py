"""Frames made of what is known at the moment, sent to a board, and what it emits of them and when.

This is the only place of a trial that sends. A frame is made just before its first byte goes out. To ports they are
sent by a process of its own (`palmfield.drive.player`).
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from palmfield.drive.board import HELD_BACK_S, Board, Emitted, Line
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.limits import SoundLimits
from palmfield.drive.player import Player
from palmfield.drive.player.messages import Schedule
from palmfield.drive.player.sources import on_the_line
from palmfield.drive.virtual import VirtualBoard
from palmfield.realtime import undisturbed
from palmfield.types import Complex, Float

VIRTUAL = "virtual"
"""Instead of a port: a virtual board that is paced in real time."""
BEFORE_S = 0.1
"""A frame is made so long before the first one that is sent, for practice."""
PRACTICE = 4
"""So many are made then."""
HANDING_S = 1.5e-3
"""From when a frame is made until its first byte can be on the line, when nothing is in the way."""
REST = 0.2
"""Of the time in which a frame was made, until the next one is begun. Linux stops threads with real-time priority, the
player's among them, for 50 ms where they leave others less than 5 % of a second."""
MAKING_SHARE = 0.9
LAST_MADE = 50
"""Frames are begun as early as that share of so many last ones took to be made."""
STALE_S = 1.0
"""Where no frame comes for so long the board falls silent."""
LAST_FRAMES = 4
"""So many frames at most are on the line, in buffers or waiting for a sync before they sound."""


class MadeFrame:
    """A frame for a board.

    data: its bytes, none for a board without a line; focus: that it is for, array frame [m], shape (3,)
    seen_s: time of the last sample that it was made from [s]
    sounds: whether anything is on in it
    wanted: what is asked of the transducers before bytes, shape (N,); computed when it is first read, as no board
        waits for it
    """

    def __init__(
        self, data: bytes, focus: Float, seen_s: float, want: Callable[[], Complex], sounds: bool = True
    ) -> None:
        self.data, self.focus, self.seen_s, self.sounds = data, focus, seen_s, sounds
        self._want: Callable[[], Complex] | None = want

    @cached_property
    def wanted(self) -> Complex:
        assert self._want is not None
        # What it was made from is large
        want, self._want = self._want, None
        return want()


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
    zero_s: the trial's time 0 on the clock of who sends [s]; notes: of the sending, in words
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
        """Frames that were due and not sent."""
        return self.due - len(self.frames)

    def add(self, frame: SentFrame, takes_s: float) -> None:
        """One that went out. takes_s: its time on the line [s]"""
        self.frames.append(frame)
        ends = frame.begun_s + takes_s
        self.late_s, self.end_s = max(self.late_s, ends - frame.due_s), ends


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
    """Make and send the frames that are due at some times [s], rising; the newest that is due wins.

    port: of a board; VIRTUAL for a virtual one, paced in real time; None for a virtual twin that takes no time, so that
        a trial is quick and repeats to the last digit
    duration_s: how long the last frame goes on [s]; log: is closed; on_progress: told the trial's time [s]
    limits: by which a player falls silent where so much sound is spent
    What a real board emits is what its twin makes of the bytes at the times when they were on the line. Ctrl-C ends it
    early, and the board is off in the end. Raises DeviceError where the port can't be opened or is lost, and for a port
    where there is no POSIX.
    """
    told = on_progress or (lambda time_s: None)
    if board.exact:
        sent = _play_exactly(times_s, make)
        sent.end_s = duration_s
    elif port is None:
        sent = _play_on_twin(board, times_s, make, duration_s, log, told)
    elif port == VIRTUAL:
        with VirtualBoard(board, decodes=False, realtime=True) as virtual:
            sent = _play_on_port(board, virtual.port, times_s, make, duration_s, log, limits, told)
            virtual.settle()
            virtual.decode()
            offset = time.monotonic() - virtual.clock - sent.zero_s
        emitted = [Emitted(one.time_s + offset, one.amplitudes) for one in virtual.emitted]
        sent.emitted = _not_early(board, sent.frames, emitted)
        sent.flags = [f"at {flag.time_s + offset:.3f} s {flag.kind}: {flag.text}" for flag in virtual.flags]
    else:
        sent = _play_on_port(board, port, times_s, make, duration_s, log, limits, told)
        _emit_by_twin(board, sent, duration_s)
    for one in sent.frames:
        one.frame.wanted  # noqa: B018 - in the order in which they were made
    return sent


def _not_early(board: Board, frames: list[SentFrame], emitted: list[Emitted]) -> list[Emitted]:
    """What a virtual board emitted, none of it before its frame's last byte can have been there.

    A virtual board knows when it looked, and not when bytes came: where this machine is busy that is long before.
    """
    begin, takes_s = len(board.decode(board.start)), board.frame_time_s
    if len(emitted) < begin + len(frames):
        return emitted
    result = list(emitted)
    for number, sent in enumerate(frames, begin):
        known = emitted[number]
        result[number] = known._replace(time_s=max(known.time_s, sent.begun_s + takes_s))
    return sorted(result, key=lambda one: one.time_s)


def _play_exactly(times_s: Sequence[float], make: Make) -> Sent:
    """What a board without limits and without a line emits: each frame at its time."""
    sent = Sent(due=len(times_s))
    for number, due_s in enumerate(times_s):
        frame = make(due_s, due_s)
        sent.frames.append(SentFrame(number, due_s, due_s, due_s, frame))
        sent.emitted.append(Emitted(due_s, frame.wanted))
    return sent


class _Twin:
    """A board's twin that is fed with what is on the line, at times since it was switched on."""

    def __init__(self, board: Board, log: FrameLog | None = None) -> None:
        self.board, self.twin, self.log = board, board.wired_twin(), log
        self.emitted: list[Emitted] = []

    def feed(self, data: bytes, begins_s: float) -> None:
        self.emitted += [*self.twin.until(begins_s), *self.twin.feed(data, begins_s)]
        if self.log is not None:
            self.log.add(begins_s, data)

    def stop(self, begins_s: float, zero_s: float, sent: Sent) -> None:
        """Silence it, and tell what was emitted in a trial whose time begins at `zero_s` of this twin's."""
        self.feed(self.board.stop, begins_s)
        self.emitted += self.twin.until(self.twin.time_s + HELD_BACK_S)
        sent.emitted = [Emitted(one.time_s - zero_s, one.amplitudes) for one in self.emitted]
        sent.flags = [f"at {flag.time_s - zero_s:.3f} s {flag.kind}: {flag.text}" for flag in self.twin.flags]


def _play_on_twin(
    board: Board,
    times_s: Sequence[float],
    make: Make,
    duration_s: float,
    log: FrameLog | None,
    told: Callable[[float], None],
) -> Sent:
    """What a virtual board emits whose line takes the time that it takes, but makes nobody wait."""
    line, takes_s = _line(board), board.frame_time_s
    sent, twin = Sent(due=len(times_s)), _Twin(board, log)
    twin.feed(board.start, 0.0)
    free_s = line.time_s(len(board.start))
    zero = sent.zero_s = free_s + takes_s - (times_s[0] if len(times_s) else 0.0)
    schedule = Schedule(times_s, [bytes(board.frame_bytes)] * len(times_s), 0.0)
    now = free_s
    try:
        for choice in on_the_line(schedule, line.time_s(1), free_s):
            now, due_s = choice.at_s, times_s[choice.number]
            sent.due = choice.number + 1
            made = SentFrame(choice.number, due_s, now - zero, now - zero, make(now - zero, due_s))
            twin.feed(made.frame.data, now)
            sent.add(made, takes_s)
            told(made.made_s)
        sent.due, sent.end_s, now = len(times_s), duration_s, max(now, zero + sent.end_s, zero + duration_s)
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


def _play_on_port(
    board: Board,
    port: str,
    times_s: Sequence[float],
    make: Make,
    duration_s: float,
    log: FrameLog | None,
    limits: SoundLimits | None,
    told: Callable[[float], None],
) -> Sent:
    """Make frames here, and have them sent by a player, which says when each was on the line."""
    within = limits or SoundLimits()
    if log is not None:
        log.close()
    path = None if log is None else log.path
    given: list[tuple[int, float, MadeFrame]] = []
    player = Player(
        board, port, log=path, stale_s=STALE_S, refresh_s=10.0 * STALE_S, tells_frames=True,
        on_time_s=within.on_time_s or 0.0, duty=within.duty,
    )  # fmt: skip
    try:
        sent = _make_and_give(player, times_s, make, duration_s, given, told)
    finally:
        player.close()
    report = player.played
    ended_s, takes_s = sent.end_s, board.frame_time_s
    for order, on_line_s in report.on_line:
        number, made_s, frame = given[order]
        begun_s = on_line_s - sent.zero_s - takes_s
        sent.add(SentFrame(number, times_s[number], made_s, begun_s, frame), takes_s)
    sent.end_s = sent.end_s if sent.interrupted else max(sent.end_s, ended_s)
    late = len(given) - len(sent.frames)
    sent.notes.append(f"sent by a player at {player.priority}; {late} frames that were made came too late for the line")
    if player.log_error:
        sent.notes.append(f"the log ends early: {player.log_error}")
    if player.silent:
        sent.notes.append(f"the player fell silent: {player.silent}")
    return sent


def _make_and_give(
    player: Player,
    times_s: Sequence[float],
    make: Make,
    duration_s: float,
    given: list[tuple[int, float, MadeFrame]],
    told: Callable[[float], None],
) -> Sent:
    """Make frames just before they are due, and give them to a player.

    given: gets of each its number among those that are due, when it was made [s], and the frame
    """
    takes_s, making = player.board.frame_time_s, _practised(make, times_s)
    first_s = times_s[0] if len(times_s) else 0.0
    sent = Sent(zero_s=time.monotonic() + making.ahead_s + takes_s - first_s)
    begins = [*(sent.zero_s + due_s - takes_s for due_s in times_s), np.inf]
    with contextlib.suppress(KeyboardInterrupt), undisturbed() as priority:
        sent.interrupted = True
        rested_s = 0.0
        for number, due_s in enumerate(times_s):
            sent.due = number + 1
            if begins[number + 1] < max(rested_s, time.monotonic()) + making.took_s + HANDING_S:
                continue
            time.sleep(max(0.0, max(rested_s, begins[number] - making.ahead_s) - time.monotonic()))
            now = time.monotonic()
            frame = make(now - sent.zero_s, due_s)
            player.send([frame.data], float(frame.sounds), made_s=now, due_s=sent.zero_s + due_s)
            given.append((number, now - sent.zero_s, frame))
            told(now - sent.zero_s)
            done_s = time.monotonic()
            making.add(done_s - now)
            rested_s = done_s + REST * (done_s - now)
        time.sleep(max(0.0, sent.zero_s + max(duration_s, first_s + takes_s) - time.monotonic()))
        sent.interrupted, sent.end_s = False, duration_s
    sent.notes.append(f"frames made at {priority}: {making}")
    return sent


class _Making:
    """How long frames take to be made. took_s: median of the last ones; ahead_s: before its first byte one is begun"""

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
        return f"one took {1e3 * median:.2g} ms ({1e3 * most:.2g} at most)"


def _practised(make: Make, times_s: Sequence[float]) -> _Making:
    """What is made for the first time takes long, and a board that is on waits for its frames."""
    making = _Making()
    for number in range(PRACTICE if len(times_s) else 0):
        began = time.monotonic()
        make(times_s[0] - BEFORE_S, times_s[0])
        if number > 0:
            making.add(time.monotonic() - began)
    return making


def _emit_by_twin(board: Board, sent: Sent, duration_s: float) -> None:
    """What a real board emitted, by its twin that is told when bytes were on the line."""
    twin = _Twin(board)
    start_s = _line(board).time_s(len(board.start))
    zero = start_s - min([0.0, *(one.begun_s for one in sent.frames[:1])])
    twin.feed(board.start, 0.0)
    for one in sent.frames:
        twin.feed(one.frame.data, zero + one.begun_s)
    twin.stop(zero + max(sent.end_s, duration_s * (not sent.interrupted)), zero, sent)


class Heard:
    """What sounds at any time of a trial, and the frame that it is of. times: from when on each sounds [s]"""

    def __init__(self, sent: Sent, board: Board) -> None:
        self.times: Float = np.array([one.time_s for one in sent.emitted])
        self.emitted, self.frames, self._board = sent.emitted, sent.frames, board
        self._begun: Float = np.array([one.begun_s for one in sent.frames])
        self._takes_s = board.frame_time_s
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
        in_by = int(np.searchsorted(self._begun + self._takes_s, emitted.time_s + 1e-9, "right")) - 1
        return min(in_by, begun)

    def _plays(self, number: int) -> Complex:
        """What the board emits of a frame whose bytes all arrive."""
        if number not in self._played:
            frame = self.frames[number].frame
            board = self._board
            self._played[number] = frame.wanted if board.exact else board.decode(board.start + frame.data)[-1]
        return self._played[number]
