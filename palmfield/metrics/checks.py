"""Checks of the signals and maps passed to metrics."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import MeasurementError
from palmfield.types import Float

Mask = NDArray[np.bool_]


def trace(times_s: ArrayLike, values: ArrayLike, least: int = 2, *, single: bool = False) -> tuple[Float, Float]:
    """Return rising times [s], shape (t,), and values, shape (t, ...), as float64 arrays.

    least: smallest number of samples; single: whether the values must have shape (t,)
    Raises MeasurementError for fewer samples, other shapes, times that do not rise, NaN and infinity.
    """
    times, signal = np.asarray(times_s, dtype=float), np.asarray(values, dtype=float)
    if times.ndim != 1 or len(times) < least:
        raise MeasurementError(f"times have shape {times.shape}; give a row of at least {least}")
    if not np.isfinite(times).all() or not np.all(np.diff(times) > 0.0):
        raise MeasurementError("times must be finite and rise from sample to sample")
    if signal.ndim == 0 or signal.shape[0] != len(times) or (single and signal.ndim != 1):
        allowed = f"; give one signal, ({len(times)},)" if single else ""
        raise MeasurementError(f"values have shape {signal.shape}, but there are {len(times)} times{allowed}")
    finite("values", signal)
    return times, signal


def even_step(times_s: Float) -> float:
    """Return the step of evenly spaced times [s]. Raises MeasurementError if they are not evenly spaced."""
    steps = np.diff(times_s)
    step = float((times_s[-1] - times_s[0]) / len(steps))
    if step <= 0.0 or np.abs(steps - step).max() > 1e-3 * step:
        raise MeasurementError(
            f"times are not evenly spaced (steps {steps.min():.3g} to {steps.max():.3g} s); use an interval "
            "without gaps"
        )
    return step


def grid(values: ArrayLike, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Float, Float, Float]:
    """Return a map, shape (m, n), and the rising coordinates x (m,) and y (n,) of its grid, as float64 arrays.

    Raises MeasurementError for other shapes, coordinates that do not rise, NaN and infinity.
    """
    field, x, y = (np.asarray(part, dtype=float) for part in (values, x_m, y_m))
    if x.ndim != 1 or y.ndim != 1 or field.shape != (len(x), len(y)):
        raise MeasurementError(f"the map has shape {field.shape}; give ({np.size(x)}, {np.size(y)}), x by y")
    for name, places in (("x", x), ("y", y)):
        if len(places) < 2 or not np.isfinite(places).all() or not np.all(np.diff(places) > 0.0):
            raise MeasurementError(f"{name} of a map must be at least two finite rising positions")
    finite("the map", field)
    return field, x, y


def mask(inside: ArrayLike, values: Float) -> Mask:
    """Return `inside` as bool, shape (m, n). Raises MeasurementError if its shape is not that of `values`."""
    chosen = np.asarray(inside, dtype=bool)
    if chosen.shape != values.shape:
        raise MeasurementError(f"inside has shape {chosen.shape}; the map has {values.shape}")
    return chosen


def cell_areas(x_m: Float, y_m: Float) -> Float:
    """Return the area of the cell of each grid point [m^2], shape (m, n).

    A cell extends half way to the next points.
    """
    across = [np.diff(np.concatenate([p[:1], 0.5 * (p[1:] + p[:-1]), p[-1:]])) for p in (x_m, y_m)]
    return np.asarray(np.outer(*across))


def finite(what: str, values: Float) -> None:
    if not np.isfinite(values).all():
        place = np.argwhere(~np.isfinite(values))[0].tolist()
        raise MeasurementError(f"{what} at {place} is {values[tuple(place)]}; give finite numbers")


def share(what: str, value: float) -> None:
    """Raise MeasurementError unless 0 < value < 1."""
    if not 0.0 < value < 1.0:
        raise MeasurementError(f"{what} is {value:g}; allowed: above 0 and below 1")


def whole(what: str, value: float, least: int, most: int) -> int:
    """Return the value as an int. Raises MeasurementError unless it is a whole number from `least` to `most`."""
    if not least <= value <= most or value != int(value):
        raise MeasurementError(f"{what} is {value}; allowed: a whole number from {least} to {most}")
    return int(value)


def above_zero(what: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise MeasurementError(f"{what} is {value:g}; give a finite number above 0")
