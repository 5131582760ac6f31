"""Wake of a moving focus: its length, its area, and the angle of its fronts.

A snapshot is the normal velocity at one moment on a grid, shape (m, n), at rising x (m,) and y (n,) [m]. The focus is
at focus_x_m on y = 0 and moves along +x. Thresholds are shares of the largest magnitude of the snapshot. All functions
raise MeasurementError for other shapes and for snapshots of zeros.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import finite, grid, share
from palmfield.metrics.maps import area_above
from palmfield.skin.analytic.mach import mach_half_angle
from palmfield.types import Float

Until = Literal["last_above", "first_below"]
Estimator = Literal["ridge", "slant_stack"]


def wake_length(
    normal_velocity: ArrayLike,
    x_m: ArrayLike,
    y_m: ArrayLike,
    *,
    focus_x_m: float,
    threshold: float = 0.1,
    lateral_m: float | None = None,
    until: Until = "last_above",
) -> float:
    """Return the length of the wake behind a focus on a straight path [m].

    The envelope at each x is the largest magnitude across the path; it is linear between the positions. If it exceeds
    the threshold up to the end of the snapshot, the result is a lower bound. For curved paths use `wake_along_path`.
    Its threshold is a share of the maximum behind the focus, and it does not interpolate.

    normal_velocity: a snapshot [m/s], shape (m, n), at rising x_m (m,) and y_m (n,) [m]; the focus is at
        focus_x_m [m] on y = 0 and moves along +x
    threshold: share of the largest magnitude of the snapshot, above 0 and below 1
    lateral_m: full width of the strip about the path; None is the whole snapshot
    until: "last_above", up to the farthest point above the threshold; "first_below", up to the first point below
    Raises MeasurementError for other shapes and shares, a snapshot of zeros, and one without points behind the focus.
    """
    share("threshold", threshold)
    values, x, y = grid(normal_velocity, x_m, y_m)
    finite("focus_x_m", np.atleast_1d(focus_x_m))
    inside = np.ones(len(y), bool) if lateral_m is None else np.abs(y) <= 0.5 * lateral_m * (1.0 + 1e-9)
    if not inside.any():
        raise MeasurementError(
            f"lateral_m is {lateral_m} m; the nearest row of the snapshot is "
            f"{np.abs(y).min():g} m away; give the position of a row"
        )
    size = np.abs(values[:, inside])
    behind = np.flatnonzero(x <= focus_x_m + 1e-6 * (x[1] - x[0]))[::-1]
    if len(behind) < 2:
        raise MeasurementError(
            f"focus_x_m is {focus_x_m:g} m; the snapshot, which begins at {x[0]:g} m, has fewer than two points "
            "behind it"
        )
    return _reach(focus_x_m - x[behind], size[behind].max(axis=1), threshold * _largest(values), until)


def wake_along_path(
    arc_m: float, velocity: ArrayLike, places_m: ArrayLike, near: ArrayLike, threshold: float = 0.1
) -> tuple[float, Float, Float]:
    """Return the wake along a curved path: its length [m], distances behind the focus [m], and the envelope at them.

    arc_m: arc length that the focus has covered
    velocity: normal velocity of the nodes [m/s], shape (s,)
    places_m: rising arc lengths of points of the path, shape (k,)
    near: which nodes are near each point, shape (k, s), bool
    The envelope at a point is the largest magnitude of the nodes near it, divided by the maximum of the envelope behind
    the focus. The wake extends back to the first point at which the envelope is below the threshold. Neighbouring
    points of a curved path share nodes, so the envelope is not interpolated as in `wake_length`.
    """
    share("threshold", threshold)
    size, places = np.abs(np.asarray(velocity, dtype=float)), np.asarray(places_m, dtype=float)
    finite("the velocity", size)
    passed = places <= arc_m
    nearby = np.asarray(near, dtype=bool)
    if nearby.shape != (len(places), len(size)) or not passed.any():
        raise MeasurementError(
            f"near has shape {nearby.shape}; give ({len(places)}, {len(size)}), and places that lie behind {arc_m:g} m"
        )
    envelope = np.where(nearby[passed], size, 0.0).max(axis=1)
    envelope = envelope / _largest(envelope)
    still = np.flatnonzero(envelope < threshold)
    return float(arc_m - (places[still[-1]] if len(still) else 0.0)), arc_m - places[passed], envelope


def wake_area(normal_velocity: ArrayLike, x_m: ArrayLike, y_m: ArrayLike, *, threshold: float = 0.1) -> float:
    """Return the area where the magnitude of a snapshot reaches a threshold [m^2], both behind and ahead of the focus.

    Arguments and errors are those of `wake_length`.
    """
    share("threshold", threshold)
    values, x, y = grid(normal_velocity, x_m, y_m)
    size = np.abs(values)
    return area_above(size, x, y, threshold * _largest(size))


def mach_angle(
    normal_velocity: ArrayLike,
    x_m: ArrayLike,
    y_m: ArrayLike,
    *,
    focus_x_m: float,
    estimator: Estimator = "ridge",
    distances_m: tuple[float, float] = (0.02, 0.06),
    skip_m: float = 0.009,
) -> float:
    """Return the angle between the wave fronts behind a focus and its path [deg].

    estimator: "ridge" fits a line through the focus on each side of the path, and averages both angles. The line passes
        through the points of largest magnitude with the least absolute deviations. "slant_stack" is
        `palmfield.skin.analytic.mach_half_angle` on the whole snapshot
    distances_m: smallest and largest distance behind the focus that "ridge" uses
    skip_m: strip about the path that "slant_stack" omits
    Raises MeasurementError if fewer than three grid points are between the distances.
    """
    values, x, y = grid(normal_velocity, x_m, y_m)
    _largest(values)
    if estimator == "slant_stack":
        return mach_half_angle(values, x, y, skip_m)
    if estimator != "ridge":
        raise MeasurementError(f"estimator is '{estimator}'; use ridge or slant_stack")
    distance = focus_x_m - x
    near, far = distances_m
    chosen = (distance >= near * (1.0 - 1e-9)) & (distance <= far * (1.0 + 1e-9)) & (distance > 0.0)
    if chosen.sum() < 3:
        raise MeasurementError(
            f"{chosen.sum()} points of the snapshot lie {near:g} to {far:g} m behind the focus; needed: three or more"
        )
    angles = []
    for side in (y > 0.0, y < 0.0):
        if not side.any():
            raise MeasurementError(f"y goes from {y[0]:g} to {y[-1]:g} m; needed: both sides of the path")
        places = np.abs(y[side])[np.abs(values[np.ix_(chosen, side)]).argmax(axis=1)]
        angles.append(np.degrees(np.arctan(_slope(distance[chosen], places))))
    return float(np.mean(angles))


def _slope(distance: Float, place: Float) -> float:
    """Return the m that minimises sum |place - m distance|: the median of place/distance with weights distance."""
    ratio = place / distance
    order = np.argsort(ratio)
    weight = np.cumsum(distance[order])
    return float(ratio[order][np.searchsorted(weight, 0.5 * weight[-1])])


def _reach(distance: Float, envelope: Float, level: float, until: str) -> float:
    """Return the distance at which an envelope falls below a level.

    Distances rise; the envelope is linear between them.
    """
    above = envelope >= level
    if until == "last_above":
        last = int(np.flatnonzero(above)[-1]) if above.any() else -1
    elif until == "first_below":
        last = (int(np.flatnonzero(~above)[0]) if not above.all() else len(above)) - 1
    else:
        raise MeasurementError(f"until is '{until}'; use last_above or first_below")
    if last < 0:
        return 0.0
    if last == len(distance) - 1:
        return float(distance[-1])
    part = (envelope[last] - level) / (envelope[last] - envelope[last + 1])
    return float(distance[last] + part * (distance[last + 1] - distance[last]))


def _largest(values: Float) -> float:
    top = float(np.abs(values).max())
    if top == 0.0:
        raise MeasurementError("the snapshot is 0 everywhere and has no wake")
    return top
