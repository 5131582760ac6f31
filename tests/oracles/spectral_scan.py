"""Scans of a layer under a zigzag, by transforms in space and time of the exact compliance, laid out as public data.

Nothing of the solver of the predictions is used: no modes in depth and no steps in time, and the base slides.
"""

import math

import numpy as np
from scipy.io import savemat

from palmfield.skin.analytic import layer_compliance

PERIOD_M, CELLS, STEP_S, COUNT = 0.5, 128, 2e-4, 2048
NODES = 240


def zigzag(times, along, length, width, across):
    """Place of the focus, shape (t, 2), and whether it is on, (t,)."""
    end = length / along
    s = np.clip(times, 0.0, end)
    phase = (s * across / width) % 2.0
    y = width * (np.where(phase < 1.0, phase, 2.0 - phase) - 0.5) if width else np.zeros_like(s)
    return np.column_stack([along * s - 0.5 * length, y]), ((times >= 0.0) & (times <= end)).astype(float)


def velocity(places, material, thickness, base, fwhm, along, *, length=0.16, width=0.02, across=2.5, before=0.05):
    """Times [s] and outward normal velocity [m/s], shape (t, n), of a zigzag along x about the origin, 1 Pa peak."""
    times = STEP_S * np.arange(COUNT) - before
    centre, level = zigzag(times, along, length, width, across)
    step = 2.0 * np.pi / PERIOD_M
    m, n = np.meshgrid(np.arange(CELLS // 2), np.arange(-CELLS // 2 + 1, CELLS // 2), indexing="ij")
    half = (m > 0) | (n > 0)
    k = step * np.column_stack([m[half], n[half]])
    size = np.linalg.norm(k, axis=1)
    k, size = k[size <= step * CELLS / 2], size[size <= step * CELLS / 2]
    spread = fwhm / math.sqrt(8.0 * math.log(2.0))
    pressure = 2.0 * np.pi * spread**2 * np.exp(-0.5 * (size * spread) ** 2) / PERIOD_M**2
    f = np.fft.rfftfreq(COUNT, STEP_S)
    nodes = np.linspace(0.5 * step, step * CELLS / 2, NODES)
    table = np.array([layer_compliance(nodes, float(one), material, thickness, base) for one in f])
    result = np.zeros((COUNT, len(places)))
    for first in range(0, len(k), 512):
        part = slice(first, first + 512)
        force = np.fft.rfft(level[:, None] * np.exp(-1j * centre @ k[part].T).real, axis=0)
        force_i = np.fft.rfft(level[:, None] * np.exp(-1j * centre @ k[part].T).imag, axis=0)
        compliance = np.array([np.interp(size[part], nodes, row) for row in table]).conj()
        rate = -2j * np.pi * f[:, None] * compliance * pressure[part]
        moved = np.fft.irfft(rate * force, COUNT, axis=0) + 1j * np.fft.irfft(rate * force_i, COUNT, axis=0)
        result += 2.0 * (moved @ np.exp(1j * places @ k[part].T).T).real
    return times, result


def write(file, places, times, values, *, noise, seed=0, rate_name="fs"):
    """Write a .mat in the layout of the public data: y (places, times, 2); records have delays, as their references."""
    rng = np.random.default_rng(seed)
    late = rng.integers(0, 40, size=(len(places), 2))
    y = np.zeros((len(places), len(times), 2))
    reference = np.zeros_like(y)
    for n in range(len(places)):
        for r in range(2):
            y[n, :, r] = np.roll(values[:, n], late[n, r])
            reference[n, :, r] = np.roll((times >= 0.0) & (times < 0.02), late[n, r])
    y += noise * np.abs(values).max() * rng.normal(size=y.shape)
    savemat(file, {"locs": places, rate_name: 1.0 / (times[1] - times[0]), "ref": reference, "y": y},
            do_compression=str(file).endswith("z.mat"))  # fmt: skip
