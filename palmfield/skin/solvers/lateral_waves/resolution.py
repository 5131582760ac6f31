"""Resolution of solver lateral_waves for a given tolerance."""

import math
from dataclasses import dataclass

import numpy as np

from palmfield.skin.problem import Load, Slab, Spot, spread
from palmfield.types import Float

SUDDEN_1_S = 2.0 * math.pi * 500.0
"""Rate of change up to which the velocity after a sudden load is resolved laterally [1/s], like the displacement."""


@dataclass(frozen=True)
class Resolution:
    """Resolution of a solution. tolerance: tolerance of each single part (wavenumbers, angles, modes, cut), relative;
    degree: initial polynomial degree.
    per_radian: further degrees per radian of wave through half a sheet; pace_1_s: largest rate of change of the load;
    speed_m_s: its largest speed"""

    tolerance: float
    degree: int
    per_radian: float
    pace_1_s: float
    speed_m_s: float

    @property
    def digits(self) -> float:
        return -math.log10(self.tolerance)

    def pace(self, k: float) -> float:
        """Rate of change of the load on a wave [1/s]: by amplitude and path; sudden changes count as SUDDEN_1_S."""
        return min(self.pace_1_s, SUDDEN_1_S) + k * self.speed_m_s

    def cut(self, fwhm_m: float) -> float:
        """Return the wavenumber [rad/m] from which the transform of a Gaussian spot, exp(-(k s)^2 / 2), is left out."""
        return math.sqrt(2.0 * math.log(4.0 / self.tolerance)) / spread(fwhm_m)

    def angles(self, k: Float, farthest_m: float) -> np.ndarray:
        """Even number of directions over the circle for points up to farthest_m from the load, shape of k.

        n directions see J_n(k r) as J_0; it falls like exp(-2^{3/2}/3 (n - x)^{3/2} x^{-1/2}) from n = x = k r on.
        """
        x = k * farthest_m
        beyond = (1.5 / math.sqrt(2.0) * 2.3 * self.digits) ** (2.0 / 3.0)
        return 2 * np.ceil(0.5 * (x + beyond * np.cbrt(x) + self.digits + 2.0)).astype(int)

    def degrees(self, slab: Slab, k: float) -> tuple[int, ...]:
        """Return the polynomial degree of each sheet: enough for the wave that a running, changing load makes in it."""
        result = []
        for sheet in slab.sheets:
            speed = math.sqrt(sheet.material.shear_relaxed_Pa / sheet.material.density_kg_m3)
            wave = math.hypot(k, (k * self.speed_m_s) / speed)
            wave += min(self.pace_1_s / speed, 12.0 * self.digits / sheet.thickness_m)
            result.append(self.degree + math.ceil(self.per_radian * 0.5 * wave * sheet.thickness_m))
        return tuple(result)


def choose(load: Load, tolerance: float) -> Resolution:
    """Return the resolution whose parts each err by about `tolerance`."""
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
