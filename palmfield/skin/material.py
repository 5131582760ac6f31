"""Skin materials: a standard linear solid in shear, elastic in bulk."""

import cmath
import math
from dataclasses import dataclass

from palmfield.errors import SceneError


@dataclass(frozen=True)
class Material:
    """Isotropic solid: spring G_r beside one Maxwell branch (G_m, tau) in shear, elastic bulk modulus K.

    density_kg_m3: rho [kg/m^3], > 0
    shear_relaxed_Pa: G_r [Pa], > 0
    shear_branch_Pa: G_m [Pa], >= 0 (0: no branch, a purely elastic solid)
    relaxation_time_s: tau = eta / G_m [s], >= 0 (0: the branch carries nothing)
    bulk_Pa: K [Pa], > 0
    source: where the numbers come from

    Raises SceneError for a value outside these ranges.
    """

    name: str
    density_kg_m3: float
    shear_relaxed_Pa: float
    shear_branch_Pa: float
    relaxation_time_s: float
    bulk_Pa: float
    source: str

    def __post_init__(self) -> None:
        for field in ("density_kg_m3", "shear_relaxed_Pa", "bulk_Pa"):
            value = getattr(self, field)
            if not (math.isfinite(value) and value > 0.0):
                raise SceneError(f"material '{self.name}': {field} is {value}; give a finite number above 0")
        for field in ("shear_branch_Pa", "relaxation_time_s"):
            value = getattr(self, field)
            if not (math.isfinite(value) and value >= 0.0):
                raise SceneError(f"material '{self.name}': {field} is {value}; give a finite number, 0 or above")

    @property
    def branch_ratio(self) -> float:
        """g = G_m / G_r."""
        return self.shear_branch_Pa / self.shear_relaxed_Pa


def bulk_from_poisson(nu: float, shear: float) -> float:
    """Bulk modulus K = 2 G (1 + nu) / (3 (1 - 2 nu)) [Pa] of Poisson's ratio nu and shear modulus [Pa].

    Raises SceneError unless -1 < nu < 0.5 and shear > 0.
    """
    if not -1.0 < nu < 0.5:
        raise SceneError(f"Poisson's ratio is {nu}; give a number above -1 and below 0.5 (0.4999 for soft tissue)")
    if not (math.isfinite(shear) and shear > 0.0):
        raise SceneError(f"shear modulus is {shear} Pa; give a finite number above 0")
    return 2.0 * shear * (1.0 + nu) / (3.0 * (1.0 - 2.0 * nu))


def complex_shear(material: Material, f_Hz: float) -> complex:
    """Complex shear modulus G' - iG'' [Pa] at f [Hz] under e^{-i w t}: G_r + G_m x / (1 + x), x = -i w tau."""
    x = -2j * math.pi * f_Hz * material.relaxation_time_s
    return material.shear_relaxed_Pa + material.shear_branch_Pa * x / (1.0 + x)


def shear_wave(material: Material, f_Hz: float) -> tuple[float, float]:
    """Phase speed [m/s] and 1/e length of the amplitude [m] of a plane shear wave at f > 0 [Hz].

    Raises SceneError for f <= 0. The length is infinite where the material is elastic.
    """
    if not f_Hz > 0.0:
        raise SceneError(f"frequency is {f_Hz} Hz; a wave needs one above 0")
    omega = 2.0 * math.pi * f_Hz
    wavenumber = omega * cmath.sqrt(material.density_kg_m3 / complex_shear(material, f_Hz))
    return omega / wavenumber.real, 1.0 / wavenumber.imag if wavenumber.imag > 0.0 else math.inf


PRESETS: dict[str, Material] = {
    "ecoflex_00-10": Material(
        name="ecoflex_00-10",
        density_kg_m3=1030.0,
        shear_relaxed_Pa=12.5e3,
        shear_branch_Pa=20e3,
        relaxation_time_s=3.42 / 20e3,
        bulk_Pa=bulk_from_poisson(0.495, 12.5e3),
        source="Chilles et al., Ecoflex 00-10 phantom: G_r 12.5 kPa, G_m 20 kPa, eta 3.42 Pa s (tau = eta/G_m = "
        "171 us), nu 0.495 read as printed, that is on the relaxed modulus",
    ),
    "palm": Material(
        name="palm",
        density_kg_m3=1100.0,
        shear_relaxed_Pa=19.9e3,
        shear_branch_Pa=17.3e3,
        relaxation_time_s=1.56e-3,
        bulk_Pa=bulk_from_poisson(0.4999, 37.2e3),
        source="fitted by scripts/fit_palm_material.py to speed and decay at once: surface wave 4.5/5.0/5.4/5.5 m/s at "
        "50/100/200/400 Hz against an aim of 3.6/4.6/6.0/7.1 m/s, rising to 7 m/s as on the finger pad (Manfredi "
        "et al. 2012): misfit +26/+9/-11/-23 %; |u(40 mm)/u(5 mm)| at 200 Hz 0.085 on 12 mm bonded to bone (0.081 at "
        "16 mm, 0.086 at 20 mm) against 0.085; one branch cannot meet both. nu 0.4999 on the instantaneous modulus",
    ),
}


def preset(name: str) -> Material:
    """The material of that name in PRESETS. Raises SceneError with the known names otherwise."""
    if name not in PRESETS:
        raise SceneError(f"skin material '{name}' is not known; use one of {', '.join(sorted(PRESETS))}")
    return PRESETS[name]
