"""Numerical accuracy of a finished run: relative errors of displacement and velocity of a skin by source.

The error is estimated at the moment of the highest ARP on the skin. Model errors (ARP law, material, linearity) are
not included; the plan lists them.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmfield import cache
from palmfield.errors import SceneError
from palmfield.estimate.array_inputs import stimulus_of
from palmfield.estimate.cost import compares_with_finer
from palmfield.estimate.numerics.load_course import LoadCourse
from palmfield.estimate.numerics.loudest_sound import LoudestSound
from palmfield.estimate.numerics.mesh_error import mesh_error, meshes_to_compare
from palmfield.estimate.numerics.other_layers import (
    Ends,
    edge_error,
    material_band,
    other_materials,
    other_sides,
)
from palmfield.estimate.numerics.point_response import Response, course_change, points_of_spot, solve_all
from palmfield.session.loudest_moment import LoudestMoment, at_full_level, place_under_focus
from palmfield.simulation.build import at_any_level
from palmfield.simulation.model import HapticModel
from palmfield.simulation.radiation import Radiation
from palmfield.skin.approximation.estimate import largest_change
from palmfield.skin.approximation.richardson import error_of_coarser
from palmfield.skin.extreme_sheets import softest_and_stiffest_sheets
from palmfield.skin.reduction.krylov import SAFETY, steady_change
from palmfield.skin.reduction.reducer import TOLERANCE, Course, PointModel
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Complex, Float

LONGEST_COURSE_S = 0.1
"""Longest time over which meshes and steps are compared [s], from the begin of the sound; transients then are over."""
MOMENTS_A_STEP = 2
"""Number of times per substep at which meshes and steps are compared."""
SOURCES = ("mesh", "step", "reduction", "edge")
"""Sources of these errors: SOURCE_error_relative of the displacement, SOURCE_velocity_error_relative."""


@dataclass(frozen=True)
class SteppedRun:
    """Use of steppers for a skin in a run.

    left_small_model: whether the run changed from a reduced model or modes to the full wedge model.
    outside_class: share of the loads outside the load class of the modes, in the energy norm.
    end_s: MuJoCo time at the end of the run [s].
    velocity_error: error of the velocity that modes add, None for other steppers.
    """

    left_small_model: bool
    outside_class: float = 0.0
    end_s: float = math.inf
    velocity_error: float | None = None


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
    """Estimate the relative errors of the motion of a skin at its point nearest to the focus and about it, by source.

    radiation: radiation of the model; its boundary-element solution for that moment is reused.
    materials: whether the ranges of materials are evaluated too.
    thorough: whether the other mesh is finer in any case, and a reduced model of the run is compared with a new one.

    mesh: solvers with an ExplicitLayer report their own estimate of mesh and steps. For all others, Richardson's rule
        on the mesh of the scene and a coarser one (a finer one for few unknowns), see `meshes_to_compare`, by reduced
        models of the point. The result is the largest of three errors: of the static response, of the harmonic
        response, and of the motion after the sound begins, to the end of the run, at most LONGEST_COURSE_S. Errors are
        L2 norms over five points (`points_of_spot`), and over time; under a moving focus (`LoadCourse`) the motion is
        that of the first point. The frequency is the main one of the stimulus, or else half of the highest frequency
        of mesh and step.
    SOURCE_velocity_error_relative: the same of the velocity, harmonic and over time; missing with an ExplicitLayer.
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
    point = place_under_focus(model, skin, loudest)
    finer = thorough or compares_with_finer(layer.system.ndof)
    ends = softest_and_stiffest_sheets(layer.config) if materials else None
    config = model.stimuli[stimulus_of(model, skin)].config
    lasted_s = float(np.clip(course.end_s - config.start_s, model.spec.timestep_s, LONGEST_COURSE_S))
    # Each place of the focus would need its own boundary-element solution
    load = LoadCourse(model, skin, loudest, lasted_s, moves=radiation.solution(skin) is None)
    sound = LoudestSound(model, skin, loudest, radiation, load.drives)

    def make() -> cache.Arrays:
        if model.skins[skin].solver.own_mesh:
            result = _explicit_estimate(layer, stepper, sound, point, ends)
            return {name: np.array(value) for name, value in result.items()}
        try:
            result = _estimate(layer, small, sound, point, finer, course.left_small_model, load, ends)
        except SceneError:
            result = _estimate(layer, small, sound, point, not finer, course.left_small_model, load, ends)
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
            load.drives,
            load.damping_1_s,
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
    if course.velocity_error is not None:
        result["reduction_velocity_error_relative"] = course.velocity_error
    return result | of_sources(result, SOURCES)


def of_sources(errors: dict[str, float], sources: Sequence[str]) -> dict[str, float]:
    """Return displacement_error_relative and velocity_error_relative: the root sum of squares of the sources.

    An error without SOURCE_velocity_error_relative, of the sound or the material, is that of the velocity too. The
    second is missing without an error of mesh and velocity.
    """
    parts = {name: errors.get(f"{name}_error_relative", 0.0) for name in sources}
    result = {"displacement_error_relative": math.hypot(*parts.values())}
    if "mesh_velocity_error_relative" in errors:
        velocities = (errors.get(f"{name}_velocity_error_relative", part) for name, part in parts.items())
        result["velocity_error_relative"] = math.hypot(*velocities)
    return result


def _estimate(
    layer: SceneLayer,
    small: SkinStepper | None,
    sound: LoudestSound,
    point: Float,
    finer: bool,
    left_small_model: bool,
    load: LoadCourse,
    materials: Ends | None,
) -> dict[str, float]:
    frequency, step_s = layer.demand.main_frequency_Hz, layer.sizes.step_s
    other, ratio, middles, other_rows = meshes_to_compare(layer, finer)
    low, high = (layer, other) if finer else (other, layer)
    points = points_of_spot(layer, point)
    coarse, fine, *between = (
        Response(each, sound.on(each), points, sound.along(each)) for each in (low, high, *middles)
    )
    own = coarse if finer else fine
    of_rows = None
    if other_rows is not None:
        of_rows = Response(other_rows, sound.on(other_rows), points, sound.along(other_rows))
    rest = between if of_rows is None else [*between, of_rows]
    cut = other_sides(low, sound, point)
    ends = other_materials(coarse, materials)
    stepped_by = None if small is None or small.any_pose or left_small_model else _in_run(small, own)
    own_is_run = (
        stepped_by is not None and small is not None and small.any_course and small.error <= TOLERANCE and not finer
    )
    if own_is_run and stepped_by is not None:
        # The model that stepped this load is as accurate as the one that would be made for it here
        own.small = stepped_by
        solve_all([coarse, *rest, *cut])
    else:
        solve_all([fine, coarse, *rest, *cut])
    course, linear = load.at(step_s / MOMENTS_A_STEP), load.at(step_s)
    exact_in_time = small is not None and small.exact_in_time and not left_small_model
    # Substeps damp waves that they do not resolve, also in their effect on the meshes
    moved = {
        response: response.small.moved(course) if exact_in_time else response.small.stepped(linear)
        for response in (coarse, fine, *rest)
    }
    mesh = mesh_error(coarse, fine, between, of_rows, moved, ratio, of_coarse=finer)
    step = np.full(2, 1.0 - float(np.sinc(frequency * step_s)) ** 2)
    if exact_in_time:
        # Loads that are linear over a step, against shorter ones; the difference falls with the square of the step
        change = course_change(coarse.small.moved(linear)[1], moved[coarse][1, ::MOMENTS_A_STEP])
        step[1] = max(step[1], error_of_coarser(change, MOMENTS_A_STEP, 2.0))
    else:
        step[:] = largest_change(coarse.discrete[None], coarse.harmonic[None])
        exact = coarse.small.moved(course)[:, ::MOMENTS_A_STEP]
        step = np.maximum(step, [course_change(*each) for each in zip(moved[coarse], exact, strict=True)])
    reduction = np.zeros(2)
    if small is not None:
        reduction[:] = _reduction_error(small, own)
    if stepped_by is not None:
        reduction[1] = max(reduction[1], _velocity_reduction(stepped_by, own, course))
    return _as_numbers(mesh, step, reduction, edge_error(coarse, cut)) | material_band(coarse, ends)


def _velocity_reduction(run: PointModel, own: Response, course: Course) -> float:
    """Return the error of the velocity by the reduced model of a run: against that of its response, or its changes.

    The changes are those by its last vectors, if the response has the same model.
    """
    models = [run] if own.small is run else [own.small, run]
    for _ in range(3 if own.small is run else 0):
        models.append(models[-1].smaller())
    velocities = [model.moved(course)[1] for model in models]
    changes: Float = np.array([course_change(less, more) for more, less in itertools.pairwise(velocities)])
    return float(changes[0] if len(changes) == 1 else SAFETY * steady_change(list(changes[::-1])))


def _in_run(small: SkinStepper, own: Response) -> PointModel:
    """Return the reduced model of a run as a model of the points of a response."""
    pressures = own.pressure[None] if own.path is None else np.vstack([own.pressure, own.path])
    projection = small.projected(_at_points(small, pressures), own.layer.probe(own.points).operator)
    return PointModel(projection, small.error, own.layer.system.supported)


def _reduction_error(small: SkinStepper, own: Response) -> float:
    """Return the estimate of a reduced model or its difference from the full wedge model, whichever is larger.

    own: response of the full wedge model on the mesh of the scene, or of the reduced model itself: then its estimate.
    """
    if not small.any_course:
        return small.error
    layer, frequency = own.layer, own.layer.demand.main_frequency_Hz
    pressure, read = _at_points(small, own.pressure), layer.probe(own.points).operator
    expected: dict[float, Float | Complex] = {0.0: own.static} if layer.system.supported else {}
    expected[frequency] = own.harmonic
    reduced = np.array([small.harmonic(pressure, f, read) for f in expected])
    return max(small.error, largest_change(reduced, np.array(list(expected.values()))))


def _at_points(small: SkinStepper, pressure: Float) -> Float:
    """Return pressures [Pa], (q,) or (k, q), at the points of a stepper of their layer, (p,) or (k, p)."""
    return pressure if small.points is None else pressure[..., small.points]


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
        edge = edge_error(own, cut)[0]
    sizes = dict(zip(SOURCES, (stepper.error, step, 0.0, edge), strict=True))
    return {f"{name}_error_relative": float(size) for name, size in sizes.items()} | material_band(own, ends)


def _as_numbers(*errors: Sequence[float] | Float) -> dict[str, float]:
    """Return the errors of displacement and velocity of each source as numbers with names."""
    names = ("error_relative", "velocity_error_relative")
    return {
        f"{source}_{name}": float(size)
        for source, sizes in zip(SOURCES, errors, strict=True)
        for name, size in zip(names, sizes, strict=True)
    }
