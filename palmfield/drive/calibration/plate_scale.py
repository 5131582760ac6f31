"""Estimate p0 from the force on a plate on a scale, with the sound switched on and off at several distances."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex, Field, Float

LAW = 0.1
"""Relative error of the local radiation-pressure law for the force on a plate of a few wavelengths."""
PER_WAVELENGTH = 8
"""Points of the plate per wavelength, along each side."""


@dataclass(frozen=True)
class PlateFit:
    """Result of the fit.

    p0_Pa_m: p0, its standard error from the scatter, and the ends of its 95 % interval with the error of the law
    fringe: relative amplitude of the variation of the force with distance, from sound between plate and array
    drift_N_s: drift of the scale [N/s]
    """

    p0_Pa_m: float
    p0_sd_Pa_m: float
    low_Pa_m: float
    high_Pa_m: float
    fringe: float
    drift_N_s: float


def fit_plate(
    array: Array,
    air: Air,
    drive: ArrayLike,
    size_m: tuple[float, float],
    distances_m: ArrayLike,
    times_s: ArrayLike,
    on: ArrayLike,
    forces_N: ArrayLike,
    level: float = 1.0,
) -> PlateFit:
    """Fit p0 by the local law to the forces on the scale.

    F(t) = on p0^2 f(h) (1 + a cos 2kh + b sin 2kh) + draught(h) + drift t. f is the force of the law for p0 = 1 on the
    plate at distance h. a and b describe the fringes (half a wavelength long) due to sound between plate and array. The
    draught is the reading at a distance with the array off. The unknowns of a linear least-squares problem are p0^2,
    p0^2 a, p0^2 b, draughts and drift.

    array: array with calibrated gains; drive: complex amplitudes, shape (n,), of transducers as wired
    size_m: size of the plate, which is centred on the axis of the array and perpendicular to it
    distances_m, times_s, on, forces_N: values of each reading, shape (k,); on is 1 while the array sounds, else 0
    level: pressure of the array relative to full drive
    Raises PalmfieldError for fewer than 4 distances, distances spread over much more than half a wavelength, a distance
    without readings both with and without sound, numbers that are not finite, and a plate without force.
    """
    h, t, sounding, force = (np.asarray(values, float) for values in (distances_m, times_s, on, forces_N))
    _check(h, t, sounding, force, size_m)
    speed = sound_speed(air)
    k = 2.0 * math.pi * array.frequency_Hz / speed
    places = np.unique(h)
    if len(places) < 4 or np.ptp(places) > 0.5 * speed / array.frequency_Hz * 1.5:
        raise PalmfieldError(
            f"{len(places)} distances over {1e3 * np.ptp(places):.2f} mm; needed: at least 4, spread over half a "
            f"wavelength ({500 * speed / array.frequency_Hz:.2f} mm), to separate fringes from p0"
        )
    for place in places:
        if len(np.unique(sounding[h == place])) < 2:
            raise PalmfieldError(
                f"distance {place:g} m lacks readings with the array on or off: give both at each distance"
            )
    unit = np.array([plate_force(array, air, np.asarray(drive, complex), size_m, place) for place in places])
    unit *= level**2 / array.p0_Pa_m**2
    pushed = sounding * unit[np.searchsorted(places, h)]
    columns = [pushed, pushed * np.cos(2.0 * k * h), pushed * np.sin(2.0 * k * h), t - t.mean()]
    columns += [(h == place).astype(float) for place in places]
    matrix = np.column_stack(columns)
    scale = np.linalg.norm(matrix, axis=0)
    if len(force) <= matrix.shape[1]:
        raise PalmfieldError(
            f"{len(force)} readings for {matrix.shape[1]} unknowns: give more readings with the array on and off"
        )
    if not scale.all():
        raise PalmfieldError(
            "all readings have the same time: give their times [s], which the drift of the scale needs"
        )
    fit, _, rank, _ = np.linalg.lstsq(matrix / scale, force, rcond=None)
    if rank < matrix.shape[1]:
        raise PalmfieldError("the distances cannot separate p0 from fringes: spread them evenly over half a wavelength")
    variance = float(np.sum((force - (matrix / scale) @ fit) ** 2)) / (len(force) - matrix.shape[1])
    covariance = np.linalg.inv((matrix / scale).T @ (matrix / scale)) * variance
    fit, errors = fit / scale, np.sqrt(np.diag(covariance)) / scale
    if fit[0] <= 0.0:
        raise PalmfieldError(
            f"the array pulls the plate by {-fit[0] * unit.mean():.3g} N: check the sign of forces_N (a push is +)"
        )
    p0 = math.sqrt(fit[0])
    error = 0.5 * errors[0] / p0
    spread = math.hypot(1.96 * error / p0, 0.5 * LAW)
    return PlateFit(
        p0, error, p0 / (1.0 + spread), p0 * (1.0 + spread), math.hypot(fit[1], fit[2]) / fit[0], float(fit[3])
    )


def plate_force(array: Array, air: Air, drive: Complex, size_m: tuple[float, float], distance_m: float) -> float:
    """Return the force away from the array [N] on a plate at a distance, by the default law and a float64 field."""
    step = sound_speed(air) / array.frequency_Hz / PER_WAVELENGTH
    lines = [_midpoints(size, step) for size in size_m]
    x, y = np.meshgrid(*(line for line, _ in lines), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, distance_m)])
    pressure, gradient = pressure64(points, array, drive, air, gradient=True)
    assert gradient is not None
    sound = Field(pressure.astype(np.complex64), gradient.astype(np.complex64))
    toward_array = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    pushes = arp(sound, toward_array, air, array.frequency_Hz, device="cpu")
    return float(pushes.sum(dtype=float) * lines[0][1] * lines[1][1])


def _midpoints(size: float, step: float) -> tuple[Float, float]:
    count = math.ceil(size / step)
    return np.asarray((np.arange(count) + 0.5) * (size / count) - 0.5 * size, float), size / count


def _check(h: Float, t: Float, on: Float, force: Float, size_m: tuple[float, float]) -> None:
    if not (h.shape == t.shape == on.shape == force.shape and h.ndim == 1 and len(h)):
        raise PalmfieldError(
            f"{len(h)} distances, {len(t)} times, {len(on)} on and {len(force)} forces: give one of each per reading"
        )
    for name, values in (("distance_m", h), ("time_s", t), ("force_N", force)):
        if not np.isfinite(values).all():
            raise PalmfieldError(f"{name}[{int(np.argmin(np.isfinite(values)))}] is not finite; give a number")
    if not np.isin(on, (0.0, 1.0)).all():
        raise PalmfieldError(f"on = {on[~np.isin(on, (0.0, 1.0))][0]:g}; give 1 while the array emits, else 0")
    if h.min() <= 0.0 or min(size_m) <= 0.0:
        raise PalmfieldError(f"a distance of {h.min():g} m and a plate of {size_m} m: give lengths above 0")
