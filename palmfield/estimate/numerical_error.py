"""Numerical accuracy of a finished run: relative error of the displacement of a skin by source.

It is estimated at one moment, the loudest on the skin. Errors of the model itself (ARP law, material, linearity) are
not included; the plan names them.
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
    held_anywhere,
    material_band,
    other_materials,
    other_sides,
)
from palmfield.estimate.numerics.point_response import Response, course_change, side_by_side
from palmfield.session.loudest_moment import LoudestMoment, place_under_focus
from palmfield.simulation.model import HapticModel
from palmfield.simulation.radiation import Radiation
from palmfield.skin.from_config import softest_and_stiffest_sheets
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Float

LONGEST_COURSE_S = 0.1
"""After the sound begins, over which meshes and steps are compared [s]: what rings has faded, and repeats follow."""
MOMENTS_A_STEP = 2
"""Moments of such a course for each substep."""


@dataclass(frozen=True)
class SteppedRun:
    """The steppers of a skin in a run.

    left_small_model: whether the run changed from a small model or modes to the whole layer.
    outside_class: the part of the loads outside the class that the modes serve, in the energy norm.
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
) -> dict[str, float]:
    """Estimate the relative error of the displacement of a skin at its point nearest to the focus, by source.

    radiation: of the model; its boundary-element solution for that moment is used again.
    materials: whether other materials are solved for as well.

    mesh: for a solver with an ExplicitLayer its own estimate, of its mesh and steps. For all others, Richardson's rule
        on the scene's mesh and one finer by RATIO or more (coarser for more than FINER_BELOW unknowns and at least
        LAYERS rows of elements). The largest of three errors counts: of the static response, of the harmonic one, and
        of the motion from the beginning of the sound on, under the level of the stimulus with the focus held. The last
        is an L2 norm over time, to the end of the run, LONGEST_COURSE_S at most. The frequency is the main one of the
        stimulus; where there is none, half of the highest that mesh and step are made for.
    step: the exact steady state of the discrete scheme against the continuous one, on the coarser mesh, where it costs
        less. If it is larger: the effect of the substeps on the motion from the beginning of the sound on.
        For small models (exact in time) and explicit solvers (shorter steps): linear interpolation of the load, sinc^2.
    reduction: of a small model its own estimate. If it is made for any course of the load: the difference from the
        static and harmonic response of the whole layer on the mesh of the scene, if that is larger. Of modes the same,
        and the part of the loads outside their class; 0 without either.
    material_band_low, _high: factors on the displacement with all ranges of the materials at their stiff, and at their
        soft ends; missing where no range is known.
    edge: half the change of the static or harmonic response between fixed and free cut faces, the larger: a layer on a
        hand ends where the body continues. 1 where only the cut faces hold it at rest, 0 for a disc.

    Kept in the cache (`palmfield.cache`). Raises SceneError if no finer or coarser mesh of the layer can be made.
    """
    layer, stepper = model.skins[skin].layer, model.begin[skin].value
    small = None if stepper.adds_error is None else stepper
    sound, point = LoudestSound(model, skin, loudest, radiation), place_under_focus(model, skin, loudest)
    finer = compares_with_finer(layer, layer.system.ndof)
    ends = softest_and_stiffest_sheets(layer.config) if materials else None
    config = model.stimuli[stimulus_of(model, skin)].config
    lasted_s = float(np.clip(course.end_s - config.start_s, model.spec.timestep_s, LONGEST_COURSE_S))

    def level(step_s: float) -> tuple[Float, Float]:
        """Times from the beginning of the sound on, with spacing `step_s` [s], and its level then."""
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
            loudest.factor,
            sound.on_own,
            point,
            layer.demand,
            layer.sizes,
            course.left_small_model,
            config,
            lasted_s,
            materials,
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
    other, ratio, middles = meshes_to_compare(layer, finer)
    low, high = (layer, other) if finer else (other, layer)
    exact_in_time = small is not None and small.exact_in_time and not left_small_model
    coarse = Response(low, sound.on(low), point, scheme_too=not exact_in_time)
    fine = Response(high, sound.on(high), point)
    between = [Response(middle, sound.on(middle), point) for middle in middles]
    cut = other_sides(low, sound, point)
    ends = other_materials(coarse, materials)
    # The most expensive first, so that the cheaper ones run at the same time
    side_by_side(
        fine.swing,
        coarse.swing,
        *(other.swing for other in (*between, *cut, *ends)),
        fine.begin,
        coarse.begin,
        *(other.begin for other in between),
        *(other.rest for other in (*held_anywhere(cut), *ends)),
    )
    times, levels = level(step_s / MOMENTS_A_STEP)
    moved = {response: response.small.moved(levels, times) for response in (coarse, fine, *between)}
    mesh = mesh_error(coarse, fine, between, moved, ratio, of_coarse=finer)
    step = 1.0 - float(np.sinc(frequency * step_s)) ** 2
    if not exact_in_time:
        step = abs(coarse.scheme - coarse.harmonic) / abs(coarse.harmonic)
        stepped = coarse.small.stepped(level(step_s)[1], step_s)
        step = max(step, course_change(stepped, moved[coarse][::MOMENTS_A_STEP]))
    own = coarse if low is layer else fine
    reduction = 0.0 if small is None else _reduction_error(small, own)
    return _as_numbers(mesh, step, reduction, edge_error(coarse, cut)) | material_band(coarse, ends)


def _reduction_error(small: SkinStepper, own: Response) -> float:
    """Of a small model: its own estimate, or its difference from the response of the whole layer, if that is larger.

    own: the response of the scene's layer, on its own mesh.
    """
    if not small.any_course:
        return small.error
    layer, frequency = own.layer, own.layer.demand.main_frequency_Hz
    pressure, read = own.pressure, layer.probe(own.point).operator
    pressure = pressure if small.points is None else pressure[small.points]
    known: dict[float, complex] = {0.0: own.static} if layer.system.supported else {}
    known[frequency] = own.harmonic
    reduced = [small.harmonic(pressure, f, read)[0] for f in known]
    references = known.values()
    return max(small.error, *(abs(a - b) / abs(b) for a, b in zip(reduced, references, strict=True)))


def _explicit_estimate(
    layer: SceneLayer, stepper: SkinStepper, sound: LoudestSound, point: Float, materials: Ends | None
) -> dict[str, float]:
    """Of a solver with its own mesh: the cut edge is that of the scene's layer, computed by its wedges."""
    frequency = layer.demand.main_frequency_Hz
    step = 1.0 - float(np.sinc(frequency * layer.sizes.step_s)) ** 2
    own = Response(layer, sound.on(layer), point)
    edge, cut, ends = 0.0, other_sides(layer, sound, point), other_materials(own, materials)
    if cut or ends:
        side_by_side(
            own.swing,
            *(other.swing for other in (*cut, *ends)),
            *(other.rest for other in (own, *held_anywhere(cut), *ends)),
        )
        edge = edge_error(own, cut)
    return _as_numbers(stepper.error, step, 0.0, edge) | material_band(own, ends)


def _as_numbers(mesh: float, step: float, reduction: float, edge: float) -> dict[str, float]:
    return {
        "mesh_error_relative": float(mesh),
        "step_error_relative": float(step),
        "reduction_error_relative": float(reduction),
        "edge_error_relative": float(edge),
    }
