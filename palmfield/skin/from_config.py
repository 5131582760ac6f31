"""Materials, rows of elements and base of a skin layer, from the keys of a scene."""

from dataclasses import astuple, replace

import scipy  # loads its submodules at first use

from palmfield.config.skin import ENDLESS, OVERRIDES, SkinConfig
from palmfield.errors import SceneError
from palmfield.skin.base import Base, Springs
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Branch, Material, Sheet, shear_wave


def sheets_of(skin: SkinConfig) -> tuple[Sheet, ...]:
    """Return the sheets from the surface down; thicknesses are shares of the depth of the layer."""
    if not skin.materials:
        return (Sheet(material_of(skin), 1.0),)
    return tuple(Sheet(preset(name), share) for name, share in zip(skin.materials, skin.shares, strict=True))


def slowest(sheets: tuple[Sheet, ...], f_Hz: float) -> Material:
    """Return the material with the slowest shear wave at a frequency [Hz]: it needs the smallest elements."""
    return min((sheet.material for sheet in sheets), key=lambda material: shear_wave(material, f_Hz)[0])


def quarter_periods(sheets: tuple[Sheet, ...], depth_m: float, f_Hz: float) -> float:
    """Return the time of a shear wave through a layer of this depth [m], in quarters of a period of f_Hz.

    If it is below 1, a layer bonded to a rigid base guides no wave.
    """
    times = [sheet.thickness_m * depth_m / shear_wave(sheet.material, f_Hz)[0] for sheet in sheets]
    return 4.0 * f_Hz * sum(times)


def layer_cutoff(sheets: tuple[Sheet, ...], depth_m: float) -> float:
    """Return the frequency [Hz] at which `quarter_periods` of a layer of this depth [m] is 1.

    For one material it is c_s / 4h (`palmfield.skin.materials.dispersion.cutoff`)."""
    from palmfield.skin.materials.dispersion import cutoff

    slow = min(cutoff(sheet.material, sheet.thickness_m * depth_m) for sheet in sheets)

    def excess(f_Hz: float) -> float:
        return quarter_periods(sheets, depth_m, f_Hz) - 1.0

    return float(scipy.optimize.brentq(excess, 1e-3 * slow, 1.000001 * slow))


def cutoff_Hz(skin: SkinConfig, sheets: tuple[Sheet, ...], depth_m: float) -> float | None:
    """Return the frequency [Hz] below which a layer of this depth [m] guides no wave; None unless on bone or springs.

    For springs instead of a rigid base, the result is an upper bound.
    """
    return None if skin.base in ("free_slip", "free", *ENDLESS) else layer_cutoff(sheets, depth_m)


def sheets_in_words(sheets: tuple[Sheet, ...]) -> str:
    """Return the names of the materials from the surface down; for several materials, with their shares."""
    if len(sheets) == 1:
        return sheets[0].material.name
    return ", ".join(f"{100 * sheet.thickness_m:.3g} % {sheet.material.name}" for sheet in sheets)


def base_of(skin: SkinConfig, sheets: tuple[Sheet, ...]) -> Base:
    """Return the base of a layer of these sheets in the form of `palmfield.skin.fem.assembly.assemble`."""
    if skin.base == "deep" or skin.base == "muscle":
        from palmfield.skin.endless import half_space

        return half_space(preset("muscle") if skin.base == "muscle" else sheets[-1].material)
    return Springs(*(skin.springs or ())) if skin.base == "springs" else skin.base


def material_of(skin: SkinConfig) -> Material:
    """Return the material: the preset, with values from the keys of the scene that override it."""
    changed = {key: getattr(skin, key) for key in OVERRIDES if getattr(skin, key) is not None}
    base = preset(skin.material)
    if not changed:
        return base
    of_branch = ("shear_branch_Pa", "relaxation_time_s")
    values = {key: value for key, value in changed.items() if key not in of_branch}
    branch = [changed.get(key) for key in of_branch]
    if branch != [None, None]:
        if base.series != base.branches:
            raise SceneError(f"material '{base.name}' has its own law: remove {' and '.join(of_branch)}")
        if None in branch and len(base.branches) != 1:
            raise SceneError(
                f"material '{base.name}' has {len(base.branches)} branches; give both shear_branch_Pa and "
                "relaxation_time_s, which replace all of them"
            )
        own = base.branches[0] if base.branches else Branch(0.0, 0.0)
        values["branches"] = (
            Branch(*(new if new is not None else old for new, old in zip(branch, astuple(own), strict=True))),
        )
    return replace(
        base, name=f"{base.name}, changed", source=f"{base.source}; set by the scene: {', '.join(changed)}", **values
    )
