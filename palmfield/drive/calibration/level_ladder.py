"""Sound level as a function of drive level, with exponent and saturation, and as a function of time during warm-up."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import curve_fit

from palmfield.acoustics.calibration_file import Level, WarmUp
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


def fit_warm_up(times_s: ArrayLike, pressures_Pa: ArrayLike) -> WarmUp:
    """Fit p = p1 (1 + drop exp(-t/time_s)) by least squares.

    times_s: since the array was switched on, shape (n,), at least 6; pressures_Pa: amplitudes, shape (n,)
    Raises PalmfieldError for fewer readings, numbers out of range, and if the readings do not determine the time
    constant.
    """
    t, p = np.asarray(times_s, float), np.asarray(pressures_Pa, float)
    if t.shape != p.shape or t.ndim != 1 or len(t) < 6:
        raise PalmfieldError(f"{t.size} times and {p.size} readings; needed: at least 6 of each")
    if not (np.isfinite(t).all() and np.all(np.isfinite(p) & (p > 0.0)) and t.min() >= 0.0 and np.ptp(t) > 0.0):
        raise PalmfieldError("times_s must be 0 or more and differ, pressures_Pa above 0, all finite")
    end, span = float(p[np.argmax(t)]), float(np.ptp(t))

    def course(time: np.ndarray, last: float, drop: float, rate: float) -> np.ndarray:
        return np.asarray(last * (1.0 + drop * np.exp(-time * np.exp(rate))))

    try:
        values, covariance = curve_fit(
            course, t, p, [end, p[np.argmin(t)] / end - 1.0, np.log(3.0 / span)], maxfev=10_000
        )
    except RuntimeError:
        raise PalmfieldError(
            "the readings do not fit an exponential approach to a constant level: record until the level is constant"
        ) from None
    time_s = float(np.exp(-values[2]))
    if not (np.isfinite(covariance).all() and time_s < span):
        raise PalmfieldError(f"the level still changes after {span:g} s, or does not change at all: record for longer")
    return WarmUp(drop=float(values[1]), drop_sd=float(np.sqrt(covariance[1, 1])), time_s=time_s)
