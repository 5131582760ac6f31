"""Waveforms of amplitude modulation from files: one period, or a course in seconds."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class AmTable:
    """Contents of a file, comparable by value.

    of: "period" (it repeats) or "course" (it keeps its last value); moments: ascending turns, 0 <= turn < 1, or times
    since the start of the sound [s]; values: waveform at these moments, -1..1, linear in between
    """

    of: Literal["period", "course"]
    moments: tuple[float, ...]
    values: tuple[float, ...]

    def __hash__(self) -> int:
        # Configurations are hashed in every step, and a hash of thousands of numbers would take longer than the step
        return hash((self.of, len(self.moments), self.values[:8]))
