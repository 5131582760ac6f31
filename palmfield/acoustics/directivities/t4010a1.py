"""Nippon Ceramic T4010A1 at 40 kHz, as measured."""

import numpy as np

from palmfield.acoustics.directivity import Measured
from palmfield.types import Float

T4010A1_DIRECTIVITY: Float = np.column_stack(
    [np.arange(0.0, 91.0, 10.0), [1.0, 1.0, 1.0, 0.891, 0.708, 0.501, 0.355, 0.251, 0.200, 0.178]]
)
"""Angle [deg] and relative amplitude, shape (10, 2).

0, 0, 0, -1, -3, -6, -9, -12, -14 and -15 dB from 0 to 90 deg: diagram of the manufacturer, as in the AUTD3 software.
"""

FORM = Measured("t4010a1", T4010A1_DIRECTIVITY)
