"""Energy of a stimulus: energy density, focal energy ratio, residual energy, and similarity of two maps.

Maps are on a grid, shape (m, n), at rising x (m,) and y (n,) [m]. A strip is the set of grid points within half the
strip's width of a path. All functions raise MeasurementError for other shapes, NaN and infinity.
"""

import itertools
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import Mask, above_zero, cell_areas, finite, grid, mask, whole
from palmfield.metrics.traces import Window, rms_map
from palmfield.types import Float

Over = Literal["outside", "total"]


def energy_density(times_s: ArrayLike, normal_velocity: ArrayLike, window_s: Window = None) -> Float:
    """Return the mean over time of the squared normal velocity [m^2/s^2]; input of shape (t, ...) gives shape (...).

    The mass per area and the factor 1/2 of a kinetic energy are omitted: they cancel in ratios and similarities.
    """
    return np.asarray(rms_map(times_s, normal_velocity, window_s) ** 2)


def strip(x_m: ArrayLike, y_m: ArrayLike, path_m: ArrayLike, width_m: float) -> Mask:
    """Return a mask of the grid points within half of width_m of a path, shape (m, n), bool.

    x_m, y_m: rising coordinates of the grid [m], shapes (m,) and (n,)
    path_m: corners of the path [m], shape (k, 2), k >= 1
    Raises MeasurementError for other shapes and a width that is not above 0.
    """
    above_zero("width_m", width_m)
    path = np.asarray(path_m, dtype=float)
    if path.ndim != 2 or path.shape[1] != 2 or len(path) == 0:
        raise MeasurementError(f"path_m has shape {path.shape}; give corners of shape (k, 2)")
    finite("path_m", path)
    _, x, y = grid(np.zeros((np.size(x_m), np.size(y_m))), x_m, y_m)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    nearest = np.linalg.norm(places - path[0], axis=-1)
    for start, end in itertools.pairwise(path):
        way = end - start
        length = float(way @ way)
        if length > 0.0:
            part = np.clip((places - start) @ way / length, 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(places - start - part[..., None] * way, axis=-1))
    return np.asarray(nearest <= 0.5 * width_m * (1.0 + 1e-9))


def focal_energy_ratio(
    density: ArrayLike,
    x_m: ArrayLike,
    y_m: ArrayLike,
    inside: ArrayLike,
    *,
    over: Literal["outside", "total"] = "outside",
) -> float:
    """Return the energy inside a strip, divided by the energy outside it or by the total.

    Points are weighted by area. density, x_m, y_m, inside: as for `average_residual_energy`.
    over: "outside" or "total". Raises MeasurementError if the divisor is zero.
    """
    values, x, y = grid(density, x_m, y_m)
    weighted = cell_areas(x, y) * values
    within = float(weighted[mask(inside, values)].sum())
    if over not in ("outside", "total"):
        raise MeasurementError(f"over is '{over}'; use outside or total")
    rest = float(weighted.sum()) - (within if over == "outside" else 0.0)
    if not rest > 0.0:
        raise MeasurementError(f"the energy {over} is {rest:g}; the ratio needs a value above 0")
    return within / rest


def average_residual_energy(density: ArrayLike, x_m: ArrayLike, y_m: ArrayLike, inside: ArrayLike) -> float:
    """Return the average residual energy (ARE): the mean energy density over the area outside a strip.

    density: shape (m, n), at rising x_m (m,) and y_m (n,) [m]; inside: mask of `strip`, shape (m, n), bool
    Raises MeasurementError for other shapes, and for a strip that covers the whole map.
    """
    values, x, y = grid(density, x_m, y_m)
    areas = np.where(mask(inside, values), 0.0, cell_areas(x, y))
    if not areas.sum() > 0.0:
        raise MeasurementError("the strip covers the whole map, so no points lie outside: use a narrower strip")
    return float((areas * values).sum() / areas.sum())


def mse(map_a: ArrayLike, map_b: ArrayLike, *, normalised: bool = True) -> float:
    """Return the mean squared difference of two maps on one even grid, shapes (m, n).

    normalised: whether each map is first divided by its largest magnitude; if not, the unit is that of the maps squared
    """
    a, b = _pair(map_a, map_b, normalised)
    return float(np.mean((a - b) ** 2))


def ssim(
    map_a: ArrayLike,
    map_b: ArrayLike,
    *,
    normalised: bool = True,
    data_range: float = 1.0,
    sigma: float = 1.5,
    radius: int = 5,
    k1: float = 0.01,
    k2: float = 0.03,
) -> float:
    """Return the mean structural similarity of two maps on one even grid, shapes (m, n); 1 for equal maps.

    Wang, Bovik, Sheikh & Simoncelli 2004, IEEE Trans. Image Process. 13, 600, eq. 13. Local means, variances and
    covariance have Gaussian weights of `sigma` grid points in windows of 2 radius + 1 points. The mean is over windows
    inside the map.
    normalised: whether each map is first divided by its largest magnitude; data_range: L of the paper
    Raises MeasurementError for maps smaller than a window, sigma <= 0 and radius < 0.
    """
    above_zero("data_range", data_range)
    above_zero("sigma", sigma)
    above_zero("k1", k1)
    above_zero("k2", k2)
    radius = whole("radius", radius, 0, 10_000)
    a, b = _pair(map_a, map_b, normalised)
    if a.ndim != 2 or min(a.shape) <= 2 * radius:
        raise MeasurementError(f"maps have shape {a.shape}; a window needs {2 * radius + 1} points in each direction")

    def local(values: Float) -> Float:
        smooth = gaussian_filter(values, sigma, radius=radius)
        return np.asarray(smooth[radius:-radius, radius:-radius] if radius else smooth)

    mean_a, mean_b = local(a), local(b)
    var_a, var_b = local(a * a) - mean_a**2, local(b * b) - mean_b**2
    both = local(a * b) - mean_a * mean_b
    c1, c2 = (k1 * data_range) ** 2, (k2 * data_range) ** 2
    index = (2.0 * mean_a * mean_b + c1) * (2.0 * both + c2)
    index /= (mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2)
    return float(index.mean())


def _pair(map_a: ArrayLike, map_b: ArrayLike, normalised: bool) -> tuple[Float, Float]:
    a, b = np.asarray(map_a, dtype=float), np.asarray(map_b, dtype=float)
    if a.shape != b.shape or a.size == 0:
        raise MeasurementError(f"maps have shapes {a.shape} and {b.shape}; give two of one shape")
    finite("the first map", a)
    finite("the second map", b)
    if normalised:
        tops = np.abs(a).max(), np.abs(b).max()
        if min(tops) == 0.0:
            raise MeasurementError("a map of zeros cannot be divided by its maximum: give normalised=False")
        a, b = a / tops[0], b / tops[1]
    return a, b
