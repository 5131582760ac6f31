"""Amplitude as a function of pulse width: the first harmonic of a rectangular wave of duty d is p = p_M sin(pi d).

Hasegawa & Shinoda 2018, eq. 5 and 6.
"""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import DeviceError
from palmfield.types import Float

FULL_DUTY = 0.5
"""Duty of maximum amplitude; beyond it the amplitude decreases."""


def relative_pressure(duty: ArrayLike, exponent: float = 2.0) -> Float:
    """Return p/p_M = sin(pi d)^(g/2).

    duty: 0 to FULL_DUTY
    exponent: g, 2 for the rectangular wave. Other values describe transducer and driver of a device whose radiation
        pressure, quadratic in the pressure, was measured as sin(pi d)^g: 1.5 in Hasegawa & Shinoda 2018.
    Raises DeviceError for a duty outside 0 to 1/2 and an exponent that is not positive.
    """
    d = _within(duty, FULL_DUTY, "duty")
    return np.sin(np.pi * d) ** (0.5 * _positive(exponent))


def duty_cycle(amplitude: ArrayLike, exponent: float = 2.0) -> Float:
    """Return the duty, 0 to 1/2, for p/p_M = amplitude: asin(a^(2/g))/pi, the inverse of `relative_pressure`.

    Raises DeviceError for an amplitude outside 0 to 1 and an exponent that is not positive.
    """
    a = _within(amplitude, 1.0, "amplitude")
    return np.arcsin(np.minimum(a, 1.0) ** (2.0 / _positive(exponent))) / np.pi


def _within(values: ArrayLike, high: float, name: str) -> Float:
    checked = np.asarray(values, float)
    if not np.all((checked >= 0.0) & (checked <= high * (1.0 + 1e-9))):
        bad = checked[~((checked >= 0.0) & (checked <= high * (1.0 + 1e-9)))].flat[0]
        raise DeviceError(f"{name} {bad:.4g} is outside 0 to {high:g}: scale it into that range")
    return checked


def _positive(exponent: float) -> float:
    if not 0.0 < exponent < np.inf:
        raise DeviceError(f"exponent = {exponent} is not positive and finite: use 2, or a measured value such as 1.5")
    return exponent
