"""Predict the cost of a solution by lateral waves. Constants are from docs/bench/skin_lateral_waves.md."""

import numpy as np

from palmfield.skin.materials.material import shear_wave
from palmfield.skin.problem import SkinProblem, Slab, Spot
from palmfield.skin.solvers.lateral_waves.build import check_sides, is_still, nyquist, reach
from palmfield.skin.solvers.lateral_waves.resolution import SERIES_FROM, choose

TRIED, SUMMED = 7.0, 4.3
"""Tried wavenumbers and summed waves, in a run and its finer run together, over the expected numbers for an infinite
slab; for other slabs TWICE."""
TWICE = 2.1
WAVENUMBER_S, SQUARE_S = 0.9e-3, 0.39e-6
"""Time of one wavenumber, and time by the square of its number of poles [s]."""
WAVE_S, POLE_S = 0.3e-6, 3e-9
"""Time of one wave over one segment of time, and time by its number of poles [s]."""
SUM_S = 9e-9
"""Time of one wave at one point and moment [s]."""
PHASE_S = 20e-9
LATE_Hz = 200.0
BEGIN_S, SHARE = 0.02, 0.4
"""Time of any solution [s], and ratio of measured to predicted time in 12 cases (docs/bench/skin_costs.md)."""


def cost_lateral_waves(problem: SkinProblem) -> float:
    """Return the predicted time [s] on one core, to a factor of about two; infinite for bodies that cannot be solved.

    Fitted to process times on Ecoflex 20 mm at 0.1 to 5 %, and on a plate of 10 mm under a fast spot.
    Raises SceneError like `check_sides`.
    """
    body, load, requested, points = problem.body, problem.load, problem.times, problem.at[:, :2]
    if not isinstance(body, Slab):
        return float("inf")
    check_sides(body, load, problem.accuracy)
    resolution = choose(load, 0.5 * problem.accuracy)
    k_end = resolution.cut(load.fwhm_m) if isinstance(load, Spot) else nyquist(load.weights_m2)
    sources = load.centres() if isinstance(load, Spot) else load.points[:, :2]
    farthest = reach(points, sources)
    horizon = max(float(requested[-1] - load.times_s[0]), 0.0)
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
    branches = max(len(sheet.material.relaxation.branches) for sheet in body.sheets)
    # Number of relevant modes for the face, fitted to runs; it grows with the digits and the waves in the depth
    digits = resolution.digits + 0.35
    poles = (2 + branches) * min(2.0 * degree, 4.0 * digits**2 + 0.2 * k_end * body.thickness_m)
    stretches = len(np.union1d(load.times_s[load.times_s < requested[-1]], requested))
    tried, summed = (TRIED, SUMMED) if body.shape == "infinite" else (TWICE, TWICE)
    modes = tried * wavenumbers * (WAVENUMBER_S + SQUARE_S * poles**2)
    steps = summed * waves * stretches * (WAVE_S + POLE_S * poles)
    sums = waves * len(requested) * min(len(points), 4 if len(requested) >= SERIES_FROM else len(points)) * SUM_S
    phases = waves * (len(points) if len(points) < 64 else 2.0 * np.sqrt(len(points))) * PHASE_S
    return BEGIN_S + SHARE * float(modes + steps + sums + phases)
