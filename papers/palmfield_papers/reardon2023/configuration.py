"""The slab of Reardon et al. 2023 under each reading, and under negative controls."""

from dataclasses import dataclass, replace
from typing import Any, Literal, cast

from palmfield.skin import Material, Sheet, Slab, half_space, kelvin_voigt
from palmfield_papers.answer import Setting

DENSITY_kg_m3 = 923.5
SHEAR_SPEED_m_s = 5.0
THICKNESS_m = 0.01
RADIUS_m = 0.125
FWHM_m = 0.006
PASCAL = 1.0
"""Largest pressure of the spot. It cancels in all compared numbers, because these are ratios and positions."""
FASTER = 1.4
"""Factor of the shear speed in control `wave_speed`."""


Back = Literal["free", "bonded", "deep"]


@dataclass(frozen=True)
class Plate:
    """A slab.

    back: "free", "bonded", or "deep" (the material without end below)
    rim: "absorbing" (infinite slab) or "reflecting" (a frictionless wall around the 25 cm)
    """

    back: Back = "free"
    rim: str = "absorbing"
    viscosity_Pa_s: float = 0.02
    shear_speed_m_s: float = SHEAR_SPEED_m_s
    thickness_m: float = THICKNESS_m
    fwhm_m: float = FWHM_m

    @property
    def material(self) -> Material:
        """Return the material: Kelvin-Voigt, nearly incompressible. The speed of pressure waves is not printed."""
        shear = DENSITY_kg_m3 * self.shear_speed_m_s**2
        return kelvin_voigt("reardon", DENSITY_kg_m3, shear, self.viscosity_Pa_s)

    @property
    def slab(self) -> Slab:
        """Return the slab in the form for `palmfield.skin`."""
        sheets = (Sheet(self.material, self.thickness_m),)
        base = half_space(self.material) if self.back == "deep" else self.back
        if self.rim == "reflecting":
            return Slab(sheets, shape="disc", base=base, side="roller", radius_m=RADIUS_m)
        return Slab(sheets, base=base)


@dataclass(frozen=True)
class Course:
    """A focus that moves along straight lines at constant speed; the slab is initially at rest.

    corners: [m], in order
    speed_m_s: speed along the lines
    steps: number of samples at equal time steps
    turns: number of turns on a closed path (whose last corner is its first)
    rate_Hz: control rate, with constant position between control steps; None for continuous motion
    skipped: number of first samples that are not evaluated
    still_after_s: silence after the end [s], which is evaluated too
    """

    corners: tuple[tuple[float, float], ...]
    speed_m_s: float
    steps: int
    turns: int = 1
    rate_Hz: float | None = None
    skipped: int = 0
    still_after_s: float = 0.0


DEEP: dict[str, Any] = {"back": "bonded", "thickness_m": 0.06}
"""Whether the slab has an absorbing layer below, as in the solver of the paper.

Shear waves need 24 ms to the base of 60 mm and back, about as long as the runs last. With
back "deep", R6b, R7a, R7b and R8-R9b of quick runs differ by less than 1 %.
"""


def plate_of(setting: Setting, **changes: Any) -> Plate:
    """Return the slab of rows R5 to R14 and R20. changes: changes of its fields, to find causes"""
    readings = dict(setting.readings)
    plate = Plate(
        back=cast(Back, readings.get("reardon_back", "free")),
        rim=readings.get("reardon_rim", "absorbing"),
        viscosity_Pa_s=_number(readings.get("reardon_viscosity", "0.02")),
        shear_speed_m_s=SHEAR_SPEED_m_s * (FASTER if setting.control == "wave_speed" else 1.0),
    )
    return replace(plate, **changes)


def tissue_of(setting: Setting, **changes: Any) -> Plate:
    """Return the slab that represents the hand in rows R16 to R19: bonded and infinite."""
    readings = dict(setting.readings)
    tissue = readings.get("reardon_hand_tissue", "slab of 1 cm at 5 m/s, bonded")
    speed = _number(tissue.split(" at ")[1])
    plate = Plate(
        back="bonded", viscosity_Pa_s=_number(readings.get("reardon_hand_viscosity", "1 Pa s")), shear_speed_m_s=speed
    )
    return replace(plate, **changes)


def length_of(setting: Setting) -> float:
    """Return the length of the straight path [m]."""
    return 0.01 * _number(dict(setting.readings).get("reardon_path", "16 cm"))


def threshold_of(setting: Setting) -> float:
    """Return the fraction of the maximum that defines a wake."""
    return 0.01 * _number(dict(setting.readings).get("reardon_threshold", "10 %"))


def first_number(setting: Setting, axis: str) -> float:
    """Return the first number in the text of a reading, such as "30 % of the ring"."""
    return _number(setting.reading(axis).removeprefix("radius "))


def _number(words: str) -> float:
    return float(words.split()[0])
