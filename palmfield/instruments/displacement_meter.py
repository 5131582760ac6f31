"""Laser displacement meter (triangulation), which measures the distance of the surface along its beam."""

import math
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from pydantic import Field

from palmfield.config.base import NonNegative, Positive
from palmfield.errors import MeasurementError
from palmfield.instruments.scan import pitch
from palmfield.instruments.settings import Settings, Vector3
from palmfield.instruments.signal_chain import sampled
from palmfield.instruments.surface_motion import SurfaceMotion

NEAR_M = 1e-3
"""Largest distance of a beam of zero width from a point of the motion, unless points are farther apart."""


class DisplacementMeter(Settings):
    """A displacement meter. Raises MeasurementError for values outside their limits."""

    instrument: ClassVar[str] = "displacement_meter"
    beam: Vector3 = Field(default=(0.0, 0.0, 1.0), description="distance from the surface to the head")
    spot_m: NonNegative = Field(
        default=0.0, description="diameter of the light spot at 1/e^2 of its centre; 0: a point"
    )
    sampling_rate_Hz: Positive = Field(default=10e3)
    averaged: int = Field(default=1, ge=1, description="number of readings in the moving average")
    range_m: Positive | None = Field(default=None, description="measuring range, plus and minus; none: unlimited")
    resolution_m: NonNegative = Field(default=0.0, description="resolution of the readings; 0: unlimited")
    repeatability_m: NonNegative = Field(default=0.0, description="standard deviation of one reading")


def spot_weights(points_m: ArrayLike, at_m: ArrayLike, settings: DisplacementMeter) -> np.ndarray:
    """Return the weights of points in the mean over the spot, shape (n,): the Gaussian intensity of the light.

    The points represent equal areas. A spot of size 0 uses the nearest point.
    Raises MeasurementError if fewer than four points are within the spot, and for size 0 if no point is nearer than the
    spacing of the points or NEAR_M.
    """
    points, at = np.asarray(points_m, dtype=float), np.asarray(at_m, dtype=float)
    if at.shape != (3,) or not np.isfinite(at).all():
        raise MeasurementError(f"displacement_meter: the position is {at.tolist()}; give three finite numbers")
    beam = np.array(settings.beam) / np.linalg.norm(settings.beam)
    away = points - at
    distance = np.linalg.norm(away - np.outer(away @ beam, beam), axis=1)
    if settings.spot_m == 0.0:
        allowed = max(NEAR_M, pitch(points) if len(points) > 1 else 0.0)
        if distance.min() > allowed:
            raise MeasurementError(
                f"displacement_meter: the beam is {distance.min():.3g} m from the nearest point of the motion; "
                f"allowed: {allowed:.3g} m; move the beam"
            )
        return np.asarray(np.arange(len(points)) == distance.argmin(), dtype=float)
    within = int((distance <= 0.5 * settings.spot_m).sum())
    if within < 4:
        raise MeasurementError(
            f"{within} points lie within the spot of {settings.spot_m:g} m; needed: four or more; give more "
            "points, or spot_m 0"
        )
    weights = np.exp(-8.0 * (distance / settings.spot_m) ** 2)
    return np.asarray(weights / weights.sum())


def displacement_reading(
    motion: SurfaceMotion, at_m: ArrayLike, settings: DisplacementMeter, *, seed: int | None = None
) -> xr.DataArray:
    """Return the reading at a point over time, dimension (time,), in metres, positive towards the head.

    The beam is fixed in space, so with tangential motion or an oblique beam it meets other points of the surface. The
    reading is (u . n)/(b . n) for motion u, normal n and beam b; a vibrometer reads u . b.
    Order of operations: mean over the spot, sampling, moving average, noise, range, resolution.
    Raises MeasurementError for a beam of length 0 or along the surface, and like `spot_weights`.
    """
    beam = np.array(settings.beam)
    if not np.linalg.norm(beam) > 0.0:
        raise MeasurementError(f"displacement_meter: beam is {settings.beam}; give a direction")
    across = motion.normals @ (beam / np.linalg.norm(beam))
    weights = spot_weights(motion.points, at_m, settings)
    if np.abs(across[weights > 1e-6]).min() < 1e-3:
        raise MeasurementError(f"displacement_meter: beam {settings.beam} lies along the surface; give another")
    chosen = weights > 1e-12
    read = np.einsum("tni,ni->tn", motion.displacement_m[:, chosen], motion.normals[chosen]) / across[chosen]
    rate = settings.sampling_rate_Hz
    times = np.arange(math.floor((motion.times_s[-1] - motion.times_s[0]) * rate + 1e-6) + 1) / rate
    signal = sampled(motion.times_s, read @ weights[chosen], motion.times_s[0] + times)
    if settings.averaged > 1:
        padded = np.concatenate([np.full(settings.averaged - 1, signal[0]), signal])
        signal = np.convolve(padded, np.full(settings.averaged, 1.0 / settings.averaged), mode="valid")
    signal = signal + np.random.default_rng(seed).normal(0.0, settings.repeatability_m, len(signal))
    if settings.range_m is not None:
        signal = np.clip(signal, -settings.range_m, settings.range_m)
    if settings.resolution_m > 0.0:
        signal = settings.resolution_m * np.round(signal / settings.resolution_m)
    attributes = {"units": "m", "long_name": "distance along the beam", "sign": "positive towards the head"}
    return xr.DataArray(signal, {"time": motion.times_s[0] + times}, ("time",), "displacement", attributes)
