"""Linear viscoelastic materials: named ones, fits to measurements, and the waves that they carry."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.materials.catalogue import CATALOGUE, PRESETS, hand_skin, preset
    from palmfield.skin.materials.dispersion import Waves, cutoff, describe
    from palmfield.skin.materials.material import (
        Branch,
        Material,
        bulk_from_poisson,
        complex_bulk,
        complex_shear,
        elastic,
        kelvin_voigt,
        prony,
        shear_wave,
        standard_linear,
    )
    from palmfield.skin.materials.prony_fit import PronyFit, fit_prony
    from palmfield.skin.materials.sheet import Sheet

_WHERE = {
    **dict.fromkeys(("CATALOGUE", "PRESETS", "hand_skin", "preset"), "catalogue"),
    **dict.fromkeys(("Waves", "cutoff", "describe"), "dispersion"),
    **dict.fromkeys(
        (
            "Branch",
            "Material",
            "bulk_from_poisson",
            "complex_bulk",
            "complex_shear",
            "elastic",
            "kelvin_voigt",
            "prony",
            "shear_wave",
            "standard_linear",
        ),
        "material",
    ),
    **dict.fromkeys(("PronyFit", "fit_prony"), "prony_fit"),
    "Sheet": "sheet",
}
__all__ = [
    "CATALOGUE",
    "PRESETS",
    "Branch",
    "Material",
    "PronyFit",
    "Sheet",
    "Waves",
    "bulk_from_poisson",
    "complex_bulk",
    "complex_shear",
    "cutoff",
    "describe",
    "elastic",
    "fit_prony",
    "hand_skin",
    "kelvin_voigt",
    "preset",
    "prony",
    "shear_wave",
    "standard_linear",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
