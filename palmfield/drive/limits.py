"""Limits set by a user: ramps of the sound, and its duration."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from palmfield.config import DriverConfig
from palmfield.drive.board import Board
from palmfield.drive.player.budget import WINDOW_S
from palmfield.errors import DeviceError


@dataclass(frozen=True)
class SoundLimits:
    """Limits of a play. ramp_s: time in which sound rises and falls, 0: no ramp; on_time_s: longest duration of sound,
    None: no limit; duty: largest share of time with sound in any interval of WINDOW_S
    """

    ramp_s: float = 0.0
    on_time_s: float | None = None
    duty: float = 1.0

    @classmethod
    def of(cls, driver: DriverConfig) -> "SoundLimits":
        return cls(driver.ramp_s, driver.on_time_s, driver.duty_limit)

    def level_at(self, time_s: float, duration_s: float) -> float:
        """Return the factor on all amplitudes at a time of a play, 0 to 1: a raised cosine at both ends."""
        if self.ramp_s <= 0.0:
            return 1.0
        inside = min(time_s, duration_s - time_s) / min(self.ramp_s, 0.5 * duration_s)
        return 0.5 - 0.5 * math.cos(math.pi * min(1.0, max(0.0, inside)))

    def share(self, board: Board, time_s: float, duration_s: float) -> float:
        """Return `level_at` rounded to the levels of the board: 1 for boards without levels and for board ideal."""
        return self.level_at(time_s, duration_s) if board.levels and not board.exact else 1.0

    def ramp_times(self, board: Board, duration_s: float) -> list[float]:
        """Return additional due times of frames, so that the ramps have as many steps as the board can play."""
        if self.ramp_s <= 0.0 or not board.levels:
            return []
        ramp_s = min(self.ramp_s, 0.5 * duration_s)
        count = math.floor(ramp_s * board.max_frame_rate_Hz)
        rise = [number / board.max_frame_rate_Hz for number in range(count + 1)]
        return rise + [duration_s - time_s for time_s in rise if time_s > 0.0]

    def in_words(self, board: Board) -> str:
        """Return a description of the ramp as the board plays it; empty without a ramp."""
        if self.ramp_s <= 0.0:
            return ""
        if not board.levels:
            dither = ": dither adds levels" if "dither" in board.keys else ""
            return (
                f"no ramp: {board.name} has no levels between off and full, so the sound starts and stops "
                f"abruptly{dither}"
            )
        return f"sound rises and falls within {1e3 * min(self.ramp_s, 1e3):g} ms"

    def check(self, times_s: Sequence[float], sounds: Sequence[bool], duration_s: float) -> tuple[float, float]:
        """Return the duration of sound in frames [s], and its largest share of any WINDOW_S.

        Raises DeviceError if they exceed the limits.
        """
        ends = [*times_s[1:], max(duration_s, times_s[-1])] if times_s else []
        stretches = [(a, b) for a, b, on in zip(times_s, ends, sounds, strict=True) if on and b > a]
        on_s = sum(b - a for a, b in stretches)
        duty = _duty(stretches, duration_s)
        if self.on_time_s is not None and on_s > self.on_time_s * (1.0 + 1e-9):
            raise DeviceError(
                f"the play has {on_s:.4g} s of sound; limit on_time_s allows {self.on_time_s:g} s: play for a "
                "shorter time (--duration), or set on_time_s larger"
            )
        if duty > self.duty * (1.0 + 1e-9):
            raise DeviceError(
                f"the play has sound in {100 * duty:.3g} % of {min(WINDOW_S, duration_s):g} s; limit "
                f"duty_limit allows {100 * self.duty:.3g} %: add pauses (stop_s, bursts), or set duty_limit larger"
            )
        return on_s, duty


def _duty(stretches: Sequence[tuple[float, float]], duration_s: float) -> float:
    """Return the largest share that intervals cover of a window of WINDOW_S (of the total, if shorter)."""
    window = min(WINDOW_S, duration_s)
    if not stretches or window <= 0.0:
        return 0.0
    most, first, whole = 0.0, 0, 0.0
    # The window with most sound begins or ends with a sounding interval; the latter are searched backwards
    for last, (_, end) in enumerate(stretches):
        whole += stretches[last][1] - stretches[last][0]
        while stretches[first][1] <= end - window:
            whole -= stretches[first][1] - stretches[first][0]
            first += 1
        most = max(most, whole - max(0.0, end - window - stretches[first][0]))
    return min(1.0, most / window)
