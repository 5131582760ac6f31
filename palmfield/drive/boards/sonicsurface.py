"""Bytes of the SonicSurface board (256 emitters, 230400 baud, 50 % duty) and the resulting emission.

The protocol and the buffers follow the open firmware of the board (upnalab/SonicSurface, `Distribute.vhd`,
`PhaseLine.vhd`); the one-step lag of every eighth address was found by a simulation of that firmware.
"""

import re
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.drive.board import Board, Emitted, Line, Twin, serial_line, switched
from palmfield.types import Complex, Float

EMITTERS = 256
STEPS = 32
LINE = serial_line(230400)

OFF = 32
STOP_CLOCKS = 150
START_CLOCKS = 151
PRIMARY = 192
SECONDARY = 193
SWAP = 253
START = 254

FRAME_BYTES = EMITTERS + 2
FRAME_RATE_HZ = 1.0 / LINE.time_s(FRAME_BYTES)
OFF_FRAME = bytes([START]) + bytes([OFF]) * EMITTERS + bytes([SWAP])
OFF_SEQUENCE = 2 * (bytes([START_CLOCKS, PRIMARY]) + OFF_FRAME)
"""Bytes that reset the state left by a program: stopped clocks, other board selected, cut frame, full second buffer."""

LAG: Float = (np.arange(EMITTERS) % 8 == 3).astype(np.float64)
"""Lag of each address in phase steps."""
SECONDARY_LAG = 16.5
CARRIER_HZ = 40e3
PIECES = re.compile(rb"[\x96\x97\xc0\xc1\xfd\xfe]|[^\x96\x97\xc0\xc1\xfd\xfe]+")
"""Commands, and runs of data between them."""


def data_bytes(amplitudes: Complex, on: NDArray[np.bool_], lag: Float) -> bytes:
    """Return data of one frame in address order: round(32 arg / 2 pi - lag) mod 32, and 32 for off."""
    step = np.rint(STEPS * np.angle(amplitudes) / (2 * np.pi) - lag).astype(np.int64)
    return np.where(on, step % STEPS, OFF).astype(np.uint8).tobytes()


@dataclass(frozen=True)
class SonicSurface(Board):
    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return 258 bytes: start, 256 data bytes, swap. Each amplitude is 0 (off) or has magnitude 1 (full drive)."""
        return bytes([START]) + data_bytes(*switched(self, amplitudes), LAG) + bytes([SWAP])

    def twin(self) -> "SonicSurfaceTwin":
        return SonicSurfaceTwin()


class BufferedTwin(Twin):
    """Twin of a firmware with two buffers and a byte counter, without reply.

    The end of a frame exchanges the buffers. So if a frame has fewer bytes than transducers, the other transducers play
    their values of two frames before.
    Data beyond 256 bytes is flagged and dropped, because the reaction of the board is undefined.
    """

    def __init__(self, line: Line, pieces: re.Pattern[bytes], first: int) -> None:
        """pieces: commands, and runs of data between them; first: content of both buffers at power-up, for all
        emitters
        """
        super().__init__(EMITTERS, 1.0 / line.bytes_per_s)
        self._pieces, self._counter = pieces, 0
        self._front, self._back = (np.full(EMITTERS, first, dtype=np.uint8) for _ in range(2))

    @abstractmethod
    def execute(self, command: int) -> bool | None:
        """Execute a command that is neither start nor swap. Return whether the emission changes; None for data."""

    def take(self, data: bytes) -> list[Emitted]:
        changes = []
        for match in self._pieces.finditer(data):
            piece = match[0]
            self.time_s += len(piece) * self.byte_s
            changed = piece[0] == SWAP or self.execute(piece[0])
            if piece[0] == SWAP:
                self._front, self._back, self._counter = self._back, self._front, 0
            elif changed is None and piece[0] == START:
                self._counter = 0
            elif changed is None:
                self._store(piece)
            if changed:
                changes.append(Emitted(self.time_s, self.emitted))
        return changes

    def _store(self, piece: bytes) -> None:
        """Store data in the hidden buffer, from the address of the counter on."""
        room = EMITTERS - self._counter
        values = np.frombuffer(piece[:room], dtype=np.uint8)
        self._back[self._counter : self._counter + len(values)] = np.where(values == OFF, OFF, values % OFF)
        if len(piece) > room:
            self.flag("overrun", f"{len(piece) - room} bytes beyond the {EMITTERS} of a frame: the output is undefined")
        self._counter += len(values)


class SonicSurfaceTwin(BufferedTwin):
    """One SonicSurface with the behaviour of its firmware.

    Both buffers hold phase 0 at power-up, so all 256 emitters sound before the first frame.
    secondary: True for the second board of a pair: its data come after byte 193, and it lags by 16.5 steps.
    """

    def __init__(self, secondary: bool = False) -> None:
        super().__init__(LINE, PIECES, 0)
        self.lag = LAG + (SECONDARY_LAG if secondary else 0.0)
        self.pins_high: NDArray[np.bool_] = np.zeros(EMITTERS, dtype=bool)
        self._selected_by = SECONDARY if secondary else PRIMARY
        self._selected = True
        self._clocks = True

    @property
    def emitted(self) -> Complex:
        """Present emission, zero while clocks are stopped: pins that are high then are a DC load, without sound."""
        if not self._clocks:
            return np.zeros(EMITTERS, dtype=np.complex128)
        wave = np.exp(2j * np.pi * (self._front + self.lag) / STEPS)
        return np.where(self._front == OFF, 0.0, wave)

    def execute(self, command: int) -> bool | None:
        """See BufferedTwin. Data and starts for the other board of a pair have no effect."""
        if command in (STOP_CLOCKS, START_CLOCKS):
            return self._clock(command == START_CLOCKS)
        if command in (PRIMARY, SECONDARY):
            self._selected = command == self._selected_by
            return False
        return None if self._selected else False

    def _clock(self, runs: bool) -> bool:
        """Start or stop the clocks, flag pins that stay high (DC); return whether the emission changes."""
        was, self._clocks = self._clocks, runs
        if runs:
            self.pins_high[:] = False
        elif was:
            # The pulse of step s is high for half a turn from s on
            turn = np.mod(self.time_s * CARRIER_HZ * STEPS - self._front - self.lag, STEPS)
            self.pins_high = (self._front != OFF) & (turn < STEPS / 2)
            high = int(self.pins_high.sum())
            self.flag(
                "dc",
                f"the shift clocks have stopped: {high} of {EMITTERS} pins stay high, which puts DC on these "
                "transducers",
            )
        return was != runs


BOARD = SonicSurface(
    "sonicsurface",
    "SonicSurface with its primary firmware, 256 emitters at 230400 baud: 32 phases, off or full (50 % duty), 89.3 "
    "frames/s",
    layouts=("sonicsurface",),
    unit=EMITTERS,
    line=LINE,
    max_frame_rate_Hz=FRAME_RATE_HZ,
    phase_steps=STEPS,
    amplitude="on_off",
    start=OFF_SEQUENCE,
    stop=OFF_SEQUENCE,
    when_host_dies="the SonicSurface keeps emitting its last frame until power is cut",
    cannot_guarantee="The board sends no reply and has no checksum, so the host cannot check whether a frame "
    "arrived. From power-up until the first frame all 256 emitters emit. A single board flashed as secondary "
    "ignores all bytes, including start and stop, and keeps its last output; such a board needs sonicsurface_pair.",
    keys=("dither",),
)
