"""Decrease of the sound level while transducers and driver warm up."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import curve_fit

from palmfield.acoustics.calibration_file import WarmUp
from palmfield.errors import PalmfieldError


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
