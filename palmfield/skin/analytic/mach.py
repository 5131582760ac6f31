"""Half-angle of the wave fronts behind a focus that is faster than its waves."""

import numpy as np

from palmfield.errors import SceneError
from palmfield.types import Float

STEP_DEG = 0.1


def mach_half_angle(
    normal_velocity: Float, x: Float, y: Float, skip_m: float, *, between_deg: tuple[float, float] = (20.0, 89.0)
) -> float:
    """Return the angle [deg] between the wave fronts and the path of a focus that moves along +x on y = 0.

    normal_velocity: snapshot at x (m,) and y (n,) [m], both ascending, shape (m, n).
    skip_m: half width of the strip that is left out, with the load and its wake; use 1.5 spot widths.

    The method is a slant stack (discrete Radon transform). For a trial angle b and each s, the snapshot is averaged
    over |y| along the lines x + |y| / tan b = s. The result is the b with the largest sum of squares over s, by a
    parabola through the three best values. Straight fronts of this slope add up; round fronts do not. The sum is over
    x, because a sum over the distance between the lines would favour steep lines.
    Raises SceneError for shapes that do not fit, and if skip_m leaves less than three rows on a side.
    """
    values = np.asarray(normal_velocity, dtype=float)
    if values.shape != (len(x), len(y)) or not np.isfinite(values).all():
        raise SceneError(f"snapshot has shape {values.shape}; give finite values of shape ({len(x)}, {len(y)})")
    rows = np.flatnonzero(np.abs(y) >= skip_m)
    if min((y[rows] > 0.0).sum(), (y[rows] < 0.0).sum()) < 3:
        raise SceneError(f"skip_m is {skip_m} m, y ends at {np.abs(y).max():.3g} m: leave three rows on each side")
    angles = np.arange(between_deg[0], between_deg[1] + 0.5 * STEP_DEG, STEP_DEG)
    power = np.array([_stacked(values, x, y, rows, np.radians(angle)) for angle in angles])
    best = int(np.clip(np.argmax(power), 1, len(angles) - 2))
    before, top, after = power[best - 1 : best + 2]
    return float(angles[best] + 0.5 * STEP_DEG * (before - after) / (before - 2.0 * top + after))


def _stacked(values: Float, x: Float, y: Float, rows: np.ndarray, angle: float) -> float:
    """Return the sum over s of the squared mean along the lines of one slope; velocity is 0 outside the snapshot."""
    total = np.zeros(len(x))
    for row in rows:
        total += np.interp(x - abs(y[row]) / np.tan(angle), x, values[:, row], left=0.0, right=0.0)
    return float(np.sum((total / len(rows)) ** 2))
