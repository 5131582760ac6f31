"""What a board is sent when: frames of bytes with their times, and the pace at which the line takes them."""

import math
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from palmfield.config import StimulusConfig
from palmfield.drive.boards import BOARDS, Board, board_named
from palmfield.drive.link import FrameSink, RecordLink, line_time_s
from palmfield.errors import DeviceError, did_you_mean
from palmfield.stimulus.schedule import frame_rates, jumps
from palmfield.types import Complex

REFRESH_S = 0.1
"""A frame that rests is sent again so often, so that a byte lost on the line does no lasting harm [s]."""


class TimedFrame(NamedTuple):
    """One frame. time_s: when it is due, since the start [s]; data: its bytes"""

    time_s: float
    data: bytes


# -- frames --------------------------------------------------------------------------------------------------------


def playable_board(name: str) -> Board:
    """The board of that name, which takes bytes. Raises DeviceError for others, with those that do."""
    names = [board.name for board in BOARDS.values() if not board.exact]
    if name not in names:
        raise DeviceError(f"board '{name}' is not known{did_you_mean(name, names)}; allowed: {', '.join(names)}")
    return board_named(name)


def frame_times(stimuli: Sequence[StimulusConfig], duration_s: float) -> list[float]:
    """When frames are due [s]: at points of paths and control ticks, at jumps, and every REFRESH_S while all rests."""
    rates = [rate for stimulus in stimuli for rate in frame_rates(stimulus)]
    step = 1.0 / max(rates) if rates else REFRESH_S
    edges = {t for stimulus in stimuli for t in jumps(stimulus, 0.0, duration_s) if 0.0 < t < duration_s}
    return sorted({k * step for k in range(math.ceil(duration_s / step - 1e-9))} | edges)


def timed_frames(
    board: Board, times: Iterable[float], drive_at: Callable[[float], Complex], duration_s: float
) -> Iterator[TimedFrame]:
    """The bytes of each frame; silence as off frames, and an off frame at the end.

    drive_at: complex amplitudes of the board's transducers at a time [s], shape (n,)
    Raises DeviceError for a board that takes no bytes, and what the board can't play as its `encode` does.
    """
    if board.encode is None:
        raise DeviceError(f"board '{board.name}' takes no bytes; use board {_others(board)}")
    for time_s in times:
        drive = drive_at(time_s)
        yield TimedFrame(time_s, board.encode(drive) if drive.any() else board.off_frame)
    yield TimedFrame(duration_s, board.off_frame)


def _others(board: Board) -> str:
    return " or ".join(other.name for other in BOARDS.values() if not other.exact and other is not board)


# -- playing -------------------------------------------------------------------------------------------------------


def record(frames: Iterable[TimedFrame], path: str | Path) -> "Played":
    """Write the bytes that the line would have carried into a file. Raises OutputError where it can't be written.

    `play_frames` plays them on an open link.
    """
    with closing(RecordLink(path)) as link:
        return play_frames(link, frames)


@dataclass(frozen=True)
class Played:
    """How playing went. frames: sent whole; skipped: not sent because a newer one was due; late_s: worst delay [s]."""

    frames: int
    skipped: int
    late_s: float


def play_frames(
    link: FrameSink,
    frames: Iterable[tuple[float, bytes]],
    *,
    on_progress: Callable[[Played], None] | None = None,
) -> Played:
    """Send frames at their times, never faster than the line; when late, the newest frame that is due wins.

    frames: (time since the start [s], bytes of one frame that begins with 254), times rising. It is read one frame
        ahead, so it must not wait for the world: give a schedule.
    on_progress: called after each frame that got through
    After a write timeout nothing is resumed: the next send begins with a frame's first byte. The board is silenced when
    this ends, also by an exception, Ctrl-C, SIGTERM or SIGHUP (the signals are caught in the main thread only).
    Raises DeviceError when the board is lost.
    """
    with _signals_as_exit():
        try:
            return _play(link, iter(frames), on_progress)
        finally:
            link.off()


def _play(
    link: FrameSink, frames: Iterator[tuple[float, bytes]], on_progress: Callable[[Played], None] | None
) -> Played:
    sent, skipped, late_s = 0, 0, 0.0
    start = link.now()
    line_free = start
    current = next(frames, None)
    while current is not None:
        upcoming = next(frames, None)
        due = start + current[0]
        newer_due = start + upcoming[0] if upcoming is not None else math.inf
        through = False
        if newer_due > max(line_free, link.now()):
            link.wait_until(max(due, line_free))
            began = link.now()
            through = link.write(current[1])
            while not through and newer_due > link.now():
                through = link.write(current[1])
            # The line, not the buffer that took the bytes, says when the next frame may start.
            line_free = max(line_free, began) + line_time_s(current[1])
        if through:
            sent, late_s = sent + 1, max(late_s, began - due)
            if on_progress is not None:
                on_progress(Played(sent, skipped, late_s))
        else:
            skipped += 1
        current = upcoming
    link.wait_until(line_free)
    return Played(sent, skipped, late_s)


@contextmanager
def _signals_as_exit() -> Iterator[None]:
    """SIGTERM and SIGHUP end a process without running `finally`; as SystemExit they leave the board silent."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    heeded = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]  # nohup ignores SIGHUP
    before = {number: signal.signal(number, leave) for number in heeded}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
