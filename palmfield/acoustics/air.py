"""Sound speed, density and absorption of air."""

import math

from palmfield.acoustics.check import frequency
from palmfield.config.array import AIR_LIMITS
from palmfield.errors import SceneError
from palmfield.types import Air

GAS_CONSTANT_AIR = 287.06
ZERO_CELSIUS_K = 273.15


def check(air: Air) -> None:
    """Raise SceneError if a property of the air is NaN or outside AIR_LIMITS."""
    for name, (low, high) in AIR_LIMITS.items():
        value = getattr(air, name)
        if not low <= value <= high:
            raise SceneError(f"air {name} = {value} is outside {low:g} to {high:g}: set it within that range")


def sound_speed(air: Air) -> float:
    """Return the speed of sound [m/s], c = 331.3 sqrt(1 + T/273.15). Raises SceneError for air outside AIR_LIMITS."""
    check(air)
    return 331.3 * math.sqrt(1.0 + air.temperature_C / ZERO_CELSIUS_K)


def sound_speed_sd(air: Air, temperature_sd_K: float) -> float:
    """Return the standard deviation of the speed of sound [m/s] for that of the temperature [K]."""
    return 0.5 * sound_speed(air) / (ZERO_CELSIUS_K + air.temperature_C) * temperature_sd_K


def density(air: Air) -> float:
    """Return the density [kg/m3] of dry air at this temperature and pressure. Raises SceneError like `check`."""
    check(air)
    return air.pressure_Pa / (GAS_CONSTANT_AIR * (air.temperature_C + ZERO_CELSIUS_K))


def absorption_Np_m(air: Air, frequency_Hz: float) -> float:
    """Return the amplitude absorption of a pure tone [Np/m], ISO 9613-1:1993 equations (3) to (5) and annex B.

    Raises SceneError for air outside AIR_LIMITS and for a frequency that is not positive.
    """
    check(air)
    frequency(frequency_Hz)
    kelvin = air.temperature_C + ZERO_CELSIUS_K
    pressure = air.pressure_Pa / 101325.0  # over the reference pressure
    temperature = kelvin / 293.15  # over the reference temperature
    saturation = 10.0 ** (-6.8346 * (273.16 / kelvin) ** 1.261 + 4.6151)
    vapour = air.humidity_percent * saturation / pressure  # molar concentration in per cent
    oxygen_Hz = pressure * (24.0 + 4.04e4 * vapour * (0.02 + vapour) / (0.391 + vapour))
    nitrogen_Hz = (
        pressure * temperature**-0.5 * (9.0 + 280.0 * vapour * math.exp(-4.170 * (temperature ** (-1.0 / 3.0) - 1.0)))
    )
    classical = 1.84e-11 * temperature**0.5 / pressure
    oxygen = 0.01275 * math.exp(-2239.1 / kelvin) / (oxygen_Hz + frequency_Hz**2 / oxygen_Hz)
    nitrogen = 0.1068 * math.exp(-3352.0 / kelvin) / (nitrogen_Hz + frequency_Hz**2 / nitrogen_Hz)
    return frequency_Hz**2 * (classical + temperature**-2.5 * (oxygen + nitrogen))
