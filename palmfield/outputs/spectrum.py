"""Amplitude spectra of displacement."""

import numpy as np
from scipy.signal import find_peaks
from scipy.signal.windows import hann

from palmfield.errors import OutputError
from palmfield.types import Float

PROMINENCE_DB = 10.0
FLOOR_DB = 50.0


def amplitude_spectrum(time_s: Float, signal: Float) -> tuple[Float, Float]:
    """Single-sided amplitude spectrum, Hann window, DC excluded.

    time_s: evenly spaced [s], shape (n,), n >= 8; signal: shape (n,)
    Returns frequencies [Hz] without 0 and amplitudes in the signal's unit, both shape (n // 2,): a sine of amplitude A
    whose frequency falls on a bin gives A there. The weighted mean is taken off first, so that the window spreads no
    DC into the lowest bins.
    Raises OutputError for fewer than 8 samples and for times that are not evenly spaced.
    """
    if len(time_s) < 8:
        raise OutputError(f"a spectrum of {len(time_s)} samples says nothing; at least 8 are needed: run for longer")
    steps = np.diff(time_s)
    step = (time_s[-1] - time_s[0]) / len(steps)
    if step <= 0 or np.abs(steps - step).max() > 1e-3 * step:
        raise OutputError(
            f"times are not evenly spaced (steps {steps.min():.3g} to {steps.max():.3g} s); take a stretch without gaps"
        )
    window = hann(len(signal), sym=False)
    centred = signal - np.average(signal, weights=window)
    amplitude = 2.0 * np.abs(np.fft.rfft(centred * window)) / window.sum()
    if len(signal) % 2 == 0:
        amplitude[-1] /= 2.0
    return np.fft.rfftfreq(len(signal), step)[1:], amplitude[1:]


def spectral_peaks(frequency_Hz: Float, amplitude: Float, most: int = 4) -> list[tuple[float, float]]:
    """Peaks at least 10 dB above what surrounds them and within 50 dB of the largest, largest first; a drift
    that rises towards the first bin is none.

    Each is (frequency [Hz], amplitude) between the bins, from the ratio of the two highest bins of a Hann window
    (Grandke 1983, IEEE Trans. Instrum. Meas. 32, 350): within 0.01 bins and 0.1 % for a lone sine of five periods.
    """
    top = float(amplitude.max(initial=0.0))
    if top == 0.0:
        return []
    level = 20.0 * np.log10(np.maximum(amplitude, 1e-12 * top) / top)
    numbers, _ = find_peaks(level, height=-FLOOR_DB, prominence=PROMINENCE_DB)
    spacing = frequency_Hz[1] - frequency_Hz[0]
    peaks = []
    for k in sorted(numbers, key=lambda k: -amplitude[k])[:most]:
        side = 1 if amplitude[k + 1] >= amplitude[k - 1] else -1
        ratio = amplitude[k + side] / amplitude[k]
        shift = (2.0 * ratio - 1.0) / (1.0 + ratio)
        height = amplitude[k] * (1.0 - shift**2) / np.sinc(shift)
        peaks.append((float(frequency_Hz[k] + side * shift * spacing), float(height)))
    return peaks
