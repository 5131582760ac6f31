"""Electronics of an instrument: filters, integration, sampling, noise.

Signals are float64, shape (t, ...), evenly sampled, with time along the first axis. All functions raise
MeasurementError for other shapes, NaN, and rates and frequencies that are not above 0.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt, sosfiltfilt

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import above_zero, even_step, finite, trace, whole
from palmfield.types import Float

Phase = Literal["causal", "zero_phase"]
ORDERS = (1, 12)
ANTI_ALIAS_ORDER = 8
ANTI_ALIAS_SHARE = 0.4
"""Cutoff of the zero-phase Butterworth low-pass before sampling at a lower rate, as a share of that rate."""


def highpass(signal: ArrayLike, rate_Hz: float, cutoff_Hz: float, order: int, *, phase: Phase = "causal") -> Float:
    """Apply a Butterworth high-pass of `order`, -3 dB at cutoff_Hz, to a signal that is at rest before it begins.

    phase: "causal", applied forward once, as in a device; "zero_phase", forward and backward (SciPy's `sosfiltfilt`):
        without delay, with squared magnitude (-6 dB at cutoff_Hz), and not causal
    """
    return _butterworth(signal, rate_Hz, cutoff_Hz, order, phase, "highpass")


def lowpass(signal: ArrayLike, rate_Hz: float, cutoff_Hz: float, order: int, *, phase: Phase = "causal") -> Float:
    """Apply a Butterworth low-pass; arguments as for `highpass`."""
    return _butterworth(signal, rate_Hz, cutoff_Hz, order, phase, "lowpass")


def _butterworth(signal: ArrayLike, rate_Hz: float, cutoff_Hz: float, order: int, phase: str, kind: str) -> Float:
    values = _samples(signal)
    above_zero("rate_Hz", rate_Hz)
    above_zero("cutoff_Hz", cutoff_Hz)
    if cutoff_Hz >= 0.5 * rate_Hz:
        raise MeasurementError(f"cutoff_Hz is {cutoff_Hz:g}; allowed: below half the rate, {0.5 * rate_Hz:g} Hz")
    order = whole("order of a filter", order, *ORDERS)
    # Second-order sections, because polynomial coefficients lose all digits at 50 Hz and a rate of 128 kHz
    sections = butter(order, cutoff_Hz, kind, fs=rate_Hz, output="sos")
    if phase == "causal":
        return np.asarray(sosfilt(sections, values, axis=0))
    if phase != "zero_phase":
        raise MeasurementError(f"phase is '{phase}'; use causal or zero_phase")
    padded = min(len(values) - 1, math.ceil(3.0 * rate_Hz / cutoff_Hz))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padtype="constant", padlen=padded))


def _samples(signal: ArrayLike) -> Float:
    values = np.atleast_1d(np.asarray(signal, dtype=float))
    finite("the signal", values)
    if values.size == 0:
        raise MeasurementError(f"the signal has shape {values.shape}; give one sample or more")
    return values


def integrated(signal: ArrayLike, rate_Hz: float) -> Float:
    """Integrate over time by trapezoids, from 0 at the first sample."""
    values = _samples(signal)
    above_zero("rate_Hz", rate_Hz)
    return np.asarray(cumulative_trapezoid(values, dx=1.0 / rate_Hz, axis=0, initial=0.0))


def sampled(times_s: ArrayLike, signal: ArrayLike, at_s: ArrayLike) -> Float:
    """Sample a signal at other, evenly spaced times, shape (len(at_s), ...), by a cubic spline.

    If the rate of the signal is higher than the rate of `at_s`, a filter first avoids aliasing: a zero-phase
    Butterworth low-pass of order 8 at 0.4 of the new rate. Before its first time the signal has its first value.
    Raises MeasurementError for times after the last one.
    """
    times, values = trace(times_s, signal, 4)
    at, _ = trace(at_s, at_s, single=True)
    step = even_step(at)
    if at[-1] > times[-1] + 1e-6 * step:
        raise MeasurementError(
            f"the record ends at {at[-1]:g} s, but the motion ends at {times[-1]:g} s; simulate for longer, or "
            "record for a shorter time"
        )
    fine = float(np.median(np.diff(times)))
    if fine < 0.999 * step:
        even_step(times)
        band = ANTI_ALIAS_SHARE / step
        values = lowpass(values, 1.0 / fine, band, ANTI_ALIAS_ORDER, phase="zero_phase")
    return np.asarray(CubicSpline(times, values, axis=0)(np.clip(at, times[0], times[-1])))
