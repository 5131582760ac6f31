"""Numbers and colours in palmfield's MJCF files."""

from collections.abc import Sequence

import numpy as np

from palmfield.types import Float

SKIN_RGBA = "0.87 0.68 0.58 1"


def numbers_text(numbers: Float | Sequence[float], digits: int) -> str:
    """Return numbers as in MJCF, rounded to this number of decimals."""
    return " ".join(f"{number + 0.0:.{digits}g}" for number in np.round(numbers, digits))
