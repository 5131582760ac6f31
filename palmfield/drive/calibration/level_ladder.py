"""Sound level as a function of drive level: exponent and saturation, from readings at rising levels."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics.calibration_file import Level
from palmfield.errors import PalmfieldError
from palmfield.types import Float

MISSING = 0.05
"""Missing share of the pressure above which the sound is no longer linear."""


def fit_level(levels: ArrayLike, pressures_Pa: ArrayLike) -> Level:
    """Fit p = p1 a^exponent to the readings below saturation, and find the level of saturation.

    The fit is in logarithms, over levels up to a limit. The limit is lowered from full drive until all readings above
    it are too low by more than MISSING. Forces are passed as their square roots.

    levels: levels of the drive, 0 < a <= 1, shape (n,), at least 5 different; pressures_Pa: amplitudes, shape (n,)
    Raises PalmfieldError for levels and readings out of these ranges, and if fewer than 4 levels are linear.
    """
    a, p = np.asarray(levels, float), np.asarray(pressures_Pa, float)
    if a.shape != p.shape or a.ndim != 1 or len(np.unique(a)) < 5:
        raise PalmfieldError(
            f"{len(np.unique(a))} different levels; needed: at least 5, better 10, with one reading each"
        )
    bad = ~((a > 0.0) & (a <= 1.0) & (p > 0.0) & np.isfinite(p))
    if bad.any():
        i = int(np.argmax(bad))
        raise PalmfieldError(
            f"reading {i}: level {a[i]:g}, {p[i]:g} Pa; give levels above 0 to 1 and pressures above 0"
        )
    steps = np.unique(a)
    for last in range(len(steps), 3, -1):
        chosen = a <= steps[last - 1]
        slope, error, offset = _line(np.log(a[chosen]), np.log(p[chosen]))
        losses = 1.0 - p / np.exp(offset + slope * np.log(a))
        # The mean at each level is tested, because single readings scatter
        missing = np.array([losses[a == step].mean() for step in steps])
        if np.all(missing[:last] <= MISSING) and np.all(missing[last:] > MISSING):
            return Level(exponent=slope, exponent_sd=error, linear_to=float(steps[last - 1]))
    raise PalmfieldError(
        f"below saturation the readings do not follow a power of the level within {100 * MISSING:g} %: check for "
        "clipping in the recorder and for other sound"
    )


def _line(x: Float, y: Float) -> tuple[float, float, float]:
    """Return the slope, its standard error, and offset of a straight line."""
    (slope, offset), covariance = np.polyfit(x, y, 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0])), float(offset)
