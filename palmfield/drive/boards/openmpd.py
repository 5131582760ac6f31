"""Frames of OpenMPD boards (AcoustophoreticBoard): a phase and a pulse width for each of 256 transducers."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.drive.board import Board, Emitted, Twin, commanded, serial_line
from palmfield.drive.pulse_width import widths
from palmfield.stimulus.duty_law import relative_pressure
from palmfield.types import Complex, Float

TRANSDUCERS = 256
STEPS = 128
HALF = STEPS // 2
FRAME_BYTES = 2 * TRANSDUCERS
FIRST = 0x80
LINE = serial_line(250000)
BUFFER_FRAMES = 32
FRAME_PERIOD_S = 4 / 40e3
OFF_FRAME = bytes([FIRST]) + bytes(FRAME_BYTES - 1)


@dataclass(frozen=True)
class OpenMpd(Board):
    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return 512 bytes: 256 phases, the first with 0x80 added, then 256 pulse widths.

        A pulse starts at its phase. The phase is shifted so that the middle of the pulse is the middle of a pulse of
        half a period.
        """
        values = commanded(self, amplitudes)
        width = widths(np.minimum(np.abs(values), 1.0), STEPS)
        start = np.rint(STEPS * np.angle(values) / (2 * np.pi) + 0.5 * (HALF - width)).astype(np.int64) % STEPS
        start[width == 0] = 0
        phases = start.astype(np.uint8)
        phases[0] |= FIRST
        return phases.tobytes() + width.astype(np.uint8).tobytes()

    def rounded(self, levels: Float) -> Float:
        return relative_pressure(widths(np.minimum(levels, 1.0), STEPS) / STEPS)

    def twin(self) -> "OpenMpdTwin":
        return OpenMpdTwin()


class OpenMpdTwin(Twin):
    """Twin that delays 32 frames and plays one every four carrier periods; the last continues. Silent at power-up."""

    def __init__(self) -> None:
        super().__init__(TRANSDUCERS, 1.0 / LINE.bytes_per_s)
        self._frame = bytearray()
        self._waiting: deque[Emitted] = deque()
        self._played = np.zeros(TRANSDUCERS, dtype=np.complex128)
        self._last_s = -math.inf

    @property
    def emitted(self) -> Complex:
        return self._played

    def take(self, data: bytes) -> list[Emitted]:
        begin, changes = self.time_s, []
        position = 0
        while position < len(data):
            piece = data[position : position + FRAME_BYTES - len(self._frame)]
            first = next((n for n, byte in enumerate(piece) if byte >= FIRST and (n or self._frame)), None)
            if first is not None:
                # A new frame begins before the last frame is complete
                self.time_s = begin + (position + first) * self.byte_s
                self.flag("garbled", f"dropped an incomplete frame of {len(self._frame) + first} bytes")
                self._frame.clear()
                position += first
                continue
            if not self._frame and piece[0] < FIRST:
                self.flag("garbled", f"dropped {len(piece)} bytes outside a frame")
                position += len(piece)
                continue
            self._frame += piece
            position += len(piece)
            if len(self._frame) == FRAME_BYTES:
                self.time_s = begin + position * self.byte_s
                changes += self.until(self.time_s)
                self._queue(bytes(self._frame))
                self._frame.clear()
        self.time_s = begin + len(data) * self.byte_s
        return changes + self.until(self.time_s)

    def _queue(self, frame: bytes) -> None:
        if len(self._waiting) >= BUFFER_FRAMES:
            self.flag("overrun", f"{BUFFER_FRAMES} frames are waiting already, so one is lost")
            return
        tick_s = math.ceil(self.time_s / FRAME_PERIOD_S - 1e-6) * FRAME_PERIOD_S
        self._last_s = max(tick_s, self._last_s + FRAME_PERIOD_S)
        self._waiting.append(Emitted(self._last_s, pulses_of(np.frombuffer(frame, dtype=np.uint8))))

    def until(self, time_s: float) -> list[Emitted]:
        changes = []
        while self._waiting and self._waiting[0].time_s <= time_s:
            changes.append(self._waiting.popleft())
            self._played = changes[-1].amplitudes
        return changes


def pulses_of(frame: NDArray[np.uint8]) -> Complex:
    """Return the first harmonic of the pulses of a frame over that of half a period from phase 0, shape (256,)."""
    start, width = frame[:TRANSDUCERS] % STEPS, frame[TRANSDUCERS:].astype(float)
    return np.sin(np.pi * width / STEPS) * np.exp(2j * np.pi * (start + 0.5 * (width - HALF)) / STEPS)


BOARD = OpenMpd(
    "openmpd",
    "OpenMPD (AcoustophoreticBoard), 256 transducers at 250000 baud: 128 phases, 64 pulse widths, 48.8 frames/s on the "
    "line (10,000 on the board)",
    layouts=("openmpd", "openmpd_rows"),
    unit=TRANSDUCERS,
    line=LINE,
    max_frame_rate_Hz=1.0 / LINE.time_s(FRAME_BYTES),
    phase_steps=STEPS,
    amplitude="pulse_width",
    amplitude_steps=HALF,
    start=2 * OFF_FRAME,
    stop=2 * OFF_FRAME,
    when_host_dies="the OpenMPD board keeps emitting its last frame until power is cut",
    cannot_guarantee="The board has no checksum and sends no reply. Its pin order comes from the vendor's board "
    "files and was not tested on hardware; a board with another order needs a calibration with addresses. The "
    "vendor's files contain the phases of single boards: `palmfield calibrate import board_N.pat BOARD.json`.",
)
