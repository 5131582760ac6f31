"""Arduino Mega boards of Ultraino: 64 signals each, as bits of ten ports in ten divisions of a carrier period.

Wiring and commands follow the open firmware and host of the boards (asiermarzo/Ultraino, `DriverMEGA.ino`,
`ArduinoMEGA64`). Boards are chained: each uses the bytes with lower nibble 1, and forwards others with that nibble
reduced by one."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.drive.board import Board, Emitted, Twin, commanded, serial_line
from palmfield.drive.pulse_width import widths
from palmfield.stimulus.duty_law import relative_pressure
from palmfield.types import Complex, Float

SIGNALS = 64
DIVISIONS = 10
PORTS = 10
PATTERN = DIVISIONS * PORTS
MOST_PATTERNS = 32
LINE = serial_line(115200)
SWITCH = 0x00
COMMIT = 0x10
DURATION = 0x30
ONE_PERIOD_THEN_AGAIN = bytes([DURATION, DURATION, DURATION, DURATION | 0x40] + 4 * [DURATION])
"""Durations 1 and 0 as four bytes each, with two bits in front: one pattern, repeated."""

PORT_MAPPING: NDArray[np.int64] = np.array([
    51, 52, 53, 54, 28, 29, 30, 31, 47, 46, 45, 44, 43, 42, 41, 40, 56, 57, 58, 59, 48, 49, 72, 69, 39, 38, 37, 36, 35,
    34, 33, 32, 21, 23, 65, 63, 9, 11, 13, 15, 20, 22, 64, 66, 8, 10, 12, 14, 24, 25, 26, 27, 16, 17, 18, 19, 7, 6, 5,
    4, 3, 2, 1, 0,
])  # fmt: skip
"""Port of each signal times 8, plus its bit in the port."""
PHASE_COMPENSATION: NDArray[np.int64] = np.zeros(SIGNALS, dtype=np.int64)
"""Delay of each signal in divisions; zero in the present version of the host."""
TURNS = np.exp(2j * np.pi * np.arange(DIVISIONS) / DIVISIONS)
FULL = TURNS[: DIVISIONS // 2].sum()


def waveforms(amplitudes: Complex) -> NDArray[np.uint8]:
    """Return the levels of each signal in each division, shape (n, 10); narrower pulses have the same middle."""
    width = widths(np.minimum(np.abs(amplitudes), 1.0), DIVISIONS)
    slack = 0.5 * (DIVISIONS // 2 - width)
    start = np.rint(DIVISIONS * np.angle(amplitudes) / (2 * np.pi) + slack).astype(np.int64)
    start += np.tile(PHASE_COMPENSATION, len(amplitudes) // SIGNALS)
    since = np.mod(np.arange(DIVISIONS) - start[:, None], DIVISIONS)
    return (since < width[:, None]).astype(np.uint8)


def pattern(levels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the bytes of the ports of a board, division by division, (100,); levels: of its signals, (64, 10)."""
    pins = np.zeros((DIVISIONS, 8 * PORTS), dtype=np.uint8)
    pins[:, PORT_MAPPING] = levels.T
    return np.packbits(pins, axis=1, bitorder="little").ravel()


def frame(patterns: NDArray[np.uint8]) -> bytes:
    """Return one frame for patterns of all boards, shape (boards, 100)."""
    board = np.arange(1, len(patterns) + 1, dtype=np.uint8)[:, None]
    pairs = np.stack([(patterns & 0xF0) | board, ((patterns << 4) & 0xF0) | board], axis=2)
    return pairs.tobytes() + ONE_PERIOD_THEN_AGAIN + bytes([COMMIT, SWITCH])


@dataclass(frozen=True)
class Ultraino(Board):
    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return two bytes for each of 100 per board, eight of durations, commit and switch: 210 for one board."""
        levels = waveforms(commanded(self, amplitudes)).reshape(self.units, SIGNALS, DIVISIONS)
        return frame(np.stack([pattern(part) for part in levels]))

    @property
    def silence(self) -> bytes:
        return frame(np.zeros((self.units, PATTERN), dtype=np.uint8))

    def sized(self, transducers: int) -> "Ultraino":
        sized = super().sized(transducers)
        off = sized.silence
        # After an incomplete frame the data of the next frame are misplaced; two complete frames then fill both buffers
        return replace(sized, start=3 * off, stop=3 * off, max_frame_rate_Hz=1.0 / LINE.time_s(len(off)))

    def rounded(self, levels: Float) -> Float:
        return relative_pressure(widths(np.minimum(levels, 1.0), DIVISIONS) / DIVISIONS)

    def twin(self) -> "UltrainoTwin":
        return UltrainoTwin(self.units)


class UltrainoTwin(Twin):
    """Chained boards, each with two buffers of 32 patterns; the first pattern of the front buffer is played.

    At power-up all signals are high in the first half of each period.
    """

    def __init__(self, boards: int) -> None:
        super().__init__(SIGNALS * boards, 1.0 / LINE.bytes_per_s)
        size = boards, MOST_PATTERNS * PATTERN
        self._front, self._back = np.zeros(size, dtype=np.uint8), np.zeros(size, dtype=np.uint8)
        self._front[:, : PATTERN // 2] = 0xFF
        self._written = [0] * boards

    @property
    def emitted(self) -> Complex:
        """First harmonic of the waveforms, relative to that of a pulse of half a period from division 0 on."""
        ports = self._front[:, :PATTERN].reshape(-1, DIVISIONS, PORTS)
        levels = (ports[:, :, PORT_MAPPING // 8] >> (PORT_MAPPING % 8).astype(np.uint8)) & 1
        turns = TURNS[:, None] * np.exp(-2j * np.pi * PHASE_COMPENSATION / DIVISIONS)
        sums: Complex = (levels * turns).sum(axis=1) / FULL
        sums[np.abs(sums) < 1e-12] = 0.0
        return sums.ravel()

    def take(self, data: bytes) -> list[Emitted]:
        changes = []
        begin = self.time_s
        for number, byte in enumerate(data):
            nibble = byte & 0x0F
            if byte == SWITCH:
                self._front, self._back = self._back, self._front
                self._written = [0] * len(self._written)
                self.time_s = begin + (number + 1) * self.byte_s
                changes.append(Emitted(self.time_s, self.emitted))
            elif nibble == 0:
                if byte & 0x3F != DURATION and byte != COMMIT:
                    self.flag("garbled", f"byte 0x{byte:02x} is not a command")
            elif nibble <= len(self._written):
                self._put(nibble - 1, byte)
        self.time_s = begin + len(data) * self.byte_s
        return changes

    def _put(self, board: int, byte: int) -> None:
        at, second = divmod(self._written[board], 2)
        if at >= self._back.shape[1]:
            self.flag(
                "overrun",
                f"more than {MOST_PATTERNS} patterns for board {board + 1}: the board would write beyond its memory",
            )
            return
        self._back[board, at] = self._back[board, at] | (byte >> 4) if second else byte & 0xF0
        self._written[board] += 1


BOARD = Ultraino(
    "ultraino",
    "Ultraino on Arduino Mega boards, 64 transducers each at 115200 baud: 10 phases, 5 pulse widths, 54.9 frames/s "
    "with one board",
    layouts=("ultraino", "csv"),
    unit=SIGNALS,
    most_units=14,
    line=LINE,
    phase_steps=DIVISIONS,
    amplitude="pulse_width",
    amplitude_steps=DIVISIONS // 2,
    when_host_dies="Ultraino keeps emitting its last pattern until power is cut",
    cannot_guarantee="The board has no checksum and no watchdog. With ten phases a focus keeps 0.98 of its "
    "pressure. From power-up until the first frame all transducers emit.",
).sized(SIGNALS)
