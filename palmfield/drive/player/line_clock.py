"""Compute when the line is free, from written bytes and its rate, and from the count of waiting bytes of the system."""

import math

READING_AGE_S = 5e-3
"""Largest age of a reading of waiting bytes [s]."""
LOOKS_S = 0.05
"""A late reading must persist this long before it is reported [s]."""
BEHIND_S = 2e-3
"""Delay below which a line counts as on time [s]."""


class LineClock:
    """Clock of a line. byte_s: time of one byte on the line [s]"""

    def __init__(self, byte_s: float) -> None:
        self.byte_s = byte_s
        self.written = 0
        self._free_s = 0.0
        self._out = 0
        self._moved_s = 0.0
        self._since_s, self._least_s = -math.inf, math.inf

    def free_s(self, now_s: float) -> float:
        """Return the time when the last written byte is on the line, at least now [s]."""
        return max(self._free_s, now_s)

    def hand(self, count: int, now_s: float) -> float:
        """Record bytes written now; return the time when the last of them is on the line [s]."""
        if self.written == self._out:
            self._moved_s = now_s
        self.written += count
        self._free_s = max(self._free_s, now_s) + count * self.byte_s
        return self._free_s

    def note_waiting(self, waiting: int, now_s: float, refused: bool) -> int:
        """Record the number of bytes that are not on the line yet; return the number of bytes sent so far.

        refused: whether the system accepts no more bytes
        """
        out = self.written - waiting
        if out > self._out or not (waiting or refused):
            self._moved_s = now_s
        self._out = max(self._out, out)
        # Some bytes are not sent yet, because the line is slower than assumed, or blocked
        self._free_s = max(self._free_s, now_s + waiting * self.byte_s - READING_AGE_S)
        # A small constant count of waiting bytes is subtracted, because it never decreases
        self._least_s = min(self._least_s, now_s + waiting * self.byte_s - self._free_s)
        if self._since_s == -math.inf:
            self._since_s = now_s
        if now_s - self._since_s > LOOKS_S:
            if BEHIND_S < self._least_s < math.inf:
                self._free_s += self._least_s
            self._since_s, self._least_s = now_s, math.inf
        return self._out

    def stuck_s(self, now_s: float) -> float:
        """Return the time since the last byte was sent, while bytes wait [s]."""
        return now_s - self._moved_s
