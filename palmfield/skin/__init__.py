"""Skin as a viscoelastic solid: materials, bodies, loads, and solvers with a known error.

from palmfield.skin import Sheet, Slab, Spot, preset, solve
body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
load = Spot(fwhm_m=0.0103, times_s=[0.0, 1e-3], peak_Pa=[0.0, 12.0])
motion = solve(body, load, times=[0.01, 0.05], at=[[0.0, 0.0]])
print(motion.displacement_m[:, 0, 2], motion.error)

`solve` takes a whole history; what scenes step are the same SkinSteppers, on a SceneLayer.
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.fem.wedge_stepper import WedgeStepper
    from palmfield.skin.materials.catalogue import CATALOGUE, preset, softest_and_stiffest
    from palmfield.skin.materials.material import Branch, Material, kelvin_voigt, shear_wave
    from palmfield.skin.materials.sheet import Sheet
    from palmfield.skin.problem import Foundation, Layer, Motion, Slab, Spot, Springs, Traction
    from palmfield.skin.reduction.reduced_stepper import KnownLoad, ReducedStepper, reduced_stepper
    from palmfield.skin.scene_layer import LayerDemand, LayerSizes, SceneLayer, layer_sizes
    from palmfield.skin.solver_choice import Choice, choices, scene_choices, solve, static
    from palmfield.skin.stepper import Reader, SkinStepper, SurfaceLoads

_WHERE = {
    "WedgeStepper": "fem.wedge_stepper",
    **dict.fromkeys(("CATALOGUE", "preset", "softest_and_stiffest"), "materials.catalogue"),
    **dict.fromkeys(("Branch", "Material", "kelvin_voigt", "shear_wave"), "materials.material"),
    "Sheet": "materials.sheet",
    **dict.fromkeys(("Foundation", "Layer", "Motion", "Slab", "Spot", "Springs", "Traction"), "problem"),
    **dict.fromkeys(("KnownLoad", "ReducedStepper", "reduced_stepper"), "reduction.reduced_stepper"),
    **dict.fromkeys(("LayerDemand", "LayerSizes", "SceneLayer", "layer_sizes"), "scene_layer"),
    **dict.fromkeys(("Choice", "choices", "scene_choices", "solve", "static"), "solver_choice"),
    **dict.fromkeys(("Reader", "SkinStepper", "SurfaceLoads"), "stepper"),
}
__all__ = [
    "CATALOGUE",
    "Branch",
    "Choice",
    "Foundation",
    "KnownLoad",
    "Layer",
    "LayerDemand",
    "LayerSizes",
    "Material",
    "Motion",
    "Reader",
    "ReducedStepper",
    "SceneLayer",
    "Sheet",
    "SkinStepper",
    "Slab",
    "Spot",
    "Springs",
    "SurfaceLoads",
    "Traction",
    "WedgeStepper",
    "choices",
    "kelvin_voigt",
    "layer_sizes",
    "preset",
    "reduced_stepper",
    "scene_choices",
    "shear_wave",
    "softest_and_stiffest",
    "solve",
    "static",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
