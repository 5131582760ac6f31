"""Two SonicSurface boards on one line; the second is above and faces the first.

The site of the second array is rotated by half a turn about the x axis of the first (quat="0 1 0 0"). In the frame of
the vendor its board has the mirrored map x' = -z, z' = -x. In the frame of the site this is a quarter turn of the grid.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics.layouts import sonicsurface_order
from palmfield.drive.board import Board, Emitted, Twin, switched
from palmfield.drive.boards.sonicsurface import (
    EMITTERS,
    LAG,
    LINE,
    OFF,
    PRIMARY,
    SECONDARY,
    SECONDARY_LAG,
    START,
    START_CLOCKS,
    STEPS,
    SWAP,
    SonicSurfaceTwin,
    data_bytes,
)
from palmfield.types import Complex

FRAME_BYTES = 2 * (EMITTERS + 2) + 1


def _downward() -> np.ndarray:
    """Return the row in layout `sonicsurface`, in the frame of the site, of each address of the downward board."""
    by_site = sonicsurface_order().reshape(16, 16)  # rows along +y, columns along +x
    # An address at (x, y) on the upward board is at (y, -x) on the downward board
    turned = by_site[:, ::-1].T
    rows = np.empty(EMITTERS, dtype=np.int64)
    rows[by_site.ravel()] = turned.ravel()
    return np.argsort(rows)


DOWNWARD = _downward()


def _frame(first: bytes, second: bytes) -> bytes:
    return bytes([PRIMARY, START]) + first + bytes([SECONDARY, START]) + second + bytes([SWAP])


OFF_FRAME = _frame(bytes([OFF]) * EMITTERS, bytes([OFF]) * EMITTERS)
OFF_SEQUENCE = 2 * (bytes([START_CLOCKS]) + OFF_FRAME)


@dataclass(frozen=True)
class SonicSurfacePair(Board):
    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return 517 bytes, a frame: for each board its address (192, 193), 254, 256 data bytes; at the end 253.

        amplitudes: amplitudes of the first array, then of the second, shape (512,), each 0 or of magnitude 1
        """
        values, on = switched(self, amplitudes)
        below, above = slice(0, EMITTERS), EMITTERS + DOWNWARD
        return _frame(
            data_bytes(values[below], on[below], LAG), data_bytes(values[above], on[above], LAG + SECONDARY_LAG)
        )

    def twin(self) -> "PairTwin":
        return PairTwin()


class PairTwin(Twin):
    """A primary and a secondary board on one line: each receives all bytes."""

    def __init__(self) -> None:
        super().__init__(2 * EMITTERS, 1.0 / LINE.bytes_per_s)
        self.boards = SonicSurfaceTwin(), SonicSurfaceTwin(secondary=True)

    @property
    def emitted(self) -> Complex:
        first, second = (board.emitted for board in self.boards)
        return self._joined(first, second)

    def _joined(self, first: Complex, second: Complex) -> Complex:
        result = np.empty(self.count, dtype=np.complex128)
        result[:EMITTERS] = first
        result[EMITTERS + DOWNWARD] = second
        return result

    def take(self, data: bytes) -> list[Emitted]:
        begin = self.time_s
        first, second = (board.feed(data, begin) for board in self.boards)
        for board in self.boards:
            self.flags += board.flags
            board.flags.clear()
        self.time_s = begin + len(data) * self.byte_s
        return [Emitted(a.time_s, self._joined(a.amplitudes, b.amplitudes)) for a, b in zip(first, second, strict=True)]


BOARD = SonicSurfacePair(
    "sonicsurface_pair",
    "two chained SonicSurface boards, the second facing the first: 512 emitters, 32 phases, off or full, 44.6 frames/s",
    layouts=("sonicsurface",),
    unit=2 * EMITTERS,
    arrays=(2, 2),
    line=LINE,
    max_frame_rate_Hz=1.0 / LINE.time_s(FRAME_BYTES),
    phase_steps=STEPS,
    amplitude="on_off",
    start=OFF_SEQUENCE,
    stop=OFF_SEQUENCE,
    when_host_dies="both SonicSurface boards keep emitting their last frame until power is cut",
    cannot_guarantee="The limits of one SonicSurface apply. The secondary board lags by 16.5 phase steps, which "
    "the sent bytes compensate; if the roles of the boards are exchanged, they are half a wavelength out of phase.",
    keys=("dither",),
)
