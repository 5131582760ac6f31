"""Numbers of a pass, measured or computed, from the normal velocity at scattered places.

All numbers are ratios, lengths, speeds and frequencies, so the pressure of the focus cancels. Measured and computed
velocities pass through the same functions at the same places and times.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palmfield.metrics import wake_length
from palmfield.types import Float

BAND_Hz = (20.0, 1000.0)
OCTAVES_Hz = (31.25, 62.5, 125.0, 250.0, 500.0, 1000.0)
STEP_s = 4e-4
SILENCE_s = 0.04
"""Time after the end of the path that is evaluated [s]."""
RINGS_m = (0.0, 0.01, 0.02, 0.04, 0.06)
"""Limits of the distances from the strip of the path. Energies are relative to that in the strip."""
LEAST_PLACES = 3
BIN_m = 5e-3
SHARE, THRESHOLD, LATERAL_m = 0.875, 0.1, 0.1
"""Wake: fraction of the path at the snapshot, fraction of the largest amplitude, and width about the path."""
MIDDLE = 0.35
"""Places up to this distance from the middle of the path, relative to its length, are used for the outward speed."""
WAKE, SPEED = "wake length [cm]", "outward speed [m/s]"
CENTROID, WIDTH = "centroid of the spectrum [Hz]", "width of the spectrum [Hz]"


@dataclass(frozen=True)
class Pass:
    """One pass of the focus.

    along_m_s: speed along the path
    length_m, width_m, across_m_s: length, width and speed across of the zigzag (width 0: straight path)
    places_m: in the frame of the path, x along it, origin in its middle, shape (n, 2)
    """

    along_m_s: float
    length_m: float
    width_m: float
    across_m_s: float
    places_m: Float

    @property
    def end_s(self) -> float:
        return self.length_m / self.along_m_s

    @property
    def times_s(self) -> Float:
        """Times of all evaluations, from the start of the stimulus, shape (t,)."""
        return np.asarray(STEP_s * np.arange(1, math.ceil((self.end_s + SILENCE_s) / STEP_s) + 1), dtype=float)

    @property
    def off_m(self) -> Float:
        """Distance of the places from the strip of the path [m], 0 inside, shape (n,)."""
        half = 0.5 * np.array([self.length_m, max(self.width_m, BIN_m)])
        return np.asarray(np.linalg.norm(np.maximum(np.abs(self.places_m) - half * (1.0 + 1e-9), 0.0), axis=1))


def band_passed(values: Float, step_s: float) -> Float:
    """Return records, shape (t, n), filtered to BAND_Hz. Outside the record, values count as 0."""
    count = len(values) + round(0.1 / step_s)
    f = np.fft.rfftfreq(count, step_s)
    low, high = BAND_Hz
    gain = np.clip(2.0 * f / low - 1.0, 0.0, 1.0) * np.clip(11.0 - 10.0 * f / high, 0.0, 1.0)
    columns = [np.fft.irfft(np.fft.rfft(one, count) * gain, count)[: len(one)] for one in values.T]
    return np.stack(columns, axis=1)


def numbers(one: Pass, velocity: Float, quiet: Float | None = None) -> dict[str, float]:
    """Return all numbers that can be computed, by name.
    velocity: band-passed velocity at one.times_s, shape (t, n)

    quiet: noise of the same shape, whose power is subtracted from spectrum and energies
    """
    noise = np.zeros_like(velocity) if quiet is None else quiet
    f = np.fft.rfftfreq(len(velocity), STEP_s)
    spectra = [(np.abs(np.fft.rfft(part, axis=0)) ** 2).mean(axis=1) for part in (velocity, noise)]
    # Lines below the noise count with their sign: without them noise would raise the centroid
    power = np.where((f >= BAND_Hz[0]) & (f <= BAND_Hz[1]), spectra[0] - spectra[1], 0.0)
    power = power / power.sum() if power.sum() > 0.0 else np.full_like(power, math.nan)
    mean = float(f @ power)
    x, size = envelope(one, velocity)
    wake = wake_length(np.column_stack([size, size]), x, [0.0, 1.0], focus_x_m=(SHARE - 0.5) * one.length_m,
                       threshold=THRESHOLD)  # fmt: skip
    found = {WAKE: 100.0 * wake, SPEED: outward_speed(one, velocity, noise), CENTROID: mean}
    found[WIDTH] = math.sqrt(max(float((f - mean) ** 2 @ power), 0.0))
    for low, high in pairwise(OCTAVES_Hz):
        found[f"power {low:.0f}-{high:.0f} Hz [%]"] = 100.0 * float(power[(f >= low) & (f < high)].sum())
    energy, off = (velocity**2).mean(axis=0) - (noise**2).mean(axis=0), one.off_m
    on_path = energy[off <= 0.0]
    for low, high in pairwise(RINGS_m):
        ring = energy[(off > low) & (off <= high)]
        if min(len(ring), len(on_path)) >= LEAST_PLACES and min(ring.mean(), on_path.mean()) > 0.0:
            decibel = 10.0 * math.log10(ring.mean() / on_path.mean())
            found[f"energy {1e3 * low:.0f}-{1e3 * high:.0f} mm off [dB]"] = decibel
    return {name: value for name, value in found.items() if math.isfinite(value)}


def envelope(one: Pass, velocity: Float) -> tuple[Float, Float]:
    """Return positions along the path [m] and the largest velocity in each bin of the snapshot [m/s], shape (b,)."""
    row = int(np.abs(one.times_s - SHARE * one.end_s).argmin())
    near = np.abs(one.places_m[:, 1]) <= 0.5 * LATERAL_m
    bins, number = np.unique(np.round(one.places_m[near, 0] / BIN_m), return_inverse=True)
    size = np.zeros(len(bins))
    np.maximum.at(size, number, np.abs(velocity[row, near]))
    return BIN_m * bins, size


def outward_speed(one: Pass, velocity: Float, noise: Float) -> float:
    """Return the speed at which energy leaves the strip [m/s]. NaN if it does not leave it.

    For each place, the mean time of the energy after the focus has passed is computed. A line is fitted to this time
    over the distance from the strip.
    """
    off, energy = one.off_m, (velocity**2).sum(axis=0) - (noise**2).sum(axis=0)
    chosen = (off > 0.0) & (off <= RINGS_m[-2]) & (np.abs(one.places_m[:, 0]) <= MIDDLE * one.length_m)
    chosen &= energy > (noise**2).sum(axis=0)
    if chosen.sum() < LEAST_PLACES:
        return math.nan
    power = velocity[:, chosen] ** 2 - (noise[:, chosen] ** 2).mean(axis=0)
    passed = (one.places_m[chosen, 0] + 0.5 * one.length_m) / one.along_m_s
    late = one.times_s @ power / energy[chosen] - passed
    slope = float(np.polyfit(off[chosen], late, 1, w=energy[chosen] ** 0.25)[0])
    return 1.0 / slope if slope > 0.0 else math.nan
