"""Resolution of solver lateral_waves for a given tolerance, and the difference of two solutions."""

import math
from dataclasses import dataclass

import numpy as np

from palmfield.skin.problem import Load, Slab, Spot, spread
from palmfield.types import Float, Int

SUDDEN_1_S = 2.0 * math.pi * 500.0
"""Largest rate of change [1/s] for which the lateral resolution of velocities after a sudden load is that of motion."""
SERIES_FROM = 8
"""Least number of requested times for which the error of each point is computed over time."""
FEW_POINTS = 32
"""Largest number of points with separate errors at fewer times; more points are a snapshot with one error."""
FAINT = 1e-3
"""Share of the largest motion that is the least reference for errors of points."""


@dataclass(frozen=True)
class Resolution:
    """Resolution of a solution.

    tolerance: relative, of each part (wavenumbers, angles, modes, omitted short waves); degree: initial degree of the
    polynomials; per_radian: added degrees per radian of wave through half a sheet;
    pace_1_s, speed_m_s: largest rate of change and largest speed of the load"""

    tolerance: float
    degree: int
    per_radian: float
    pace_1_s: float
    speed_m_s: float

    @property
    def digits(self) -> float:
        return -math.log10(self.tolerance)

    def pace(self, k: float) -> float:
        """Return the rate of change of the load on a wave [1/s], by amplitude and path; sudden changes: SUDDEN_1_S."""
        return min(self.pace_1_s, SUDDEN_1_S) + k * self.speed_m_s

    def cut(self, fwhm_m: float) -> float:
        """Return the wavenumber [rad/m] from which the transform of a Gaussian spot, exp(-(k s)^2 / 2), is omitted."""
        return math.sqrt(2.0 * math.log(4.0 / self.tolerance)) / spread(fwhm_m)

    def angles(self, k: Float, farthest_m: float) -> np.ndarray:
        """Return an even number of directions over the circle for points up to farthest_m from the load, shape of k.

        With n directions the error is J_n(k r). It falls like exp(-2^{3/2}/3 (n - x)^{3/2} x^{-1/2}) for n > x = k r.
        """
        x = k * farthest_m
        beyond = (1.5 / math.sqrt(2.0) * 2.3 * self.digits) ** (2.0 / 3.0)
        return 2 * np.ceil(0.5 * (x + beyond * np.cbrt(x) + self.digits + 2.0)).astype(int)

    def degrees(self, slab: Slab, k: float) -> tuple[int, ...]:
        """Return the polynomial degree of each sheet: enough for the waves of a moving, changing load."""
        result = []
        for sheet in slab.sheets:
            speed = math.sqrt(sheet.material.shear_relaxed_Pa / sheet.material.density_kg_m3)
            wave = math.hypot(k, (k * self.speed_m_s) / speed)
            wave += min(self.pace_1_s / speed, 12.0 * self.digits / sheet.thickness_m)
            result.append(self.degree + math.ceil(self.per_radian * 0.5 * wave * sheet.thickness_m))
        return tuple(result)


def choose(load: Load, tolerance: float) -> Resolution:
    """Return the resolution whose parts each have an error of about `tolerance`."""
    values = load.peak_Pa[:, None] if isinstance(load, Spot) else load.pressure_Pa
    size = float(np.abs(values).max()) or 1.0
    steps = np.diff(load.times_s)
    speed = 0.0
    if load.law == "held" or len(steps) == 0 or np.abs(values[0]).max() > 0.0:
        pace = math.inf
    else:
        pace = 4.0 * float((np.abs(np.diff(values, axis=0)).max(axis=1) / steps).max()) / size
    if isinstance(load, Spot) and load.law == "linear" and len(steps):
        speed = float((np.linalg.norm(np.diff(load.centres(), axis=0), axis=1) / steps).max())
    return resolution_for(tolerance, pace, speed)


def resolution_for(tolerance: float, pace_1_s: float, speed_m_s: float) -> Resolution:
    digits = -math.log10(tolerance)
    return Resolution(tolerance, math.ceil(4.0 + 2.0 * digits), 0.6 + 0.2 * digits, pace_1_s, speed_m_s)


def is_picture(times: int, points: int) -> bool:
    """Return whether all points together have one error."""
    return times < SERIES_FROM and points > FEW_POINTS


def relative_error(result: Float, finer: Float, picture: bool | None = None) -> float:
    """Return the L2 difference of motions, (t, n, 3), relative to the finer: over times at the worst point, or, for a
    picture (default: `is_picture`), over times and points together."""
    if finer.size == 0:
        return 0.0
    picture = is_picture(*finer.shape[:2]) if picture is None else picture
    over = (0, 1, 2) if picture else (0, 2)
    size = np.sqrt((finer**2).sum(axis=over))
    floor = max(FAINT * float(size.max()), 1e-300)
    return float(np.max(np.sqrt(((result - finer) ** 2).sum(axis=over)) / np.maximum(size, floor)))


def pick(displacement: Float) -> Int:
    """Return points to compare runs: nearest to and farthest from the middle of the motion, or a selection."""
    times, points, _ = displacement.shape
    if times < SERIES_FROM:
        return np.unique(np.linspace(0, points - 1, min(points, 200)).astype(np.int32))
    order = np.argsort((displacement**2).sum(axis=(0, 2)), kind="stable")
    return np.unique(order[np.linspace(0, points - 1, min(points, 4)).astype(np.int32)]).astype(np.int32)
