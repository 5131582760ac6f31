"""Waveforms of amplitude modulation from files: one period, or a course in seconds."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class AmTable:
    """Contents of a file, comparable.

    of: a period, which repeats, or a course, whose last value holds; moments: turns from 0 to below 1, or times since
    the sound began [s], rising; values: of the waveform there, -1..1, linear in between
    """

    of: Literal["period", "course"]
    moments: tuple[float, ...]
    values: tuple[float, ...]

    def __hash__(self) -> int:
        # Configurations are hashed in every step; hashing thousands of numbers would take longer than the step
        return hash((self.of, len(self.moments), self.values[:8]))
