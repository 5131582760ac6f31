"""Sheets of a scene at the ends of the ranges of their presets."""

from palmfield.config.skin import OVERRIDES, SkinConfig
from palmfield.skin.from_config import sheets_of
from palmfield.skin.materials.catalogue import CATALOGUE
from palmfield.skin.materials.extremes import softest_and_stiffest
from palmfield.skin.materials.sheet import Sheet


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
