"""Metrics of a map over a surface: diameters, areas above a level, radial profiles, and the halved-pressure depth."""

import itertools
from typing import Literal

import numpy as np
from contourpy import contour_generator
from numpy.typing import ArrayLike

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import finite, grid, share
from palmfield.types import Float

Diameter = Literal["equal_area", "widest"]
Lobe = Literal["outermost", "central"]


def area_above(values: ArrayLike, x_m: ArrayLike, y_m: ArrayLike, level: float) -> float:
    """Return the area in which a map reaches a level [m^2]; the map is linear between grid points.

    values: shape (m, n) at rising x (m,) and y (n,) [m]; level: level in the unit of the map
    Raises MeasurementError for other shapes, and for values or a level that are not finite.
    """
    field, x, y = grid(values, x_m, y_m)
    if not np.isfinite(level):
        raise MeasurementError(f"level is {level}; give a finite number in the map's unit")
    total = 0.0
    for corners in _filled(field, x, y, level):
        ahead = np.roll(corners, -1, axis=0)
        total += 0.5 * float((corners[:, 0] * ahead[:, 1] - ahead[:, 0] * corners[:, 1]).sum())
    return abs(total)


def spot_diameter(
    values: ArrayLike, x_m: ArrayLike, y_m: ArrayLike, level_of_peak: float = 0.2, *, of: Diameter = "equal_area"
) -> float:
    """Return the diameter of the region where the magnitude of a map exceeds a share of its maximum [m].

    values: shape (m, n) at rising x (m,) and y (n,) [m]
    level_of_peak: share of the maximum, above 0 and below 1
    of: "equal_area", diameter of the circle of equal area; "widest", largest distance of two points of the region
    Raises MeasurementError for a map of zeros, and for a region of unknown size because it reaches the rim of the map.
    """
    share("level_of_peak", level_of_peak)
    field, x, y = grid(np.abs(np.asarray(values, dtype=float)), x_m, y_m)
    top = float(field.max())
    if top == 0.0:
        raise MeasurementError("the map is 0 everywhere and has no spot")
    level = level_of_peak * top
    rim = np.concatenate([field[0], field[-1], field[:, 0], field[:, -1]]).max()
    if rim >= level:
        raise MeasurementError(
            f"at the rim of the map {rim / top:.2g} of the peak is left; needed: less than {level_of_peak:g}: give "
            "a wider map"
        )
    if of == "equal_area":
        return float(2.0 * np.sqrt(area_above(field, x, y, level) / np.pi))
    if of != "widest":
        raise MeasurementError(f"of is '{of}'; use equal_area or widest")
    outline = np.concatenate([np.asarray(line) for line in contour_generator(x, y, field.T).lines(level)])
    return float(np.sqrt(((outline[:, None] - outline) ** 2).sum(axis=2)).max())


def radial_profile(
    values: ArrayLike, points_m: ArrayLike, radii_m: ArrayLike, weights: ArrayLike | None = None
) -> Float:
    """Return the mean of a map over each ring about the origin, shape (k,); NaN for a ring without points.

    values: shape (n,); points: positions, shape (n, 2) or (n, 3) [m], of which only x and y are used
    radii_m: rising limits of the rings, shape (k + 1,); weights: area of each point, shape (n,), default equal
    """
    field, points, edges = (np.asarray(part, dtype=float) for part in (values, points_m, radii_m))
    share_of = np.ones(np.shape(field)) if weights is None else np.asarray(weights, dtype=float)
    finite("values", np.atleast_1d(field))
    if field.ndim != 1 or points.ndim != 2 or points.shape[0] != len(field) or share_of.shape != field.shape:
        raise MeasurementError(
            f"points have shape {points.shape} and weights {share_of.shape}, but values {field.shape}"
        )
    if edges.ndim != 1 or len(edges) < 2 or not np.all(np.diff(edges) > 0.0):
        raise MeasurementError("radii_m must be at least two lengths that rise")
    radius = np.hypot(points[:, 0], points[:, 1])
    total = np.histogram(radius, edges, weights=share_of * field)[0]
    count = np.histogram(radius, edges, weights=share_of)[0]
    return np.where(count > 0.0, total / np.where(count > 0.0, count, 1.0), np.nan)


def level_depth(depth_m: ArrayLike, values: ArrayLike, reference_m: float, level: float = 0.5) -> float:
    """Return the distance beyond `reference_m` at which a curve first falls to `level` times its value there [m].

    depth_m: rising distances from the array [m], shape (n,); values: shape (n,), linear between the distances, for
        example the pressure at a focus placed at each distance
    With level 0.5 this is the halved-pressure depth. The reference is an argument, because not all papers state it.
    Raises MeasurementError if the reference is outside the curve, or the curve stays above the level.
    """
    depth, curve = np.asarray(depth_m, dtype=float), np.asarray(values, dtype=float)
    share("level", level)
    if depth.ndim != 1 or curve.shape != depth.shape or len(depth) < 2 or not np.all(np.diff(depth) > 0.0):
        raise MeasurementError(
            f"depths of shape {depth.shape} must rise and have as many entries as values {curve.shape}"
        )
    finite("values", curve)
    if not depth[0] <= reference_m <= depth[-1]:
        raise MeasurementError(f"reference_m is {reference_m:g} m; the curve goes from {depth[0]:g} to {depth[-1]:g} m")
    goal = level * float(np.interp(reference_m, depth, curve))
    if goal <= 0.0:
        raise MeasurementError(f"the curve is {goal / level:g} at {reference_m:g} m; give one that is above 0 there")
    low = np.flatnonzero((depth > reference_m) & (curve <= goal))
    if len(low) == 0:
        raise MeasurementError(
            f"up to {depth[-1]:g} m the curve stays above {level:g} of its value at {reference_m:g} m: give a "
            "longer curve"
        )
    after = int(low[0])
    before = max(float(depth[after - 1]), reference_m)
    high = float(np.interp(before, depth, curve))
    part = (high - goal) / (high - curve[after])
    return float(before + part * (depth[after] - before))


def half_width(at_m: ArrayLike, values: ArrayLike, level: float = 0.5, *, of: Lobe = "outermost") -> float:
    """Return the mean distance from the maximum of a curve to its fall below `level` times the maximum [m].

    The mean is over both sides. For a curve with one maximum and level 0.5, the result is half of the full width at
    half maximum.

    at_m: rising positions along a line [m], shape (n,)
    values: 0 or above, shape (n,), linear between positions
    of: "outermost": distance to the last position on each side that reaches the level (envelope of interference
        fringes); "central": distance to the first position below the level (central fringe)
    Raises MeasurementError for other shapes, a curve of zeros, and a curve that exceeds the level at an end.
    """
    share("level", level)
    places, curve = np.asarray(at_m, dtype=float), np.asarray(values, dtype=float)
    if places.ndim != 1 or curve.shape != places.shape or len(places) < 3 or not np.all(np.diff(places) > 0.0):
        raise MeasurementError(
            f"places of shape {places.shape} must rise and have as many entries as values {curve.shape}"
        )
    finite("values", curve)
    if of not in ("outermost", "central"):
        raise MeasurementError(f"of is '{of}'; use outermost or central")
    top = int(curve.argmax())
    goal = level * float(curve[top])
    if goal <= 0.0:
        raise MeasurementError("the curve is 0 everywhere and has no width")
    reached = curve >= goal
    if reached[0] or reached[-1]:
        raise MeasurementError(
            f"at an end, {places[0]:g} or {places[-1]:g} m, the curve still exceeds {level:g} of its maximum: give "
            "a longer curve"
        )
    below = np.flatnonzero(~reached)
    if of == "central":
        low, high = int(below[below < top][-1]), int(below[below > top][0])
    else:
        inside = np.flatnonzero(reached)
        low, high = int(inside[0]) - 1, int(inside[-1]) + 1
    ends = [
        places[out] + (goal - curve[out]) / (curve[within] - curve[out]) * (places[within] - places[out])
        for out, within in ((low, low + 1), (high, high - 1))
    ]
    return float(0.5 * (ends[1] - ends[0]))


def _filled(field: Float, x: Float, y: Float, level: float) -> list[Float]:
    """Return the outlines of the regions where a map reaches a level.

    Outlines of holes have the opposite orientation.
    """
    top = max(float(field.max()), level) + 1.0 + abs(level)
    rings: list[Float] = []
    for points, offsets in zip(
        *contour_generator(x, y, field.T, fill_type="OuterOffset").filled(level, top), strict=True
    ):
        rings += [np.asarray(points[a:b]) for a, b in itertools.pairwise(offsets)]
    return rings
