"""Limits of the duration of sound: in total, and as a share of any interval."""

WINDOW_S = 10.0
"""Length of the interval for the largest share of time with sound [s]."""


class SoundBudget:
    """Budget of sound. on_time_s: longest total, 0: no limit; duty: largest share of time with sound over window_s.

    reason: why sound is not allowed, in words
    Allowed time grows at the rate `duty`, up to this share of the window; sound uses it. When it is used up, there is
    silence until half of it is restored."""

    def __init__(self, on_time_s: float = 0.0, duty: float = 1.0, window_s: float = WINDOW_S) -> None:
        self.on_time_s, self.duty, self.window_s = on_time_s, duty, window_s
        self.reason = ""
        self.sounded_s = 0.0
        self._saved_s = duty * window_s
        self._last_s: float | None = None

    def allows(self, now_s: float, sounds: bool) -> bool:
        """Return whether sound is allowed from now on; sounds: whether there was sound since the last call."""
        passed = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        most = self.duty * self.window_s
        self._saved_s = min(most, self._saved_s + self.duty * passed)
        if sounds:
            self.sounded_s += passed
            self._saved_s -= passed
        if self.on_time_s and self.sounded_s >= self.on_time_s:
            self.reason = f"the time with sound has reached {self.on_time_s:g} s, the limit on_time_s"
        elif self.duty < 1.0 and self._saved_s <= 0.0:
            self.reason = f"the share of time with sound exceeds {self.duty:g}, the limit duty"
        elif self._saved_s >= 0.5 * most or self.duty >= 1.0:
            self.reason = ""
        return not self.reason
