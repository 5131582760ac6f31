"""Spectrum of a scan over frequency and wavenumber along the surface."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal.windows import hann

from palmfield.errors import MeasurementError
from palmfield.instruments.scan import pitch
from palmfield.metrics.checks import even_step, trace
from palmfield.types import Float

DIRECTIONS = 48
WAVENUMBERS = 120
MOST_LINES = 240


class FrequencyWavenumber(NamedTuple):
    """Amplitude (rms over all directions), shape (f, k), over frequency [Hz], (f,), and wavenumber [rad/m], (k,)."""

    frequency_Hz: Float
    wavenumber_rad_m: Float
    amplitude: Float


def on_plane(points_m: ArrayLike) -> Float:
    """Project points to their best plane, relative to their centre [m], shape (n, 2)."""
    points = np.asarray(points_m, dtype=float)
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    return np.asarray(centred @ axes[:2].T)


def frequency_wavenumber(
    times_s: ArrayLike, values: ArrayLike, points_m: ArrayLike, *, most_Hz: float | None = None
) -> FrequencyWavenumber:
    """Return the spectrum of records, shape (t, n), at points, shape (n, 3), projected to a plane.

    most_Hz: highest frequency; None: the frequency below which 99.9 % of the power lies
    A Hann window is applied over time. The largest wavenumber is pi/pitch, where aliasing of a grid begins.
    """
    times, signal = trace(times_s, values, 16)
    if signal.ndim != 2 or np.shape(points_m) != (signal.shape[1], 3):
        raise MeasurementError(
            f"records have shape {signal.shape} and points {np.shape(points_m)}; give (t, n) and (n, 3)"
        )
    if not np.ptp(signal, axis=0).max() > 0.0:
        raise MeasurementError("the records are silent and have no spectrum")
    flat = on_plane(points_m)
    window = hann(len(times), sym=False)[:, None]
    spectrum = 2.0 * np.fft.rfft((signal - signal.mean(axis=0)) * window, axis=0) / window.sum()
    frequency = np.fft.rfftfreq(len(times), even_step(times))
    power = np.cumsum((np.abs(spectrum) ** 2).sum(axis=1))
    highest = most_Hz or frequency[int(np.searchsorted(power, 0.999 * power[-1]))] * 1.1
    chosen = np.flatnonzero((frequency > 0.0) & (frequency <= highest))
    if len(chosen) == 0:
        raise MeasurementError(f"the record has no line up to {highest:g} Hz; its lines are {frequency[1]:g} Hz apart")
    chosen = chosen[:: max(1, len(chosen) // MOST_LINES)]
    wavenumber = np.linspace(0.0, np.pi / pitch(points_m), WAVENUMBERS)
    angles = np.pi * np.arange(2 * DIRECTIONS) / DIRECTIONS
    total = np.zeros((len(chosen), WAVENUMBERS))
    for angle in angles:
        along = flat @ np.array([np.cos(angle), np.sin(angle)])
        waves = np.exp(-1j * np.outer(along, wavenumber)) / len(flat)
        total += np.abs(spectrum[chosen] @ waves) ** 2
    return FrequencyWavenumber(np.asarray(frequency[chosen], float), wavenumber, np.sqrt(total / len(angles)))
