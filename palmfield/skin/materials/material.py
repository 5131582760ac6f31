"""Viscoelastic materials of skin, and its sub-layers. Presets are in palmfield.skin.materials.catalogue."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from palmfield.errors import SceneError
from palmfield.types import Complex, Float

INCOMPRESSIBLE = 1e6
"""Ratio K / shear modulus that replaces nu = 0.5 in `elastic`, `kelvin_voigt` and similar functions.

The motion differs from that of an incompressible layer by less than 6e-5 for spots of 6 to 20 mm on bonded layers of
1 to 20 mm at 0 to 400 Hz (docs/materials.md; tests/skin/test_material.py), and by more for thinner layers, wider spots.
"""
FELT_Hz: Float = np.geomspace(5.0, 1000.0, 48)
"""Frequencies at which a law is compared with the series that replaces it in time steppers [Hz]."""
NuOf = Literal["instant", "relaxed"]


@dataclass(frozen=True)
class Branch:
    """Maxwell branch: spring G_m [Pa], >= 0, in series with a dashpot; time_s: tau = eta / G_m [s], >= 0.

    With tau = 0 the branch has no effect.
    """

    shear_Pa: float
    time_s: float


class Relaxation(NamedTuple):
    """G(s) / G_r = 1 + sum g s tau / (1 + s tau) + t s: form of a law in time steppers and reduced models.

    branches: (g, tau [s]) of each Maxwell branch; viscous_time_s: t = eta / G_r [s]
    """

    branches: tuple[tuple[float, float], ...]
    viscous_time_s: float

    @property
    def active(self) -> tuple[tuple[float, float], ...]:
        """Branches with stiffness and time above 0."""
        return tuple((ratio, time_s) for ratio, time_s in self.branches if ratio > 0.0 and time_s > 0.0)

    def stiffening(self, s: complex | Complex) -> complex | Complex:
        """Return G(s) / G_r at complex rates s [1/s] of e^{st}, any shape."""
        total = 1.0 + self.viscous_time_s * s
        for ratio, time_s in self.branches:
            total = total + ratio * (s * time_s) / (1.0 + s * time_s)
        return total


@dataclass(frozen=True)
class Material:
    """Spring, Maxwell branches and dashpot in parallel, in shear: G(s) = G_r + sum G_i s tau_i/(1 + s tau_i) + eta s.

    No branch and no dashpot: elastic. A dashpot alone: Kelvin-Voigt. One branch: standard linear solid. More branches:
    Prony series. A law of another form is a subclass (docs/materials.md). It has its own `stiffening`, by ratios to
    G_r and times, and a `series` that replaces it in time steppers. Solvers use `stiffening` and `modulus` at rates s,
    `relaxation` in time, and G_r, K, `shear_instant_Pa` and `bulk_instant_Pa` as bounds.

    density_kg_m3: rho [kg/m^3], > 0.
    shear_relaxed_Pa: G_r [Pa], > 0.
    branches: Maxwell branches, any number.
    bulk_Pa: K [Pa], > 0, of the relaxed solid.
    viscosity_Pa_s: eta [Pa s], >= 0.
    bulk_relaxes: True: K(s) = K G(s) / G_r (Poisson's ratio is constant); False: K is elastic.
    source: source of the numbers.

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
        positive = ("density_kg_m3", "shear_relaxed_Pa", "bulk_Pa")
        values = {name: getattr(self, name) for name in (*positive, "viscosity_Pa_s")}
        for number, branch in enumerate(self.branches):
            values |= {f"branches[{number}].shear_Pa": branch.shear_Pa, f"branches[{number}].time_s": branch.time_s}
        for name, value in values.items():
            if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and name not in positive))):
                least = " above 0" if name in positive else ", 0 or above"
                raise SceneError(f"material '{self.name}': {name} is {value}; give a finite number{least}")
        at_rest = complex(self.stiffening(0.0))
        if not abs(at_rest - 1.0) < 1e-9:
            raise SceneError(f"material '{self.name}': G(0) is {at_rest:g} G_r; give a law with G(0) = G_r")

    @property
    def series(self) -> tuple[Branch, ...]:
        """Maxwell branches, parallel to spring and dashpot, that replace the law in time steppers."""
        return self.branches

    @cached_property
    def relaxation(self) -> Relaxation:
        """Form of the law in time steppers, from `series` and the dashpot."""
        branches = tuple((branch.shear_Pa / self.shear_relaxed_Pa, branch.time_s) for branch in self.series)
        return Relaxation(branches, self.viscosity_Pa_s / self.shear_relaxed_Pa)

    @cached_property
    def series_error(self) -> float:
        """Relative error of G by `relaxation`, rms over FELT_Hz; 0 if the law has the form of `relaxation`."""
        s = np.asarray(-2j * np.pi * FELT_Hz, dtype=np.complex128)
        exact = self.stiffening(s)
        return float(np.sqrt(np.mean(np.abs((self.relaxation.stiffening(s) - exact) / exact) ** 2)))

    @property
    def law(self) -> tuple[type, Relaxation]:
        """Value that is equal for materials with the same relaxation."""
        return type(self), self.relaxation

    @property
    def relaxes(self) -> bool:
        """Whether the material loses energy, so that it is not elastic."""
        return self.viscosity_Pa_s > 0.0 or len(self.relaxation.active) > 0

    @property
    def shear_instant_Pa(self) -> float:
        """Instantaneous shear modulus G_r + sum G_i [Pa], without the dashpot, which would make it infinite."""
        return self.shear_relaxed_Pa + sum(b.shear_Pa for b in self.series if b.time_s > 0.0)

    @property
    def bulk_instant_Pa(self) -> float:
        """Instantaneous bulk modulus [Pa]."""
        return self.bulk_Pa * (self.shear_instant_Pa / self.shear_relaxed_Pa if self.bulk_relaxes else 1.0)

    def stiffening(self, s: complex | Complex) -> complex | Complex:
        """Return G(s) / G_r at complex rates s [1/s] of e^{st}, any shape; 1 at s = 0."""
        return self.relaxation.stiffening(s)

    def modulus(self, s: complex | Complex) -> complex | Complex:
        """Return G(s) [Pa]; arguments as for `stiffening`."""
        return self.shear_relaxed_Pa * self.stiffening(s)


def bulk_from_poisson(nu: float, shear: float) -> float:
    """Return the bulk modulus K = 2 G (1 + nu) / (3 (1 - 2 nu)) [Pa] for Poisson's ratio nu and shear modulus G [Pa].

    Raises SceneError unless -1 < nu < 0.5 and shear > 0.
    """
    if not -1.0 < nu < 0.5:
        raise SceneError(f"Poisson's ratio is {nu}; give a number above -1 and below 0.5 (0.4999 for soft tissue)")
    if not (math.isfinite(shear) and shear > 0.0):
        raise SceneError(f"shear modulus is {shear} Pa; give a finite number above 0")
    return 2.0 * shear * (1.0 + nu) / (3.0 * (1.0 - 2.0 * nu))


def elastic(
    name: str,
    density_kg_m3: float,
    shear_Pa: float,
    nu: float = 0.4999,
    *,
    source: str = "",
    bulk_relaxes: bool = False,
) -> Material:
    """Return a spring G: density rho [kg/m^3], shear modulus G [Pa], Poisson's ratio nu; errors as for `prony`."""
    return prony(name, density_kg_m3, shear_Pa, (), (), nu, source=source, bulk_relaxes=bulk_relaxes)


def kelvin_voigt(
    name: str,
    density_kg_m3: float,
    shear_Pa: float,
    viscosity_Pa_s: float,
    nu: float = 0.4999,
    *,
    source: str = "",
    bulk_relaxes: bool = False,
) -> Material:
    """Return a spring G [Pa] parallel to a dashpot eta [Pa s]: G(s) = G + eta s. nu: of the spring; see `prony`."""
    return prony(
        name, density_kg_m3, shear_Pa, (), (), nu,
        viscosity_Pa_s=viscosity_Pa_s, source=source, bulk_relaxes=bulk_relaxes,
    )  # fmt: skip


def standard_linear(
    name: str,
    density_kg_m3: float,
    relaxed_Pa: float,
    branch_Pa: float,
    time_s: float,
    nu: float = 0.4999,
    *,
    nu_of: NuOf = "instant",
    source: str = "",
    bulk_relaxes: bool = False,
) -> Material:
    """Return a standard linear solid: spring G_r [Pa] parallel to a Maxwell branch G_m [Pa], tau [s]; see `prony`."""
    return prony(
        name, density_kg_m3, relaxed_Pa, (branch_Pa,), (time_s,), nu,
        nu_of=nu_of, source=source, bulk_relaxes=bulk_relaxes,
    )  # fmt: skip


def prony(
    name: str,
    density_kg_m3: float,
    relaxed_Pa: float,
    branches_Pa: Sequence[float],
    times_s: Sequence[float],
    nu: float = 0.4999,
    *,
    nu_of: NuOf = "instant",
    viscosity_Pa_s: float = 0.0,
    source: str = "",
    bulk_relaxes: bool = False,
) -> Material:
    """Return a spring G_r [Pa] parallel to Maxwell branches G_i [Pa], tau_i [s], and a dashpot eta [Pa s].

    nu: Poisson's ratio, above -1; 0.5 gives K = INCOMPRESSIBLE times the shear modulus.
    nu_of: the shear modulus to which nu applies: "instant", G_r + sum G_i (without the dashpot), or "relaxed", G_r.
        The default is "instant", because soft tissue is nearly incompressible at all rates. If the bulk relaxes too, nu
        is the same at all rates, and K of the relaxed solid follows from G_r.
    Raises SceneError as Material and bulk_from_poisson, for unequal numbers of moduli and times, and an unknown nu_of.
    """
    if len(branches_Pa) != len(times_s):
        raise SceneError(
            f"material '{name}': {len(branches_Pa)} branch moduli, {len(times_s)} times; give one for each"
        )
    if nu_of not in ("instant", "relaxed"):
        raise SceneError(f"material '{name}': nu_of is '{nu_of}'; use 'instant' or 'relaxed'")
    branches = tuple(Branch(float(shear), float(time)) for shear, time in zip(branches_Pa, times_s, strict=True))
    springs = Material(
        name, density_kg_m3, relaxed_Pa, branches, 1.0, source, viscosity_Pa_s=viscosity_Pa_s, bulk_relaxes=bulk_relaxes
    )
    shear = springs.shear_relaxed_Pa if bulk_relaxes or nu_of == "relaxed" else springs.shear_instant_Pa
    return replace(springs, bulk_Pa=INCOMPRESSIBLE * shear if nu == 0.5 else bulk_from_poisson(nu, shear))


def complex_shear(material: Material, f_Hz: float) -> complex:
    """Return the complex shear modulus G' - iG'' [Pa] at f [Hz] under e^{-i w t}."""
    return complex(material.modulus(-2j * math.pi * f_Hz))


def complex_bulk(material: Material, f_Hz: float) -> complex:
    """Return the complex bulk modulus [Pa] at f [Hz] under e^{-i w t}; real unless `bulk_relaxes`."""
    return complex(material.bulk_Pa * (material.stiffening(-2j * math.pi * f_Hz) if material.bulk_relaxes else 1.0))


def shear_wave(material: Material, f_Hz: float) -> tuple[float, float]:
    """Return the phase speed [m/s] and 1/e length of the amplitude [m] of a plane shear wave at f > 0 [Hz].

    Raises SceneError for f <= 0. The length is infinite where the material is elastic.
    """
    if not f_Hz > 0.0:
        raise SceneError(f"frequency is {f_Hz} Hz; allowed: above 0")
    omega = 2.0 * math.pi * f_Hz
    wavenumber = omega * cmath.sqrt(material.density_kg_m3 / complex_shear(material, f_Hz))
    return omega / wavenumber.real, 1.0 / wavenumber.imag if wavenumber.imag > 0.0 else math.inf


@dataclass(frozen=True)
class Sheet:
    """A sub-layer: thickness_m [m], > 0, of one material."""

    material: Material
    thickness_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.thickness_m) and self.thickness_m > 0.0):
            raise SceneError(f"sheet of '{self.material.name}': thickness_m is {self.thickness_m}; give one above 0")
