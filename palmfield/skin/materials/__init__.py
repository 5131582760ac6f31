"""Linear viscoelastic materials: named ones, fits to measurements, and the waves that they carry."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
