"""Skin as a viscoelastic solid: materials, bodies, loads, and solvers with a known error.

from palmfield.skin import Sheet, Slab, Spot, preset, solve
body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
load = Spot(fwhm_m=0.0103, times_s=[0.0, 1e-3], peak_Pa=[0.0, 12.0])
motion = solve(body, load, times=[0.01, 0.05], at=[[0.0, 0.0]])
print(motion.displacement_m[:, 0, 2], motion.error)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.materials.catalogue import preset
    from palmfield.skin.materials.material import Branch, Material
    from palmfield.skin.problem import Foundation, Layer, Motion, Sheet, Slab, Spot, Springs, Traction
    from palmfield.skin.solver_choice import choices, solve, static

_WHERE = {
    **dict.fromkeys(("Branch", "Material"), "materials.material"),
    **dict.fromkeys(("Foundation", "Layer", "Motion", "Sheet", "Slab", "Spot", "Springs", "Traction"), "problem"),
    **dict.fromkeys(("choices", "solve", "static"), "solver_choice"),
    "preset": "materials.catalogue",
}
__all__ = [
    "Branch",
    "Foundation",
    "Layer",
    "Material",
    "Motion",
    "Sheet",
    "Slab",
    "Spot",
    "Springs",
    "Traction",
    "choices",
    "preset",
    "solve",
    "static",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
