"""A preset material and the uncertainty of its numbers."""

from dataclasses import dataclass

from palmfield.skin.materials.material import Material


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
class Preset:
    """A material and the ranges of its numbers."""

    material: Material
    ranges: tuple[Range, ...] = ()
