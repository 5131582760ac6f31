"""Compute maps of the face: rms and steady displacement of the three stimuli, raw and through the vibrometer."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from palmfield.instruments import SurfaceMotion, sampled, vibrometer_record
from palmfield.metrics import mean_value, rms_map
from palmfield.types import Float
from palmfield_papers.chilles2019.runs import (
    ANGLES,
    MAP_RATE_HZ,
    along_radius,
    circle_radii,
    on_circles,
)
from palmfield_papers.chilles2019.setup import RADIUS_M, STIMULUS_S, Case, Probe, Stimulus
from palmfield_papers.chilles2019.traces import UM, vibrometer

GRID_M = 1e-3
STEADY_S = (0.18, 0.2)
RAYS = 8
"""Number of angles from the side of the head to the other side at which readings are computed along a ray."""
GROUP = 1000


@dataclass(frozen=True)
class Map:
    """A number [um] at points of the face. values: shape (n, n) at x and y [m], x first; error: relative error"""

    axis_m: Float
    values: Float
    error: float


@dataclass(frozen=True)
class Circles:
    """An rms [um] on circles.

    values: shape (radii, angles), at radii [m]; middle: in the centre; error: relative error
    """

    radii_m: Float
    values: Float
    middle: float
    error: float


def grid_axis() -> Float:
    half = round(RADIUS_M / GRID_M)
    return np.asarray(GRID_M * np.arange(-half, half + 1))


def raw_profile(case: Case, stimulus: Stimulus, of: str) -> tuple[Float, Float, float]:
    """Return radii [m] at steps of 1 mm, the rms or steady vertical displacement [um] within 200 ms, and its error."""
    run = along_radius(case, stimulus)
    times = np.arange(round(STIMULUS_S * MAP_RATE_HZ) + 1) / MAP_RATE_HZ
    moved = UM * case.level_Pa * sampled(run.motion.times_s, run.motion.displacement_m[:, :, 2], times)
    if of == "rms of the displacement":
        return run.motion.points[:, 0], rms_map(times, moved), run.error
    steady = np.array([mean_value(times, one, STEADY_S) for one in moved.T])
    return run.motion.points[:, 0], np.abs(steady), run.error


def round_map(radii_m: Float, profile: Float, error: float) -> Map:
    """Return a map of an axisymmetric quantity on the disc, 0 outside."""
    axis = grid_axis()
    radius = np.hypot(*np.meshgrid(axis, axis, indexing="ij"))
    return Map(axis, np.where(radius <= RADIUS_M + 1e-9, CubicSpline(radii_m, profile)(radius), 0.0), error)


def measured_map(case: Case, stimulus: Stimulus, probe: Probe) -> Map:
    """Return the rms over 256 ms of the vibrometer reading under a spot in the centre, 0 outside the disc."""
    one = _measured_map(replace(case, level_Pa=1.0), stimulus, replace(probe, azimuth_deg=0.0))
    values = case.level_Pa * one.values
    # The motion is axisymmetric, so a head at 90 degrees records the rotated map
    return replace(one, values=values.T if probe.azimuth_deg == 90.0 else values)


@cache
def _measured_map(case: Case, stimulus: Stimulus, probe: Probe) -> Map:
    """Compute `measured_map` from points on rays. The mean square is a sum of cosines of the angle to the head."""
    run, axis = along_radius(case, stimulus), grid_axis()
    angles = np.pi * np.arange(RAYS + 1) / RAYS
    radii = run.motion.points[:, 0]
    places = (radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)).reshape(-1, 2)
    square = np.concatenate([_rms(part, probe) for part in _spun(run.motion, places)]).reshape(len(radii), -1) ** 2
    cosines = np.cos(np.outer(angles, np.arange(RAYS + 1)))
    parts = np.linalg.solve(cosines, square.T).T
    # Across the centre even terms continue, and odd ones change their sign
    beyond = parts[:0:-1] * (-1.0) ** np.arange(RAYS + 1)
    of_radius = CubicSpline(np.concatenate([-radii[:0:-1], radii]), np.concatenate([beyond, parts]))
    x, y = np.meshgrid(axis, axis, indexing="ij")
    inside = np.hypot(x, y) <= RADIUS_M + 1e-9
    angle = np.arctan2(np.abs(y), x)[inside]
    pattern = of_radius(np.hypot(x, y)[inside]) * np.cos(np.outer(angle, np.arange(RAYS + 1)))
    values = np.zeros(x.shape)
    values[inside] = np.sqrt(np.maximum(pattern.sum(axis=1), 0.0))
    return Map(axis, values, run.error)


def _rms(motion: SurfaceMotion, probe: Probe) -> Float:
    record = vibrometer_record(motion, vibrometer(probe, MAP_RATE_HZ))
    return UM * rms_map(record["time"].values, record.values)


def _spun(motion: SurfaceMotion, places: Float) -> Iterator[SurfaceMotion]:
    """Yield axisymmetric motion at points (n, 2), computed from the motion along the x axis, in groups."""
    radii = motion.points[:, 0]
    lines = [
        CubicSpline(radii, values[:, :, (0, 2)], axis=1) for values in (motion.displacement_m, motion.velocity_m_s)
    ]
    for first in range(0, len(places), GROUP):
        part = places[first : first + GROUP]
        radius = np.hypot(*part.T)
        outwards = part / np.maximum(radius, 1e-12)[:, None]
        moved = []
        for line in lines:
            along, up = np.moveaxis(line(radius), 2, 0)
            moved.append(np.stack([along * outwards[:, 0], along * outwards[:, 1], up], axis=2))
        points = np.column_stack([part, np.zeros(len(part))])
        yield SurfaceMotion(motion.times_s, points, np.tile([0.0, 0.0, 1.0], (len(part), 1)), *moved)


def measured_circles(case: Case, probe: Probe) -> Circles:
    """Return the rms over 256 ms of the vibrometer reading under the moving spot."""
    one = _measured_circles(replace(case, level_Pa=1.0), probe)
    return replace(one, values=case.level_Pa * one.values, middle=case.level_Pa * one.middle)


@cache
def _measured_circles(case: Case, probe: Probe) -> Circles:
    run = on_circles(case)
    values = _rms(run.motion, probe)
    return Circles(circle_radii(case.quick), values[1:].reshape(-1, ANGLES), float(values[0]), run.error)
