"""Next frame of a player and its time, from a schedule or from live frames. The newest due frame is sent."""

import math
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from palmfield.drive.player.budget import SoundBudget
from palmfield.drive.player.messages import LiveFrame, Schedule

CLOSE_S = 1e-6
"""Difference below which the time of a free line counts as the time of a frame [s]."""
LIVE_AHEAD_S = 1e-3
"""Time before the line is free at which a live frame is written, so that the line has no pause [s]."""


class NextFrame(NamedTuple):
    """The next frame.

    at_s: time of writing; due_s: target time of the last byte on the line; data: bytes, empty: choose again at at_s
    number: number of the frame among all, from 0 on; -1 for repeated or extra frames"""

    at_s: float
    due_s: float
    data: bytes
    number: int = -1


class Source(Protocol):
    """Source of frames. skipped: number of frames replaced by a newer due frame"""

    skipped: int

    def choose(self, now_s: float, free_s: float) -> NextFrame | None:
        """Return the next frame if the line is free at a time; None after the end."""

    def sent(self, now_s: float) -> None:
        """Record that the chosen frame was sent."""

    def shift(self, by_s: float) -> None:
        """Shift the schedule by a pause of this length."""


class ScheduleSource:
    """Frames with given times. One frame may wait for the line while another is on it."""

    def __init__(self, schedule: Schedule, byte_s: float, now_s: float) -> None:
        self.schedule, self.byte_s = schedule, byte_s
        self.skipped = 0
        self._next = 0
        first = self._line_s(0) - schedule.times_s[0] if schedule.frames else 0.0
        self.start_s = now_s + first

    def _line_s(self, number: int) -> float:
        return len(self.schedule.frames[number]) * self.byte_s

    def choose(self, now_s: float, free_s: float) -> NextFrame | None:
        times, frames, number = self.schedule.times_s, self.schedule.frames, self._next
        if number == len(frames):
            ends = max(self.start_s + self.schedule.duration_s, free_s)
            return None if now_s >= ends else NextFrame(ends, ends, b"")
        lasts = self._line_s(number)
        begins = self.start_s + times[number] - lasts
        while number + 1 < len(frames):
            lasts_next = self._line_s(number + 1)
            begins_next = self.start_s + times[number + 1] - lasts_next
            if begins_next > max(begins, free_s, now_s):
                break
            number, begins, lasts = number + 1, begins_next, lasts_next
            self.skipped += 1
        self._next = number
        # While the line is busy, a frame waits in the buffer of the system, so that the line has no pause
        at = begins if free_s < begins - CLOSE_S else free_s - lasts
        return NextFrame(at, begins + lasts, frames[number], number)

    def sent(self, now_s: float) -> None:
        self._next += 1

    def shift(self, by_s: float) -> None:
        self.start_s += by_s
        # The sound before the pause is repeated
        self._next = max(0, self._next - 1)


def on_the_line(schedule: Schedule, byte_s: float, free_s: float) -> Iterator[NextFrame]:
    """Return the frames of a schedule that a line can send, each with `at_s`, when its first byte is on the line.

    byte_s: time of a byte on the line [s]; free_s: time when the line is free and the schedule begins [s]
    """
    source, now = ScheduleSource(schedule, byte_s, free_s), free_s
    while (choice := source.choose(now, max(free_s, now))) is not None:
        now = max(now, choice.at_s)
        if choice.data:
            begins = max(free_s, now)
            yield choice._replace(at_s=begins)
            free_s = begins + len(choice.data) * byte_s
            source.sent(now)


class LiveSource:
    """The newest live frame; old frames fade out. There is a ramp between silence and full level.

    Frames with a due time wait for it. Of several due frames the newest is sent.

    reason: reason of silence, or ""; muted: whether the caller has muted the sound
    """

    def __init__(
        self,
        byte_s: float,
        stop: bytes,
        *,
        ramp_s: float,
        stale_s: float,
        refresh_s: float,
        budget: SoundBudget,
    ) -> None:
        self.byte_s, self.stop, self.budget = byte_s, stop, budget
        self.ramp_s, self.stale_s, self.refresh_s = ramp_s, stale_s, refresh_s
        self.skipped = 0
        self.reason = ""
        self.muted, self.silent = False, True
        self._waiting: deque[tuple[int, LiveFrame]] = deque()
        self._accepted = 0
        self._number = -1
        self._newest: LiveFrame | None = None
        self._unsent = False
        self._gain, self._gain_s = 0.0, -math.inf
        self._sent: tuple[bytes, float] = (b"", -math.inf)
        self._choice: NextFrame | None = None

    def accept(self, frame: LiveFrame) -> None:
        """Add a frame that is newer than all others."""
        self.muted = False
        if frame.due_s > 0.0:
            self._waiting.append((self._accepted, frame))
        else:
            self.skipped += len(self._waiting)
            self._waiting.clear()
            self._show(self._accepted, frame)
        self._accepted += 1

    def fade(self) -> None:
        """Use no further frames, and let the present sound fade out."""
        self.muted = True
        self.skipped += len(self._waiting)
        self._waiting.clear()

    def _show(self, number: int, frame: LiveFrame) -> None:
        self.skipped += self._unsent
        self._number, self._newest, self._unsent = number, frame, True

    def _show_due(self, now_s: float, free_s: float) -> float:
        """Use the frame that is due for writing; return the time of the next waiting frame [s]."""
        while len(self._waiting) > 1 and self._begins_s(1) <= max(self._begins_s(0), free_s, now_s):
            self._waiting.popleft()
            self.skipped += 1
        if not self._waiting:
            return math.inf
        begins = self._begins_s(0)
        # As in a schedule, one frame waits in the buffer of the system while another is on the line
        at = begins if free_s < begins - CLOSE_S else free_s - self._line_s(0)
        if at > now_s:
            return at
        self._show(*self._waiting.popleft())
        return self._begins_s(0) if self._waiting else math.inf

    def _line_s(self, waiting: int) -> float:
        return len(self._waiting[waiting][1].steps[0]) * self.byte_s

    def _begins_s(self, waiting: int) -> float:
        return self._waiting[waiting][1].due_s - self._line_s(waiting)

    def choose(self, now_s: float, free_s: float) -> NextFrame | None:
        next_s = self._show_due(now_s, free_s)
        choice = self._of_newest(now_s, free_s)
        return choice if choice.at_s <= max(next_s, now_s) else NextFrame(next_s, now_s, b"")

    def _of_newest(self, now_s: float, free_s: float) -> NextFrame:
        frame = self._newest
        if frame is None:
            return NextFrame(now_s + self.refresh_s, now_s, b"")
        gain = self._ramped(frame, now_s)
        if gain <= 0.0:
            if self.silent:
                return NextFrame(now_s + self.refresh_s, now_s, b"")
            data = self.stop
        else:
            data = frame.steps[max(0, math.ceil(gain * len(frame.steps) - 1e-9) - 1)]
        timed = self._unsent and frame.due_s > 0.0
        due = frame.due_s if timed else (frame.made_s if self._unsent else now_s) + len(data) * self.byte_s
        at = now_s if timed else max(now_s, free_s - LIVE_AHEAD_S)
        if data == self._sent[0] and not self._unsent:
            # During a ramp the next check is soon, at the latest when the frame is too old
            soon = now_s + min(0.01, max(1e-4, self.ramp_s / max(1, len(frame.steps))))
            at = max(at, self._sent[1] + self.refresh_s)
            if at > soon:
                return NextFrame(soon, now_s, b"")
        self._choice = NextFrame(at, due, data, self._number if self._unsent else -1)
        return self._choice

    def _ramped(self, frame: LiveFrame, now_s: float) -> float:
        """Return the present share of the level of the newest frame, which rises and falls within the ramp."""
        sounds = self._gain > 0.0 and frame.level > 0.0
        within = self.budget.allows(now_s, sounds)
        # The age of a frame with a later due time counts from the due time
        old = now_s - max(frame.made_s, frame.due_s) > self.stale_s
        self.reason = "" if within else self.budget.reason
        if old and not self.reason:
            self.reason = f"no frame arrived for {self.stale_s:g} s"
        target = 0.0 if self.muted or self.reason else 1.0
        passed = now_s - self._gain_s if self._gain_s > -math.inf else 0.0
        self._gain_s = now_s
        if self.ramp_s <= 0.0 or len(frame.steps) == 1:
            self._gain = target
        elif target > self._gain:
            # The first step is played immediately
            self._gain = min(target, max(self._gain, 1.0 / len(frame.steps)) + passed / self.ramp_s * (not self.silent))
        else:
            self._gain = max(target, self._gain - passed / self.ramp_s)
        return self._gain

    def sent(self, now_s: float) -> None:
        assert self._choice is not None
        self.silent = self._choice.data == self.stop
        self._sent = self._choice.data, now_s
        self._unsent = False

    def shift(self, by_s: float) -> None:
        self._gain, self._sent, self.silent = 0.0, (b"", -math.inf), True
