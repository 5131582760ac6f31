"""Compute maps of levels in the sphere of a head and on skins, for the picture of a safety sheet."""

from collections.abc import Sequence

import numpy as np

from palmfield.acoustics.exposure import OCCUPATIONAL_DB, PUBLIC_DB, REFERENCE_PA, ball_points
from palmfield.config import DriverConfig
from palmfield.hardware.safety.exposure import Exposure, SoundMoment, peaks_at
from palmfield.outputs.safety_picture import LevelCourse, LevelMap
from palmfield.types import Float

GRID = 61
"""Number of points across the sphere of a head."""
COURSE_SPACING_M = 20e-3
"""Spacing of the points in the sphere of a head at which the level over time is computed [m]."""


def levels_dB(peaks_Pa: Float) -> Float:
    """Return the sound pressure levels of peak pressures, of the same shape; -inf for silence."""
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(np.asarray(peaks_Pa) / (np.sqrt(2.0) * REFERENCE_PA)))


def head_map(moments: Sequence[SoundMoment], driver: DriverConfig, point: Exposure, transducers: Float) -> LevelMap:
    """Map the sphere of a head in the plane through its centre, the array centre and its loudest point.

    transducers: positions [m], shape (n, 3)
    """
    assert driver.head_m is not None
    middle, radius = np.array(driver.head_m), driver.head_radius_m
    along = middle - transducers.mean(axis=0)
    along /= np.linalg.norm(along)
    across = point.place - middle
    across = across - (across @ along) * along
    if np.linalg.norm(across) < 1e-9:
        across = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    across /= np.linalg.norm(across)
    steps = np.linspace(-radius, radius, GRID)
    plane = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    plane = plane[np.linalg.norm(plane, axis=1) <= radius * (1.0 + 1e-9)]
    peaks, _ = peaks_at(moments, middle + plane[:, :1] * across + plane[:, 1:] * along)
    loudest = np.array([(point.place - middle) @ across, (point.place - middle) @ along])
    own = {} if driver.head_limit_dB is None else {"head_limit_dB": driver.head_limit_dB}
    limits = {"public": PUBLIC_DB, "at work": OCCUPATIONAL_DB, **own}
    axes = "across, through the loudest point", "away from the array"
    return LevelMap("head", plane, levels_dB(peaks), loudest, point.level_dB, limits, axes)


def skin_map(name: str, points: Float, peaks_Pa: Float, point: Exposure) -> LevelMap:
    """Map a skin in the plane of its two largest extents.

    points: points of the skin at its loudest moment [m], shape (n, 3)
    """
    middle = points.mean(axis=0)
    wide = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
    places = (points - middle) @ wide.T
    loudest = (point.place - middle) @ wide.T
    axes = "along the skin", "across it"
    return LevelMap(name, places, levels_dB(peaks_Pa), loudest, point.level_dB, {}, axes)


def course(
    times_s: Float, moments: Sequence[SoundMoment | None], driver: DriverConfig, head: Exposure, skins: dict[str, Float]
) -> LevelCourse:
    """Compute the levels during a play.

    moments: one moment for each time, None for silence
    skins: peak pressures [Pa] at each of these times
    """
    assert driver.head_m is not None
    ball = ball_points(np.array(driver.head_m), driver.head_radius_m, COURSE_SPACING_M)
    points = np.concatenate([head.place[None], ball])
    peaks = [0.0 if one is None else float(np.abs(one.pressure(points)).max()) for one in moments]
    levels = {"head": levels_dB(np.array(peaks)), **{name: levels_dB(own) for name, own in skins.items()}}
    return LevelCourse(times_s, levels)
