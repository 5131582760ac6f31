"""Limits of the linear far-field model of the sound, with warnings as text."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from palmfield.acoustics import check
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.directivities import form_of
from palmfield.acoustics.nonlinear import arp_left, beam_steepening, steepening
from palmfield.acoustics.reference import directivity, pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex, Float

FAR_FIELD_ERROR = 0.01
"""Error of the amplitude of one transducer above which `warnings` reports it."""

ARP_LOSS = 0.01
"""Share of the ARP lost in a shock above which `warnings` reports it."""

SATURATION_Pa = 500.0
"""Radiation pressure at which focused devices saturate, about 50 mN/cm2."""


class PalmfieldWarning(UserWarning):
    """The model is used outside its limits of validity."""


def far_field_m(array: Array, error: float = FAR_FIELD_ERROR) -> float:
    """Return the distance [m] beyond which the relative error of the far-field amplitude of a transducer is below
    `error`: b sqrt(near/error), with `near` of the directivity, 0.45.

    The phase error is then k b^2/(4 distance) [rad] on the axis and up to 1.4 times this off the axis; most of it is
    common to all transducers and does not move a focus. Raises PalmfieldError for an error above 0.1, where the error
    no longer falls with the square of the distance.
    """
    if not 0.0 < error <= 0.1:
        raise PalmfieldError(f"error = {error:g} of the far-field approximation; allowed: above 0, at most 0.1")
    return float(array.piston_radius_m * np.sqrt(form_of(array).near / error))


def radiation_pressure_Pa(pressure_Pa: float, air: Air) -> float:
    """Return the ARP [Pa] of a plane wave of this peak pressure at normal incidence on skin, |p|^2/(rho c^2)."""
    return abs(pressure_Pa) ** 2 / (density(air) * sound_speed(air) ** 2)


def warnings(
    array: Array, points: ArrayLike, pressure: ArrayLike, air: Air, beam: tuple[Complex, Float] | None = None
) -> list[str]:
    """Return the warnings on errors of the linear far-field model for this sound, one line each.

    points: [m], array frame, shape (n, 3), or one point, for example the focus, shape (3,).
    pressure: peak pressure at the points, complex or magnitude [Pa], shape (n,), or one number.
    beam: drive, complex amplitudes, shape (len(array),), and focus, shape (3,), of the beam; default: focused at the
        loudest point.
    Raises PalmfieldError for points or pressures that are not finite or do not match, SceneError for bad air or array.
    """
    check.array(array)
    where = check.points(np.atleast_2d(check.numbers(points, "points")), np.float64)
    loudness = np.abs(np.atleast_1d(np.asarray(pressure)))
    if loudness.shape != (len(where),):
        raise PalmfieldError(
            f"pressure has shape {loudness.shape} but there are {len(where)} points: give one value per point"
        )
    if not np.isfinite(loudness).all():
        raise PalmfieldError(f"pressure[{check.first_bad(loudness)}] is not finite: correct the points or the drive")
    if len(where) == 0 or len(array) == 0:
        return []
    loudest = int(np.argmax(loudness))
    peak = float(loudness[loudest])
    return [*_too_near(array, where), *_too_loud(array, where[loudest], peak, air, beam)]


def _too_near(array: Array, points: np.ndarray) -> list[str]:
    limit = far_field_m(array)
    gaps = np.maximum(array.positions.min(axis=0) - points, points - array.positions.max(axis=0))
    close = points[(gaps < limit).all(axis=1)]  # preselected, because the tree takes longer than the field
    if len(close) == 0:
        return []
    distance = float(KDTree(array.positions).query(close)[0].min())
    if distance >= limit:
        return []
    return [
        f"a point is {1e3 * distance:.1f} mm from a transducer; below {1e3 * limit:.0f} mm the error of the "
        f"far-field directivity exceeds {100 * FAR_FIELD_ERROR:g} %"
    ]


def _too_loud(array: Array, point: np.ndarray, peak: float, air: Air, beam: tuple[Complex, Float] | None) -> list[str]:
    distance = np.linalg.norm(array.positions - point, axis=1)
    messages = []
    if beam is not None:
        sigma = beam_steepening(array, *beam, air, until=point)
    else:
        sigma = steepening([peak, peak], float(distance.mean()), air, array.frequency_Hz)
        if sigma > 1.0:  # upper bound with constant pressure; a focused beam steepens less
            wavenumber = check.angular_frequency(array.frequency_Hz) / sound_speed(air)
            focused = np.exp(-1j * wavenumber * distance)
            loud = float(np.abs(pressure64(point[None], array, focused, air)[0][0]))
            sigma = beam_steepening(array, focused, point, air) * peak / loud if loud > 0.0 else 0.0
    if arp_left(sigma) < 1.0 - ARP_LOSS:
        messages.append(
            f"sigma is {sigma:.2f} along a beam that arrives with {peak:.0f} Pa: a shock forms, which removes "
            f"{100 * (1 - arp_left(sigma)):.0f} % of the ARP that this linear model computes"
        )
    load = radiation_pressure_Pa(peak, air)
    if load > SATURATION_Pa:
        messages.append(
            f"{peak:.0f} Pa gives a radiation pressure of {load:.0f} Pa, but devices saturate near "
            f"{SATURATION_Pa:g} Pa: lower the drive"
        )
    gain = 1.0 if array.gain is None else np.abs(array.gain)
    wavenumber = check.angular_frequency(array.frequency_Hz) / sound_speed(air)
    shape = directivity(array, wavenumber, np.linspace(0.0, 1.0, 181)).max()
    most = float((array.p0_Pa_m * shape * gain / np.maximum(distance, 1e-9)).sum())
    if peak > most * (1.0 + 1e-3):
        messages.append(
            f"{peak:.0f} Pa exceeds the output of array '{array.name}' there at full drive ({most:.0f} Pa): check "
            "the units of points (m) and drive (1 is full drive)"
        )
    if peak > air.pressure_Pa:
        messages.append(
            f"{peak:.0f} Pa exceeds the static pressure of the air, {air.pressure_Pa:.0f} Pa, which no sound wave "
            "can do: lower the drive"
        )
    return messages


def least_radius_m(points: Float, at: Float, reach_m: float) -> float | None:
    """Return the smallest radius of curvature [m] of a surface near a point, by a paraboloid fit; inf if it is flat.

    points: points of the surface [m], shape (n, 3). at: shape (3,). reach_m: radius of the fit about the nearest point.
    The result is None if the nearest point is farther than twice this radius, or the fit has fewer than six points.
    """
    distance = np.linalg.norm(points - at, axis=1)
    nearest = points[int(np.argmin(distance))]
    near = points[np.linalg.norm(points - nearest, axis=1) < reach_m]
    if distance.min() > 2.0 * reach_m or len(near) < 6:
        return None
    axes = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2]
    u, v, height = axes @ (near - nearest).T
    terms = np.stack([np.ones_like(u), u, v, u**2, u * v, v**2], axis=1)
    _, slope_u, slope_v, uu, uv, vv = np.linalg.lstsq(terms, height)[0]
    first = np.array([[1.0 + slope_u**2, slope_u * slope_v], [slope_u * slope_v, 1.0 + slope_v**2]])
    second = np.array([[2.0 * uu, uv], [uv, 2.0 * vv]]) / np.sqrt(1.0 + slope_u**2 + slope_v**2)
    most = float(np.abs(np.linalg.eigvals(np.linalg.solve(first, second))).max())
    return 1.0 / most if most > 0.0 else float("inf")
