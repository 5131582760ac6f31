"""Nonlinear effects in a focused beam: steepening, remaining amplitude of the fundamental, and wind (streaming).

sigma is the propagation distance over the shock distance. It is integrated along the beam, because a focused beam is
loud only near its focus. The formulas are for plane waves (Blackstock, Fundamentals of Physical Acoustics, 2000), so
they give only the order of magnitude in a focus.

Air that absorbs sound of intensity I absorbs its momentum: a force of 2 alpha I/c per volume (Nyborg 1965; Lighthill
1978), which is alpha times the ARP of the sound on a wall. Without viscosity and turbulence, the integral of this force
along the axis of a beam is the stagnation pressure of the wind. In the free wind it is rho w^2/2. Viscosity and
turbulence reduce it, so this is an upper bound.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy  # loads its submodules at first use
from numpy.typing import ArrayLike
from scipy.special import jv

from palmfield.acoustics import check
from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.placement import sides_of
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex

NONLINEARITY = 1.2
"""1 + B/2A of air."""
SAMPLES = 100
"""Number of samples along a beam; its pressure changes over a few wavelengths or more."""
FIRST_M = 5e-3
"""Distance from the transducers at which the beam starts [m]: the radius of a transducer."""
LAST_SIGMA = 0.95
"""Largest sigma for the sum over harmonics of a plane wave; near 1 their absorption diverges, and a shock forms."""


def steepening(pressures_Pa: ArrayLike, step_m: float, air: Air, frequency_Hz: float) -> float:
    """Return sigma = (1.2 w/(rho c^3)) times the integral of |p| along a beam.

    pressures_Pa: peak pressures, magnitudes or complex, at even steps of step_m [m], shape (n,)
    Raises PalmfieldError for pressures that are not finite.
    """
    loudness = np.abs(np.asarray(pressures_Pa))
    if not np.isfinite(loudness).all():
        raise PalmfieldError(f"pressures_Pa[{check.first_bad(loudness)}] is not finite: give peak pressures")
    per_Pa_m = NONLINEARITY * check.angular_frequency(frequency_Hz) / (density(air) * sound_speed(air) ** 3)
    return float(per_Pa_m * np.trapezoid(loudness, dx=step_m))


def beams(
    array: Array, drive: Complex, focus: ArrayLike, air: Air, until: ArrayLike | None = None
) -> list[tuple[float, Complex]]:
    """Return step [m] and pressures [Pa] along the beam of each side of an array (`sides_of`), each side separately.

    A beam is the straight line from the centre of the driven transducers of a side to a focus. Silent sides and sides
    with beams shorter than FIRST_M are omitted.

    drive: complex amplitudes, shape (len(array),). focus: position [m], array frame, shape (3,).
    until: a point whose distance from the centre is the length of the beam, shape (3,); default the focus.
    """
    loud = np.abs(drive) if array.gain is None else np.abs(drive * array.gain)
    driven, results = np.flatnonzero(loud), []
    end = np.asarray(focus, float)
    for side in (driven[of] for of in (sides_of(array.normals[driven]) if len(driven) else ())):
        start = loud[side] @ array.positions[side] / loud[side].sum()
        direction = (end - start) / max(float(np.linalg.norm(end - start)), 1e-300)
        length = float(np.linalg.norm((end if until is None else np.asarray(until, float)) - start))
        if length > FIRST_M:
            own = np.zeros_like(drive)
            own[side] = drive[side]
            distances = np.linspace(FIRST_M, length, SAMPLES)
            pressures, _ = pressure64(start + distances[:, None] * direction, array, own, air)
            results.append((float(distances[1] - distances[0]), pressures))
    return results


def beam_steepening(array: Array, drive: Complex, focus: ArrayLike, air: Air, until: ArrayLike | None = None) -> float:
    """Return the largest sigma at the ends of `beams`; 0 without beams."""
    results = beams(array, drive, focus, air, until)
    return max((steepening(pressures, step_m, air, array.frequency_Hz) for step_m, pressures in results), default=0.0)


def fundamental_left(sigma: float) -> float:
    """Return the pressure amplitude at the drive frequency, as measured by a microphone, relative to a linear beam.

    It is Fubini's 2 J1(sigma)/sigma below the shock, and Blackstock's bridging integral beyond.
    Raises PalmfieldError for sigma that is negative or not finite.
    """
    _check(sigma)
    if sigma == 0.0:
        return 1.0
    if sigma <= 1.0:
        return float(2.0 * jv(1, sigma) / sigma)
    shock = _shock_phase(sigma)
    phases = np.linspace(shock, math.pi, 2001)
    integral = np.trapezoid(np.cos(phases - sigma * np.sin(phases)), phases)
    return float(2.0 / math.pi * (math.sin(shock) + integral / sigma))


def arp_left(sigma: float) -> float:
    """Return the ARP relative to that of a linear beam; below the shock distance, harmonics have all of the lost ARP.

    It is the mean square of the steepened sine with its weak shock, (2/pi) ((pi - s)/2 + sin(2s)/4 + sigma sin(s)^3/3).
    The phase s = sigma sin(s) has entered the shock.
    Raises PalmfieldError for sigma that is negative or not finite.
    """
    _check(sigma)
    if sigma <= 1.0:
        return 1.0
    shock = _shock_phase(sigma)
    terms = (math.pi - shock) / 2.0 + math.sin(2.0 * shock) / 4.0 + sigma * math.sin(shock) ** 3 / 3.0
    return 2.0 / math.pi * terms


def _shock_phase(sigma: float) -> float:
    """Return s in (0, pi) with s = sigma sin(s), for sigma above 1."""
    return float(
        scipy.optimize.brentq(lambda s: s - sigma * math.sin(s), math.sqrt(min(1.0, sigma - 1.0)) * 1e-3, math.pi)
    )


def _check(sigma: float) -> None:
    if not (math.isfinite(sigma) and sigma >= 0.0):
        raise PalmfieldError(f"sigma = {sigma}: give 0 or more, see `steepening`")


class Wind(NamedTuple):
    """Upper bound of the wind of a beam, at the end of the beam.

    pressure_Pa: stagnation pressure. speed_m_s: speed of the free wind.
    force: force of the wind on a wall over that of the sound.
    harmonics: share of the momentum of the sound that is lost by steepening, by harmonics and a shock.
    time_s: approximate build-up time: transit time of the air through the loud part of the beam at half the speed.
    """

    pressure_Pa: float
    speed_m_s: float
    force: float
    harmonics: float
    time_s: float


def wind(step_m: float, pressures_Pa: Complex, air: Air, frequency_Hz: float) -> Wind:
    """Return the wind of a beam with the pressures of `nonlinear.beams`, at even steps, shape (n,).

    Harmonics are absorbed more than the fundamental: sum n^2 B_n^2 = 2/s^2 (1/sqrt(1 - s^2) - 1) for Fubini's B_n at
    sigma = s, by Kapteyn's series. The momentum that the sound loses in a shock also drives the wind.
    """
    arp = np.abs(pressures_Pa) ** 2 / (density(air) * sound_speed(air) ** 2)
    if not arp.any():
        return Wind(0.0, 0.0, 0.0, 0.0, math.inf)
    sigma = np.array([steepening(pressures_Pa[: i + 1], step_m, air, frequency_Hz) for i in range(len(arp))])
    s = np.clip(sigma, 1e-3, LAST_SIGMA)
    line = absorption_Np_m(air, frequency_Hz)
    absorbed = line * 2.0 / s**2 * (1.0 / np.sqrt(1.0 - s**2) - 1.0)
    shock = (1.0 - arp_left(float(sigma[-1]))) / 2.0
    pressure = float(np.trapezoid(absorbed * arp, dx=step_m)) + shock * float(arp[-1])
    force = float(np.trapezoid(absorbed, dx=step_m)) + shock
    speed = math.sqrt(2.0 * pressure / density(air))
    forced_m = float(np.trapezoid(arp, dx=step_m) / arp.max())
    return Wind(pressure, speed, force, 2.0 * (force - line * step_m * (len(arp) - 1)), 2.0 * forced_m / speed)
