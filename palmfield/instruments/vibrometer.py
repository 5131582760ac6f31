"""Scanning laser vibrometer, which measures the velocity along its beam at each point, with its electronics.

The frame is that of the surface. The line of sight of a beam is the unit vector from a point to the head, so that
motion towards the head is positive.
"""

import math
from typing import ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from pydantic import Field

from palmfield.config.base import NonNegative, Positive
from palmfield.errors import MeasurementError
from palmfield.instruments.settings import Settings, Vector3
from palmfield.instruments.signal_chain import Phase, highpass, integrated, lowpass, sampled
from palmfield.instruments.surface_motion import SurfaceMotion
from palmfield.types import Float

MOVES = 0.01
"""Share of the largest velocity above which a surface is considered to move."""


class Vibrometer(Settings):
    """Pose and settings of a vibrometer. Raises MeasurementError for values outside their limits."""

    instrument: ClassVar[str] = "vibrometer"
    incidence_deg: float = Field(default=0.0, ge=0, lt=90, description="angle of incidence of the beam to aim_m")
    azimuth_deg: float = Field(
        default=0.0, description="azimuth of the head about the normal, from x_axis, counter-clockwise"
    )
    distance_m: Positive | None = Field(
        default=None, description="distance of the head from aim_m; none: parallel beams"
    )
    aim_m: Vector3 = Field(default=(0.0, 0.0, 0.0), description="point at which the central beam hits the surface")
    normal: Vector3 = Field(default=(0.0, 0.0, 1.0), description="outward, at aim_m")
    x_axis: Vector3 = Field(default=(1.0, 0.0, 0.0), description="direction of azimuth 0, seen along the normal")
    as_normal: bool = Field(default=True, description="whether readings are divided by the cosine of incidence_deg")
    reading: Literal["velocity", "displacement"] = Field(
        default="displacement", description="displacement is integrated"
    )
    sampling_rate_Hz: Positive = Field(default=128e3, description="of the record")
    duration_s: Positive | None = Field(default=None, description="duration of the record; none: that of the motion")
    trigger_s: float = Field(default=0.0, description="start of the record, in the time of the motion")
    flight_s: NonNegative = Field(default=0.0, description="flight time of the sound, by which the motion is delayed")
    highpass_Hz: Positive | None = Field(
        default=None, description="cutoff of the Butterworth high-pass on the velocity; none: no filter"
    )
    highpass_order: int = Field(default=2, ge=1, le=12)
    lowpass_Hz: Positive | None = Field(
        default=None, description="cutoff of the Butterworth low-pass on the velocity; none: no filter"
    )
    lowpass_order: int = Field(default=5, ge=1, le=12)
    phase: Phase = Field(default="causal", description="of both filters")
    noise_m_s_rtHz: NonNegative = Field(default=0.0, description="spectral density of the white velocity noise")
    averages: int = Field(default=1, ge=1, description="number of averaged records; noise falls with its square root")


def lines_of_sight(points_m: ArrayLike, settings: Vibrometer) -> Float:
    """Return unit vectors from points [m], shape (n, 3), to the head, shape (n, 3).

    Raises MeasurementError for a normal of length 0, and for an x_axis along the normal.
    """
    points = np.atleast_2d(np.asarray(points_m, dtype=float))
    middle = middle_beam(settings)
    if settings.distance_m is None:
        return np.tile(middle, (len(points), 1))
    beams = np.array(settings.aim_m) + settings.distance_m * middle - points
    return np.asarray(beams / np.linalg.norm(beams, axis=1, keepdims=True))


def middle_beam(settings: Vibrometer) -> Float:
    """Return the line of sight at aim_m, shape (3,)."""
    normal = np.array(settings.normal)
    length = np.linalg.norm(normal)
    if not length > 0.0:
        raise MeasurementError(f"vibrometer: normal is {settings.normal}; give a direction")
    normal = normal / length
    along = np.array(settings.x_axis) - (normal @ np.array(settings.x_axis)) * normal
    if np.linalg.norm(along) < 1e-6 * max(float(np.linalg.norm(settings.x_axis)), 1e-300):
        raise MeasurementError(f"vibrometer: x_axis {settings.x_axis} lies along the normal; give another direction")
    along = along / np.linalg.norm(along)
    incidence, azimuth = math.radians(settings.incidence_deg), math.radians(settings.azimuth_deg)
    sideways = math.cos(azimuth) * along + math.sin(azimuth) * np.cross(normal, along)
    return np.asarray(math.cos(incidence) * normal + math.sin(incidence) * sideways)


def along_beam(motion: ArrayLike, sights: ArrayLike, settings: Vibrometer) -> Float:
    """Return vectors, shape (t, n, 3), projected to lines of sight, shape (n, 3), as shape (t, n).

    With settings.as_normal they are divided by the cosine of incidence_deg. For parallel beams and purely normal motion
    this is the normal motion. Tangential motion is added with the tangent of the angle: factor 1 at 45 degrees.
    """
    projected = np.einsum("tni,ni->tn", np.asarray(motion, dtype=float), np.asarray(sights, dtype=float))
    return np.asarray(projected / math.cos(math.radians(settings.incidence_deg)) if settings.as_normal else projected)


def vibrometer_record(
    motion: SurfaceMotion, settings: Vibrometer, *, sights: ArrayLike | None = None, seed: int | None = None
) -> xr.DataArray:
    """Return the record of each point, dimensions (time, point), in m/s or m by settings.reading.

    Order of operations: velocity along the beam, anti-aliasing low-pass, sampling, noise, high-pass, low-pass,
    integration. Time 0 is the trigger. sights: measured lines of sight, shape (n, 3), instead of those of the settings
    seed: seed of the noise; None for a random seed
    Coordinates: time [s]; x, y, z [m] and sight_x, sight_y, sight_z of each point.
    Raises MeasurementError for points that face away, records longer than the motion or with fewer than four samples,
    and records that begin before a motion that does not start at rest.
    """
    beams = lines_of_sight(motion.points, settings) if sights is None else np.asarray(sights, dtype=float)
    if beams.shape != motion.points.shape:
        raise MeasurementError(f"lines of sight have shape {beams.shape}; the points have {motion.points.shape}")
    _check_visible(motion, beams)
    moments, velocity = _from_rest(motion.times_s, along_beam(motion.velocity_m_s, beams, settings))
    rate = settings.sampling_rate_Hz
    start = settings.trigger_s - settings.flight_s
    lasts = motion.times_s[-1] - start if settings.duration_s is None else settings.duration_s
    count = math.floor(lasts * rate * (1.0 + 1e-12) + 1e-6) + (settings.duration_s is None)
    if count < 4:
        raise MeasurementError(f"a record of {lasts:g} s holds {count} samples at {rate:g} Hz; needed: four or more")
    _check_rest(moments, velocity, start)
    times = np.arange(count) / rate
    signal = sampled(moments, velocity, start + times)
    if settings.noise_m_s_rtHz > 0.0:
        # White noise with a one-sided density up to half the rate
        deviation = settings.noise_m_s_rtHz * math.sqrt(0.5 * rate / settings.averages)
        signal = signal + np.random.default_rng(seed).normal(0.0, deviation, signal.shape)
    return labelled(times, chain(signal, settings), motion.points, beams, settings.reading)


def _from_rest(times: Float, velocity: Float) -> tuple[Float, Float]:
    """Add time 0, at which runs and solvers are at rest; their first sample is one step later."""
    if not 0.0 < times[0] <= 1.5 * (times[1] - times[0]):
        return times, velocity
    return np.append(0.0, times), np.concatenate([np.zeros_like(velocity[:1]), velocity])


def _check_rest(times: Float, velocity: Float, start: float) -> None:
    """Raise MeasurementError if the record begins before the motion and the motion does not begin at rest."""
    if start >= times[0] - 1e-6 * (times[1] - times[0]):
        return
    first, most = float(np.abs(velocity[0]).max()), float(np.abs(velocity).max())
    if first > MOVES * most:
        raise MeasurementError(
            f"the record begins at {start:g} s, but the motion begins at {times[0]:g} s with "
            f"{100 * first / most:.2g} % of its largest velocity; begin at rest, or correct trigger_s and flight_s"
        )


def _check_visible(motion: SurfaceMotion, beams: Float) -> None:
    across = np.einsum("ni,ni->n", motion.normals, beams)
    worst = int(across.argmin())
    if across[worst] <= 0.0:
        place, normal = (", ".join(f"{x:.3g}" for x in part[worst]) for part in (motion.points, motion.normals))
        raise MeasurementError(
            f"vibrometer: point {worst} at ({place}) m, whose outward normal is ({normal}), faces away from the "
            "head; correct normal, aim_m or incidence_deg, or remove the point"
        )


def chain(velocity: ArrayLike, settings: Vibrometer) -> Float:
    """Apply filters and integration to velocities along the beam at the sampling rate, shape (t, n)."""
    signal = np.asarray(velocity, dtype=float)
    rate = settings.sampling_rate_Hz
    if settings.highpass_Hz is not None:
        signal = highpass(signal, rate, settings.highpass_Hz, settings.highpass_order, phase=settings.phase)
    if settings.lowpass_Hz is not None:
        signal = lowpass(signal, rate, settings.lowpass_Hz, settings.lowpass_order, phase=settings.phase)
    return integrated(signal, rate) if settings.reading == "displacement" else signal


def labelled(times_s: Float, values: Float, points_m: Float, sights: Float, reading: str) -> xr.DataArray:
    """Return a record with times, points and lines of sight as coordinates."""
    units = "m" if reading == "displacement" else "m s-1"
    coordinates = {"time": ("time", times_s, {"units": "s", "long_name": "from the trigger"})}
    for column, axis in enumerate("xyz"):
        coordinates[axis] = ("point", points_m[:, column], {"units": "m"})
        coordinates[f"sight_{axis}"] = ("point", sights[:, column], {"units": "1"})
    attributes = {"units": units, "long_name": f"{reading} along the beam", "sign": "positive towards the head"}
    return xr.DataArray(values, coordinates, ("time", "point"), reading, attributes)
