"""What is asked for, and how far two answers are apart."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import SceneError
from palmfield.skin.problem import Slab
from palmfield.types import Float, Int

SERIES_FROM = 8
"""Asked times from which points are judged one by one, over time; fewer are judged over times and points."""
FAINT = 1e-3
"""Share of the largest motion below which a point is judged by that."""


def relative_error(found: Float, finer: Float) -> float:
    """L2 difference of motions (t, n, 3), relative to the finer one: over the times at each point, the largest of the
    points; over times and points together where there are few times."""
    if finer.size == 0:
        return 0.0
    over = (0, 2) if len(finer) >= SERIES_FROM else (0, 1, 2)
    size = np.sqrt((finer**2).sum(axis=over))
    floor = max(FAINT * float(size.max()), 1e-300)
    return float(np.max(np.sqrt(((found - finer) ** 2).sum(axis=over)) / np.maximum(size, floor)))


def pick(displacement: Float) -> Int:
    """Points to compare runs at: nearest to and farthest from the middle of the motion for series, else some of all."""
    times, points, _ = displacement.shape
    if times < SERIES_FROM:
        return np.unique(np.linspace(0, points - 1, min(points, 200)).astype(np.int32))
    order = np.argsort((displacement**2).sum(axis=(0, 2)), kind="stable")
    return np.unique(order[np.linspace(0, points - 1, min(points, 4)).astype(np.int32)]).astype(np.int32)


def check_points(body: Slab, times: ArrayLike, at: ArrayLike, accuracy: float) -> tuple[Float, Float]:
    """Times (t,) and points (n, 3) on the face. Raises SceneError for others, and for an accuracy out of range."""
    asked = np.asarray(times, dtype=float)
    if asked.ndim != 1 or len(asked) == 0 or not np.isfinite(asked).all() or not np.all(np.diff(asked) > 0.0):
        raise SceneError(f"times of shape {asked.shape} must be finite, rising and at least one")
    points = np.asarray(at, dtype=float)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) == 0 or not np.isfinite(points).all():
        raise SceneError(f"points have shape {points.shape}; give finite ones of shape (n, 2) or (n, 3), at least one")
    if not 1e-7 <= accuracy <= 0.5:
        raise SceneError(f"accuracy is {accuracy}; give a relative error from 1e-7 to 0.5")
    flat = np.zeros((len(points), 3))
    flat[:, :2] = points[:, :2]
    outside = np.zeros(len(points), dtype=bool)
    if body.radius_m is not None:
        outside = np.linalg.norm(flat, axis=1) > (1.0 + 1e-9) * body.radius_m
    elif body.size_m is not None:
        outside = np.any(np.abs(flat[:, :2]) > (0.5 + 1e-9) * np.asarray(body.size_m), axis=1)
    if outside.any():
        raise SceneError(f"point {points[outside][0].tolist()} lies off the {body.shape}; give points on its face")
    return asked, flat
