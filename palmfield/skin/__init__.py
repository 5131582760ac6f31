"""Skin as a viscoelastic solid: materials, bodies, loads, and solvers with a known error.

from palmfield.skin import Sheet, Slab, Spot, preset, solve
body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
load = Spot(fwhm_m=0.0103, times_s=[0.0, 1e-3], peak_Pa=[0.0, 12.0])
motion = solve(body, load, times=[0.01, 0.05], at=[[0.0, 0.0]])
print(motion.displacement_m[:, 0, 2], motion.error)
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.materials.catalogue import preset
    from palmfield.skin.materials.material import Branch, Material
    from palmfield.skin.problem import Foundation, Layer, Motion, Sheet, Slab, Spot, Springs, Traction
    from palmfield.skin.solver_choice import choices, solve, static

_WHERE = {
    "preset": "materials.catalogue",
    **dict.fromkeys(("Branch", "Material"), "materials.material"),
    **dict.fromkeys(("Foundation", "Layer", "Motion", "Sheet", "Slab", "Spot", "Springs", "Traction"), "problem"),
    **dict.fromkeys(("choices", "solve", "static"), "solver_choice"),
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
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
