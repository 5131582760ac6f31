"""A preset material and the uncertainty of its numbers."""

from dataclasses import dataclass
from typing import Literal

from palmfield.skin.materials.material import Material

Quantity = Literal["surface speed", "shear speed", "decay", "storage in compression"]
UNITS: dict[str, str] = {"surface speed": "m/s", "shear speed": "m/s", "decay": "1", "storage in compression": "Pa"}


@dataclass(frozen=True)
class Range:
    """Range of a parameter: name of a field of Material, or "shear" for all shear moduli together.

    low, high: values in the unit of the field; for "shear", factors on the shear modulus of the preset.
    source: kind of range (one standard deviation, extremes, ...) and origin.
    """

    parameter: str
    low: float
    high: float
    source: str


@dataclass(frozen=True)
class Observation:
    """A measurement with which a material can be compared.

    quantity: "surface speed" [m/s]: phase speed of the Rayleigh wave; "shear speed" [m/s]; "decay": |u(40 mm)| /
        |u(5 mm)| from a Gaussian spot of 10 mm full width on a layer of depth depth_m, bonded to bone; "storage in
        compression" [Pa]: 3 G' of a bar with free sides.
    f_Hz: frequency [Hz]. value: in UNITS[quantity]. spread: standard deviation or half the range, None if unknown.
    """

    quantity: Quantity
    f_Hz: float
    value: float
    spread: float | None
    source: str
    depth_m: float = 0.0


@dataclass(frozen=True)
class Preset:
    """A material, the ranges of its numbers, and measurements for comparison."""

    material: Material
    ranges: tuple[Range, ...] = ()
    observations: tuple[Observation, ...] = ()
