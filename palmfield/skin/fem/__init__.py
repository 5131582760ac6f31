"""Finite elements of a skin layer: its matrices, loads and readers, and what steps the whole layer in time."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.fem.assembly import SkinSystem, assemble
    from palmfield.skin.fem.body import build
    from palmfield.skin.fem.factor import Factor, factorise
    from palmfield.skin.fem.foundation import fit_foundation
    from palmfield.skin.fem.load import PressureHistory, SurfaceQuadrature
    from palmfield.skin.fem.probe import SurfaceProbe, surface_motion, surface_vectors
    from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
    from palmfield.skin.fem.wedge_stepper import WedgeStepper

_WHERE = {
    **dict.fromkeys(("SkinSystem", "assemble"), "assembly"),
    "build": "body",
    **dict.fromkeys(("Factor", "factorise"), "factor"),
    "fit_foundation": "foundation",
    **dict.fromkeys(("PressureHistory", "SurfaceQuadrature"), "load"),
    **dict.fromkeys(("SurfaceProbe", "surface_motion", "surface_vectors"), "probe"),
    **dict.fromkeys(("harmonic", "harmonic_discrete", "static"), "solver"),
    "WedgeStepper": "wedge_stepper",
}
__all__ = [
    "Factor",
    "PressureHistory",
    "SkinSystem",
    "SurfaceProbe",
    "SurfaceQuadrature",
    "WedgeStepper",
    "assemble",
    "build",
    "factorise",
    "fit_foundation",
    "harmonic",
    "harmonic_discrete",
    "static",
    "surface_motion",
    "surface_vectors",
]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
