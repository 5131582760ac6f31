"""Effect of nonlinear propagation on a focused beam: its steepening, and the fundamental line that remains.

sigma is the propagation distance over the shock distance; here it is summed along the beam, because a focused beam is
loud near its focus only. Formulas are those of plane waves (Blackstock, Fundamentals of Physical Acoustics, 2000), so
that in a focus they give the order of magnitude.
"""

import math

import numpy as np
import scipy  # which loads its parts when they are used
from numpy.typing import ArrayLike
from scipy.special import jv

from palmfield.acoustics import check
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.placement import sides_of
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex

NONLINEARITY = 1.2
"""1 + B/2A of air."""
SAMPLES = 100
"""Along a beam; its pressure changes over a few wavelengths at the least."""
FIRST_M = 5e-3
"""Distance from the transducers from which the beam is followed [m]: one of their radii."""


def steepening(pressures_Pa: ArrayLike, step_m: float, air: Air, frequency_Hz: float) -> float:
    """sigma = (1.2 w/(rho c^3)) times the integral of |p| along a beam.

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
    """Step [m] and pressures [Pa] along the beam of each side of an array (`sides_of`), each side separately.

    A beam is the straight line from the middle of the driven transducers of a side to a focus. None in silence, and for
    a side whose end is no further than FIRST_M from its middle.

    drive: complex amplitudes, shape (len(array),). focus: the point [m], array frame, shape (3,).
    until: a point whose distance from that middle is the end of the beam, before or behind the focus; the focus itself
        by default, shape (3,).
    """
    loud = np.abs(drive) if array.gain is None else np.abs(drive * array.gain)
    driven, found = np.flatnonzero(loud), []
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
            found.append((float(distances[1] - distances[0]), pressures))
    return found


def beam_steepening(array: Array, drive: Complex, focus: ArrayLike, air: Air, until: ArrayLike | None = None) -> float:
    """sigma at the end of the beam that steepens most, as of `beams`; 0 where there is none."""
    found = beams(array, drive, focus, air, until)
    return max((steepening(pressures, step_m, air, array.frequency_Hz) for step_m, pressures in found), default=0.0)


def fundamental_left(sigma: float) -> float:
    """Pressure amplitude of the line at the drive frequency, relative to a linear beam, as a microphone reads it.

    Fubini's 2 J1(sigma)/sigma below the shock, Blackstock's bridging integral beyond.
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
    """ARP relative to that of a linear beam: harmonics contribute, so that there is no loss below the shock distance.

    The mean square of the steepened sine with its weak shock: (2/pi) ((pi - s)/2 + sin(2s)/4 + sigma sin(s)^3/3) with s
    = sigma sin(s) the phase that has run into the shock.
    Raises PalmfieldError for sigma that is negative or not finite.
    """
    _check(sigma)
    if sigma <= 1.0:
        return 1.0
    shock = _shock_phase(sigma)
    terms = (math.pi - shock) / 2.0 + math.sin(2.0 * shock) / 4.0 + sigma * math.sin(shock) ** 3 / 3.0
    return 2.0 / math.pi * terms


def _shock_phase(sigma: float) -> float:
    """s in (0, pi) with s = sigma sin(s), for sigma above 1."""
    return float(
        scipy.optimize.brentq(lambda s: s - sigma * math.sin(s), math.sqrt(min(1.0, sigma - 1.0)) * 1e-3, math.pi)
    )


def _check(sigma: float) -> None:
    if not (math.isfinite(sigma) and sigma >= 0.0):
        raise PalmfieldError(f"sigma = {sigma}: give 0 or more, see `steepening`")
