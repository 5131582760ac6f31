"""Waves of a skin material at one frequency, from its complex moduli.

The time factor is e^{-i w t}: G* = G' - iG''; wavenumbers k = w/c + i/L with phase speed c and 1/e length L.
"""

import cmath
import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material, complex_bulk, complex_shear, shear_wave


@dataclass(frozen=True)
class Waves:
    """A material at one frequency. Speeds are phase speeds [m/s]; lengths are 1/e lengths of the amplitude [m].

    f_Hz: frequency [Hz]. shear_Pa, bulk_Pa: complex moduli G' - iG'', K' - iK'' [Pa].
    shear, pressure: plane waves in the solid. rayleigh: the surface wave of a deep, bare half-space.
    cutoff_Hz: c_s / 4h [Hz]; below it a bonded layer of given thickness h guides no wave; None without a thickness.
    """

    f_Hz: float
    shear_Pa: complex
    bulk_Pa: complex
    shear_speed_m_s: float
    shear_length_m: float
    pressure_speed_m_s: float
    pressure_length_m: float
    rayleigh_speed_m_s: float
    rayleigh_length_m: float
    cutoff_Hz: float | None = None


def describe(material: Material, f_Hz: float, thickness_m: float | None = None) -> Waves:
    """Return complex moduli, speeds and 1/e lengths at f > 0 [Hz]; with a thickness [m], the cut-off of a bonded layer.

    Raises SceneError for a frequency or thickness that is not above 0 and finite.
    """
    check_positive("frequency", f_Hz, "Hz")
    shear, bulk = complex_shear(material, f_Hz), complex_bulk(material, f_Hz)
    omega = 2.0 * math.pi * f_Hz
    pressure = omega * cmath.sqrt(material.density_kg_m3 / (bulk + 4.0 / 3.0 * shear))
    rayleigh = rayleigh_wavenumber(material, f_Hz)
    return Waves(
        f_Hz,
        shear,
        bulk,
        *shear_wave(material, f_Hz),
        *speed_and_length(pressure, omega),
        *speed_and_length(rayleigh, omega),
        None if thickness_m is None else cutoff(material, thickness_m),
    )


def rayleigh_wavenumber(material: Material, f_Hz: float) -> complex:
    """Return the wavenumber of the Rayleigh wave of a viscoelastic half-space at f > 0 [rad/m].

    (2 - x)^2 = 4 sqrt(1 - x) sqrt(1 - m x), x = (c/c_s)^2, m = G/(K + 4G/3), is squared to the cubic
    x^3 - 8 x^2 + (24 - 16 m) x - 16 (1 - m) = 0 (Achenbach 1973, ch. 5). A root is valid if both parts of its wave
    decay with depth and if it solves the equation before squaring. Above a loss tangent of about 0.16 there is a
    second, faster root (Currie, Hayes & O'Leary 1977). The root that is continuous with the elastic solid is returned.
    Raises SceneError for a frequency that is not above 0 and finite.
    """
    check_positive("frequency", f_Hz, "Hz")
    shear, bulk = complex_shear(material, f_Hz), complex_bulk(material, f_Hz)
    ratio = shear / (bulk + 4.0 / 3.0 * shear)
    roots = np.roots([1.0, -8.0, 24.0 - 16.0 * ratio, -16.0 * (1.0 - ratio)])
    slow = elastic_root(ratio.real)
    root = complex(roots[np.argmin(np.abs(roots - slow))])
    wavenumber = 2.0 * math.pi * f_Hz * cmath.sqrt(material.density_kg_m3 / shear) / cmath.sqrt(root)
    decays = [decaying(wavenumber * cmath.sqrt(1.0 - part * root)) for part in (1.0, ratio)]
    left = (2.0 - root) ** 2 * wavenumber**2
    if abs(left - 4.0 * decays[0] * decays[1]) > 1e-8 * abs(left):
        raise SceneError(
            f"material '{material.name}' carries no Rayleigh wave at {f_Hz} Hz, because its loss is "
            "too high; use a lower frequency"
        )
    return wavenumber


def elastic_root(ratio: float) -> float:
    """Return (c_R / c_s)^2 of an elastic solid, the only root of the cubic in 0..1; ratio: (c_s / c_p)^2, 0 to 3/4."""
    return float(
        scipy.optimize.brentq(lambda x: ((x - 8.0) * x + 24.0 - 16.0 * ratio) * x - 16.0 * (1.0 - ratio), 0.0, 1.0)
    )


def cutoff(material: Material, thickness_m: float) -> float:
    """Return the frequency f = c_s(f) / 4h [Hz]; below it a bonded layer of thickness h [m] guides no wave.

    It is the first thickness resonance in shear, for the phase speed of the shear wave at f. c_s(f) / f falls with f,
    so there is one solution. Raises SceneError for a thickness that is not above 0 and finite.
    """
    check_positive("thickness", thickness_m, "m")
    low = math.sqrt(material.shear_relaxed_Pa / material.density_kg_m3) / (4.0 * thickness_m)

    def excess(f_Hz: float) -> float:
        return f_Hz - shear_wave(material, f_Hz)[0] / (4.0 * thickness_m)

    high = 2.0 * low
    while excess(high) < 0.0:
        high *= 2.0
    return float(scipy.optimize.brentq(excess, 0.5 * low, high, xtol=1e-9 * low))


def speed_and_length(wavenumber: complex, omega: float) -> tuple[float, float]:
    """Return the phase speed [m/s] and 1/e length [m] of k = w/c + i/L; the length of an undamped wave is infinite."""
    return omega / wavenumber.real, 1.0 / wavenumber.imag if wavenumber.imag > 0.0 else math.inf


def decaying(rate: complex) -> complex:
    """Return +rate or -rate, the one with a real part >= 0."""
    return -rate if rate.real < 0.0 else rate


def check_positive(what: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise SceneError(f"{what} is {value} {unit}; give a finite number above 0")
