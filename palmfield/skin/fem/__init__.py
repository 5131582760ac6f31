"""Finite elements of a skin layer: its matrices, loads and readers, and what steps the whole layer in time."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.fem.assembly import SkinSystem, assemble
    from palmfield.skin.fem.body import build
    from palmfield.skin.fem.factor import Factor, factorise
    from palmfield.skin.fem.foundation import fit_foundation
    from palmfield.skin.fem.load import PressureHistory, SurfaceQuadrature, face_points
    from palmfield.skin.fem.probe import SurfaceProbe, surface_motion, surface_vectors
    from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
    from palmfield.skin.fem.wedge_stepper import WedgeStepper

_WHERE = {
    **dict.fromkeys(("SkinSystem", "assemble"), "assembly"),
    "build": "body",
    **dict.fromkeys(("Factor", "factorise"), "factor"),
    "fit_foundation": "foundation",
    **dict.fromkeys(("PressureHistory", "SurfaceQuadrature", "face_points"), "load"),
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
    "face_points",
    "factorise",
    "fit_foundation",
    "harmonic",
    "harmonic_discrete",
    "static",
    "surface_motion",
    "surface_vectors",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
