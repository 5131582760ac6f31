"""Difference of two solutions."""

import numpy as np

from palmfield.types import Float, Int

SERIES_FROM = 8
"""Least number of requested times for which the error of each point is computed over time."""
FEW_POINTS = 32
"""Largest number of points with separate errors at fewer times; more points are a snapshot with one error."""
FAINT = 1e-3
"""Share of the largest motion that is the least reference for errors of points."""


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
