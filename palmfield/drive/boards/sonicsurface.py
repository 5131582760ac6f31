"""Bytes of the SonicSurface board (256 emitters, 230400 baud, 50 % duty) and what the board emits when fed with them.

The protocol and the buffers follow the board's open firmware (upnalab/SonicSurface, `Distribute.vhd`, `PhaseLine.vhd`);
the one-step lag of every eighth address is what a simulation of that firmware shows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.drive.boards.board import Board
from palmfield.errors import DeviceError
from palmfield.types import Complex, Float

EMITTERS = 256
STEPS = 32
BAUD = 230400
BITS_PER_BYTE = 10  # 8N1: start, 8 data, stop

OFF = 32
STOP_CLOCKS = 150
START_CLOCKS = 151
PRIMARY = 192
SECONDARY = 193
SWAP = 253
START = 254

FRAME_BYTES = EMITTERS + 2
FRAME_RATE_HZ = BAUD / BITS_PER_BYTE / FRAME_BYTES
OFF_FRAME = bytes([START]) + bytes([OFF]) * EMITTERS + bytes([SWAP])

LAG = (np.arange(EMITTERS) % 8 == 3).astype(np.int64)
SECONDARY_LAG = 16.5
UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Calibration:
    """How the emitters of one real board differ from ideal ones, in address order.

    polarity: +1 or -1 for a transducer wired the other way round, shape (256,)
    phase_rad: extra phase of each emitter, positive for later [rad], shape (256,)
    Raises DeviceError for other shapes and values.
    """

    polarity: Float
    phase_rad: Float

    def __post_init__(self) -> None:
        for name, values in (("polarity", self.polarity), ("phase_rad", self.phase_rad)):
            if np.shape(values) != (EMITTERS,):
                raise DeviceError(f"calibration {name} has shape {np.shape(values)}; give ({EMITTERS},)")
        if not np.all(np.abs(self.polarity) == 1):
            raise DeviceError("calibration polarity has values other than +1 and -1; give the sign of each transducer")
        if not np.all(np.isfinite(self.phase_rad)):
            raise DeviceError("calibration phase_rad has values that are not finite; measure them or put 0")

    def response(self) -> Complex:
        """What each emitter makes of a unit drive: polarity e^{i phase}, shape (256,)."""
        return np.asarray(self.polarity) * np.exp(1j * np.asarray(self.phase_rad))


def encode(amplitude: ArrayLike, calibration: Calibration | None = None) -> bytes:
    """One frame that makes the board emit `amplitude`, to the nearest of 32 phases.

    amplitude: complex amplitude of each emitter, e^{-iwt} (a delay is +phase), shape (256,), in address order. Each is
        0 (off) or has magnitude 1 (full drive): the board's duty is fixed at 50 %.
    calibration: the board's own deviations, which are taken off; None for an ideal board
    Returns 258 bytes: start, 256 data bytes, swap. Data byte = round(32 arg / 2 pi) mod 32, one less for the addresses
    that lag; 32 for off.
    Raises DeviceError for another shape or magnitude.
    """
    commanded = np.asarray(amplitude, dtype=np.complex128)
    if commanded.shape != (EMITTERS,):
        raise DeviceError(f"a SonicSurface frame has shape {commanded.shape}; give ({EMITTERS},)")
    magnitude = np.abs(commanded)
    on = magnitude != 0
    bad = on & ~(np.abs(magnitude - 1) <= UNIT_TOLERANCE)
    if bad.any():
        address = int(np.flatnonzero(bad)[0])
        raise DeviceError(
            f"emitter {address} is asked for amplitude {magnitude[address]:.4g}; the SonicSurface has a fixed 50 % "
            "duty, so only 0 (off) and 1 (full) can be sent: use drive amplitude 1, or board ideal"
        )
    if calibration is not None:
        commanded = commanded / calibration.response()
    step = np.rint(STEPS * np.angle(commanded) / (2 * np.pi)).astype(np.int64)
    data = np.where(on, (step - LAG) % STEPS, OFF).astype(np.uint8)
    return bytes([START]) + data.tobytes() + bytes([SWAP])


class SonicSurfaceTwin:
    """One SonicSurface as its firmware behaves: two buffers, a byte counter, and no reply.

    Both buffers hold phase 0 at power-up, so all 256 emitters sound before the first frame. A swap *exchanges* the
    buffers: after a short frame the addresses that it left out play what they had two frames before.
    secondary: True for the second board of a pair, which takes the data after 193 and lags by 16.5 steps.
    """

    def __init__(self, calibration: Calibration | None = None, secondary: bool = False) -> None:
        self._response = np.ones(EMITTERS, dtype=np.complex128) if calibration is None else calibration.response()
        self._lag = LAG + (SECONDARY_LAG if secondary else 0.0)
        self._selected_by = SECONDARY if secondary else PRIMARY
        self._selected = True
        self._clocks = True
        self._counter = 0
        self._front = np.zeros(EMITTERS, dtype=np.uint8)
        self._back = np.zeros(EMITTERS, dtype=np.uint8)

    @property
    def emitted(self) -> Complex:
        """What sounds now: complex amplitude of each emitter at the carrier, shape (256,). Zero while clocks stand."""
        if not self._clocks:
            return np.zeros(EMITTERS, dtype=np.complex128)
        wave = np.exp(2j * np.pi * (self._front + self._lag) / STEPS)
        return np.where(self._front == OFF, 0.0, wave * self._response)

    def feed(self, data: bytes) -> list[Complex]:
        """Take bytes from the line; gives what is emitted after each byte that changes it (swap, clocks off and on).

        Raises DeviceError when a frame has more than 256 data bytes: what the board then does is undefined.
        """
        frames = []
        for byte in data:
            if byte == SWAP:
                self._front, self._back = self._back, self._front
                self._counter = 0
                frames.append(self.emitted)
            elif byte in (STOP_CLOCKS, START_CLOCKS):
                self._clocks = byte == START_CLOCKS
                frames.append(self.emitted)
            elif byte in (PRIMARY, SECONDARY):
                self._selected = byte == self._selected_by
            elif self._selected and byte == START:
                self._counter = 0
            elif self._selected:
                if self._counter == EMITTERS:
                    raise DeviceError(f"more than {EMITTERS} data bytes in one frame; start each frame with {START}")
                self._back[self._counter] = byte if byte == OFF else byte % STEPS
                self._counter += 1
        return frames


def decode(data: bytes, calibration: Calibration | None = None) -> list[Complex]:
    """What a board that has just been switched on emits, one frame of shape (256,) for each change, lag included.

    data: bytes as sent; calibration: the board's own deviations, None for an ideal board
    Raises DeviceError when a frame has more than 256 data bytes.
    """
    return SonicSurfaceTwin(calibration).feed(data)


BOARD = Board(
    "sonicsurface",
    FRAME_RATE_HZ,
    "on_off",
    "SonicSurface, 256 emitters at 230400 baud: 32 phases, off or full (50 % duty), 89.3 frames/s",
    layout="sonicsurface",
    encode=encode,
    decode=decode,
    off_frame=OFF_FRAME,
)
