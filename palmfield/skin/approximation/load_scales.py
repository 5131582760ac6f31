"""Width, place and frequency of a load, for the choice of meshes and steps."""

import math

import numpy as np
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.skin.problem import GAUSSIAN, Body, Layer, Load, Spot, depth_of
from palmfield.types import Float

SAMPLES = 1 << 14
"""Number of evenly spaced samples of the time course of a load."""
MARGIN_S = 0.1
"""Least time before and after a load that is part of its course [s]."""
MOST = 0.95
"""Share of the power of a load over time below the frequency that a step must resolve."""
AT_SIDES = 1e-4
"""Pressure at the sides of a body, over the peak of the load, above which the sides affect the motion."""
ACROSS = 6.0
"""Least number of resolved lengths from the middle to the sides if the sides affect the motion."""


def load_width(load: Load) -> float:
    """Return the full width at half maximum [m] of the pressure of a load.

    For a traction it is the width of the Gaussian with the same (int p)^2 / int p^2, the smallest over the times.
    Raises SceneError if there is no pressure.
    """
    if isinstance(load, Spot):
        return load.fwhm_m
    pressure = np.asarray(load.pressure_Pa, dtype=float)
    square = (pressure**2) @ load.weights_m2
    acting = square > 1e-12 * square.max(initial=0.0)
    if not acting.any():
        raise SceneError("traction: pressure_Pa is 0 everywhere; give a nonzero pressure")
    area = (np.abs(pressure[acting]) @ load.weights_m2) ** 2 / square[acting]
    return float(math.sqrt(GAUSSIAN * area.min() / (2.0 * math.pi)))


def distance_to_sides(body: Body, places: Float) -> Float:
    """Return distances [m], (n,), of places (n, 2) from the nearest side: negative off a slab, inf without sides."""
    if isinstance(body, Layer):
        rim = body.patch.vertices[body.patch.rim, :2]
        return cKDTree(rim).query(places)[0] if len(rim) else np.full(len(places), np.inf)
    if body.shape == "disc":
        return (body.radius_m or 0.0) - np.hypot(*places.T)
    if body.shape == "box":
        return (0.5 * np.asarray(body.size_m) - np.abs(places)).min(axis=1)
    return np.full(len(places), np.inf)


def pressure_at_sides(body: Body, load: Load) -> float:
    """Return the largest pressure at the sides of a body over the peak of the load, 0 to 1."""
    if isinstance(load, Spot):
        room = np.maximum(distance_to_sides(body, load.centres()), 0.0)
        strength = np.abs(load.peak_Pa) * np.exp(-GAUSSIAN * (room / load.fwhm_m) ** 2)
        most = float(np.abs(load.peak_Pa).max())
    else:
        by_point = np.abs(load.pressure_Pa).max(axis=0)
        strength = by_point[distance_to_sides(body, load.points[:, :2]) < np.sqrt(load.weights_m2)]
        most = float(by_point.max(initial=0.0))
    return float(strength.max(initial=0.0)) / most if most > 0.0 else 0.0


def edge_is_felt(body: Body, load: Load, points: Float) -> bool:
    """Return whether load or requested points (n, 3) are near an edge where a fixed side meets the free face.

    Stresses are singular at such an edge, so smooth elements converge only at first order there.
    """
    held_side, held_base = body.side == "fixed", body.base not in ("free", "free_slip")
    if not (held_side or (body.side == "free" and held_base)):
        return False
    return bool(
        pressure_at_sides(body, load) >= AT_SIDES or distance_to_sides(body, points[:, :2]).min() < depth_of(body)
    )


def motion_width(body: Body, load: Load) -> float:
    """Return the length [m] along the face that elements must resolve: the width of the load.

    If pressure reaches the sides, it is at most the depth, because the effect of the sides decays over the depth. It is
    also at most a part of the distance from the middle to the sides. It has a lower limit relative to the body."""
    width = load_width(load)
    if pressure_at_sides(body, load) < AT_SIDES:
        return width
    if isinstance(body, Layer):
        extent = 0.5 * float(np.ptp(body.patch.vertices[:, :2], axis=0).min())
    else:
        extent = 0.5 * min(body.size_m) if body.size_m is not None else float(body.radius_m or math.inf)
    return min(width, max(min(depth_of(body), extent), extent / ACROSS))


def load_centre(load: Load) -> tuple[Float, float]:
    """Return the middle (2,) of the places of a load, and its distance from the farthest centre of the load [m]."""
    if isinstance(load, Spot):
        centres = load.centres()
    else:
        strength = np.abs(np.asarray(load.pressure_Pa, dtype=float)) * load.weights_m2
        acting = strength.sum(axis=1) > 0.0
        centres = strength[acting] @ load.points[:, :2] / strength[acting].sum(axis=1, keepdims=True)
    middle = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
    return middle, float(np.hypot(*(centres - middle).T).max())


def course_frequency(load: Load, share: float = MOST) -> float:
    """Return the frequency [Hz] below which `share` of the power of a load (about its mean) lies; 0 for few times.

    The time course is the peak of a spot, or the total force of a traction. It is piecewise linear, 0 before the first
    time and constant after the last. The window includes the duration of the load, at least MARGIN_S, before and after.
    """
    times = np.asarray(load.times_s, dtype=float)
    if len(times) < 3:
        return 0.0
    course = np.asarray(load.peak_Pa) if isinstance(load, Spot) else np.abs(load.pressure_Pa) @ load.weights_m2
    margin = max(times[-1] - times[0], MARGIN_S)
    even = np.linspace(times[0] - margin, times[-1] + margin, SAMPLES)
    values = np.interp(even, times, course, left=0.0)
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    if not power.sum() > 0.0:
        return 0.0
    place = int(np.searchsorted(np.cumsum(power), share * power.sum()))
    return float(np.fft.rfftfreq(len(even), even[1] - even[0])[place])


def mean_frequency(load: Load) -> float:
    """Return the mean frequency of a load with its constant part [Hz], rms rate over 2 pi rms; 0 for few times."""
    times = np.asarray(load.times_s, dtype=float)
    if len(times) < 3:
        return 0.0
    values = np.asarray(load.peak_Pa if isinstance(load, Spot) else load.pressure_Pa, dtype=float)
    values = values.reshape(len(times), -1)
    lengths = np.diff(times)[:, None]
    size = (0.5 * (values[1:] ** 2 + values[:-1] ** 2) * lengths).sum()
    rate = (np.diff(values, axis=0) ** 2 / lengths).sum()
    return math.sqrt(rate / size) / (2.0 * math.pi) if size > 0.0 else 0.0


def passing_frequency(load: Load, width_m: float) -> float:
    """Return v / (2 width) [Hz] for a spot with largest speed v; 0 for a spot at rest. At this frequency the spectrum
    of a passing Gaussian is a third of its maximum."""
    if not isinstance(load, Spot) or len(load.times_s) < 2:
        return 0.0
    speeds = np.linalg.norm(np.diff(load.centres(), axis=0), axis=1) / np.diff(load.times_s)
    return float(speeds.max()) / (2.0 * width_m)


def load_frequency(load: Load, speed_m_s: float, width_m: float) -> float:
    """Return the highest frequency that a step must resolve [Hz].

    It is the largest of three: c_s / (pi width), at which the skin oscillates after the end of a spot;
    passing_frequency; and, if the load is linear between more than three times, course_frequency.
    """
    course = course_frequency(load) if len(load.times_s) > 3 and load.law == "linear" else 0.0
    return max(speed_m_s / (math.pi * width_m), passing_frequency(load, width_m), course)
