"""Acoustic streaming: an upper bound on the pressure of the wind at the end of a beam, and the time of its build-up.

Air that absorbs sound of intensity I absorbs its momentum: a force of 2 alpha I/c per volume (Nyborg 1965; Lighthill
1978), which is alpha times the ARP of the sound on a wall. Without viscosity and turbulence, the integral of this force
along the axis of a beam is the stagnation pressure of the wind. In the free wind it is rho w^2/2. Viscosity and
turbulence reduce it, so this is an upper bound.
"""

import math
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.nonlinear import arp_left, steepening
from palmfield.types import Air, Complex

LAST_SIGMA = 0.95
"""Largest sigma for the sum over harmonics of a plane wave; near 1 their absorption diverges, and a shock forms."""


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
