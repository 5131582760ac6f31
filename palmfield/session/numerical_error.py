"""What the numbers of a finished run are worth: relative error of a skin's displacement by source.

It is estimated at one moment, the loudest on the skin. Errors of the model itself (ARP law, material, linearity) are
not in these; the plan names them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from palmfield import cache
from palmfield.config.skin import EXPLICIT
from palmfield.errors import SceneError
from palmfield.session.array_inputs import stimulus_of
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface
from palmfield.simulation.radiation import Radiation
from palmfield.skin.approximation.estimate import ORDER, largest_change
from palmfield.skin.approximation.richardson import error_of_coarser, error_of_finer
from palmfield.skin.fem.influence import harmonic_influence, static_influence
from palmfield.skin.from_config import softest_and_stiffest_sheets
from palmfield.skin.problem import Sheet
from palmfield.skin.reduction.modal_stepper import ModalStepper
from palmfield.skin.reduction.point_model import TOLERANCE, PointModel, point_model
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper
from palmfield.stimulus.schedule import frame_at, frames_at
from palmfield.threads import cores, share
from palmfield.types import Complex, Float

T = TypeVar("T")
Ends: TypeAlias = tuple[tuple[Sheet, ...], tuple[Sheet, ...]]
"""A layer's sheets with the ranges of their materials at the low ends, and at the high ends."""

RATIO = 1.25
"""Element sizes of the two meshes that are compared."""
ALIKE = 1.3
"""Triangles of one mesh over those of another, below which their difference is no measure of the error."""
LEAST_RATIO = 1.1
"""Least ratio of edges with which Richardson's rule is asked."""
FEW, FEW_CHANGES, FEW_ORDER = 2000, 4, 1.0
"""Unknowns below which a mesh has a handful of triangles under the spot, whose error falls unevenly: then the other one
is finer by this power of RATIO, and the order is this, the least that was seen on discs of 13 and 15 mm. A third mesh
between the two tells where the first is right by chance: on discs of 25 and 30 mm the next two were farther off."""
COURSE_ORDER = 1.5
"""Order of the error over a course of time: two meshes ring out of step, the more the longer it rings. Lower than
ORDER, as a small ratio of edges makes much of a little: on discs of palm and gelatin 1.8 to 3.3 was seen."""
LONGEST_COURSE_S = 0.1
"""After the sound begins, over which meshes and steps are compared [s]: what rings has faded, and repeats follow."""
MOMENTS_A_STEP = 2
"""Moments of such a course for each substep."""
MOST_CHANGES = 6
"""How often the other mesh's elements are made finer or coarser at most, by RATIO, until the two differ."""
FINER_BELOW = 15_000
"""Unknowns above which a finer mesh costs minutes and gigabytes."""
MOST_AT_ONCE = 2
"""Matrices that are factorised side by side: each factor of a palm takes a third of a gigabyte."""
LAYERS = 3
"""A coarser mesh must keep two rows of elements: one alone is off by 20 %."""


@dataclass(frozen=True)
class LoudestMoment:
    """The moment of a run at which the ARP on a skin was highest.

    time_s: when, by MuJoCo's clock [s]; posed: where everything was
    drive: what all transducers emitted, relative to full drive, shape (N,); factor: of its ARP
    """

    time_s: float
    posed: PosedScene
    drive: Complex
    factor: float


@dataclass(frozen=True)
class Course:
    """How a skin was stepped in a run.

    left_small_model: whether the run went on from a small model or modes to the whole layer
    outside_class: what of the loads lay outside the class that the modes serve, in the energy norm
    end_s: when the run ended, by MuJoCo's clock [s]
    """

    left_small_model: bool
    outside_class: float = 0.0
    end_s: float = math.inf


# -- error of the displacement -------------------------------------------------------------------------------------


def compares_with_finer(layer: SceneLayer, dofs: int) -> bool:
    """Whether the error estimate of a layer with `dofs` unknowns takes a finer mesh, rather than a coarser one."""
    return dofs < FINER_BELOW or len(layer.sizes.depth_fractions) - 1 < LAYERS


def error_estimate(
    model: HapticModel,
    skin: int,
    loudest: LoudestMoment,
    radiation: Radiation,
    course: Course,
    *,
    materials: bool = True,
) -> dict[str, float]:
    """Relative error of a skin's displacement at its point nearest to the focus, by source.

    radiation: of the model; its solution by boundary elements for that moment serves again
    materials: whether other materials are solved for as well

    mesh: of a solver of EXPLICIT its own estimate, of its elements or particles, and of its steps. Else the static and
        harmonic response on the scene's mesh and on one RATIO or more finer (RATIO or more coarser, for more than
        FINER_BELOW unknowns and at least LAYERS rows of elements), by Richardson's rule; and so the motion from the
        sound's beginning on, as it rings, under the stimulus's level with the focus held where it is (L2 over time, to
        the run's end, LONGEST_COURSE_S at most); the largest of these. The frequency is the stimulus's main one; half
        of the highest that mesh and step are made for where there is none
    step: the discrete scheme's exact steady state against the continuous one, on the coarser mesh, where it costs less,
        or what the substeps make of the motion from the sound's beginning on, if that is larger.
        A small model is exact in time, and the steps of an explicit solver are far shorter; what they are given is the
        load's chords, of which a sine has sinc^2 of itself
    reduction: of a small model: its own estimate, or, where it is made for any course of the load, the difference from
        the whole layer's static and harmonic response on the scene's mesh, if that is larger; of modes the same, and
        what of the run's loads lay outside their class; 0 without either
    material_band_low, _high: factors on the displacement where all ranges of the layer's materials are at their stiff,
        and at their soft ends; missing where no range is known
    edge: half the difference that fixed or free cut faces make to the static or to the harmonic response, also there,
        the larger: a layer on a hand ends where the body goes on. 1 where nothing else holds it at rest, 0 for a disc,
        whose side is its own

    Kept in the cache (`palmfield.cache`). Raises SceneError where neither a finer nor a coarser mesh of the layer can
    be made.
    """
    layer, stepper = model.skins[skin].layer, model.begin[skin].value
    small = stepper if isinstance(stepper, ReducedStepper | ModalStepper) else None
    sound, point = _Sound(model, skin, loudest, radiation), _under_focus(model, skin, loudest)
    finer = compares_with_finer(layer, layer.system.ndof)
    ends = softest_and_stiffest_sheets(layer.config) if materials else None
    config = model.stimuli[stimulus_of(model, skin)].config
    lasted_s = float(np.clip(course.end_s - config.start_s, model.spec.timestep_s, LONGEST_COURSE_S))

    def level(step_s: float) -> tuple[Float, Float]:
        """Times from the sound's beginning on, `step_s` apart [s], and its level then."""
        times: Float = step_s * np.arange(1 + max(1, round(lasted_s / step_s)), dtype=np.float64)
        return times, frames_at(config, config.start_s + times)[1]

    def make() -> cache.Arrays:
        if stepper.name in EXPLICIT:
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
        None if small is None else _numbers_of(small),
    )
    result = {name: float(value) for name, value in cache.kept("error-estimate", depends_on, make).items()}
    result["reduction_error_relative"] = math.hypot(result["reduction_error_relative"], course.outside_class)
    sources = [result[f"{name}_error_relative"] for name in ("mesh", "step", "reduction", "edge")]
    return result | {"displacement_error_relative": math.hypot(*sources)}


def _numbers_of(small: ReducedStepper | ModalStepper) -> tuple[Any, ...]:
    """All that a small model's or modes' answers follow from."""
    if isinstance(small, ModalStepper):
        modes = small.body.modes
        return modes.elastic, modes.stiffness, modes.coupling, modes.shares, small.body.forces, small.error
    return small.small.matrices, small.vectors, small.error, small.any_course


class _Response:
    """Displacement at a point of one mesh of a skin under one sound, by how pressure moves that point.

    pressure: ARP at the mesh's quadrature points at the factor 1 [Pa], shape (q,)
    static, harmonic, scheme: of the point [m], the first 0 for a body that nothing holds at rest; `rest` finds the
        first, `swing` the others, exact in time and by the scheme of the whole layer
    scheme_too: whether the last is wanted
    small: of any course of time; `begin` finds it, and the first of the others with it
    """

    small: PointModel

    def __init__(self, layer: SceneLayer, pressure: Float, point: Float, *, scheme_too: bool = False):
        self.layer, self.point, self.scheme_too = layer, point, scheme_too
        self.pressure = pressure
        self.static, self.harmonic, self.scheme = 0.0, 0j, 0j

    def of(self, layer: SceneLayer) -> "_Response":
        """The response of another layer on the same mesh."""
        return _Response(layer, self.pressure, self.point)

    def rest(self) -> None:
        if not self.layer.system.supported:
            return
        self.static = float(static_influence(self.layer.system, self.layer.quadrature, self.point) @ self.pressure)

    def begin(self) -> None:
        layer = self.layer
        force, read = layer.quadrature.operator @ self.pressure, layer.probe(self.point).operator.toarray()[0]
        self.small = point_model(layer.system, force, read, layer.demand.max_frequency_Hz)
        if layer.system.supported:
            self.static = self.small.static()

    def swing(self) -> None:
        layer = self.layer
        step_s = layer.sizes.step_s if self.scheme_too else None
        frequency = layer.demand.main_frequency_Hz
        exact, scheme = harmonic_influence(layer.system, layer.quadrature, self.point, frequency, step_s)
        self.harmonic, self.scheme = complex(exact @ self.pressure), complex(scheme @ self.pressure)


def _side_by_side(*solutions: Callable[[], None]) -> None:
    """Factorisations hold no lock of Python's."""
    share([(solution,) for solution in solutions], min(cores(), MOST_AT_ONCE))


class _Sound:
    """ARP of the loudest moment on other meshes of a skin's layer."""

    def __init__(self, model: HapticModel, skin: int, loudest: LoudestMoment, radiation: Radiation):
        self.model, self.skin, self.loudest, self.radiation = model, skin, loudest, radiation
        self.on_own: Float = self._arp(radiation, loudest.posed)

    def on(self, layer: SceneLayer) -> Float:
        """ARP [Pa] at a layer's quadrature points, shape (q,)."""
        model, skin, posed = self.model, self.skin, self.loudest.posed
        part = model.skins[skin]
        if layer is part.layer:
            return self.on_own
        other = SkinModel(part.spec, part.body, part.carrier, layer, part.choice, part.still_m)
        place, body = posed.skins[skin], posed.bodies[part.body]
        disc = part.carrier.surface is None
        if disc:
            # The boundary of a disc is that of its skin's mesh; any other body's is its own.
            body = PosedSurface(part.carrier, other, body.frame, (body.bone_positions, body.bone_rotations))
        obstacles = place.obstacle_positions, place.obstacle_rotations
        varied_model = replace(model, skins=_exchanged(model.skins, skin, other))
        varied = PosedScene(
            posed.array_frame,
            posed.arrays,
            posed.frames,
            _exchanged(posed.bodies, part.body, body),
            _exchanged(posed.skins, skin, PosedSkin(other, body, obstacles)),
        )
        radiation, solved = Radiation(varied_model), self.radiation.scattered_fields()
        if skin in solved and not disc:
            radiation.adopt({skin: (varied, *solved[skin][1:])})
        return self._arp(radiation, varied)

    def _arp(self, radiation: Radiation, posed: PosedScene) -> Float:
        return radiation.on(posed, self.skin, "quadrature", self.loudest.drive).arp.astype(np.float64)


def _exchanged(parts: Sequence[T], number: int, other: T) -> tuple[T, ...]:
    """The parts, with another one in one's place."""
    return (*parts[:number], other, *parts[number + 1 :])


def _estimate(
    layer: SceneLayer,
    small: ReducedStepper | ModalStepper | None,
    sound: _Sound,
    point: Float,
    finer: bool,
    left_small_model: bool,
    level: Callable[[float], tuple[Float, Float]],
    materials: Ends | None,
) -> dict[str, float]:
    frequency, step_s = layer.demand.main_frequency_Hz, layer.sizes.step_s
    few = finer and layer.system.ndof < FEW
    other, ratio = _other_mesh(layer, 1 / RATIO if finer else RATIO, FEW_CHANGES if few else 1)
    low, high = (layer, other) if finer else (other, layer)
    exact_in_time = isinstance(small, ReducedStepper) and not left_small_model
    coarse = _Response(low, sound.on(low), point, scheme_too=not exact_in_time)
    fine = _Response(high, sound.on(high), point)
    between = []
    if few:
        middle = layer.resized(RATIO ** (-FEW_CHANGES // 2))
        between.append(_Response(middle, sound.on(middle), point))
    cut = _other_sides(low, sound, point)
    ends = _other_materials(coarse, materials)
    # The dearest first, so that the cheaper ones fill the time beside it
    _side_by_side(
        fine.swing,
        coarse.swing,
        *(other.swing for other in (*between, *cut, *ends)),
        fine.begin,
        coarse.begin,
        *(other.begin for other in between),
        *(other.rest for other in (*_held(cut), *ends)),
    )
    times, levels = level(step_s / MOMENTS_A_STEP)
    moved = {response: response.small.moved(levels, times) for response in (coarse, fine, *between)}
    mesh, ringing = _changes(coarse, fine, moved)
    order = FEW_ORDER if few else ORDER
    course_order = min(order, COURSE_ORDER)
    error = max(error_of_finer(mesh, ratio, order), error_of_finer(ringing, ratio, course_order))
    if finer:
        error = max(error_of_coarser(mesh, ratio, order), error_of_coarser(ringing, ratio, course_order))
    # Where sound from afar is too rough for a small model, its own error is the least that is stated
    error = max(error, *(each.small.error for each in (coarse, fine) if each.small.error > TOLERANCE), 0.0)
    for response in between:
        more = len(high.system.mesh.surface_triangles6) / len(response.layer.system.mesh.surface_triangles6)
        left = error_of_finer(max(_changes(response, fine, moved)), max(math.sqrt(more), LEAST_RATIO), order)
        error = max(error, max(mesh, ringing) + left)
    step = 1.0 - float(np.sinc(frequency * step_s)) ** 2
    if not exact_in_time:
        step = abs(coarse.scheme - coarse.harmonic) / abs(coarse.harmonic)
        stepped = coarse.small.stepped(level(step_s)[1], step_s)
        step = max(step, _change(stepped, moved[coarse][::MOMENTS_A_STEP]))
    reduction = 0.0
    if small is not None:
        own = coarse if low is layer else fine
        reduction = small.error
        if isinstance(small, ModalStepper) or small.any_course:
            pressure, read = own.pressure, layer.probe(point).operator
            pressure = pressure if small.points is None else pressure[small.points]
            known: dict[float, complex] = {0.0: own.static} if layer.system.supported else {}
            known[frequency] = own.harmonic
            reduced = [small.harmonic(pressure, f, read)[0] for f in known]
            references = known.values()
            reduction = max(reduction, *(abs(a - b) / abs(b) for a, b in zip(reduced, references, strict=True)))
    return _as_numbers(error, step, reduction, _edge_error(coarse, cut)) | _material_band(coarse, ends)


def _changes(one: _Response, other: _Response, moved: dict[_Response, Float]) -> tuple[float, float]:
    """Relative difference of two meshes' answers at rest and at the main frequency, the larger, and over time.

    Raises SceneError where the second doesn't move.
    """
    held = other.layer.system.supported
    mine, theirs = (
        np.array([response.static, response.harmonic] if held else [response.harmonic]) for response in (one, other)
    )
    return largest_change(mine, theirs), _change(moved[one], moved[other])


def _change(course: Float, reference: Float) -> float:
    """Difference of two courses over the second's size, L2 over time; 0 where that doesn't move."""
    size = float(np.linalg.norm(reference))
    return float(np.linalg.norm(course - reference)) / size if size > 0.0 else 0.0


def _other_mesh(layer: SceneLayer, factor: float, changes: int) -> tuple[SceneLayer, float]:
    """A layer on elements of factor^changes times the size, or more, and the ratio of the edges of both, above 1.

    Small discs have the same rings of triangles for many sizes: sizes go on until the meshes differ. Raises SceneError
    as SceneLayer.
    """
    own, change = len(layer.system.mesh.surface_triangles6), factor**changes
    for _ in range(MOST_CHANGES):
        other = layer.resized(change)
        more = len(other.system.mesh.surface_triangles6) / own
        if not 1.0 / ALIKE < more < ALIKE:
            break
        change *= factor
    edges = math.sqrt(max(more, 1.0 / more))
    return other, float(np.clip(edges, LEAST_RATIO, max(change, 1.0 / change)))


def _explicit_estimate(
    layer: SceneLayer, stepper: SkinStepper, sound: _Sound, point: Float, materials: Ends | None
) -> dict[str, float]:
    """Of a solver with a mesh of its own: the cut edge is that of the scene's layer, by its wedges."""
    frequency = layer.demand.main_frequency_Hz
    step = 1.0 - float(np.sinc(frequency * layer.sizes.step_s)) ** 2
    own = _Response(layer, sound.on(layer), point)
    edge, cut, ends = 0.0, _other_sides(layer, sound, point), _other_materials(own, materials)
    if cut or ends:
        _side_by_side(
            own.swing,
            *(other.swing for other in (*cut, *ends)),
            *(other.rest for other in (own, *_held(cut), *ends)),
        )
        edge = _edge_error(own, cut)
    return _as_numbers(stepper.error, step, 0.0, edge) | _material_band(own, ends)


def _other_sides(layer: SceneLayer, sound: _Sound, point: Float) -> list[_Response]:
    """The layer with other cut faces; nothing for a disc, whose side is its own."""
    if layer.config.shape == "disc":
        return []
    other = layer.resized(layer.resizing, side="free" if layer.config.side == "fixed" else "fixed")
    return [_Response(other, sound.on(other), point)]


def _held(cut: Sequence[_Response]) -> list[_Response]:
    """Those that rest anywhere: a layer that nothing holds, neither base nor side, flies away under a steady load."""
    return [other for other in cut if other.layer.config.base != "free" or other.layer.config.side == "fixed"]


def _edge_error(own: _Response, cut: Sequence[_Response]) -> float:
    """Half of what other cut faces change of a layer's displacement at rest or of its harmonic one, the larger.

    All of it where at rest nothing else holds the layer.
    """
    held = _held(cut)
    if len(held) < len(cut):
        return 1.0
    changes = [abs(other.harmonic - own.harmonic) / abs(own.harmonic) for other in cut]
    changes += [abs(other.static - own.static) / abs(own.static) for other in held]
    return 0.5 * max(changes, default=0.0)


def _other_materials(own: _Response, ends: Ends | None) -> list[_Response]:
    """A response with the ranges of the layer's materials at the soft and at the stiff ends; nothing without any."""
    return [own.of(own.layer.resized(own.layer.resizing, sheets=sheets)) for sheets in ends or ()]


def _material_band(own: _Response, ends: Sequence[_Response]) -> dict[str, float]:
    """By how much softer and stiffer materials change the displacement, static and harmonic together, as factors."""
    if not ends:
        return {}
    factors = [(abs(other.static) + abs(other.harmonic)) / (abs(own.static) + abs(own.harmonic)) for other in ends]
    return {"material_band_low": min(1.0, *factors), "material_band_high": max(1.0, *factors)}


def _as_numbers(mesh: float, step: float, reduction: float, edge: float) -> dict[str, float]:
    return {
        "mesh_error_relative": float(mesh),
        "step_error_relative": float(step),
        "reduction_error_relative": float(reduction),
        "edge_error_relative": float(edge),
    }


def nearest_focus(foci: Float, nodes: Float) -> Float:
    """The one of some points, shape (3,) or (k, 3), that is nearest to a skin's nodes, shape (S, 3); shape (3,)."""
    places = np.atleast_2d(foci)
    nearest: Float = places[int(np.argmin([np.linalg.norm(nodes - place, axis=1).min() for place in places]))]
    return nearest


def loudest_place(posed: PosedScene, skin: int, radiation: Radiation, drive: Complex) -> tuple[Float, Float]:
    """Where the ARP on a skin is highest under a drive of all transducers (N,): a node and its outward normal.

    Both in the frame of the first array, shapes (3,) [m]; the first node's where no sound pushes any.
    """
    nodes, outwards = posed.skins[skin].nodes
    highest = int(radiation.on(posed, skin, "nodes", drive).arp.argmax())
    return nodes[highest], outwards[highest]


def _under_focus(model: HapticModel, skin: int, loudest: LoudestMoment) -> Float:
    """The place of the resting skin that is nearest to a focus at the loudest moment, body frame [m], shape (3,)."""
    posed = loudest.posed.skins[skin]
    nodes = posed.nodes[0]
    foci = []
    for number, stimulus in enumerate(model.stimuli):
        if not stimulus.silent:
            places = loudest.posed.focal_points(stimulus, number)
            foci += list(np.atleast_2d(places.at(frame_at(stimulus.config, loudest.time_s).focus)))
    focus = nearest_focus(np.array(foci), nodes)
    if posed.body.model.hand is None:
        return posed.body.frame.inverse_points(focus)
    nearest = np.linalg.norm(nodes - focus, axis=1).argmin()
    return model.skins[skin].nodes[0][nearest]
