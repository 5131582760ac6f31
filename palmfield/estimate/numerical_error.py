"""Numerical accuracy of a finished run: relative error of the displacement of a skin by source.

The error is estimated at the moment of the highest ARP on the skin. Model errors (ARP law, material, linearity) are
not included; the plan lists them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palmfield import cache
from palmfield.errors import SceneError
from palmfield.estimate.array_inputs import stimulus_of
from palmfield.estimate.cost import compares_with_finer
from palmfield.estimate.numerics.loudest_sound import LoudestSound
from palmfield.estimate.numerics.mesh_error import mesh_error, meshes_to_compare
from palmfield.estimate.numerics.other_layers import (
    Ends,
    edge_error,
    material_band,
    other_materials,
    other_sides,
)
from palmfield.estimate.numerics.point_response import Response, course_change, solve_all
from palmfield.session.loudest_moment import LoudestMoment, at_full_level, place_under_focus
from palmfield.simulation.build import at_any_level
from palmfield.simulation.model import HapticModel
from palmfield.simulation.radiation import Radiation
from palmfield.skin.extreme_sheets import softest_and_stiffest_sheets
from palmfield.skin.reduction.reducer import TOLERANCE, PointModel
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Float

LONGEST_COURSE_S = 0.1
"""Longest time over which meshes and steps are compared [s], from the begin of the sound; transients then are over."""
MOMENTS_A_STEP = 2
"""Number of times per substep in such a comparison."""


@dataclass(frozen=True)
class SteppedRun:
    """Use of steppers for a skin in a run.

    left_small_model: whether the run changed from a reduced model or modes to the full wedge model.
    outside_class: share of the loads outside the load class of the modes, in the energy norm.
    end_s: MuJoCo time at the end of the run [s].
    """

    left_small_model: bool
    outside_class: float = 0.0
    end_s: float = math.inf


def error_estimate(
    model: HapticModel,
    skin: int,
    loudest: LoudestMoment,
    radiation: Radiation,
    course: SteppedRun,
    *,
    materials: bool = True,
    thorough: bool = False,
) -> dict[str, float]:
    """Estimate the relative error of the displacement of a skin at its point nearest to the focus, by source.

    radiation: radiation of the model; its boundary-element solution for that moment is reused.
    materials: whether the ranges of materials are evaluated too.
    thorough: whether the other mesh is finer in any case, and a reduced model of the run is compared with a new one.

    mesh: solvers with an ExplicitLayer report their own estimate of mesh and steps. For all others, Richardson's rule
        on the mesh of the scene and a coarser one (a finer one for few unknowns), see `meshes_to_compare`, by reduced
        models of the point. The result is the largest of three errors: of the static response, of the harmonic
        response, and of the motion after the sound begins, with the level of the stimulus and a fixed focus. The last
        is an L2 norm over time, to the end of the run, at most LONGEST_COURSE_S. The frequency is the main one of the
        stimulus, or else half of the highest frequency of mesh and step.
    step: the difference between the exact steady states of the discrete scheme and of the continuous equation, on the
        cheaper coarser mesh, or, if it is larger, the effect of the substeps on the motion after the sound begins. For
        reduced models (exact in time) and explicit solvers (shorter steps): linear interpolation of the load, sinc^2.
    reduction: for a reduced model its own estimate or, if it is valid for any time course of the load and the value is
        larger, the difference from the static and harmonic response of the full wedge model on the mesh of the scene.
        For modes the same, and the share of the loads outside their class; else 0. Without `thorough`, the reduced
        model of a predicted load also serves as the full model, and only its own estimate counts.
    material_band_low, _high: factors of the displacement with all material ranges at their stiff and at their soft
        ends; missing if no range is known.
    edge: half of the larger change of the static or harmonic response between fixed and free cut faces, because a layer
    on a hand ends inside the body. 1 if only the cut faces support the layer, 0 for a disc.

    The result is cached (`palmfield.cache`). Raises SceneError if no finer or coarser mesh of the layer can be made.
    """
    if radiation.solution(skin) is None:
        # A boundary-element solution holds for the drive of the run
        loudest = at_full_level(loudest)
    layer, stepper = model.skins[skin].layer, model.begin[skin].value
    small = None if stepper.adds_error is None else stepper
    sound, point = LoudestSound(model, skin, loudest, radiation), place_under_focus(model, skin, loudest)
    finer = thorough or compares_with_finer(layer.system.ndof)
    ends = softest_and_stiffest_sheets(layer.config) if materials else None
    config = model.stimuli[stimulus_of(model, skin)].config
    lasted_s = float(np.clip(course.end_s - config.start_s, model.spec.timestep_s, LONGEST_COURSE_S))

    def level(step_s: float) -> tuple[Float, Float]:
        """Return times from the begin of the sound, with spacing `step_s` [s], and the level at these times."""
        times: Float = step_s * np.arange(1 + max(1, round(lasted_s / step_s)), dtype=np.float64)
        return times, frames_at(config, config.start_s + times)[1]

    def make() -> cache.Arrays:
        if model.skins[skin].solver.own_mesh:
            result = _explicit_estimate(layer, stepper, sound, point, ends)
            return {name: np.array(value) for name, value in result.items()}
        try:
            result = _estimate(layer, small, sound, point, finer, course.left_small_model, level, ends)
        except SceneError:
            result = _estimate(layer, small, sound, point, not finer, course.left_small_model, level, ends)
        return {name: np.array(value) for name, value in result.items()}

    posed, system = loudest.posed, layer.system
    place = posed.skins[skin]
    depends_on = (
        *(model.spec.skins[skin], model.spec.device, posed.arrays.array, posed.arrays.air, posed.arrays.placements),
        system.made_of,
        [(body.vertices_in_array, body.faces) for body in posed.bodies],
        *(place.obstacle_positions, place.obstacle_rotations),
        *(
            loudest.drive,
            sound.on_own,
            point,
            layer.demand,
            layer.sizes,
            course.left_small_model,
            at_any_level(config),
            lasted_s,
            materials,
            thorough,
        ),
        None if small is None else small.made_of,
    )
    result = {name: float(value) for name, value in cache.kept("error-estimate", depends_on, make).items()}
    result["reduction_error_relative"] = math.hypot(result["reduction_error_relative"], course.outside_class)
    sources = [result[f"{name}_error_relative"] for name in ("mesh", "step", "reduction", "edge")]
    return result | {"displacement_error_relative": math.hypot(*sources)}


def _estimate(
    layer: SceneLayer,
    small: SkinStepper | None,
    sound: LoudestSound,
    point: Float,
    finer: bool,
    left_small_model: bool,
    level: Callable[[float], tuple[Float, Float]],
    materials: Ends | None,
) -> dict[str, float]:
    frequency, step_s = layer.demand.main_frequency_Hz, layer.sizes.step_s
    other, ratio, middles, other_rows = meshes_to_compare(layer, finer)
    low, high = (layer, other) if finer else (other, layer)
    coarse, fine = (Response(each, sound.on(each), point) for each in (low, high))
    own = coarse if finer else fine
    between = [Response(middle, sound.on(middle), point) for middle in middles]
    of_rows = None if other_rows is None else Response(other_rows, sound.on(other_rows), point)
    rest = between if of_rows is None else [*between, of_rows]
    cut = other_sides(low, sound, point)
    ends = other_materials(coarse, materials)
    predicted = small is not None and small.any_course and not (small.any_pose or left_small_model)
    if small is not None and predicted and small.error <= TOLERANCE and not finer:
        # The model that stepped this load is as accurate as the one that would be made for it here
        projection = small.projected(_at_points(small, own), layer.probe(point).operator)
        own.small = PointModel(projection, small.error, layer.system.supported)
        solve_all([coarse, *rest, *cut])
    else:
        solve_all([fine, coarse, *rest, *cut])
    times, levels = level(step_s / MOMENTS_A_STEP)
    moved = {response: response.small.moved(levels, times) for response in (coarse, fine, *rest)}
    mesh = mesh_error(coarse, fine, between, of_rows, moved, ratio, of_coarse=finer)
    step = 1.0 - float(np.sinc(frequency * step_s)) ** 2
    if small is None or not small.exact_in_time or left_small_model:
        step = abs(coarse.discrete - coarse.harmonic) / abs(coarse.harmonic)
        stepped = coarse.small.stepped(level(step_s)[1], step_s)
        step = max(step, course_change(stepped, moved[coarse][::MOMENTS_A_STEP]))
    reduction = 0.0 if small is None else _reduction_error(small, own)
    return _as_numbers(mesh, step, reduction, edge_error(coarse, cut)) | material_band(coarse, ends)


def _reduction_error(small: SkinStepper, own: Response) -> float:
    """Return the estimate of a reduced model or its difference from the full wedge model, whichever is larger.

    own: response of the full wedge model on the mesh of the scene, or of the reduced model itself: then its estimate.
    """
    if not small.any_course:
        return small.error
    layer, frequency = own.layer, own.layer.demand.main_frequency_Hz
    pressure, read = _at_points(small, own), layer.probe(own.point).operator
    expected: dict[float, complex] = {0.0: own.static} if layer.system.supported else {}
    expected[frequency] = own.harmonic
    reduced = [small.harmonic(pressure, f, read)[0] for f in expected]
    references = expected.values()
    return max(small.error, *(abs(a - b) / abs(b) for a, b in zip(reduced, references, strict=True)))


def _at_points(small: SkinStepper, own: Response) -> Float:
    """Return the pressure of a response at the points of a stepper of its layer [Pa], shape (p,)."""
    return own.pressure if small.points is None else own.pressure[small.points]


def _explicit_estimate(
    layer: SceneLayer, stepper: SkinStepper, sound: LoudestSound, point: Float, materials: Ends | None
) -> dict[str, float]:
    """Estimate a solver with its own mesh; the error of the cut edge is that of the wedge model."""
    frequency = layer.demand.main_frequency_Hz
    step = 1.0 - float(np.sinc(frequency * layer.sizes.step_s)) ** 2
    own = Response(layer, sound.on(layer), point)
    edge, cut, ends = 0.0, other_sides(layer, sound, point), other_materials(own, materials)
    if cut or ends:
        solve_all([own, *cut])
        edge = edge_error(own, cut)
    return _as_numbers(stepper.error, step, 0.0, edge) | material_band(own, ends)


def _as_numbers(mesh: float, step: float, reduction: float, edge: float) -> dict[str, float]:
    return {
        "mesh_error_relative": float(mesh),
        "step_error_relative": float(step),
        "reduction_error_relative": float(reduction),
        "edge_error_relative": float(edge),
    }
