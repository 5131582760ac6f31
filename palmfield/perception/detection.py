"""Probability of detection from a level above threshold, and the effect of a time course on the level.

p = g + (1 - g - l) (1 - exp(-ln 2 E^b)), with E the level as a ratio. At threshold, E = 1, and p is 1/2 for g = l = 0.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from palmfield.errors import OutputError
from palmfield.perception.psychometric import PsychometricFunction
from palmfield.types import Float

SLOPE = 2.0
"""Default exponent b: E^b is then the energy that `levels_dB_SL` sums."""


def detection_probability(
    level_dB_SL: ArrayLike, *, slope: float = SLOPE, guess: float = 0.0, lapse: float = 0.0
) -> Float:
    """Return the probability of detection, or of a right answer, in the shape of level_dB_SL [dB]; -inf is silence.

    slope: exponent b; lapse: rate l; guess: rate g of right guesses, 0 for the method of limits, 1/n for n alternatives
    Raises OutputError for a slope that is not above 0, and for invalid rates.
    """
    if not slope > 0.0:
        raise OutputError(f"slope {slope:g}; allowed: above 0")
    ratio = 10.0 ** (np.asarray(level_dB_SL, dtype=np.float64) / 20.0)
    return PsychometricFunction("weibull", 1.0, 1.0 / slope, guess, lapse)(ratio)


def summed_gain(envelope: ArrayLike, step_s: float, tau_s: float) -> float:
    """Return the gain of an enveloped vibration for a leaky energy integrator, relative to steady amplitude 1.

    The gain is sqrt(max y) of tau y' = envelope^2 - y from y = 0; levels change by 20 log10 of it. For a burst of
    length T it is sqrt(1 - exp(-T/tau)).

    envelope: amplitude, constant over each step_s [s], shape (n,); tau_s: `TemporalSummation.tau_s` [s]
    Source: J. J. Zwislocki, J. Acoust. Soc. Am. 32 (1960) 1046.
    Raises OutputError for a step or time constant that is not above 0, and for an envelope that is empty or not finite.
    """
    power = np.asarray(envelope, dtype=np.float64) ** 2
    if power.ndim != 1 or len(power) == 0 or not np.isfinite(power).all():
        raise OutputError(f"the envelope has shape {power.shape}; give finite numbers of shape (n,), one or more")
    if not (tau_s > 0.0 and step_s > 0.0):
        raise OutputError(f"step_s {step_s:g}, tau_s {tau_s:g}; allowed: above 0")
    decay = float(np.exp(-step_s / tau_s))
    return float(np.sqrt(lfilter([1.0 - decay], [1.0, -decay], power).max()))
