"""Pulses for target amplitudes: their widths in ticks and their phases (Hasegawa & Shinoda 2018, eq. 5 and 6).

A device counts a carrier period in ticks: 640 ticks of 25.6 MHz in the paper, 512 in AUTD3. At most half of them are
used (duty 0 to 1/2).
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import DeviceError
from palmfield.stimulus.duty_law import duty_cycle
from palmfield.types import Float, Int

HASEGAWA_TICKS = 640
AUTD3_TICKS = 512
AUTD3_LEVELS = 255

Edge = Literal["leading", "trailing", "centre"]
EDGE_TURNS: dict[Edge, float] = {"leading": 0.5, "trailing": -0.5, "centre": 0.0}
"""Phase of the first harmonic per duty, in turns, for each edge of the pulse that can be fixed."""


def widths(amplitude: ArrayLike, ticks: int, exponent: float = 2.0) -> Int:
    """Return the pulse width in ticks, round(ticks d(amplitude)), shape of amplitude, int32; 0 to ticks/2.

    AUTD3 has ticks = 512 and amplitude = i/255 for an intensity byte i. Raises DeviceError like `duty_cycle`, and if
    ticks is odd or less than 2.
    """
    if ticks < 2 or ticks % 2:
        raise DeviceError(f"ticks = {ticks} is not even and at least 2: use for example {AUTD3_TICKS}")
    return np.rint(ticks * duty_cycle(amplitude, exponent)).astype(np.int32)


def edge_phase(duty: ArrayLike, fixed: Edge) -> Float:
    """Return the phase of the first harmonic [rad] (later is positive) relative to a pulse centred at time 0.

    With the leading edge at time 0 the middle of the pulse is pi d later; with the trailing edge, pi d earlier.
    So with a fixed edge, the phase of a drive changes with its amplitude.
    """
    return 2.0 * np.pi * EDGE_TURNS[fixed] * np.asarray(duty, float)
