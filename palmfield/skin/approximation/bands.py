"""Shares of the energy of a load by frequency band, for approximations whose effect depends on frequency."""

import itertools
import math

import numpy as np

from palmfield.skin.materials.material import Material, shear_wave
from palmfield.skin.problem import Load, Spot, between, spread
from palmfield.types import Float

COUNT = 14
"""Number of bands above the lowest band, evenly spaced in log frequency."""

NEAR = np.linspace(0.85, 1.3, 10)
"""Edges of bands near a resonance, over its frequency; they are asymmetric because damping raises the frequency."""

HIGHEST_Hz = 4000.0
"""Frequency above which skin hardly moves [Hz]."""

SAMPLES = 1 << 15
"""Largest number of samples of the time course."""


def bands(load: Load, end_s: float, resonance_Hz: float) -> tuple[Float, Float]:
    """Return frequency [Hz] and energy of the course of a load up to end_s by band, both (b,), without empty bands.

    The course of a spot is its pressure at the middle of its path; the course of a traction is that of its strongest
    point. It is 0 before and after this time, so that jumps count. Near resonance_Hz the bands are narrower.
    """
    start = float(load.times_s[0])
    length = max(end_s - start, 1e-6)
    step = max(length / SAMPLES, min(length / 256.0, 0.125 / HIGHEST_Hz))
    count = max(2, math.ceil(length / step))
    times: Float = start + step * np.arange(count, dtype=np.float64)
    course = course_at(load, times)
    energy = np.abs(np.fft.rfft(np.concatenate([np.zeros(count), course]))) ** 2
    # Each frequency except the first also represents its negative
    energy[1:] *= 2.0
    rates = np.fft.rfftfreq(2 * count, step)
    low = 1.0 / length
    wide = np.geomspace(low, max(HIGHEST_Hz, 2.0 * low), COUNT + 1)
    edges = np.unique(np.concatenate([[0.0], wide, resonance_Hz * NEAR]))
    result = []
    for first, last in itertools.pairwise(edges):
        inside = (rates >= first) & (rates < last)
        total = float(energy[inside].sum())
        if total > 0.0:
            result.append((float(rates[inside] @ energy[inside]) / total, total))
    frequencies, energies = np.array(result).reshape(-1, 2).T
    # The lowest band contains a steady load, so its frequency is 0
    return np.where(frequencies < low, 0.0, frequencies), energies


def course_moves(load: Load, end_s: float) -> bool:
    """Return whether the pressure of `bands` is not 0 at some time up to end_s."""
    times = np.linspace(float(load.times_s[0]), max(end_s, float(load.times_s[0]) + 1e-6), 257)
    return bool(np.any(course_at(load, np.asarray(times, dtype=np.float64)) != 0.0))


def resonance(material: Material, depth_m: float) -> float:
    """Return the lowest frequency at which a bonded layer guides waves [Hz]: c_s / 4h, with c_s at this frequency."""
    frequency = 200.0
    for _ in range(20):
        frequency = shear_wave(material, frequency)[0] / (4.0 * depth_m)
    return frequency


def course_at(load: Load, times: Float) -> Float:
    """Return the pressure [Pa] at times, (t,), at the middle of the path of a spot or the strongest traction point."""
    if not isinstance(load, Spot):
        strongest = int(np.argmax(np.abs(load.pressure_Pa).max(axis=0)))
        return between(load, load.pressure_Pa[:, strongest], times)
    centres = load.centres()
    halfway = 0.5 * (load.times_s[0] + load.times_s[-1])
    away = between(load, centres, times) - [np.interp(halfway, load.times_s, column) for column in centres.T]
    return between(load, load.peak_Pa, times) * np.exp(-0.5 * (away**2).sum(axis=1) / spread(load.fwhm_m) ** 2)
