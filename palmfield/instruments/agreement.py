"""Agreement of a measured and a computed record at each point: gain, delay, difference, coherence."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import csd, detrend, welch

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import above_zero, even_step, finite, trace
from palmfield.types import Float

AMBIGUOUS = 0.98
"""Correlation at another delay, as a share of the best, from which the delay is ambiguous."""
SEGMENTS = 8
"""Number of half-overlapping Hann windows for a coherence; the coherence of noise is then about 1/5."""
FEWEST = 16
"""Smallest number of samples in a Hann window."""


class Agreement(NamedTuple):
    """Comparison of measured and computed records, each of shape (n,).

    gain: measured over computed amplitude, by least squares without delay, offset and drift; negative: inverted
    delay_s: delay of the measured record; ambiguous: whether another delay fits nearly as well
    l2: norm of measured - computed over norm of measured; l2_shape: l2 after removing gain, delay, offset and drift
    coherence: share of the measured power that is linear in the computed record, weighted by measured power
    offset: mean of the line fitted with gain and delay, in the unit of the records; drift: rise of the line
    level: rms of the measured record over that of the loudest point
    """

    gain: Float
    delay_s: Float
    ambiguous: Float
    l2: Float
    l2_shape: Float
    coherence: Float
    level: Float
    offset: Float
    drift: Float


def agreement(times_s: ArrayLike, measured: ArrayLike, computed: ArrayLike, *, most_delay_s: float) -> Agreement:
    """Compare two records of the same points at the same, evenly spaced times, both of shape (t, n).

    most_delay_s: largest absolute delay in the search [s]
    Raises MeasurementError for other shapes, records too short for a coherence, and points without motion.
    """
    times, theirs = trace(times_s, measured, 2 * FEWEST)
    ours = np.asarray(computed, dtype=float)
    above_zero("most_delay_s", most_delay_s)
    if theirs.ndim != 2 or ours.shape != theirs.shape:
        raise MeasurementError(f"records have shapes {theirs.shape} and {ours.shape}; give two of (t, n)")
    finite("the computed record", ours)
    for name, record in (("measured", theirs), ("computed", ours)):
        still = np.flatnonzero(~(np.abs(record).max(axis=0) > 0.0))
        if len(still):
            raise MeasurementError(f"the {name} record of point {still[0]} is 0 throughout: remove the point")
    step = even_step(times)
    delay, ambiguous = delays(_without_line(theirs), _without_line(ours), step, most_delay_s)
    late = shifted(ours, step, delay)
    # Joint least squares of gain, offset and drift gives the gain of records without their lines (Frisch and Waugh)
    bare, moving = _without_line(theirs), _without_line(late)
    gain = (moving * bare).sum(axis=0) / np.maximum((moving * moving).sum(axis=0), np.finfo(float).tiny)
    line = theirs - gain * late - (bare - gain * moving)
    size = np.linalg.norm(theirs, axis=0)
    return Agreement(
        gain, delay, ambiguous, np.linalg.norm(theirs - ours, axis=0) / size,
        np.linalg.norm(bare - gain * moving, axis=0) / size, coherence(theirs, ours, 1.0 / step), size / size.max(),
        line.mean(axis=0), line[-1] - line[0],
    )  # fmt: skip


def _without_line(record: Float) -> Float:
    """Return records, shape (t, n), without their best-fit straight lines."""
    return np.asarray(detrend(record, axis=0))


def delays(measured: Float, computed: Float, step: float, most_s: float) -> tuple[Float, Float]:
    """Return the delay of the largest absolute correlation [s], by a parabola, and whether it is ambiguous."""
    length = next_fast_len(2 * len(measured))
    product = rfft(measured, length, axis=0) * rfft(computed, length, axis=0).conj()
    reach = min(math.ceil(most_s / step), len(measured) - 2)
    lags = np.arange(-reach, reach + 1)
    correlation = irfft(product, length, axis=0)[lags]
    size = np.abs(correlation)
    best = size.argmax(axis=0)
    inner = np.clip(best, 1, len(lags) - 2)
    rows = np.arange(size.shape[1])
    left, top, right = (size[inner + n, rows] for n in (-1, 0, 1))
    bend = left - 2.0 * top + right
    part = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, 1.0), 0.0)
    delay = (lags[inner] + np.clip(part, -0.5, 0.5)) * step
    peaks = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:]) & (np.sign(correlation[1:-1]) == np.sign(
        correlation[inner, rows]))  # fmt: skip
    others = np.where(peaks & (np.abs(np.arange(1, len(lags) - 1)[:, None] - inner) > 1), size[1:-1], 0.0)
    return delay, np.asarray(others.max(axis=0, initial=0.0) > AMBIGUOUS * top)


def shifted(record: Float, step: float, delay_s: Float) -> Float:
    """Delay a record, shape (n,), by any time, with its spectrum; values that enter at the ends are 0."""
    length = next_fast_len(2 * len(record))
    turn = np.exp(-2j * np.pi * rfftfreq(length, step)[:, None] * delay_s)
    return np.asarray(irfft(rfft(record, length, axis=0) * turn, length, axis=0)[: len(record)])


def coherence(measured: Float, computed: Float, rate_Hz: float) -> Float:
    """Return the mean magnitude-squared coherence, weighted by the measured power, shape (n,).

    Welch's method with SEGMENTS half-overlapping Hann windows. Raises MeasurementError for records that are too short.
    """
    window = 2 * len(measured) // (SEGMENTS + 1)
    if window < FEWEST:
        raise MeasurementError(
            f"records of {len(measured)} samples are too short for a coherence of {SEGMENTS} windows; give "
            f"{FEWEST * (SEGMENTS + 1) // 2} or more"
        )
    options = {"fs": rate_Hz, "nperseg": window, "noverlap": window // 2, "axis": 0}
    own, other = welch(measured, **options)[1], welch(computed, **options)[1]
    both = np.abs(csd(measured, computed, **options)[1]) ** 2
    linear = np.divide(both, other, out=np.zeros_like(both), where=other > 1e-12 * other.max(axis=0))
    return np.asarray(linear.sum(axis=0) / own.sum(axis=0))
