"""Direction of the motion of a stimulus over the skin: an observer that compares the likelihoods of both directions.

It is given the motion of the skin under the forward and the reversed stimulus, weights the motion at each place by a
threshold table, follows its level over time, and adds noise that is independent between places and moments. Noise is
its only free number: fit it for a measured accuracy (`noise_for`) and then keep it.

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
"""Length of the record after zero padding, in its own lengths, before its spectrum is weighted, so that its end does
not wrap to its beginning."""


def weighted(times_s: ArrayLike, displacement_m: ArrayLike, observer: Observer) -> Float:
    """Displacement over the threshold of each of its frequencies, shape (t, n); zero outside the observer's table.

    times_s: even [s], shape (t,); displacement_m: of n places along the normal [m], shape (t, n)
    Of a sine at one of the table's frequencies it is the sine in units of its threshold, which is a peak amplitude.
    Raises OutputError for other shapes, infinity, and times that are not even.
    """
    times, motion = np.asarray(times_s, dtype=float), np.asarray(displacement_m, dtype=float)
    if motion.ndim != 2 or times.shape != motion.shape[:1] or len(times) < 2:
        raise OutputError(f"times have shape {times.shape} and displacements {motion.shape}; give (t,) and (t, n)")
    if np.isinf(motion).any():
        raise OutputError(f"displacement {motion[np.isinf(motion)][0]} m is infinite; give finite ones")
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
    """Perceived level of each place over time, in units of threshold, shape (t, n).

    The root of the running mean of the square of `weighted`, with a memory that fades by e in integration_s [s]; at 0
    the magnitude itself. Raises OutputError as `weighted`, and for a time below 0.
    """
    if not (math.isfinite(integration_s) and integration_s >= 0.0):
        raise OutputError(f"integration_s is {integration_s}; give seconds, 0 or more")
    felt = weighted(times_s, displacement_m, observer)
    if integration_s == 0.0:
        return np.abs(felt)
    kept = math.exp(-float(np.mean(np.diff(np.asarray(times_s, dtype=float)))) / integration_s)
    return np.asarray(np.sqrt(np.maximum(lfilter([1.0 - kept], [1.0, -kept], felt**2, axis=0), 0.0)))


def separation(forward: ArrayLike, reversed_: ArrayLike, step_s: float, step_m: float) -> float:
    """Distance between the courses of both directions: the root of the integral over time and path of their squared
    difference, in the courses' unit times (s m)^1/2.

    forward, reversed_: courses, shape (t, n); step_s, step_m: between their samples. Raises OutputError for others.
    """
    one, other = np.asarray(forward, dtype=float), np.asarray(reversed_, dtype=float)
    if one.shape != other.shape or not (step_s > 0.0 and step_m > 0.0):
        raise OutputError(
            f"courses have shapes {one.shape} and {other.shape}, steps {step_s:g} s and {step_m:g} m; give equal "
            "shapes and steps above 0"
        )
    return math.sqrt(float(((one - other) ** 2).sum()) * step_s * step_m)


def direction_share(apart: float, noise: float) -> float:
    """Expected share of right answers between two directions that are equally frequent, 0.5 to 1.

    apart: as of `separation`; noise: spectral density of the noise in the same unit, above 0
    The likelihood ratio of two given courses in white noise: Phi(apart / (2 noise)). Raises OutputError for others.
    """
    if not (noise > 0.0 and apart >= 0.0):
        raise OutputError(f"noise is {noise:g} and the separation {apart:g}; give noise above 0 and 0 or more")
    return float(ndtr(0.5 * apart / noise))


def noise_for(separations: ArrayLike, share: float) -> float:
    """The noise at which the mean share of right answers over several stimuli is `share`, in the separations' unit.

    separations: above 0, shape (k,); share: above 0.5 and below 1. Raises OutputError for others.
    """
    apart = np.asarray(separations, dtype=float)
    if apart.ndim != 1 or len(apart) == 0 or not (apart.min() > 0.0 and apart.max() < np.inf) or not 0.5 < share < 1.0:
        raise OutputError(f"separations {apart.tolist()}, share {share:g}; give some above 0 and a share of 0.5 to 1")

    def missing(logarithm: float) -> float:
        return float(ndtr(0.5 * apart / math.exp(logarithm)).mean()) - share

    return math.exp(brentq(missing, math.log(apart.min()) - 20.0, math.log(apart.max()) + 20.0, xtol=1e-12))
