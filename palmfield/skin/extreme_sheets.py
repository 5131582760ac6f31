"""Materials and sheets of a scene at the ends of the ranges of their presets."""

from dataclasses import replace
from typing import Any

from palmfield.config.skin import OVERRIDES, SkinConfig
from palmfield.skin.from_config import sheets_of
from palmfield.skin.materials.catalogue import CATALOGUE
from palmfield.skin.materials.material import Branch, Material, Sheet
from palmfield.skin.materials.ranges import Preset


def softest_and_stiffest_sheets(skin: SkinConfig) -> tuple[tuple[Sheet, ...], tuple[Sheet, ...]] | None:
    """Return the sheets of a scene with all preset ranges at their low ends, and at their high ends.

    Returns None if no sheet has a range, or if keys of the scene set the material: keys have no range.
    """
    if not skin.materials and any(getattr(skin, key) is not None for key in OVERRIDES):
        return None
    sheets = sheets_of(skin)
    names = skin.materials or (skin.material,)
    ends = [softest_and_stiffest(CATALOGUE[name]) for name in names]
    if all(end is None for end in ends):
        return None
    soft, stiff = (
        tuple(
            Sheet(sheet.material if end is None else end[number], sheet.thickness_m)
            for sheet, end in zip(sheets, ends, strict=True)
        )
        for number in (0, 1)
    )
    return soft, stiff


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
