"""What a board can play, and what comes out when it is asked for more."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import DeviceError
from palmfield.types import Complex


@dataclass(frozen=True)
class Board:
    """What plays a drive: its limits and its bytes.

    max_frame_rate_Hz: frames that reach it a second, inf for none
    amplitude: whether each transducer takes any amplitude, or only off and full
    description: in words, with the limits
    layout: of the one array that it drives; None for any arrays
    encode: complex amplitudes relative to full drive, e^{-iwt}, shape (n,) in address order -> one frame's bytes;
        raises DeviceError for what it can't play. None where amplitudes are played as they are
    decode: bytes -> what a board just switched on emits after each change, shape (n,) each: its virtual twin
    off_frame: the bytes of silence
    """

    name: str
    max_frame_rate_Hz: float
    amplitude: Literal["continuous", "on_off"]
    description: str
    layout: str | None = None
    encode: Callable[[ArrayLike], bytes] | None = None
    decode: Callable[[bytes], list[Complex]] | None = None
    off_frame: bytes = b""

    @property
    def exact(self) -> bool:
        """Whether it emits exactly what it is asked for."""
        return self.encode is None


def play(board: Board, amplitudes: ArrayLike) -> Complex:
    """What the board emits when asked for `amplitudes`.

    amplitudes: complex amplitude of each transducer relative to full drive, e^{-iwt}, shape (n,), in address order
    Returns the same shape: unchanged where the board is exact, else through its bytes and its virtual twin.
    Raises DeviceError for what the board cannot play.
    """
    if board.encode is None or board.decode is None:
        return np.array(amplitudes, dtype=np.complex128)
    return board.decode(board.encode(amplitudes))[-1]


def check(
    board: Board, *, frame_rate_Hz: float, points_per_turn: float | None = None, modulated: bool, element: str
) -> None:
    """Refuse a stimulus that the board cannot play.

    frame_rate_Hz: drive frames a second that the stimulus needs, 0 when it stands still
    points_per_turn: points on each turn of a closed path at that rate, None when there is no path
    modulated: whether the amplitude takes values between 0 and full
    element: what the scene calls the stimulus, for the message
    Raises DeviceError that says what the scene needs and what the board gives.
    """
    needs_amplitude = modulated and board.amplitude == "on_off"
    too_fast = frame_rate_Hz > board.max_frame_rate_Hz
    if not needs_amplitude and not too_fast:
        return
    amplitude = "continuous amplitude at " if needs_amplitude else ""
    needs = f"stimulus '{element}' needs {amplitude}{frame_rate_Hz:.4g} frames/s"
    gives = f"{board.name} gives {'on/off' if board.amplitude == 'on_off' else 'any'} amplitude"
    gives += f" at {board.max_frame_rate_Hz:.1f} frames/s"
    if points_per_turn is not None and too_fast:
        needs += f" ({points_per_turn:.4g} points a turn)"
        gives += f", {points_per_turn * board.max_frame_rate_Hz / frame_rate_Hz:.2g} points a turn"
    mends = ["board ideal"]
    if needs_amplitude:
        gives += f", so on/off AM up to {board.max_frame_rate_Hz / 2:.1f} Hz"
        mends.append("modulation none or a rectangle of am_depth 1")
    if too_fast:
        mends.append(f"at most {math.floor(board.max_frame_rate_Hz)} frames/s")
    raise DeviceError(f"{needs}; {gives}: use {' or '.join(mends)}")
