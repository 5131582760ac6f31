"""When frames are due, and the pace at which a line takes them."""

import bisect
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from palmfield.config import StimulusConfig
from palmfield.drive.board import Line
from palmfield.drive.exit_signals import handling, leave
from palmfield.stimulus.schedule import frame_rates, jumps

REFRESH_S = 0.1
"""A frame that rests is sent again so often, so that a byte lost on the line does no lasting harm [s]."""
ON_STEP = 1e-6
"""Of a step: a moment that lies so near to the beginning of one counts as that."""


class TimedFrame(NamedTuple):
    """One frame.

    time_s: when it is to be emitted, its last byte on the line, since the start [s]; data: its bytes
    sounds: whether anything is on in it
    """

    time_s: float
    data: bytes
    sounds: bool = True


class FrameSink(Protocol):
    """What `play_frames` needs: a line with a clock. `palmfield.drive.board_link.BoardLink` is one."""

    line: Line

    def now(self) -> float:
        """Seconds on this sink's clock."""

    def wait_until(self, when: float) -> None:
        """Return when the clock shows `when`."""

    def start(self) -> None:
        """Put the board into a known, silent state; the line is free when this returns."""

    def write(self, frame: bytes) -> bool:
        """Send one whole frame; False when it did not get through in time and must be sent again from its start."""

    def off(self) -> None:
        """Silence the board, unless nothing was sent since it was last silenced."""


def frame_times(
    stimuli: Sequence[StimulusConfig],
    duration_s: float,
    step_s: float | None = None,
    besides: Sequence[float] = (),
    least_s: float = 0.0,
) -> list[float]:
    """When frames are due [s]: at points of paths and control ticks, at jumps, and every REFRESH_S while all rests.

    step_s: of MuJoCo, where something moves: a pose is new where a step begins, so that frames that come less often
        wait for the next one
    besides: times at which frames are due as well where no other is within least_s [s]
    """
    rates = [rate for stimulus in stimuli for rate in frame_rates(stimulus)]
    period_s = 1.0 / max(rates) if rates else REFRESH_S
    edges = {t for stimulus in stimuli for t in jumps(stimulus, 0.0, duration_s) if 0.0 < t < duration_s}
    times = {k * period_s for k in range(math.ceil(duration_s / period_s - 1e-9))}
    if step_s is not None and period_s >= step_s:
        times = {math.ceil(time_s / step_s - ON_STEP) * step_s for time_s in times}
    due = sorted({time_s for time_s in times | edges if time_s < duration_s})
    return filled(due, besides, least_s, duration_s)


def filled(due: list[float], besides: Sequence[float], least_s: float, duration_s: float) -> list[float]:
    """Times with those besides that lie at least so far from all others [s]."""
    result = list(due)
    for time_s in sorted(besides):
        at = bisect.bisect_left(result, time_s)
        before = time_s - result[at - 1] if at else math.inf
        after = result[at] - time_s if at < len(result) else math.inf
        if min(before, after) >= least_s * (1.0 - ON_STEP) and time_s < duration_s:
            result.insert(at, time_s)
    return result


@dataclass(frozen=True)
class Played:
    """How playing went. frames: sent whole; skipped: not sent because a newer one was due

    late_s: worst delay of a frame's last byte on the line, by the host's own clock
    """

    frames: int
    skipped: int
    late_s: float


def play_frames(
    link: FrameSink,
    frames: Iterable[tuple[float, bytes] | TimedFrame],
    *,
    duration_s: float = 0.0,
    on_progress: Callable[[Played], None] | None = None,
) -> Played:
    """Send frames so that they are emitted at their times, never faster than the line; the newest that is due wins.

    frames: (time of emission since the start [s], bytes of one frame), times rising. The start is when the first frame
        can be emitted. It is read one frame ahead, so it must not wait for the world: give a schedule.
    duration_s: how long the last frame goes on at least, since the start [s]
    on_progress: called after each frame that got through
    After a write timeout nothing is resumed: the next send begins with a frame's first byte. The board is silenced when
    this ends, also by an exception, Ctrl-C, SIGTERM or SIGHUP (the signals are caught in the main thread only).
    Raises DeviceError when the board is lost.
    """
    with signals_as_exit():
        try:
            link.start()
            return _play(link, iter(frames), duration_s, on_progress)
        finally:
            link.off()


def _play(
    link: FrameSink,
    frames: Iterator[tuple[float, bytes] | TimedFrame],
    duration_s: float,
    on_progress: Callable[[Played], None] | None,
) -> Played:
    sent, skipped, late_s = 0, 0, 0.0
    current = next(frames, None)
    line_free = link.now()
    start = line_free + (0.0 if current is None else link.line.time_s(len(current[1])) - current[0])
    while current is not None:
        upcoming = next(frames, None)
        takes_s = link.line.time_s(len(current[1]))
        due = start + current[0] - takes_s
        newer_due = math.inf
        if upcoming is not None:
            newer_due = start + upcoming[0] - link.line.time_s(len(upcoming[1]))
        through = False
        if newer_due > max(line_free, link.now()):
            link.wait_until(max(due, line_free))
            began = link.now()
            through = link.write(current[1])
            while not through and newer_due > link.now():
                began = link.now()
                through = link.write(current[1])
            # The line, not the buffer that took the bytes, says when the next frame may start.
            line_free = max(line_free, began) + takes_s
        if through:
            sent, late_s = sent + 1, max(late_s, line_free - (start + current[0]))
            if on_progress is not None:
                on_progress(Played(sent, skipped, late_s))
        else:
            skipped += 1
        current = upcoming
    link.wait_until(max(line_free, start + duration_s))
    return Played(sent, skipped, late_s)


@contextmanager
def signals_as_exit() -> Iterator[None]:
    """SIGTERM and SIGHUP end a process without running `finally`; as SystemExit they leave the board silent."""
    with handling(dict.fromkeys(("SIGTERM", "SIGHUP"), leave)):
        yield
