"""Scan: records of a real or virtual vibrometer at the points of a grid, and grids in the plane z = 0 of its frame."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from palmfield.errors import MeasurementError, naming, refuse_unknown
from palmfield.metrics.checks import above_zero, even_step, finite, trace, whole
from palmfield.types import Float

Quantity = Literal["displacement", "velocity"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
SIGHTS = ("sight_x", "sight_y", "sight_z")
"""Columns of files for directions of sight."""
UNITS: dict[Quantity, dict[str, float]] = {
    "displacement": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
}
"""Factors of units to m and m/s."""
MOST_PLACES = 10_000_000


@dataclass(frozen=True)
class Scan:
    """Records of points at common times.

    quantity: quantity measured along the beams; times_s: evenly spaced, from the trigger [s], shape (t,)
    points: [m], shape (n, 3), in the frame of the scan; values: [m or m/s], shape (t, n)
    sights: unit vectors from the points to the head, shape (n, 3), or None if not given
    name: name for messages and pictures
    Raises MeasurementError for other shapes, fewer than 16 samples, uneven times, numbers that are not finite, points
    at equal positions, and lines of sight of length 0.
    """

    quantity: Quantity
    times_s: Float
    points: Float
    values: Float
    sights: Float | None = None
    name: str = "scan"

    def __post_init__(self) -> None:
        with naming(self.name):
            refuse_unknown(MeasurementError, "quantity is {}", self.quantity, QUANTITIES)
        bad = np.argwhere(~np.isfinite(np.atleast_2d(np.asarray(self.values, dtype=float))))
        if len(bad):
            raise MeasurementError(
                f"{self.name}: point {bad[0][1]} has a value that is not finite, at sample {bad[0][0]}; correct "
                "it, or remove the point"
            )
        with naming(self.name):
            times, values = trace(self.times_s, self.values, 16)
            even_step(times)
        points = np.asarray(self.points, dtype=float)
        if values.ndim != 2 or points.shape != (values.shape[1], 3) or not np.isfinite(points).all():
            raise MeasurementError(
                f"{self.name}: values are {values.shape}, points {points.shape}; give shapes (t, n) and (n, 3), finite"
            )
        first, second = _in_one_place(points)
        if second:
            place = ", ".join(f"{1e3 * x:.4g}" for x in points[first])
            raise MeasurementError(
                f"{self.name}: points {first} and {second} have the same position, ({place}) mm; remove one, or "
                "give their mean"
            )
        for name, value in (("times_s", times), ("values", values), ("points", points)):
            object.__setattr__(self, name, value)
        if self.sights is not None:
            sights = np.asarray(self.sights, dtype=float)
            lengths = np.linalg.norm(sights, axis=-1, keepdims=True)
            if sights.shape != points.shape or not (np.isfinite(lengths).all() and lengths.min() > 0.0):
                raise MeasurementError(
                    f"{self.name}: sights have shape {sights.shape}; give directions, {points.shape}"
                )
            object.__setattr__(self, "sights", sights / lengths)

    @property
    def rate_Hz(self) -> float:
        """Sampling rate [Hz]."""
        return 1.0 / even_step(self.times_s)

    def at_points(self, chosen: "np.ndarray") -> "Scan":
        """Return the scan at some of its points, chosen by numbers or a mask."""
        sights = None if self.sights is None else self.sights[chosen]
        return Scan(self.quantity, self.times_s, self.points[chosen], self.values[:, chosen], sights, self.name)


def _in_one_place(points: Float) -> tuple[int, int]:
    """Return the numbers of the first two coincident points, (0, 0) without any. points: [m], shape (n, 3)"""
    order = np.lexsort(points.T)
    same = np.flatnonzero((np.diff(points[order], axis=0) == 0.0).all(axis=1))
    if len(same) == 0:
        return 0, 0
    pair = sorted(int(order[n]) for n in (same[0], same[0] + 1))
    return pair[0], pair[1]


def of_record(record: xr.DataArray, name: str = "palmfield") -> Scan:
    """Convert the record of a virtual vibrometer to a scan."""
    points, sights = (
        np.column_stack([record[f"{prefix}{axis}"].values for axis in "xyz"]) for prefix in ("", "sight_")
    )
    quantity: Quantity = "velocity" if record.name == "velocity" else "displacement"
    return Scan(quantity, record["time"].values, points, record.values, sights, name)


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
