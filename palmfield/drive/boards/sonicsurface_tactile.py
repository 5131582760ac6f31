"""Second firmware of the SonicSurface, "FPGA tactile modulation", for haptics.

It switches the emitters one after another, which makes an envelope. A byte sets its rate. 150, 151, 192, 193 are data.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from palmfield.drive.board import Board, Line, switched
from palmfield.drive.boards.sonicsurface import EMITTERS, FRAME_BYTES, OFF, START, SWAP, BufferedTwin
from palmfield.errors import DeviceError
from palmfield.stimulus.duty_law import relative_pressure
from palmfield.types import Complex

STEPS = 16
DUTY = 7 / 16
UART_SLOW = 0.035
LINE = Line(23040.0 * (1.0 - UART_SLOW), round(230400 * (1.0 - UART_SLOW)))
"""Line at the rate of the receiver, which is 3.5 % slow."""
RATE = 160
RATES = 32
ENVELOPE_TOP_HZ = 1250.0
DEFAULT_RATE = 10
"""Default of the firmware at power-up: an envelope of 113.6 Hz."""
OFF_FRAME = bytes([START]) + bytes([OFF]) * EMITTERS + bytes([SWAP])
LEVEL = float(relative_pressure(DUTY))
PIECES = re.compile(rb"[\xa0-\xbf\xfd\xfe]|[^\xa0-\xbf\xfd\xfe]+")
CLOSE = 0.01
"""Largest relative difference of the envelope from the requested rate."""


def envelope_Hz(number: int) -> float:
    """Return the rate of the envelope for byte 160 + number [Hz]."""
    return ENVELOPE_TOP_HZ / (number + 1)


def envelope_byte(frequency_Hz: float) -> int:
    """Return the byte for an envelope. Raises DeviceError if no rate is within 1 % of the frequency [Hz]."""
    rates = np.array([envelope_Hz(number) for number in range(RATES)])
    nearest = int(np.abs(np.log(rates / max(frequency_Hz, 1e-9))).argmin())
    if abs(rates[nearest] / max(frequency_Hz, 1e-9) - 1.0) > CLOSE:
        around = sorted(rates, key=lambda rate: abs(rate - frequency_Hz))[:2]
        raise DeviceError(
            f"sonicsurface_tactile has no envelope of {frequency_Hz:g} Hz; the nearest are "
            + " and ".join(f"{rate:.1f}" for rate in sorted(around))
            + " Hz (1250/(n + 1))"
        )
    return RATE + nearest


@dataclass(frozen=True)
class SonicSurfaceTactile(Board):
    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return 258 bytes, as in the primary firmware: data 2 round(16 arg / 2 pi), 32 for off."""
        values, on = switched(self, amplitudes)
        step = np.rint(STEPS * np.angle(values) / (2 * np.pi)).astype(np.int64) % STEPS
        return bytes([START]) + np.where(on, 2 * step, OFF).astype(np.uint8).tobytes() + bytes([SWAP])

    def modulating(self, frequency_Hz: float) -> "SonicSurfaceTactile":
        return replace(self, start=bytes([envelope_byte(frequency_Hz)]) + 2 * OFF_FRAME)

    def twin(self) -> "TactileTwin":
        return TactileTwin()


class TactileTwin(BufferedTwin):
    """Twin of this firmware. Amplitudes are those while an emitter is on. envelope_Hz: rate of the envelope [Hz]"""

    def __init__(self) -> None:
        super().__init__(LINE, PIECES, OFF)
        self.envelope_Hz = envelope_Hz(DEFAULT_RATE)

    @property
    def emitted(self) -> Complex:
        """Present emission, relative to full drive with pulses of half a period."""
        wave = LEVEL * np.exp(2j * np.pi * (self._front // 2) / STEPS)
        return np.where(self._front == OFF, 0.0, wave)

    def execute(self, command: int) -> bool | None:
        if RATE <= command < RATE + RATES:
            self.envelope_Hz = envelope_Hz(command - RATE)
            return False
        return None


BOARD = SonicSurfaceTactile(
    "sonicsurface_tactile",
    "SonicSurface with the vendor's firmware for tactile modulation: 16 phases, off or full (duty 7/16), an envelope "
    "of 1250/(n + 1) Hz made by switching emitters in turn, 86.2 frames/s",
    layouts=("sonicsurface",),
    unit=EMITTERS,
    line=LINE,
    max_frame_rate_Hz=1.0 / LINE.time_s(FRAME_BYTES),
    phase_steps=STEPS,
    amplitude="on_off",
    start=bytes([RATE + DEFAULT_RATE]) + 2 * OFF_FRAME,
    stop=2 * OFF_FRAME,
    when_host_dies="the SonicSurface keeps emitting its last frame, with its envelope, until power is cut",
    cannot_guarantee="The firmware adds phase corrections that were measured on its authors' board: build it with "
    "that table set to zero, or calibrate. It sends no reply. Its receiver runs 3.5 % slow, so a port that cannot "
    "be set to 222336 baud may lose bytes.",
    modulates=True,
    keys=("dither",),
)
