"""Materials at the ends of the ranges of a preset."""

from dataclasses import replace
from typing import Any

from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.materials.ranges import Preset


def varied(entry: Preset) -> list[Material]:
    """Return the materials of a preset at the low and the high end of each range, one range at a time."""
    materials = []
    for bounds in entry.ranges:
        for value in (bounds.low, bounds.high):
            name = f"{entry.material.name}, {bounds.parameter} {value:g}"
            materials.append(_with_value(entry.material, bounds.parameter, value, name))
    return materials


def softest_and_stiffest(entry: Preset) -> tuple[Material, Material] | None:
    """Return the material of a preset with all ranges at the low ends, and at the high ends; None without ranges."""
    if not entry.ranges:
        return None
    ends = []
    for end in ("low", "high"):
        material = entry.material
        for bounds in entry.ranges:
            name = f"{entry.material.name}, ranges at their {end} ends"
            material = _with_value(material, bounds.parameter, getattr(bounds, end), name)
        ends.append(material)
    return ends[0], ends[1]


def _with_value(material: Material, parameter: str, value: float, name: str) -> Material:
    """Return the material with another value of one parameter; see `Range`."""
    if parameter == "shear":
        return scaled(material, value, name)
    changed: dict[str, Any] = {parameter: value}
    return replace(material, name=name, **changed)


def scaled(material: Material, factor: float, name: str) -> Material:
    """Return the material with all shear moduli times a factor. K, for the small change of the volume, is unchanged."""
    branches = tuple(Branch(factor * branch.shear_Pa, branch.time_s) for branch in material.branches)
    return replace(
        material,
        name=name,
        shear_relaxed_Pa=factor * material.shear_relaxed_Pa,
        branches=branches,
        viscosity_Pa_s=factor * material.viscosity_Pa_s,
    )
