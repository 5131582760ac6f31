"""Checks of the signals and maps passed to metrics."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import MeasurementError
from palmfield.types import Float

Mask = NDArray[np.bool_]


def trace(times_s: ArrayLike, values: ArrayLike, least: int = 2, *, single: bool = False) -> tuple[Float, Float]:
    """Return times [s], shape (t,), rising, and values, shape (t, ...), as float64 arrays; (t,) for a single one.

    Raises MeasurementError for fewer than `least` samples, other shapes, times that do not rise, NaN and infinity.
    """
    times, signal = np.asarray(times_s, dtype=float), np.asarray(values, dtype=float)
    if times.ndim != 1 or len(times) < least:
        raise MeasurementError(f"times have shape {times.shape}; give a row of at least {least}")
    if not np.isfinite(times).all() or not np.all(np.diff(times) > 0.0):
        raise MeasurementError("times must be finite and rise from sample to sample")
    if signal.ndim == 0 or signal.shape[0] != len(times) or (single and signal.ndim != 1):
        wanted = f"; give one signal, ({len(times)},)" if single else ""
        raise MeasurementError(f"values have shape {signal.shape}, but there are {len(times)} times{wanted}")
    finite("values", signal)
    return times, signal


def even_step(times_s: Float) -> float:
    """Step of evenly spaced times [s]. Raises MeasurementError if they are uneven."""
    steps = np.diff(times_s)
    step = float((times_s[-1] - times_s[0]) / len(steps))
    if step <= 0.0 or np.abs(steps - step).max() > 1e-3 * step:
        raise MeasurementError(
            f"times are not evenly spaced (steps {steps.min():.3g} to {steps.max():.3g} s); use an interval "
            "without gaps"
        )
    return step


def grid(values: ArrayLike, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Float, Float, Float]:
    """A map on a grid, shape (m, n), with its places x (m,) and y (n,), both rising, as float64 arrays.

    Raises MeasurementError for other shapes, places that do not rise, NaN and infinity.
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
    """Which places of a map count, shape (m, n), bool. Raises MeasurementError for another shape than the map's."""
    chosen = np.asarray(inside, dtype=bool)
    if chosen.shape != values.shape:
        raise MeasurementError(f"inside has shape {chosen.shape}; the map has {values.shape}")
    return chosen


def cell_areas(x_m: Float, y_m: Float) -> Float:
    """Area of each place of a grid [m^2], shape (m, n): half way to its neighbours, cut at the rim."""
    across = [np.diff(np.concatenate([p[:1], 0.5 * (p[1:] + p[:-1]), p[-1:]])) for p in (x_m, y_m)]
    return np.asarray(np.outer(*across))


def finite(what: str, values: Float) -> None:
    if not np.isfinite(values).all():
        place = np.argwhere(~np.isfinite(values))[0].tolist()
        raise MeasurementError(f"{what} at {place} is {values[tuple(place)]}; give finite numbers")


def share(what: str, value: float) -> None:
    """Raise MeasurementError if a share is not between 0 and 1, both excluded."""
    if not 0.0 < value < 1.0:
        raise MeasurementError(f"{what} is {value:g}; allowed: above 0 and below 1")


def whole(what: str, value: float, least: int, most: int) -> int:
    """The value as an int. Raises MeasurementError if it is no whole number from `least` to `most`."""
    if not least <= value <= most or value != int(value):
        raise MeasurementError(f"{what} is {value}; allowed: a whole number from {least} to {most}")
    return int(value)


def above_zero(what: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise MeasurementError(f"{what} is {value:g}; give a finite number above 0")
