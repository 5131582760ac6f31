"""Points of a scan, in the plane z = 0 of its frame."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import above_zero, finite, whole
from palmfield.types import Float

MOST_PLACES = 10_000_000


def rectangle_grid(width_m: float, height_m: float, pitch_m: float) -> Float:
    """Return a square grid with a point in the centre, at most width_m by height_m along x and y [m], shape (n, 3)."""
    for name, value in (("width_m", width_m), ("height_m", height_m), ("pitch_m", pitch_m)):
        above_zero(name, value)
    if width_m * height_m > MOST_PLACES * pitch_m**2:
        raise MeasurementError(
            f"a grid of {width_m:g} by {height_m:g} m with pitch {pitch_m:g} m has more than {MOST_PLACES:,} "
            "points; give a larger pitch_m"
        )
    along = [pitch_m * np.arange(-n, n + 1) for n in (_half(width_m, pitch_m), _half(height_m, pitch_m))]
    x, y = np.meshgrid(*along, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def disc_grid(radius_m: float, pitch_m: float) -> Float:
    """Return the points of a square grid on a disc about its centre [m], shape (n, 3)."""
    grid = rectangle_grid(2.0 * radius_m, 2.0 * radius_m, pitch_m)
    return grid[np.hypot(grid[:, 0], grid[:, 1]) <= radius_m * (1.0 + 1e-9)]


def line_grid(length_m: float, count: int, azimuth_deg: float = 0.0) -> Float:
    """Return `count` evenly spaced points on a line through the centre [m], shape (count, 3)."""
    above_zero("length_m", length_m)
    finite("azimuth_deg", np.atleast_1d(azimuth_deg))
    count = whole("count of places", count, 2, MOST_PLACES)
    along = np.linspace(-0.5 * length_m, 0.5 * length_m, count)
    angle = math.radians(azimuth_deg)
    return np.column_stack([along * math.cos(angle), along * math.sin(angle), np.zeros(count)])


def pitch(points_m: ArrayLike) -> float:
    """Return the median distance of points to their nearest neighbours [m]."""
    points = np.asarray(points_m, dtype=float)
    if points.ndim != 2 or len(points) < 2:
        raise MeasurementError(f"points have shape {points.shape}; a pitch needs two or more")
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))


def _half(length_m: float, pitch_m: float) -> int:
    return math.floor(0.5 * length_m / pitch_m * (1.0 + 1e-9))
