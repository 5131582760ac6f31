"""How playing went."""

from collections.abc import Sequence
from dataclasses import dataclass

UNSENT_SHARE = 0.01
"""Of due frames, above which not sending them is a fault that users are told of."""


@dataclass(frozen=True)
class PlayReport:
    """frames: sent whole; skipped: not sent because a newer one was due too; cut: of which the system took only a part

    late_s: worst delay of a frame's last byte on the line; late_p99_s, late_p50_s: which 99 and 50 % stay within
    write_p99_s: which 99 % of delays stay within when frames are handed to the system; write_worst_s: the worst of them
    seconds: that frames went out for; priority: that the player had, in words
    first_s, last_s: when the last bytes of the first and the last frame were on the line, on time.monotonic() [s]; None
        where nothing was sent, and of a record
    on_line: of live frames, where the player was asked to tell: their numbers, in the order in which they were given to
        it, and when the last byte of each was on the line, on time.monotonic() [s]
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
        """Share of the frames that were due."""
        return self.skipped / max(1, self.frames + self.skipped)

    @property
    def warning(self) -> str:
        """What users are warned of; empty where more than UNSENT_SHARE of the frames went out."""
        if self.unsent <= UNSENT_SHARE:
            return ""
        return (
            f"{self.skipped} of {self.frames + self.skipped} frames that were due were not sent "
            f"({100.0 * self.unsent:.1f} %)"
        )


def quantile(values: Sequence[float], share: float) -> float:
    """The value that such a share of some values stays within, 0 of none. Players do not load NumPy."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else 0.0
