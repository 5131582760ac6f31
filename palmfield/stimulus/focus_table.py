"""Foci over time as a plain table: position and level of each focus, frame, and interpolation between rows."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from palmfield.stimulus.duty_law import FULL_DUTY, relative_pressure
from palmfield.types import Float

TableFrame = Literal["array", "skin", "world"]
Quantity = Literal["duty", "amplitude", "arp"]
Between = Literal["held", "linear"]
SOONER_S = 1e-9
"""Time before a row [s] that counts as its time, like ticks of `schedule`."""


@dataclass(frozen=True)
class FocusTable:
    """Foci over time, comparable by value.

    frame: frame of the positions; rate_Hz: times of rows are whole numbers of samples of this rate
    quantity: meaning of the intensities: amplitude of the sound, ARP, or duty of the pulses relative to 1/2
    between: "held", rows are constant until the next one, the last for one sample; "linear", the last row is the end
    foci: number of simultaneous foci; rows: float64 numbers as bytes: sample, then x, y, z [m] and intensity 0..1 of
    each focus
    """

    frame: TableFrame
    rate_Hz: float
    quantity: Quantity
    between: Between
    foci: int
    rows: bytes

    def __hash__(self) -> int:
        # Configurations are hashed in every step
        return hash((self.rate_Hz, self.foci, len(self.rows), self.rows[:256]))

    @cached_property
    def _numbers(self) -> Float:
        return np.frombuffer(self.rows, np.float64).reshape(-1, 1 + 4 * self.foci)

    @cached_property
    def samples(self) -> NDArray[np.int64]:
        """Sample number of each row, from 0, shape (n,)."""
        return self._numbers[:, 0].astype(np.int64)

    @cached_property
    def times(self) -> Float:
        """Times of the rows since the start of the table [s], shape (n,)."""
        return self.samples / self.rate_Hz

    @cached_property
    def positions(self) -> Float:
        """Positions of the foci in each row [m], shape (n, foci, 3)."""
        return np.ascontiguousarray(self._numbers[:, 1:].reshape(-1, self.foci, 4)[..., :3])

    @cached_property
    def intensities(self) -> Float:
        """Intensities of the foci in each row, 0..1, shape (n, foci)."""
        return np.ascontiguousarray(self._numbers[:, 1:].reshape(-1, self.foci, 4)[..., 3])

    @cached_property
    def length_samples(self) -> int:
        """Duration in samples."""
        return int(self.samples[-1]) + (1 if self.between == "held" else 0)

    @property
    def length_s(self) -> float:
        """Duration [s]."""
        return self.length_samples / self.rate_Hz

    def positions_at(self, since_s: Float) -> Float:
        """Return positions of the foci [m], (k, foci, 3), at times since the start of the table [s], shape (k,)."""
        return self._at(self.positions, since_s)

    def intensities_at(self, since_s: Float) -> Float:
        """Return intensities, 0..1, shape (k, foci), at times since the start of the table [s], shape (k,)."""
        return self._at(self.intensities, since_s)

    def arp_of_each(self, since_s: Float, duty_exponent: float = 2.0) -> Float:
        """Return the ARP of the foci relative to intensity 1, shape (k, foci); duty_exponent: g, for pulses."""
        intensities = self.intensities_at(since_s)
        if self.quantity == "duty":
            return relative_pressure(FULL_DUTY * intensities, duty_exponent) ** 2
        return intensities**2 if self.quantity == "amplitude" else intensities

    def _at(self, values: Float, since_s: Float) -> Float:
        place = np.clip(since_s * self.rate_Hz, 0.0, float(self.samples[-1]))
        row = self.samples.searchsorted(place + SOONER_S * self.rate_Hz, "right") - 1
        if self.between == "held" or len(self.samples) == 1:
            return np.asarray(values[row])
        row = np.minimum(row, len(self.samples) - 2)
        share = (place - self.samples[row]) / (self.samples[row + 1] - self.samples[row])
        share = np.clip(share, 0.0, 1.0).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1.0 - share) * values[row] + share * values[row + 1])

    def without_repeats(self) -> "FocusTable":
        """Return the table without held rows equal to the row before, except the last, which sets the duration."""
        if self.between != "held":
            return self
        changes = np.append(True, np.any(np.diff(self._numbers[:, 1:], axis=0) != 0.0, axis=1))
        changes[-1] = True
        return replace(self, rows=np.ascontiguousarray(self._numbers[changes]).tobytes())

    @cached_property
    def has_levels(self) -> bool:
        """Whether intensities have values other than 0 and 1, also by linear interpolation."""
        values = np.unique(self.intensities)
        return bool(np.any((values > 0.0) & (values < 1.0))) or (self.between == "linear" and len(values) > 1)

    @cached_property
    def moved_m(self) -> float:
        """Largest path length of a focus from the first row to the last [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=2).sum(axis=0).max(initial=0.0))
