"""The wind that sound drives: an upper bound on its pressure at the end of the sound, and the time of its build-up.

Air that absorbs sound of intensity I absorbs its momentum: a force of 2 alpha I/c per volume (Nyborg 1965; Lighthill
1978), which is alpha times the ARP that the sound would have on a wall. Without viscosity and turbulence, the integral
of this force along the axis of a beam is the pressure of the wind where it is stopped, and rho w^2/2 before. Viscosity
and turbulence reduce it, so that this is a bound.
"""

import math
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.nonlinear import arp_left, steepening
from palmfield.types import Air, Complex

LAST_SIGMA = 0.95
"""Up to which harmonics of a plane wave are counted one by one; close to 1 they take up without bound, as a shock."""


class Wind(NamedTuple):
    """Upper bound of the wind of a beam, at the end of the beam.

    pressure_Pa: where it is stopped. speed_m_s: before.
    force: of it, over that of the sound of the beam, on a wall that stops both.
    harmonics: share of the momentum of the sound that is lost at the end by steepening, by harmonics and by a shock.
    time_s: of the build-up, about: the transit time of the air through the loud part of the beam, at half that speed.
    """

    pressure_Pa: float
    speed_m_s: float
    force: float
    harmonics: float
    time_s: float


def wind(step_m: float, pressures_Pa: Complex, air: Air, frequency_Hz: float) -> Wind:
    """The wind of a beam, whose pressures are those of `nonlinear.beams`, at even steps, shape (n,).

    Harmonics absorb more than the line at the drive frequency: sum n^2 B_n^2 = 2/s^2 (1/sqrt(1 - s^2) - 1) of
    Fubini's B_n, sigma s, by Kapteyn's series. The momentum that a shock takes from the sound goes to the wind as well.
    """
    arp = np.abs(pressures_Pa) ** 2 / (density(air) * sound_speed(air) ** 2)
    if not arp.any():
        return Wind(0.0, 0.0, 0.0, 0.0, math.inf)
    sigma = np.array([steepening(pressures_Pa[: i + 1], step_m, air, frequency_Hz) for i in range(len(arp))])
    s = np.clip(sigma, 1e-3, LAST_SIGMA)
    line = absorption_Np_m(air, frequency_Hz)
    taken = line * 2.0 / s**2 * (1.0 / np.sqrt(1.0 - s**2) - 1.0)
    shock = (1.0 - arp_left(float(sigma[-1]))) / 2.0
    pressure = float(np.trapezoid(taken * arp, dx=step_m)) + shock * float(arp[-1])
    force = float(np.trapezoid(taken, dx=step_m)) + shock
    speed = math.sqrt(2.0 * pressure / density(air))
    forced_m = float(np.trapezoid(arp, dx=step_m) / arp.max())
    return Wind(pressure, speed, force, 2.0 * (force - line * step_m * (len(arp) - 1)), 2.0 * forced_m / speed)
