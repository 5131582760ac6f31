"""Build the model of a scene from its spec. All parts of a model are made and connected in this file."""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from palmfield import cache
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.config import SkinConfig, StimulusConfig
from palmfield.config.base import naming_keys
from palmfield.device import load_ahead
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.board import Board
from palmfield.drive.boards import BOARDS, board_of
from palmfield.drive.transducer_response import TransducerResponse, transducer_response
from palmfield.errors import SceneError, naming
from palmfield.hand.meshquery import barycentric, closest_faces
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.locked import Lazy
from palmfield.simulation.model import BodyModel, HapticModel, SkinModel, StimulusModel, about_stimulus, array_instances
from palmfield.simulation.small_models.choice import choose_stepper, first_stepper
from palmfield.simulation.small_models.mode_estimate import corner_Hz
from palmfield.simulation.spec import SceneSpec, SkinSpec, StimulusSpec
from palmfield.simulation.validate import (
    check_apart,
    check_arrays,
    check_board,
    check_bodies,
    check_body_sound,
    check_cost,
    check_envelope,
    check_overlaps,
)
from palmfield.skin.scene_layer import LayerDemand, SceneLayer
from palmfield.stimulus.focal_points import FocalPoints, SurfaceCourse
from palmfield.stimulus.modulation import peak_amplitude
from palmfield.stimulus.resolved import resolved
from palmfield.stimulus.schedule import frame_at, main_frequencies, plane_path, zigzag_stroke_m
from palmfield.transforms import Transform
from palmfield.types import Float
from warp_kernels import arp, mesh_query, sdf

if TYPE_CHECKING:
    from palmfield.skin.fem.wedge_stepper import WedgeStepper
    from palmfield.stimulus.surface_path import SurfacePath

LEAST_FREQUENCY_Hz = 200.0
"""Frequency that mesh and time step always resolve, unless key max_frequency_Hz is set."""
BANDS_AN_OCTAVE, BEYOND = 2, 1.07
"""Number of frequency bands per octave; tolerance beyond a band's end.

A mesh is made for the upper end of a band, so that all its frequencies share it. It serves up to BEYOND times this end,
because size rules are less exact than this.
"""
MOST_MODELS = 8
RIM = 0.6
"""Reduction of the region of fine elements, relative to the spot width: half of a spot at the rim is still inside."""
_lock = threading.RLock()
_models: list[HapticModel] = []
_cached_wholes: "list[tuple[SceneLayer, Lazy[WedgeStepper]]]" = []
# Models that need the same parts share them while any model uses them: a mesh and its matrices take seconds
_bodies: WeakValueDictionary[SkinConfig, BodyModel] = WeakValueDictionary()
_cached_layers: WeakValueDictionary[tuple[object, ...], SceneLayer] = WeakValueDictionary()


def model_of(spec: SceneSpec) -> HapticModel:
    """Return the model of a spec. Equal specs share one model and its factors. The errors are those of `build`."""
    with _lock:
        for other in _models:
            if other.spec == spec:
                return other
        alike = next((m for m in _models if _but_for_texts(m.spec) == _but_for_texts(spec)), None)
        model = build(spec, alike)
        _models[:] = [*_models, model][-MOST_MODELS:]
        return model


def keep_model(spec: SceneSpec, model: HapticModel) -> None:
    """Drop all models except that of a spec. Keep the layers of `model` for later scenes that need the same layers.

    model: the model of the spec, or of a world with other layers
    """
    with _lock:
        _models[:] = [other for other in _models if other.spec == spec]
        _cached_wholes[:] = [(skin.layer, whole) for skin, whole in zip(model.skins, model.whole, strict=True)]


def _but_for_texts(spec: SceneSpec) -> SceneSpec:
    """Return the spec without the entries that MuJoCo fills in last, after it has read the sizes of the states."""
    return replace(spec, duration_s=1.0, device="cpu")


def build(spec: SceneSpec, alike: HapticModel | None = None) -> HapticModel:
    """Make the model of a scene.

    alike: a model of the same scene for another duration or device; its bodies and layers are reused
    Raises SceneError or DeviceError, with element, key, value and allowed values, for inconsistent keys.
    """
    check_bodies(spec)
    arrays = _arrays(spec)
    board = board_for(spec, arrays)
    names = list(dict.fromkeys(skin.config.body for skin in spec.skins))
    if alike is not None:
        bodies = alike.bodies
    else:
        bodies = tuple(_body(next(skin.config for skin in spec.skins if skin.config.body == name)) for name in names)
    numbers = [names.index(skin.config.body) for skin in spec.skins]
    carriers = [bodies[number] for number in numbers]
    stimuli = stimuli_of(spec, arrays, board, carriers)
    if alike is not None:
        layers = [skin.layer for skin in alike.skins]
    else:
        layers = layers_for(spec, stimuli, demands_of(spec, stimuli, arrays, board, carriers), carriers)
    skins = tuple(
        SkinModel(skin, number, bodies[number], layer, choose_stepper(spec, skin, layer, stimuli))
        for skin, number, layer in zip(spec.skins, numbers, layers, strict=True)
    )
    check_overlaps(skins)
    whole = tuple(whole_of(skin.layer) for skin in skins)
    model = HapticModel(spec, arrays, board, stimuli, bodies, skins, (), whole)
    return replace(model, begin=tuple(Lazy(partial(first_stepper, model, number)) for number in range(len(skins))))


def load_for_sound(model: HapticModel) -> None:
    """Begin to load the kernels for free sound on skins. On a CPU, threads compile them."""
    field = model.arrays.field
    for skin in model.spec.skins:
        if skin.config.body_sound == "none" and field.device == "cpu":
            centre = skin.body.transform.points(np.array(skin.patch_centre)).tolist()
            kernels = [one.kernel(one.fall(centre, centre, True)[0], True, faced=True) for one in field.evaluators]
            load_ahead([arp, *(kernel.module for kernel in kernels)], "cpu")


def make_surfaces(model: HapticModel) -> None:
    """Make the meshes and force samples that are needed to show a scene first, because Ctrl-C waits for them."""
    for skin in model.skins:
        skin.nodes  # noqa: B018
    for body in model.bodies:
        if body.surface is not None:
            body.sample_mesh  # noqa: B018


def board_for(spec: SceneSpec, arrays: PhasedArray) -> Board:
    """Return the board of a scene. Raises SceneError for arrays not of the board, DeviceError for unknown keys."""
    check_arrays(BOARDS[spec.driver.board], spec.arrays)
    calibrated = any(array.calibration is not None for array in spec.arrays)
    with naming_keys("plugin 'palmfield.driver'", spec.driver):
        board = board_of(spec.driver, len(arrays), calibrated=calibrated, address=arrays.array.address)
    if board.modulates:
        for stimulus in spec.stimuli:
            check_envelope(stimulus, board)
            board = board.modulating(stimulus.config.am_frequency_Hz or 0.0)
    return board


def whole_of(layer: SceneLayer) -> "Lazy[WedgeStepper]":
    """Return the stepper of a full layer, from the cache or new. Its matrix is factorised at the first use."""
    with _lock:
        stored = next((whole for other, whole in _cached_wholes if other is layer), None)
        return stored or Lazy(partial(whole_stepper, layer))


def whole_stepper(layer: SceneLayer) -> "WedgeStepper":
    """Make the stepper of a full layer, with its factorised matrix."""
    from palmfield.skin.fem.wedge_stepper import WedgeStepper

    return WedgeStepper(layer.system, layer.quadrature.operator, layer.sizes.step_s)


def _arrays(spec: SceneSpec) -> PhasedArray:
    """Return the arrays in the reference pose. A SceneError names the instance that cannot be built."""
    instances = array_instances(spec)
    for array, instance in zip(spec.arrays, instances, strict=True):
        with array.naming():
            gain = instance.array(array.placement.sites).gain
            if gain is not None and not gain.any():
                raise SceneError(
                    f"all {len(gain)} transducers are dead or have gain 0; needed: at least one active transducer"
                )
    wall_m = None
    if any(array.config.array_face == "rigid" for array in spec.arrays):
        from palmfield.simulation.array_face import wall_distance  # few arrays send echoes

        wall_m = wall_distance(spec, instances[0].array(spec.arrays[0].placement.sites))
    with naming("plugin 'palmfield.array'"):
        arrays = PhasedArray(instances, [array.placement for array in spec.arrays], spec.device, wall_m)
    check_apart([array.name for array in spec.arrays], arrays)
    return arrays


# -- bodies and stimuli --------------------------------------------------------------------------------------------


def _body(skin: SkinConfig) -> BodyModel:
    """Return the body of a skin: surface and bones. While a model uses it, equal keys share one object."""
    with _lock:
        body = _bodies.get(skin) or _bodies.setdefault(skin, _new_body(skin))
        body.force_accuracy = skin.force_accuracy
        return body


def _new_body(skin: SkinConfig) -> BodyModel:
    if skin.shape == "disc":
        return BodyModel(skin.body, None, None, skin.depth_m)
    if skin.shape == "mesh":
        assert skin.mesh
        from palmfield.hand.meshfile import load_mesh  # slow import: it loads the mesh repair code

        return BodyModel(skin.body, load_mesh(Path(skin.mesh), skin.unit), None, skin.depth_m)
    if skin.shape == "cylinder":
        from palmfield.skin.mesh.cylinder import round_body

        assert skin.cylinder_radius_m and skin.cylinder_length_m
        return BodyModel(skin.body, round_body(skin.cylinder_radius_m, skin.cylinder_length_m), None, skin.depth_m)
    if skin.shape == "rigged":
        from palmfield.hand.rigged import joint_of_body
        from palmfield.hand.skinning import rigged_file, skinned_mesh

        assert skin.mesh
        mesh = rigged_file(skin.mesh, skin.unit)
        joint, _ = joint_of_body(skin.body, mesh.joints)
        rigged = skinned_mesh(mesh, mesh.joints.rest[joint, :3, 3])
        return BodyModel(skin.body, rigged.surface, rigged, skin.depth_m)
    load_ahead((sdf, mesh_query), "cpu")
    preset = load_preset(skin.hand)
    hand = hand_surface(preset)
    if skin.shape != "articulated":
        return BodyModel(skin.body, hand.surface, None, hand.depth_to_bone)
    from palmfield.hand.skinning import SkinnedHand

    return BodyModel(skin.body, hand.surface, SkinnedHand(preset), hand.depth_to_bone)


Responses = dict[tuple[StimulusSpec, bool], TransducerResponse]
"""Cached responses of stimuli, which do not depend on the level, and whether the stimulus is silent."""


def stimuli_of(
    spec: SceneSpec,
    arrays: PhasedArray,
    board: Board,
    carriers: Sequence[BodyModel],
    responses: Responses | None = None,
) -> tuple[StimulusModel, ...]:
    """Return the stimuli. Ring-up is modelled for all transducers of a scene or for none, because they share one state.

    carriers: the body of each skin; responses: responses of other worlds of the scene; new ones are added
    """
    responses, stimuli = {} if responses is None else responses, []
    for stimulus in spec.stimuli:
        check_board(stimulus, board)
        stimuli.append(_stimulus(stimulus, spec, arrays, board, carriers, responses))
    rings = any(stimulus.response.on for stimulus in stimuli)
    stimuli = [replace(stimulus, response=replace(stimulus.response, on=rings)) for stimulus in stimuli]
    for skin in spec.skins:
        check_body_sound(skin, stimuli)
    return tuple(stimuli)


def _stimulus(
    spec: StimulusSpec,
    scene: SceneSpec,
    arrays: PhasedArray,
    board: Board,
    carriers: Sequence[BodyModel],
    responses: Responses,
) -> StimulusModel:
    """Make a stimulus with its path and the response of its transducers; carriers, responses: see `stimuli_of`."""
    config: StimulusConfig = spec.config
    path, course = None, None
    if spec.on_skin is not None:
        carrier, body = carriers[spec.on_skin], scene.skins[spec.on_skin].body.transform
        path = _path_on(spec, carrier, body)
        assert carrier.surface is not None
        course = SurfaceCourse(path, carrier.surface.vertices, carrier.surface.faces, body)
    length_m = float(path.arc_m[-1]) if config.path == "sites" and path is not None else None
    config = resolved(config, length_m, spec.am_table, scene.driver.duty_exponent, spec.focus_table)
    offsets = np.reshape(config.foci_m, (-1, 3))
    if spec.focus_table is not None and spec.focus_table.foci > 1:
        offsets = np.zeros((spec.focus_table.foci, 3))
    focal_points = FocalPoints(spec.frame.transform, offsets, course, spec.focus_table, config.foci_arp)
    transducers = np.concatenate([np.arange(arrays.slices[i].start, arrays.slices[i].stop) for i in spec.arrays])
    about = about_stimulus(spec)
    accuracy = min(skin.config.accuracy for skin in scene.skins)
    spread = not any(skin.config.body_sound == "scattering" for skin in scene.skins)
    with naming(about[0]):
        amplitude = peak_amplitude(config)
        drive = ArrayDrive(arrays, transducers.astype(np.int32), config.arp_peak_Pa, amplitude, board, about[:1], about)
        foci = focal_points.at(frame_at(config, config.start_s).focus)
        silent = not np.any(drive.unit_drive(foci).amplitudes)
        # The key is equal at any level that the board plays unchanged. Silence has its own key.
        key = (replace(spec, config=at_any_level(spec.config)) if board.exact else spec), silent
        response = responses.get(key)
        if response is None:
            response = transducer_response(config, drive, focal_points, array_instances(scene), accuracy, spread=spread)
            responses[key] = response
    return StimulusModel(spec, config, transducers.astype(np.int32), path, offsets, response, foci, silent)


def at_any_level(config: StimulusConfig) -> StimulusConfig:
    """Return a key that is equal for stimuli that differ only in level. For a modulated duty it is the stimulus itself,
    because the level then changes the waveform of the ARP.
    """
    if config.am_quantity == "duty":
        return config
    by_pressure = config.arp_peak_Pa is not None
    return config.model_copy(update={"arp_peak_Pa": 1.0 if by_pressure else None, "drive_amplitude": None})


def _path_on(spec: StimulusSpec, carrier: BodyModel, body: Transform) -> "SurfacePath":
    """Return the path of the focus on the surface of the resting body.

    body: frame of the surface relative to the first array, in the reference pose
    """
    from palmfield.stimulus.surface_path import SurfacePath, drawn, through, zigzag_through  # few stimuli have one

    with spec.naming("path_on"):
        surface = carrier.surface
        if surface is None:
            raise SceneError("the skin is a flat disc: set path_on to plane")
        way: tuple[Callable[..., SurfacePath], tuple[Any, ...]]
        if spec.config.path == "sites":
            sites, stroke = np.array(spec.path_sites), zigzag_stroke_m(spec.config)
            way = through, (sites,)
            if stroke is not None:
                way = zigzag_through, (sites, spec.config.path_zigzag_width_m, stroke)
        else:
            frame = spec.frame.transform
            start = body.inverse_points(frame.points(np.array(spec.config.focus_m)))
            way = drawn, (start, body.inverse_vectors(frame.rotation[:, 0]), plane_path(spec.config))

        def make() -> cache.Arrays:
            function, inputs = way
            return {name: np.array(value) for name, value in vars(function(surface, *inputs)).items()}

        kept = cache.kept("surface-path", (surface.vertices, surface.faces, way[0].__name__, *way[1]), make)
        return SurfacePath(kept["faces"], kept["barycentric"], kept["arc_m"], bool(kept["closed"]))


# -- skins ---------------------------------------------------------------------------------------------------------


def demands_of(
    spec: SceneSpec,
    stimuli: tuple[StimulusModel, ...],
    arrays: PhasedArray,
    board: Board,
    carriers: Sequence[BodyModel],
) -> list[LayerDemand]:
    """Return the requirements of the stimuli on the layer of each skin. carriers: body of each skin"""
    demands = []
    for skin, body in zip(spec.skins, carriers, strict=True):
        stimulus = nearest_stimulus(skin, stimuli)
        frequencies = main_frequencies(stimulus.config)
        highest = skin.config.max_frequency_Hz
        if highest is None:
            highest = band_end(max(frequencies, default=LEAST_FREQUENCY_Hz))
        spot_m = spot_fwhm(arrays, board, stimulus)
        beside, off_m, reach_m = path_place(stimulus, skin, body)
        widest_m = skin.config.radius_m or skin.config.patch_radius_m or max(reach_m, 4.0 * spot_m)
        if skin.moves or float(np.linalg.norm(beside)) >= widest_m:
            beside = np.zeros(3)
        elif off_m < spot_m:
            # The spot at the middle of the layer, so that the mesh is the same for all foci of a region
            middle = skin.body.transform.points(np.array(skin.patch_centre))
            spot_m = spot_fwhm(arrays, board, stimulus, middle)
        offset, near_m = fine_region(beside, reach_m, skin.config.focus_region_m, spot_m)
        demand = LayerDemand(
            spot_fwhm_m=spot_m,
            max_frequency_Hz=highest,
            main_frequency_Hz=next(iter(frequencies), 0.5 * highest),
            path_reach_m=(near_m, reach_m),
            timestep_s=spec.timestep_s,
            corner_Hz=max(corner_Hz(one, spot_m) for one in stimuli),
            offset_m=offset,
        )
        demands.append(demand)
    return demands


def layers_for(
    spec: SceneSpec,
    stimuli: tuple[StimulusModel, ...],
    demands: Sequence[LayerDemand],
    carriers: Sequence[BodyModel],
) -> list[SceneLayer]:
    """Return the layers of the skins, all with the shortest time step that one needs. carriers: body of each skin"""
    layers = []
    for skin, body, demand in zip(spec.skins, carriers, demands, strict=True):
        layers.append(_layer(skin, body, demand))
        # Check before meshing: meshing is slow if the elements are too small.
        check_cost(skin, layers[-1], spec.timestep_s, nearest_stimulus(skin, stimuli))
    if len(layers) == 1:
        return layers
    step_s = _common_step([layer.sizes.step_s for layer in layers], spec)
    return [
        _layer(skin, body, replace(demand, longest_step_s=step_s))
        for skin, body, demand in zip(spec.skins, carriers, demands, strict=True)
    ]


def _layer(skin: SkinSpec, body: BodyModel, demand: LayerDemand) -> SceneLayer:
    """Return the layer of a skin. Skins of a body with equal keys, place and requirements share it while in use."""
    key = skin.name, skin.config, skin.patch_centre, body, demand
    with _lock:
        return _cached_layers.get(key) or _cached_layers.setdefault(
            key,
            SceneLayer(
                skin.config, body.surface, body.depth_to_bone_m, np.array(skin.patch_centre), demand,
                named=skin.naming(),
            ),
        )  # fmt: skip


def nearest_stimulus(skin: SkinSpec, stimuli: tuple[StimulusModel, ...]) -> StimulusModel:
    """Return the stimulus whose first focus is nearest to the middle of a skin. The layer is made for its sound."""
    centre = skin.body.transform.points(np.array(skin.patch_centre))
    sounding = [stimulus for stimulus in stimuli if not stimulus.silent] or list(stimuli)
    return min(sounding, key=lambda stimulus: float(np.linalg.norm(stimulus.first_focus - centre)))


def _common_step(steps_s: list[float], spec: SceneSpec) -> float:
    """Return the time step that all skins share [s]. With one step, results have one time axis."""
    step_s = min(steps_s)
    for skin, own in zip(spec.skins, steps_s, strict=True):
        if skin.config.step_s is not None and own > (1.0 + 1e-9) * step_s:
            raise SceneError(
                f"{skin.element}: key 'step_s' has value {skin.config.step_s:g}, but another skin needs {step_s:g}, "
                f"and all skins use one step; allowed: {step_s:g}"
            )
    return step_s


def band_end(f_Hz: float) -> float:
    """Return the frequency for which the mesh is made for a given frequency [Hz], at least LEAST_FREQUENCY_Hz."""
    bands = BANDS_AN_OCTAVE * math.log2(max(f_Hz / BEYOND, LEAST_FREQUENCY_Hz) / LEAST_FREQUENCY_Hz)
    return float(LEAST_FREQUENCY_Hz * 2.0 ** (math.ceil(bands - 1e-9) / BANDS_AN_OCTAVE))


def fine_region(
    beside: Float, reach_m: float, region_m: float, spot_m: float
) -> tuple[tuple[float, float, float], float]:
    """Return middle (from the middle of the layer) and radius of the region with fine elements [m].

    beside: vector from the middle of the layer to the middle of the foci, shape (3,); reach_m: largest distance of foci
        from there
    region_m: key focus_region_m, smallest radius; spot_m: width of the spot; RIM times it is subtracted from the radius
    If the foci leave this region about the middle of the layer, its middle is the nearest point of a grid with the
    spacing of the region. So foci that are close together share a region.
    """
    middle, radius_m = beside, reach_m
    if region_m:
        outside = float(np.linalg.norm(beside)) + reach_m > region_m
        middle = region_m * np.round(beside / region_m) if outside else np.zeros(3)
        left = (reach_m + float(np.linalg.norm(beside - middle))) / region_m
        radius_m = region_m * max(1, math.ceil(left - 1e-9)) - RIM * spot_m
    x, y, z = middle.tolist()
    return (x, y, z), radius_m


def spot_fwhm(arrays: PhasedArray, board: Board, stimulus: StimulusModel, at: Float | None = None) -> float:
    """Return the full width at half maximum of |p|^2 at the first focus, along the x axis of the array [m].

    at: another focus of the same transducers, shape (3,) [m], at full drive
    """
    config = stimulus.config
    focus = stimulus.first_focus if at is None else at
    # For a silent stimulus: the spot that it would have
    level = (config.arp_peak_Pa, peak_amplitude(config) or 1.0) if at is None else (None, 1.0)
    amplitudes = ArrayDrive(arrays, stimulus.transducers, *level, board).unit_drive(focus).amplitudes
    offsets, peak = np.linspace(0.0, 0.06, 241), None
    # The line is searched in pieces: most spots end in the first
    for offset in np.array_split(offsets, 8):
        points = focus + offset[:, None] * np.array([1.0, 0.0, 0.0])
        square = np.abs(arrays.pressure64(points, amplitudes)) ** 2
        peak = square[0] if peak is None else peak
        below = np.flatnonzero(square < 0.5 * peak)
        if len(below):
            return 2 * float(offset[below[0]])
    return 2 * float(offsets[-1])


class PathPlace(NamedTuple):
    """Place of a path, or of a focus, on a layer.

    beside: vector from the middle of the layer to the skin point nearest to the middle of the path, shape (3,) [m]
    off_m: distance of the middle of the path from that point [m]
    reach_m: largest distance of the path from its middle [m]
    """

    beside: Float
    off_m: float
    reach_m: float


def path_place(stimulus: StimulusModel, skin: SkinSpec, body: BodyModel) -> PathPlace:
    """Return the place of the path (or focus) of a stimulus. For a path on the skin its middle is the layer's."""
    centre = np.array(skin.patch_centre)
    if stimulus.path is not None and body.surface is not None:
        places, _ = stimulus.path.at(stimulus.path.arc_m, body.surface.vertices, body.surface.faces)
        return PathPlace(np.zeros(3), 0.0, float(np.linalg.norm(places - centre, axis=1).max()))
    middle, foci = np.array(stimulus.config.focus_m), np.reshape(stimulus.config.foci_m, (-1, 3))[:, :2]
    reach = float(np.hypot(*foci.T).max(initial=0.0))
    path = plane_path(stimulus.config)
    if (table := stimulus.spec.focus_table) is not None:
        places = table.positions.reshape(-1, 3)
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        reach = float(np.linalg.norm(places - middle, axis=1).max())
    elif stimulus.config.path_diameter_m:
        reach += 0.5 * stimulus.config.path_diameter_m
    elif path is not None:
        reach += float(np.hypot(*path.points.T).max())
    focus = skin.body.transform.inverse_points(stimulus.spec.frame.transform.points(middle))
    nearest = _on_skin(body, focus)
    return PathPlace(nearest - centre, float(np.linalg.norm(focus - nearest)), reach)


def _on_skin(body: BodyModel, point: Float) -> Float:
    """Return the surface point of a resting body nearest to a point, body frame [m]; for a disc, its projection."""
    surface = body.surface
    if surface is None:
        return np.array([*point[:2], 0.0])
    reach = float(np.linalg.norm(surface.vertices - point, axis=1).min()) * 1.01 + 1e-6
    face = int(closest_faces(body.query_mesh, point[None], reach)[0])
    corners = surface.vertices[surface.faces[face]]
    nearest: Float = barycentric(corners[None], point[None])[0] @ corners
    return nearest
