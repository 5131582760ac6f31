"""Report of a play."""

from collections.abc import Sequence
from dataclasses import dataclass

UNSENT_SHARE = 0.01
"""Unsent share of the due frames above which users are warned."""


@dataclass(frozen=True)
class PlayReport:
    """Report of a play.

    frames: frames sent whole; skipped: frames replaced by a newer due frame; cut: frames accepted only in part
    late_s: worst delay of the last byte of a frame on the line; late_p99_s, late_p50_s: its 99 and 50 % quantiles
    write_p99_s, write_worst_s: 99 % quantile and worst delay of writing to the system
    seconds: duration of the sending; priority: priority of the player, in words
    first_s, last_s: when the last bytes of the first and the last frame were on the line, on time.monotonic() [s];
        None without frames, and for a record
    on_line: numbers of live frames in order, and when the last byte of each was on the line, on time.monotonic() [s]
    """

    frames: int
    skipped: int
    late_s: float
    late_p99_s: float = 0.0
    late_p50_s: float = 0.0
    write_p99_s: float = 0.0
    write_worst_s: float = 0.0
    cut: int = 0
    seconds: float = 0.0
    priority: str = ""
    first_s: float | None = None
    last_s: float | None = None
    on_line: Sequence[tuple[int, float]] = ()

    @property
    def unsent(self) -> float:
        """Unsent share of the due frames."""
        return self.skipped / max(1, self.frames + self.skipped)

    @property
    def warning(self) -> str:
        """Warning for users; empty if the unsent share is at most UNSENT_SHARE."""
        if self.unsent <= UNSENT_SHARE:
            return ""
        return f"{self.skipped} of {self.frames + self.skipped} due frames were not sent ({100.0 * self.unsent:.1f} %)"


def quantile(values: Sequence[float], share: float) -> float:
    """Return a quantile of some values, 0 without values. Players do not load NumPy."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else 0.0
