"""When the line is free: by the bytes handed over and its rate, and by what the system says is still waiting."""

import math

TOLD_LATE_S = 5e-3
"""What is told of bytes that wait may be so old [s]."""
LOOKS_S = 0.05
"""What is told all that time is so [s]."""
BEHIND_S = 2e-3
"""A line that is less behind counts as on time [s]."""


class LineClock:
    """byte_s: time of one byte on the line [s]"""

    def __init__(self, byte_s: float) -> None:
        self.byte_s = byte_s
        self.handed = 0
        self._free_s = 0.0
        self._out = 0
        self._moved_s = 0.0
        self._since_s, self._least_s = -math.inf, math.inf

    def free_s(self, now_s: float) -> float:
        """When the last byte handed over is on the line, or now."""
        return max(self._free_s, now_s)

    def hand(self, count: int, now_s: float) -> float:
        """Bytes handed over now; returns when the last of them is on the line."""
        if self.handed == self._out:
            self._moved_s = now_s
        self.handed += count
        self._free_s = max(self._free_s, now_s) + count * self.byte_s
        return self._free_s

    def hear(self, waiting: int, now_s: float, refused: bool) -> int:
        """What is told of bytes that are not on the line yet; returns how many have gone out so far.

        refused: whether the system takes no more bytes
        """
        out = self.handed - waiting
        if out > self._out or not (waiting or refused):
            self._moved_s = now_s
        self._out = max(self._out, out)
        # Bytes that a line with another rate than ours, or one that stands, has not taken yet
        self._free_s = max(self._free_s, now_s + waiting * self.byte_s - TOLD_LATE_S)
        # A little that is always there is no old news: it would never be made up for
        self._least_s = min(self._least_s, now_s + waiting * self.byte_s - self._free_s)
        if self._since_s == -math.inf:
            self._since_s = now_s
        if now_s - self._since_s > LOOKS_S:
            if BEHIND_S < self._least_s < math.inf:
                self._free_s += self._least_s
            self._since_s, self._least_s = now_s, math.inf
        return self._out

    def stuck_s(self, now_s: float) -> float:
        """For how long no byte has gone out, though some wait."""
        return now_s - self._moved_s
