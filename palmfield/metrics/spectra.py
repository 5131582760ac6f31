"""Amplitude spectra of a signal, their peaks, harmonics and centroid."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import above_zero, even_step, trace, whole
from palmfield.types import Float

PROMINENCE_DB = 10.0
FLOOR_DB = 50.0


Taper = Literal["hann", "none"]


def amplitude_spectrum(time_s: ArrayLike, signal: ArrayLike, *, taper: Taper = "hann") -> tuple[Float, Float]:
    """Return the single-sided amplitude spectrum without DC.

    time_s: evenly spaced times [s], shape (n,), n >= 8; signal: shape (n,)
    taper: "hann" or "none"; with "none", a record without whole periods has spectral leakage
    Returns frequencies [Hz] without 0 and amplitudes in the unit of the signal, both of shape (n // 2,). A sine of
    amplitude A at the frequency of a bin gives A in this bin. The weighted mean is subtracted first, so that the
    window does not spread DC into the lowest bins.
    Raises MeasurementError for fewer than 8 samples, times that are not evenly spaced, and another taper.
    """
    if len(np.atleast_1d(time_s)) < 8:
        raise MeasurementError(
            f"a spectrum of {np.size(time_s)} samples is not meaningful; needed: at least 8: run for longer"
        )
    times, values = trace(time_s, signal, 8, single=True)
    step = even_step(times)
    if taper not in ("hann", "none"):
        raise MeasurementError(f"taper is '{taper}'; use hann or none")
    # scipy.signal would take half a second to load
    turn = np.linspace(-np.pi, np.pi, len(values) + 1)[:-1]
    window = 0.5 + 0.5 * np.cos(turn) if taper == "hann" else np.ones(len(values))
    centred = values - np.average(values, weights=window)
    amplitude = 2.0 * np.abs(np.fft.rfft(centred * window)) / window.sum()
    if len(values) % 2 == 0:
        amplitude[-1] /= 2.0
    return np.asarray(np.fft.rfftfreq(len(values), step)[1:], dtype=float), np.asarray(amplitude[1:], dtype=float)


def harmonics(time_s: ArrayLike, signal: ArrayLike, fundamental_Hz: float, count: int = 4) -> Float:
    """Return the amplitudes of the lines at 1, 2, ... count times a frequency, in the unit of the signal, shape
    (count,).

    The lines and a constant are fitted by least squares, so the record may have any length and uneven times.
    Raises MeasurementError for a record shorter than a period, and for lines above half the sampling rate.
    """
    above_zero("fundamental_Hz", fundamental_Hz)
    count = whole("count", count, 1, 10_000)
    times, values = trace(time_s, signal, 2 * count + 1, single=True)
    step = float(np.median(np.diff(times)))
    if times[-1] - times[0] + step < (1.0 - 1e-6) / fundamental_Hz:
        raise MeasurementError(
            f"a record of {times[-1] - times[0]:g} s is shorter than one period of {fundamental_Hz:g} Hz: record "
            "for longer"
        )
    if count * fundamental_Hz * step >= 0.5:
        raise MeasurementError(
            f"{count} lines of {fundamental_Hz:g} Hz end at {count * fundamental_Hz:g} Hz; give 1 or more, below half "
            f"the sampling rate, {0.5 / step:g} Hz"
        )
    angle = 2.0 * np.pi * fundamental_Hz * np.outer(times - times[0], np.arange(1, count + 1))
    columns = np.hstack([np.ones((len(times), 1)), np.cos(angle), np.sin(angle)])
    fitted = np.linalg.lstsq(columns, values, rcond=None)[0]
    return np.asarray(np.hypot(fitted[1 : count + 1], fitted[count + 1 :]))


def strongest_line(
    time_s: ArrayLike, signal: ArrayLike, band_Hz: tuple[float, float], *, taper: Taper = "none"
) -> tuple[float, float]:
    """Return frequency [Hz] and amplitude of the largest bin of `amplitude_spectrum` in a band.

    time_s, signal, taper: as for `amplitude_spectrum`; band_Hz: (lowest, highest) [Hz], both included
    Raises MeasurementError like `amplitude_spectrum`, and if no bin is in the band.
    """
    frequency, amplitude = amplitude_spectrum(time_s, signal, taper=taper)
    chosen = _in_band(frequency, band_Hz)
    best = int(np.argmax(np.where(chosen, amplitude, -1.0)))
    return float(frequency[best]), float(amplitude[best])


def spectral_centroid(
    time_s: ArrayLike, signal: ArrayLike, band_Hz: tuple[float, float], *, taper: Taper = "none"
) -> float:
    """Return the mean frequency in a band, weighted by the square of `amplitude_spectrum` [Hz]; NaN for silence.

    Arguments and errors are those of `strongest_line`.
    """
    frequency, amplitude = amplitude_spectrum(time_s, signal, taper=taper)
    chosen = _in_band(frequency, band_Hz)
    power = amplitude[chosen] ** 2
    return float((frequency[chosen] * power).sum() / power.sum()) if power.sum() > 0.0 else float("nan")


def _in_band(frequency: Float, band_Hz: tuple[float, float]) -> np.ndarray:
    chosen = (frequency >= band_Hz[0]) & (frequency <= band_Hz[1])
    if not chosen.any():
        raise MeasurementError(
            f"the record has no line between {band_Hz[0]:g} and {band_Hz[1]:g} Hz; its lines are at "
            f"{frequency[0]:g} to {frequency[-1]:g} Hz"
        )
    return np.asarray(chosen)


def spectral_peaks(frequency_Hz: Float, amplitude: Float, most: int = 4) -> list[tuple[float, float]]:
    """Return the `most` largest peaks as (frequency [Hz], amplitude), largest first.

    Peaks are at least 10 dB above their surroundings and within 50 dB of the largest. A drift of the signal raises the
    first bins; it does not count as a peak. Peaks are interpolated from the ratio of the two highest bins of a Hann
    window (Grandke 1983, IEEE Trans. Instrum. Meas. 32, 350); error for a single sine of five periods: 0.01 bins and
    0.1 %.
    """
    frequency_Hz, amplitude = trace(frequency_Hz, amplitude, 3, single=True)
    most, top = whole("most", most, 1, len(amplitude)), float(amplitude.max())
    if top <= 0.0:
        return []
    level = 20.0 * np.log10(np.maximum(amplitude, 1e-12 * top) / top)
    numbers = [k for k in _maxima(level) if level[k] >= -FLOOR_DB and _prominence(level, k) >= PROMINENCE_DB]
    spacing = frequency_Hz[1] - frequency_Hz[0]
    peaks = []
    for k in sorted(numbers, key=lambda k: -amplitude[k])[:most]:
        side = 1 if amplitude[k + 1] >= amplitude[k - 1] else -1
        ratio = amplitude[k + side] / amplitude[k]
        shift = (2.0 * ratio - 1.0) / (1.0 + ratio)
        height = amplitude[k] * (1.0 - shift**2) / np.sinc(shift)
        peaks.append((float(frequency_Hz[k] + side * shift * spacing), float(height)))
    return peaks


def _maxima(level: Float) -> list[int]:
    """Return the places of local maxima. A plateau of equal values has its maximum in the middle."""
    ends = np.append(np.flatnonzero(np.diff(level)), len(level) - 1)
    starts = np.append(0, ends[:-1] + 1)
    heights = level[starts]
    higher = np.flatnonzero((heights[1:-1] > heights[:-2]) & (heights[1:-1] > heights[2:])) + 1
    return ((starts[higher] + ends[higher]) // 2).tolist()


def _prominence(level: Float, peak: int) -> float:
    """Return the height of a peak above the higher of two levels, one on each side.

    The level of a side is the lowest level between the peak and the next higher value, or the end.
    """
    lowest = []
    for side in (level[peak::-1], level[peak:]):
        above = np.flatnonzero(side > level[peak])
        lowest.append(side[: above[0] if len(above) else None].min())
    return float(level[peak] - max(lowest))
