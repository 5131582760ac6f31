"""A named material, and how sure its numbers are."""

from dataclasses import dataclass
from typing import Literal

from palmfield.skin.materials.material import Material

Quantity = Literal["surface speed", "shear speed", "decay", "storage in compression"]
UNITS: dict[str, str] = {"surface speed": "m/s", "shear speed": "m/s", "decay": "1", "storage in compression": "Pa"}


@dataclass(frozen=True)
class Range:
    """A parameter of a Material (a field's name) or of its whole shear modulus ("shear"), and what is known of it.

    low, high: in the field's unit, or as factors on the preset's shear modulus where the parameter is "shear"
    source: what the range is (one standard deviation, extremes, ...) and where it comes from
    """

    parameter: str
    low: float
    high: float
    source: str


@dataclass(frozen=True)
class Observation:
    """Something measured that a material can be held against.

    quantity: "surface speed" [m/s]: phase speed of the Rayleigh wave; "shear speed" [m/s]; "decay": |u(40 mm)| over
        |u(5 mm)| beside a Gaussian spot of 10 mm full width on a layer depth_m deep, bonded to bone; "storage in
        compression" [Pa]: 3 G' of a bar that may widen freely
    f_Hz: frequency [Hz]; value: in UNITS[quantity]; spread: its standard deviation or half its range, None if unknown
    """

    quantity: Quantity
    f_Hz: float
    value: float
    spread: float | None
    source: str
    depth_m: float = 0.0


@dataclass(frozen=True)
class Preset:
    """A material, the ranges of its numbers, and the measurements that it stands beside."""

    material: Material
    ranges: tuple[Range, ...] = ()
    observations: tuple[Observation, ...] = ()
