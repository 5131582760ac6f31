"""Samples in time of a moving spot on a disc, and the frequency band of the resulting motion."""

import math
from dataclasses import dataclass

import numpy as np

from palmfield.skin.problem import Law, Slab, Spot, between, spread
from palmfield.types import Float

REACH = 3.0
"""Radius to which a spot is resolved, in standard deviations."""
BAND, MOST_BAND = 8.0, 24.0
"""Limits of the band of the reduced models, in c / (2 pi s); above it the response to a spot falls as 1 / f^2."""
MOST_BINS = 1 << 16


@dataclass(frozen=True)
class Samples:
    """A spot at ascending times up to the last requested time: amplitude [Pa], distance [m], angle [rad], all (t,)."""

    times_s: Float
    peak_Pa: Float
    distance_m: Float
    angle_rad: Float
    law: Law


def sample(load: Spot, times: Float, error: float) -> Samples:
    """Sample the spot at its own and the requested times, and in between until the load is linear to `error`.

    A Gaussian that moves by x in a step differs from its chord by up to (x / s)^2 / 8 of its peak.
    """
    start, end = load.times_s[0], max(times[-1], load.times_s[0])
    own = load.times_s[load.times_s <= end]
    knots = [own, times[times >= start]]
    if load.law == "linear":
        far = np.linalg.norm(np.diff(load.centres(), axis=0), axis=1)
        pieces = np.ceil(far / (spread(load.fwhm_m) * math.sqrt(8.0 * error))).astype(int)
        for n in np.flatnonzero(pieces > 1):
            inner = np.linspace(load.times_s[n], load.times_s[n + 1], pieces[n] + 1)
            knots.append(inner[inner <= end])
    grid = np.unique(np.concatenate(knots))
    # Times that differ only by rounding are merged
    grid = grid[np.concatenate([np.diff(grid) > 1e-12 * abs(end), [True]])]
    evaluated = grid + 1e-12 * abs(end) if load.law == "held" else grid
    peak, centre = between(load, load.peak_Pa, evaluated), between(load, load.centres(), evaluated)
    return Samples(grid, peak, np.hypot(*centre.T), np.arctan2(centre[:, 1], centre[:, 0]), load.law)


def _speed(body: Slab, s: float) -> float:
    """Return the shear speed [m/s] at frequency c / (2 pi s), for means of modulus and density over the thickness."""
    shares = [sheet.thickness_m / body.thickness_m for sheet in body.sheets]
    density = sum(share * sheet.material.density_kg_m3 for share, sheet in zip(shares, body.sheets, strict=True))
    rate = 0.0
    for _ in range(4):
        modulus = sum(
            share * sheet.material.shear_relaxed_Pa * abs(complex(sheet.material.stiffening(1j * rate)))
            for share, sheet in zip(shares, body.sheets, strict=True)
        )
        rate = math.sqrt(modulus / density) / s
    return rate * s


def _own_frequency(body: Slab, s: float) -> float:
    """Return the frequency [Hz] of the oscillation after release of a spot: c_s / (2 pi s), or that of the layer.

    A layer thinner than the spot oscillates at the quarter-wave frequency of shear. Under a wide spot it also
    oscillates at the quarter-wave frequency of compression. A spot is wide if the compression of a column, h / M, is
    more than the squeeze to the sides, about (h / s)^2 h / 3 G.
    """
    h = body.thickness_m
    own = _speed(body, min(s, 2.0 * h / math.pi)) / (2.0 * math.pi * min(s, 2.0 * h / math.pi))
    for material in (sheet.material for sheet in body.sheets):
        modulus = material.bulk_instant_Pa + 4.0 / 3.0 * material.shear_instant_Pa
        if (s / h) ** 2 > 0.1 * modulus / (3.0 * material.shear_instant_Pa):
            own = max(own, math.sqrt(modulus / material.density_kg_m3) / (4.0 * h))
    return own


def band_of(body: Slab, load: Spot, samples: Samples, error: float) -> float:
    """Return the highest frequency of the reduced models [Hz], from width, path and time course of the spot."""
    s = spread(load.fwhm_m)
    own = _own_frequency(body, s)
    steps = np.diff(samples.times_s)
    if len(steps) == 0:
        return BAND * own
    place = samples.distance_m * np.exp(1j * samples.angle_rad)
    path = (
        REACH * float(np.max(np.abs(np.diff(place)) / steps)) / (2.0 * math.pi * s) if samples.law == "linear" else 0.0
    )
    # Spectrum of the amplitude from its increments, with the first jump, times a response of 1 / f^2
    count = min(MOST_BINS, 2 + math.ceil(np.ptp(samples.times_s) / steps.min()))
    even = np.linspace(samples.times_s[0], samples.times_s[-1], count)
    rise = np.diff(np.interp(even, samples.times_s, samples.peak_Pa), prepend=0.0)
    frequency = np.fft.rfftfreq(count, even[1] - even[0])[1:]
    power = (np.abs(np.fft.rfft(rise))[1:] / frequency) ** 2 * np.minimum(1.0, own / frequency) ** 4
    above = np.cumsum(power[::-1])[::-1]
    law = float(frequency[above >= error**2 * above[0]][-1]) if above[0] > 0.0 else 0.0
    return max(BAND * own, min(1.5 * law, MOST_BAND * own), path)


def principal_shapes(loads: Float, tolerance: float) -> tuple[Float, Float]:
    """Return shapes (n, j) and coordinates (j, f) with loads (n, f) = shapes @ coordinates, to a relative tolerance.

    Proper orthogonal decomposition: singular values below tolerance times the largest are dropped; at least one stays.
    """
    left, singular, right = np.linalg.svd(loads, full_matrices=False)
    kept = max(1, int(np.sum(singular > tolerance * singular[0])))
    return left[:, :kept] * singular[:kept], right[:kept]
