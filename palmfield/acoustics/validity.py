"""Where the linear far-field model of the sound stops being right, and warnings in words."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from palmfield.acoustics import check
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.derived import angular_frequency
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array

AMPLITUDE_ERROR = 0.45
"""Largest error of a piston's far field times (d/b)^2, over angles to 85 degrees and for k b up to 3.3, the usual
transducer (`palmfield.studies.bench.rayleigh`, docs/bench/peers.md). Larger pistons have a null, where the sound is
weak."""

FAR_FIELD_ERROR = 0.01
"""Error of one transducer's amplitude from which `warnings` speaks."""

SHOCK_SHARE = 0.3
"""Focal distance over shock distance from which harmonics take a noticeable part of the sound."""

SATURATION_Pa = 500.0
"""Radiation pressure at which focused devices saturate, about 50 mN/cm2."""

NONLINEARITY = 1.2
"""1 + B/2A of air."""


class PalmfieldWarning(UserWarning):
    """The model is used where it does not hold."""


def near_field_m(array: Array, air: Air) -> float:
    """Rayleigh distance k b^2/2 [m] of one piston of radius b; 0 for point sources. Raises SceneError for bad air.

    Well beyond it a piston's directivity applies; a few of it away it doesn't, see `far_field_m`.
    """
    wavenumber = angular_frequency(array.frequency_Hz) / sound_speed(air)
    return wavenumber * array.piston_radius_m**2 / 2.0


def far_field_m(array: Array, error: float = FAR_FIELD_ERROR) -> float:
    """Distance [m] from which the far-field directivity gives a transducer's amplitude within a relative error.

    It is b sqrt(0.45/error). The phase is then off by near_field_m/(2 distance) on the axis and up to 1.4 times that
    off it, in radians; most of it is common to all transducers and moves no focus.

    Raises PalmfieldError for an error above 0.1, where the fall with the square of the distance ends.
    """
    if not 0.0 < error <= 0.1:
        raise PalmfieldError(f"error = {error:g} of the far field; allowed: more than 0, at most 0.1")
    return float(array.piston_radius_m * np.sqrt(AMPLITUDE_ERROR / error))


def shock_distance_m(pressure_Pa: float, air: Air, frequency_Hz: float) -> float:
    """Distance rho c^3/(1.2 w |p|) [m] after which a plane wave of this peak pressure has a shock; inf in silence.

    Blackstock, Fundamentals of Physical Acoustics, 2000. A focused beam is that loud near its focus only, so its
    waves steepen less than this says. Raises PalmfieldError for a pressure that is not finite.
    """
    if not np.isfinite(pressure_Pa):
        raise PalmfieldError(f"pressure_Pa = {pressure_Pa} is not finite: give a peak pressure")
    steepening = NONLINEARITY * angular_frequency(frequency_Hz) * abs(pressure_Pa)
    return density(air) * sound_speed(air) ** 3 / steepening if steepening > 0.0 else np.inf


def radiation_pressure_Pa(pressure_Pa: float, air: Air) -> float:
    """ARP [Pa] of a plane wave of this peak pressure on skin at normal incidence, |p|^2/(rho c^2)."""
    return abs(pressure_Pa) ** 2 / (density(air) * sound_speed(air) ** 2)


def warnings(array: Array, points: ArrayLike, pressure: ArrayLike, air: Air) -> list[str]:
    """What a linear far-field model gets wrong for this sound, one line each; empty where it holds.

    points: [m], array frame, shape (n, 3), or one, for example the focus, shape (3,)
    pressure: peak pressure at the points, complex or magnitude [Pa], shape (n,), or one number
    Raises PalmfieldError for points or pressures that are not finite or don't match, SceneError for bad air or array.
    """
    check.array(array)
    where = check.points(np.atleast_2d(check.numbers(points, "points")), np.float64)
    loudness = np.abs(np.atleast_1d(np.asarray(pressure)))
    if loudness.shape != (len(where),):
        raise PalmfieldError(
            f"pressure has shape {loudness.shape} but there are {len(where)} points: give one for each"
        )
    if not np.isfinite(loudness).all():
        raise PalmfieldError(f"pressure[{check.first_bad(loudness)}] is not finite: mend the points or the drive")
    if len(where) == 0 or len(array) == 0:
        return []
    loudest = int(np.argmax(loudness))
    peak = float(loudness[loudest])
    return [*_too_near(array, where), *_too_loud(array, where[loudest], peak, air)]


def _too_near(array: Array, points: np.ndarray) -> list[str]:
    limit = far_field_m(array)
    gaps = np.maximum(array.positions.min(axis=0) - points, points - array.positions.max(axis=0))
    close = points[(gaps < limit).all(axis=1)]  # few of many: the tree takes longer than the field itself
    if len(close) == 0:
        return []
    distance = float(KDTree(array.positions).query(close)[0].min())
    if distance >= limit:
        return []
    return [
        f"a point is {1e3 * distance:.1f} mm from a transducer: nearer than {1e3 * limit:.0f} mm its far-field "
        f"directivity is off by more than {100 * FAR_FIELD_ERROR:g} %"
    ]


def _too_loud(array: Array, point: np.ndarray, peak: float, air: Air) -> list[str]:
    distance = np.linalg.norm(array.positions - point, axis=1)
    messages = []
    share = float(distance.mean()) / shock_distance_m(peak, air, array.frequency_Hz)
    if share > SHOCK_SHARE:
        messages.append(
            f"focal distance / shock distance is {share:.2f} at {peak:.0f} Pa: beyond {SHOCK_SHARE:g} sound turns into "
            "harmonics and heat, expect less than this linear field gives"
        )
    load = radiation_pressure_Pa(peak, air)
    if load > SATURATION_Pa:
        messages.append(
            f"{peak:.0f} Pa makes a radiation pressure of {load:.0f} Pa, but devices saturate near "
            f"{SATURATION_Pa:g} Pa: lower the drive"
        )
    gain = 1.0 if array.gain is None else np.abs(array.gain)
    shape = 1.0 if array.directivity_table is None else float(array.directivity_table[:, 1].max())
    most = float((array.p0_Pa_m * shape * gain / np.maximum(distance, 1e-9)).sum())
    if peak > most * (1.0 + 1e-3):
        messages.append(
            f"{peak:.0f} Pa is more than array '{array.name}' can give there at full drive ({most:.0f} Pa): look at "
            "the units of points (m) and drive (1 is full)"
        )
    if peak > air.pressure_Pa:
        messages.append(
            f"{peak:.0f} Pa is more than the air's own pressure of {air.pressure_Pa:.0f} Pa: no sound wave can have it"
        )
    return messages
