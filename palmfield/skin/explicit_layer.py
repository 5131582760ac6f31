"""A scene's layer as a solver steps it that key `solver` names, and of which the scene itself knows nothing else: those
with elements or particles of their own, which step explicitly, and those of other packages.

Body, loads and operators are those of the scene's wedges; what is here lies below the same face.
"""

import functools
import math
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Protocol, get_args

import numpy as np
from scipy.spatial import cKDTree

from palmfield.config.skin import SKIN_SOLVERS, Solver
from palmfield.errors import SceneError
from palmfield.skin.approximation.trim_absorbing_rim import refusal_of_spot
from palmfield.skin.from_config import base_of
from palmfield.skin.problem import GAUSSIAN, Body, Layer, Load, Sheet, Slab, Spot, Traction
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.solver_choice import WHERE, function
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Float

TONE = 8
"""Periods of the load for which meshes are chosen: enough for a spectrum that is a line."""
TRIAL, LONGEST_TRIAL_s = 2, 0.02
"""Periods of the main frequency under which a solver estimates its error, and at most that long [s]."""
SAMPLES = 32
"""Times in each period."""
STEPS = "explicit steps, in each of which a pressure wave crosses an element or less"
MOST_STEPS = 20_000
"""Of a scheme in one of MuJoCo's steps."""


class ExplicitLayer(Protocol):
    """What a solver knows of a layer before it steps it; made of the SceneLayer alone, and costly parts when asked for.

    unknowns: of its mesh; state_size: numbers of its state; resolution: in words
    expected_error: relative, of the displacement, before anything runs, or None
    preview: whether it is one; steps, sizes_follow: how it steps, and what its sizes go by, in words
    """

    preview: bool = False
    steps: str = "steps of its own"
    sizes_follow: str = "sizes are the solver's own; the run estimates what was reached"

    @property
    def unknowns(self) -> int: ...
    @property
    def state_size(self) -> int: ...
    @property
    def resolution(self) -> str: ...
    @property
    def expected_error(self) -> float | None:
        return None

    def refuse(self) -> None:
        """Raise SceneError, with element, key, value and what is allowed, for what the solver can't step.

        Looks at keys and materials alone: nothing is meshed.
        """
        ...

    def seconds(self, duration_s: float, device: str) -> float:
        """Predicted time of a run of this length [s] on a device, with what estimates the error [s]."""
        ...

    def stepper(self, device: str) -> SkinStepper:
        """What steps it on a device of `palmfield.device.resolve`. Raises SceneError for elements that can't be."""
        ...


def explicit_layer(layer: SceneLayer) -> ExplicitLayer | None:
    """The layer as its key `solver` has it, the same for the same layer; None for steppers of the wedges themselves."""
    solver = layer.config.solver
    if solver in get_args(Solver) and "scene" not in WHERE.get(solver, {}):
        return None
    return _made(layer)


@functools.lru_cache(maxsize=8)
def _made(layer: SceneLayer) -> ExplicitLayer:
    solver = layer.config.solver
    if solver in WHERE:
        made: ExplicitLayer = function(solver, "scene")(layer)
        return made
    [entry] = entry_points(group=SKIN_SOLVERS, name=solver)
    try:
        return entry.load()(layer)
    except (ImportError, AttributeError) as error:
        raise SceneError(
            f"{layer.element}: key 'solver' has value '{solver}', whose entry point '{entry.value}' can't be loaded: "
            f"{error}; install it anew, or set solver to auto"
        ) from error


def refuse_explicit(layer: SceneLayer, stiffest: float, ask: Callable[[Body, Load], str | None]) -> None:
    """`ExplicitLayer.refuse`. stiffest: bulk modulus over shear modulus, at most; ask: why a problem can't be solved"""
    config, solver = layer.config, layer.config.solver
    element = f"{layer.element}: key 'solver' has value '{solver}'"
    if config.side == "absorbing":
        allowed = "fixed, free" + (", roller" if config.shape == "disc" else "")
        raise SceneError(f"{element} and key 'side' value 'absorbing'; allowed with it: {allowed}; or solver wedges")
    if config.foundation is not None:
        raise SceneError(
            f"{element} and key 'foundation_normal_Pa_m' value '{config.foundation[0]:g}'; allowed with it: no "
            "foundation (base springs is one that spectral_elements has); or solver wedges"
        )
    for material in (sheet.material for sheet in layer.sheets):
        ratio = material.bulk_Pa / material.shear_instant_Pa
        if ratio > stiffest:
            raise SceneError(
                f"{element} and material '{material.name}' a bulk modulus of {ratio:.3g} times its shear modulus; "
                f"allowed with it, as it steps with the pressure wave: at most {stiffest:g} (keys material, materials, "
                "bulk_Pa); or solver wedges"
            )
    # A slab of the same sheets: what is asked of it here are base and materials
    sheets = tuple(Sheet(sheet.material, 0.01 * sheet.thickness_m) for sheet in layer.sheets)
    slab = Slab(sheets, "disc", base_of(config), "fixed", 0.1)
    load = Spot(layer.demand.spot_fwhm_m, np.zeros(1), np.ones(1))
    reason = ask(slab, load)
    if reason is not None:
        raise SceneError(f"{element}, but {reason}")


def body_of(layer: SceneLayer, refinement: float = 1.0) -> Body:
    """The body below a layer's face, in its frame: a disc, or the sheets below its patch.

    refinement: factor of the patch's edges, at most 1
    """
    config = layer.config
    if config.shape == "disc":
        assert config.radius_m and config.thickness_m
        sheets = tuple(Sheet(sheet.material, sheet.thickness_m * config.thickness_m) for sheet in layer.sheets)
        return Slab(sheets, "disc", base_of(config), config.side, config.radius_m)
    patch = layer.patch if refinement >= 1.0 else layer.resized(refinement * layer.resizing).patch
    return Layer(patch, layer.sheets, base_of(config), config.side)


def planned_load(layer: SceneLayer) -> Spot:
    """A spot as wide and a tone as high as the layer is made for, by which meshes are chosen."""
    return _spot(layer, TONE, layer.demand.max_frequency_Hz)


def _spot(layer: SceneLayer, periods: float, f_Hz: float) -> Spot:
    """A spot in the layer's middle whose pressure goes up and down between 0 and 1 Pa."""
    times = np.linspace(0.0, periods / f_Hz, math.ceil(SAMPLES * periods) + 1)
    return Spot(layer.demand.spot_fwhm_m, times, np.sin(math.pi * f_Hz * times) ** 2, _middle(layer)[:2])


def _middle(layer: SceneLayer) -> Float:
    """The middle of the layer on its face, body frame [m], shape (3,)."""
    if layer.config.shape == "disc":
        return np.zeros(3)
    vertices = layer.patch.vertices
    return vertices[cKDTree(vertices).query(layer.centre_m)[1]]


def trial_s(layer: SceneLayer) -> float:
    """Time under the load by which a solver estimates its error [s]."""
    return min(TRIAL / layer.demand.main_frequency_Hz, LONGEST_TRIAL_s)


def trial(layer: SceneLayer, body: Body, points: Float, areas_m2: Float) -> tuple[Load, Float, Float]:
    """The load under which a solver estimates its error, the times at which it looks, and two points of the face.

    points, areas_m2: of the face [m], (f, 3) and (f,), for a face on which a spot can't be given by its x and y
    """
    f_Hz, middle = layer.demand.main_frequency_Hz, _middle(layer)
    spot = _spot(layer, trial_s(layer) * f_Hz, f_Hz)
    load: Load = spot
    if refusal_of_spot(body, spot) is not None:
        away = np.linalg.norm(points - middle, axis=1)
        shape = np.exp(-GAUSSIAN * (away / spot.fwhm_m) ** 2)
        load = Traction(points, areas_m2, spot.times_s, spot.peak_Pa[:, None] * shape)
    away = np.linalg.norm(points - middle, axis=1)
    beside = points[np.argmin(np.abs(away - 0.5 * spot.fwhm_m))]
    return load, spot.times_s[1:], np.stack([points[np.argmin(away)], beside])


def check_steps(layer: SceneLayer, steps: int) -> None:
    """Raise SceneError where a substep of the scene takes so many steps of the scheme that a run would not end."""
    in_one = steps * round(layer.demand.timestep_s / layer.step_s)
    if in_one > MOST_STEPS:
        raise SceneError(
            f"{layer.element}: key 'solver' has value '{layer.config.solver}', which takes {in_one:,} steps in each of "
            f"MuJoCo's, of {layer.demand.timestep_s:g} s, so that the run would not end; allowed: at most "
            f"{MOST_STEPS:,}; set accuracy or depth_m larger, bulk_Pa or timestep smaller, or solver to wedges"
        )
