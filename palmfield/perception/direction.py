"""Direction of the motion of a stimulus over the skin: an observer that compares the likelihoods of both directions.

The inputs are the motions of the skin under the forward and the reversed stimulus. The motion at each point is weighted
by a threshold table, and its level is followed over time. Noise is added that is independent between points and
moments. The noise is the only free parameter: fit it to a measured accuracy (`noise_for`) and then keep it constant.

from palmfield.perception import OBSERVERS, direction_share, level_course, separation
level = level_course(times, displacement, OBSERVERS["afferent_human"], integration_s=0.2)
print(direction_share(separation(level, level[:, ::-1], step_s, step_m), noise))
"""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.special import ndtr

from palmfield.errors import OutputError
from palmfield.perception.observers import Observer, threshold_m
from palmfield.types import Float

PADDED = 2
"""Length of the zero-padded record over that of the record; padding prevents wrap-around in the weighted spectrum."""


def weighted(times_s: ArrayLike, displacement_m: ArrayLike, observer: Observer) -> Float:
    """Return displacement divided by the threshold at each frequency, shape (t, n); zero outside the table of the
    observer.

    times_s: evenly spaced [s], shape (t,); displacement_m: normal displacement of n points [m], shape (t, n)
    A sine at a frequency of the table is returned in units of its threshold, which is a peak amplitude.
    Raises OutputError for other shapes, infinity, and times that are not evenly spaced.
    """
    times, motion = np.asarray(times_s, dtype=float), np.asarray(displacement_m, dtype=float)
    if motion.ndim != 2 or times.shape != motion.shape[:1] or len(times) < 2:
        raise OutputError(f"times have shape {times.shape} and displacements {motion.shape}; give (t,) and (t, n)")
    if np.isinf(motion).any():
        raise OutputError(f"displacement {motion[np.isinf(motion)][0]} m is infinite; give finite displacements")
    steps = np.diff(times)
    if not steps.min() > 0.0 or np.ptp(steps) > 1e-3 * steps.mean():
        raise OutputError(
            f"the steps of the times vary from {steps.min():g} to {steps.max():g} s; give evenly spaced times"
        )
    count = PADDED * len(times)
    frequency = np.fft.rfftfreq(count, float(steps.mean()))
    threshold = threshold_m(observer, np.maximum(frequency, 1e-9))
    sensitivity = np.where(np.isfinite(threshold), 1.0 / np.where(np.isfinite(threshold), threshold, 1.0), 0.0)
    spectrum = np.fft.rfft(motion, count, axis=0) * sensitivity[:, None]
    return np.asarray(np.fft.irfft(spectrum, count, axis=0)[: len(times)])


def level_course(
    times_s: ArrayLike, displacement_m: ArrayLike, observer: Observer, *, integration_s: float = 0.0
) -> Float:
    """Return the perceived level of each point over time, in units of threshold, shape (t, n).

    The level is the running root mean square of `weighted` with exponential time constant integration_s [s], or its
    magnitude for 0. Raises OutputError like `weighted`, and for a time below 0.
    """
    if not (math.isfinite(integration_s) and integration_s >= 0.0):
        raise OutputError(f"integration_s is {integration_s}; give seconds, 0 or more")
    motion = weighted(times_s, displacement_m, observer)
    if integration_s == 0.0:
        return np.abs(motion)
    decay = math.exp(-float(np.mean(np.diff(np.asarray(times_s, dtype=float)))) / integration_s)
    return np.asarray(np.sqrt(np.maximum(lfilter([1.0 - decay], [1.0, -decay], motion**2, axis=0), 0.0)))


def separation(forward: ArrayLike, reversed_: ArrayLike, step_s: float, step_m: float) -> float:
    """Return the distance between the level courses of both directions, in their unit times (s m)^1/2: the root of the
    integral over time and path of their squared difference.

    forward, reversed_: courses of `level_course`, shape (t, n); step_s, step_m: steps of time and path, above 0
    Raises OutputError for other shapes and steps.
    """
    one, other = np.asarray(forward, dtype=float), np.asarray(reversed_, dtype=float)
    if one.shape != other.shape or not (step_s > 0.0 and step_m > 0.0):
        raise OutputError(
            f"courses have shapes {one.shape} and {other.shape}, steps {step_s:g} s and {step_m:g} m; give equal "
            "shapes and steps above 0"
        )
    return math.sqrt(float(((one - other) ** 2).sum()) * step_s * step_m)


def direction_share(apart: float, noise: float) -> float:
    """Return the expected share of right answers for two equally frequent directions, 0.5 to 1.

    apart: result of `separation`, at least 0; noise: spectral density in the same unit, above 0, else OutputError
    The share is Phi(apart / (2 noise)), by the likelihood ratio of two courses in white noise.
    """
    if not (noise > 0.0 and apart >= 0.0):
        raise OutputError(f"noise is {noise:g} and the separation {apart:g}; allowed: noise > 0, separation >= 0")
    return float(ndtr(0.5 * apart / noise))


def noise_for(separations: ArrayLike, share: float) -> float:
    """Return the noise at which the mean share of right answers over several stimuli is `share`.

    separations: results of `separation`, above 0, shape (k,); share: above 0.5 and below 1; else OutputError
    """
    sizes = np.asarray(separations, dtype=float)
    if sizes.ndim != 1 or len(sizes) == 0 or not (sizes.min() > 0.0 and sizes.max() < np.inf) or not 0.5 < share < 1.0:
        raise OutputError(f"separations {sizes.tolist()}, share {share:g}; allowed: above 0, and between 0.5 and 1")

    def missing(logarithm: float) -> float:
        return float(ndtr(0.5 * sizes / math.exp(logarithm)).mean()) - share

    return math.exp(brentq(missing, math.log(sizes.min()) - 20.0, math.log(sizes.max()) + 20.0, xtol=1e-12))
