"""Skin materials: linear viscoelastic solids, isotropic."""

import cmath
import math
from dataclasses import dataclass

from palmfield.errors import SceneError
from palmfield.types import Complex


@dataclass(frozen=True)
class Branch:
    """Maxwell branch: spring G_m [Pa], >= 0, in series with a dashpot; time_s: tau = eta / G_m [s], >= 0.

    At tau = 0 the branch carries nothing.
    """

    shear_Pa: float
    time_s: float


@dataclass(frozen=True)
class Material:
    """Spring G_r beside Maxwell branches and a dashpot, in shear: G(s) = G_r + sum G_i s tau_i / (1 + s tau_i) + eta s.

    No branch and no dashpot: elastic. A dashpot alone: Kelvin-Voigt. One branch: standard linear solid. More: Prony
    series.

    density_kg_m3: rho [kg/m^3], > 0
    shear_relaxed_Pa: G_r [Pa], > 0
    branches: Maxwell branches, any number
    bulk_Pa: K [Pa], > 0, of the relaxed solid
    viscosity_Pa_s: eta [Pa s], >= 0
    bulk_relaxes: whether K follows G, K(s) = K G(s) / G_r (Poisson's ratio is constant), or is elastic
    source: where the numbers come from

    Raises SceneError for a value outside these ranges.
    """

    name: str
    density_kg_m3: float
    shear_relaxed_Pa: float
    branches: tuple[Branch, ...]
    bulk_Pa: float
    source: str
    viscosity_Pa_s: float = 0.0
    bulk_relaxes: bool = False

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in ("density_kg_m3", "shear_relaxed_Pa", "bulk_Pa")}
        for name, value in values.items():
            if not (math.isfinite(value) and value > 0.0):
                raise SceneError(f"material '{self.name}': {name} is {value}; give a finite number above 0")
        values = {"viscosity_Pa_s": self.viscosity_Pa_s}
        for number, branch in enumerate(self.branches):
            values |= {f"branches[{number}].shear_Pa": branch.shear_Pa, f"branches[{number}].time_s": branch.time_s}
        for name, value in values.items():
            if not (math.isfinite(value) and value >= 0.0):
                raise SceneError(f"material '{self.name}': {name} is {value}; give a finite number, 0 or above")

    @property
    def ratios(self) -> tuple[float, ...]:
        """g_i = G_i / G_r of each branch."""
        return tuple(branch.shear_Pa / self.shear_relaxed_Pa for branch in self.branches)

    @property
    def times_s(self) -> tuple[float, ...]:
        """tau_i of each branch [s]."""
        return tuple(branch.time_s for branch in self.branches)

    @property
    def viscous_time_s(self) -> float:
        """eta / G_r [s]."""
        return self.viscosity_Pa_s / self.shear_relaxed_Pa

    @property
    def shear_instant_Pa(self) -> float:
        """G_r + sum G_i [Pa], the shear modulus at once; with a dashpot it is infinite, which this leaves out."""
        return self.shear_relaxed_Pa + sum(b.shear_Pa for b in self.branches if b.time_s > 0.0)


def bulk_from_poisson(nu: float, shear: float) -> float:
    """Bulk modulus K = 2 G (1 + nu) / (3 (1 - 2 nu)) [Pa] of Poisson's ratio nu and shear modulus [Pa].

    Raises SceneError unless -1 < nu < 0.5 and shear > 0.
    """
    if not -1.0 < nu < 0.5:
        raise SceneError(f"Poisson's ratio is {nu}; give a number above -1 and below 0.5 (0.4999 for soft tissue)")
    if not (math.isfinite(shear) and shear > 0.0):
        raise SceneError(f"shear modulus is {shear} Pa; give a finite number above 0")
    return 2.0 * shear * (1.0 + nu) / (3.0 * (1.0 - 2.0 * nu))


def stiffening(material: Material, s: complex | Complex) -> complex | Complex:
    """G(s) / G_r at complex rates s [1/s] of e^{st}, any shape."""
    total = 1.0 + material.viscous_time_s * s
    for ratio, time_s in zip(material.ratios, material.times_s, strict=True):
        total = total + ratio * (s * time_s) / (1.0 + s * time_s)
    return total


def complex_shear(material: Material, f_Hz: float) -> complex:
    """Complex shear modulus G' - iG'' [Pa] at f [Hz] under e^{-i w t}."""
    return complex(material.shear_relaxed_Pa * stiffening(material, -2j * math.pi * f_Hz))


def complex_bulk(material: Material, f_Hz: float) -> complex:
    """Complex bulk modulus [Pa] at f [Hz] under e^{-i w t}; real unless it follows the shear modulus."""
    return complex(material.bulk_Pa * (stiffening(material, -2j * math.pi * f_Hz) if material.bulk_relaxes else 1.0))


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
        branches=(Branch(20e3, 3.42 / 20e3),),
        bulk_Pa=bulk_from_poisson(0.495, 12.5e3),
        source="Chilles et al., Ecoflex 00-10 phantom: G_r 12.5 kPa, G_m 20 kPa, eta 3.42 Pa s (tau = eta/G_m = "
        "171 us), nu 0.495 read as printed, that is on the relaxed modulus",
    ),
    "palm": Material(
        name="palm",
        density_kg_m3=1100.0,
        shear_relaxed_Pa=19.9e3,
        branches=(Branch(17.3e3, 1.56e-3),),
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
