"""Phase and intensity bytes of AUTD3 units, and the corresponding pulse widths.

The bytes are a pattern of the AUTD3 software: phases of one unit, then its intensities, unit after unit.
`palmfield.drive.autd3_units` sends them to real units.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.drive.board import Board, Emitted, Line, Twin, commanded
from palmfield.drive.pulse_width import AUTD3_LEVELS, AUTD3_TICKS
from palmfield.drive.quantise import phase_codes
from palmfield.types import Complex, Float

TRANSDUCERS = 249
STEPS = 256
FRAME_BYTES = 2 * TRANSDUCERS
FRAME_RATE_HZ = 1000.0
"""One frame per EtherCAT cycle of 1 ms."""
WATCHDOG_S = 0.5
MOST_UNITS = 8


def pulse_widths(intensity: ArrayLike) -> NDArray[np.int64]:
    """Return the pulse width in ticks of 1/512 of a period for intensity bytes: round(512 asin(i/255) / pi)."""
    share = np.asarray(intensity, float) / AUTD3_LEVELS
    return np.rint(AUTD3_TICKS * np.arcsin(share) / np.pi).astype(np.int64)


def emitted_by(phase: ArrayLike, intensity: ArrayLike) -> Complex:
    """Return the complex amplitude of transducers at the carrier relative to full drive; bytes, shapes (n,)."""
    turns: Float = np.asarray(phase, float) / STEPS
    return np.sin(np.pi * pulse_widths(intensity) / AUTD3_TICKS) * np.exp(2j * np.pi * turns)


LEVELS: Float = np.sin(np.pi * pulse_widths(np.arange(AUTD3_LEVELS + 1)) / AUTD3_TICKS)
"""Amplitude of each intensity."""
LOWEST = np.unique(LEVELS, return_index=True)[1]
"""Lowest intensity of each pulse width."""
BETWEEN = 0.5 * (LEVELS[LOWEST][1:] + LEVELS[LOWEST][:-1])
"""Amplitudes above which the next of LOWEST is nearer."""


@dataclass(frozen=True)
class Autd3(Board):
    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return 498 bytes per unit: 249 phases round(256 arg / 2 pi) mod 256, then 249 intensities, each the lowest
        intensity whose pulse is closest to the amplitude."""
        values = commanded(self, amplitudes)
        phase = phase_codes(np.exp(1j * np.angle(values)), STEPS)
        intensity = LOWEST[np.searchsorted(BETWEEN, np.abs(values))]
        phase[intensity == 0] = 0
        both = np.stack([phase.reshape(-1, TRANSDUCERS), intensity.reshape(-1, TRANSDUCERS)], axis=1)
        return both.astype(np.uint8).tobytes()

    def rounded(self, levels: Float) -> Float:
        return LEVELS[LOWEST[np.searchsorted(BETWEEN, levels)]]

    def sized(self, transducers: int) -> "Autd3":
        sized = super().sized(transducers)
        off = bytes(FRAME_BYTES * sized.units)
        return replace(sized, start=off, stop=off, line=Line(FRAME_RATE_HZ * len(off)))

    def twin(self) -> "Autd3Twin":
        return Autd3Twin(self.units, self.frame_time_s)


class Autd3Twin(Twin):
    """Units that change with a whole frame and become silent half a second after the last frame. Silent at power-up.

    The silencer, which spreads a change over about ten periods, is off.
    """

    def __init__(self, units: int, frame_s: float) -> None:
        super().__init__(TRANSDUCERS * units, frame_s / (FRAME_BYTES * units))
        self._size = FRAME_BYTES * units
        self._frame = bytearray()
        self._played = np.zeros(self.count, dtype=np.complex128)

    @property
    def emitted(self) -> Complex:
        return self._played

    def take(self, data: bytes) -> list[Emitted]:
        begin, changes = self.time_s, []
        changes += self.until(begin)
        position = 0
        while position < len(data):
            piece = data[position : position + self._size - len(self._frame)]
            self._frame += piece
            position += len(piece)
            if len(self._frame) == self._size:
                self.time_s = begin + position * self.byte_s
                both = np.frombuffer(bytes(self._frame), dtype=np.uint8).reshape(-1, 2, TRANSDUCERS)
                self._played = emitted_by(both[:, 0].ravel(), both[:, 1].ravel())
                changes.append(Emitted(self.time_s, self._played))
                self._frame.clear()
        self.time_s = begin + len(data) * self.byte_s
        return changes

    def until(self, time_s: float) -> list[Emitted]:
        silent_s = self.time_s + WATCHDOG_S
        if time_s <= silent_s or not self._played.any():
            return []
        self._played = np.zeros(self.count, dtype=np.complex128)
        self._frame.clear()
        return [Emitted(silent_s, self._played)]


BOARD = Autd3(
    "autd3",
    "AUTD3 units, 249 transducers each on EtherCAT: 256 phases, 255 intensities, 1000 frames/s",
    layouts=("autd3", "autd3_2x2", "autd3_3x2", "autd3_4x2"),
    unit=TRANSDUCERS,
    most_units=MOST_UNITS,
    arrays=(1, MOST_UNITS),
    line=Line(FRAME_RATE_HZ * FRAME_BYTES),
    max_frame_rate_Hz=FRAME_RATE_HZ,
    phase_steps=STEPS,
    amplitude="pulse_width",
    amplitude_steps=AUTD3_LEVELS,
    when_host_dies="AUTD3 units switch off 0.5 s after the last frame",
    cannot_guarantee="The silencer of the AUTD3 software is off, so changes of level may be audible as clicks.",
).sized(TRANSDUCERS)
