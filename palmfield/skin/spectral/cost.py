"""What a spectral solution will cost, before any of it is computed. Constants are from docs/bench/skin_spectral.md."""

import numpy as np

from palmfield.skin.material import shear_wave
from palmfield.skin.problem import Body, Load, Slab, Spot
from palmfield.skin.spectral.accuracy import SERIES_FROM
from palmfield.skin.spectral.build import is_still, nyquist, reach
from palmfield.skin.spectral.resolution import choose
from palmfield.types import Float

WASTE = 2.5
"""Wavenumbers tried for one kept, and the finer run that the answer is compared with."""
STATE_S, DEPTH_S, WAVENUMBER_S = 8e-9, 3e-9, 2e-3
"""Seconds of one wavenumber: by the cube of its states, by that of its unknowns in depth, and besides."""
POLE_S = 4e-9
PHASE_S = 20e-9
LATE_Hz = 200.0


def cost_spectral(body: Body, load: Load, times: Float, at: Float, accuracy: float) -> float:
    """Predicted seconds on one core, within a factor of about five; infinite for what the solver refuses."""
    if not isinstance(body, Slab):
        return float("inf")
    asked = np.asarray(times, dtype=float)
    points = np.asarray(at, dtype=float)[:, :2]
    resolution = choose(load, 0.5 * accuracy)
    k_end = resolution.cut(load.fwhm_m) if isinstance(load, Spot) else nyquist(load.weights_m2)
    sources = load.centres() if isinstance(load, Spot) else load.points[:, :2]
    farthest = reach(points, sources)
    horizon = max(float(asked[-1] - load.times_s[0]), 0.0)
    main = max(body.sheets, key=lambda sheet: sheet.thickness_m)
    speed, length = shear_wave(main.material, LATE_Hz)
    way = farthest + min(speed * horizon, resolution.digits * length)
    moving = not (isinstance(load, Spot) and is_still(load))
    if body.shape == "infinite":
        wavenumbers = 10.0 * max(4.0, k_end * way / 10.0)
        waves = wavenumbers * (0.5 * float(resolution.angles(np.array([0.5 * k_end]), farthest)[0]) if moving else 1.0)
    elif body.shape == "disc":
        waves = wavenumbers = k_end * (body.radius_m or 0.0) / np.pi
    else:
        wavenumbers = k_end**2 * float(np.prod(body.size_m or (0.0,))) / (4.0 * np.pi)
        waves = 2.0 * wavenumbers
    degree = sum(resolution.degrees(body, 0.5 * k_end))
    branches = max(len(sheet.material.branches) for sheet in body.sheets)
    # Modes that matter for the face, seen in runs: they grow with the digits asked for and with waves in the depth
    kept = min(2.0 * degree, 6.0 + 6.0 * resolution.digits + 0.2 * k_end * body.thickness_m)
    states = kept * (2 + branches)
    segments = min(len(load.times_s), 1 + np.searchsorted(load.times_s, asked[-1])) + len(asked)
    sums = waves * len(asked) * 6 * min(len(points), 4 if len(asked) >= SERIES_FROM else len(points)) * 1e-9
    phases = waves * (len(points) if len(points) < 64 else 2.0 * np.sqrt(len(points))) * PHASE_S
    modes = wavenumbers * (WAVENUMBER_S + states**3 * STATE_S + (2 * degree) ** 3 * DEPTH_S)
    return float(WASTE * (modes + waves * 2.0 * kept * segments * POLE_S) + sums + phases)
