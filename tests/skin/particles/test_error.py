"""The stated error against the true one, over random discs, spots and bursts with an exact answer."""

import math

import numpy as np
import pytest

from palmfield.skin.layer_oracle import centre_response
from palmfield.skin.material import Branch, Material, bulk_from_poisson
from palmfield.skin.particles import solve_particles
from palmfield.skin.problem import Sheet, Slab, Spot

PERIOD_S, SAMPLES, HIGHEST_HZ = 0.25, 12500, 1200.0


def case(rng):
    """A roller disc of a damped material under a smooth burst: body, load, points, and the exact push over time."""
    width, depth = rng.uniform(6e-3, 14e-3), rng.uniform(4e-3, 20e-3)
    shear = rng.uniform(8e3, 3e4)
    branch = Branch(rng.uniform(0.5, 2.0) * shear, rng.uniform(2e-4, 1.5e-3))
    bulk = bulk_from_poisson(rng.choice([0.3, 0.45, 0.49, 0.495]), shear)
    material = Material("random", 1050.0, shear, (branch,), bulk, "")
    frequency, radius = rng.uniform(40.0, 250.0), 2.2 * width
    times = np.arange(SAMPLES) * PERIOD_S / SAMPLES
    on = times < 2.0 / frequency
    pulse = np.where(on, 0.5 * (1.0 - np.cos(2.0 * math.pi * frequency * times)), 0.0)
    at = np.column_stack([np.array([0.0, 0.5, 1.0]) * width, np.zeros(3)])
    spectrum = np.zeros((SAMPLES // 2 + 1, 3), dtype=complex)
    count = round(HIGHEST_HZ * PERIOD_S)
    response = [centre_response(k / PERIOD_S, material, depth, width, radius, at[:, 0]) for k in range(count)]
    spectrum[:count] = np.fft.rfft(pulse)[:count, None] * np.conj(response)
    kept = slice(0, round(3.0 / frequency / PERIOD_S * SAMPLES), 10)
    body = Slab((Sheet(material, depth),), "disc", "bonded", "roller", radius_m=radius)
    return body, Spot(width, times[on], pulse[on]), at, times[kept], np.fft.irfft(spectrum, SAMPLES, axis=0)[kept]


def ratios(seeds):
    """Stated over true error, L2 over times and points, of each seed's case."""
    found = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        body, load, at, times, exact = case(rng)
        motion = solve_particles(body, load, times, at, accuracy=rng.uniform(0.15, 0.4))
        miss = np.linalg.norm(-motion.displacement_m[..., 2] - exact) / np.linalg.norm(exact)
        found.append(motion.error / miss)
    return np.array(found)


@pytest.mark.slow
def test_stated_error_covers_the_true_one():
    found = ratios(range(24))
    assert np.mean(found >= 1.0) >= 0.9
    assert np.median(found) <= 4.0
