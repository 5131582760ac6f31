"""Class of all sounds that the arrays can make on a skin, for loads that cannot be predicted before the run.

The class is spanned by examples. In an example, one or two foci are on the region of the skin for which its layer is
made; one array or all arrays emit. The body is in the reference pose, or it is shifted and tilted from this pose. The
class does not depend on the stimulus. So its modes can be used for all stimuli and for every moving hand.

The examples are drawn in a frame on the skin. Each has images under quarter turns about the normal and under mirroring.
The examples are equal for every array and combination of arrays. So they do not depend on rotation and mirroring of the
scene, on the order of its arrays, or on the mesh of the skin.
"""

import math
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield import cache
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.drive.array_drive import ArrayDrive
from palmfield.errors import SceneError
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface, reference_scene
from palmfield.simulation.small_models.mode_estimate import block_count, laws, region_m
from palmfield.simulation.spec import SkinSpec
from palmfield.skin.reduction.load_shapes import POINTS
from palmfield.skin.scene_layer import SceneLayer
from palmfield.transforms import Transform
from palmfield.types import Complex, Float, Int

if TYPE_CHECKING:
    from palmfield.skin.reduction.modal_stepper import ModalBody, ModalStepper

MOVES = (
    ((0.0, 0.0, 0.0), (0.0, 0.0), 20, 12),
    ((0.0, 0.0, 0.025), (0.0, 0.0), 8, 5),
    ((0.0, 0.0, -0.025), (0.0, 0.0), 8, 5),
    ((0.018, 0.018, 0.0), (0.12, -0.12), 8, 5),
)
"""Motions of the body in the examples.

Each entry has a shift along the two axes of the skin frame and outwards [m], a tilt about these axes [rad], the number
of examples with one focus, and the number with two foci of any relative phase. Images are not counted.
"""
NEAREST = 0.5
"""Upper limit of a shift, as a fraction of the distance from the skin to the nearest transducer."""
ALONG = 0.9
"""Largest component of the first body axis along the normal of the skin.

Above it, the second axis defines the frame.
"""
OFF_SKIN_m = 0.006
"""Largest distance of a focus from the skin in an example, along each axis [m]."""
SPAN = 0.1
"""Fraction of the target accuracy that the load shapes of the class may omit from its examples."""
LEAST_OMITTED = 0.0075
"""Smallest omitted part for which another load shape helps. Below it, another block of modes reduces the error more."""
WEAK, MOST_WEAK = 0.3, 0.025
"""Fraction of the target accuracy, in the energy norm, that omitted weak modes may cost; and its upper limit."""
WEAK_TOGETHER = 0.3
"""The same fraction with several relaxation laws.

They couple modes; few modes are lossy, and weak ones follow slow loads.
"""
EDGES_SPAN, EDGES_POINTS = 0.5, 4
"""SPAN for a skin with shadows, and number of points per load shape.

Shadow edges need far more shapes than sound alone.
"""
FINGER_m = 0.008, 0.02
"""Widths of the objects that cast shadows in the examples."""
_lock = threading.RLock()
# The last modes of a layer and their other inputs, in memory: reading 100 MB from the disk cache takes a second
_bodies: "WeakKeyDictionary[SceneLayer, tuple[str, ModalBody]]" = WeakKeyDictionary()


def class_stepper(model: HapticModel, skin: int, blocks: int | None = None) -> "ModalStepper":
    """Return the modes of the layer of a skin for the class of its loads.

    blocks: number of Krylov blocks of the space of the modes; default: the number for the accuracy of the skin
    Raises SceneError if modes are impossible.
    """
    from palmfield.skin.reduction.modal_stepper import ModalStepper, modal_body

    part = model.skins[skin]
    layer, accuracy = part.layer, part.spec.config.accuracy
    posed = reference_scene(model)
    arrays, law = posed.arrays, part.spec.arp_law
    depends_on = (
        *(arrays.array, arrays.air, arrays.placements, arrays.wall_m, arrays.precision, model.board.name, law),
        *(*posed.skins[skin].quadrature, part.spec.patch_centre, region_m(layer)),
    )
    span, points = (EDGES_SPAN, EDGES_POINTS) if _has_edges(part.spec) else (SPAN, POINTS)
    tolerance, blocks = max(span * accuracy, LEAST_OMITTED), blocks or block_count(accuracy)
    weak = min(WEAK * accuracy, MOST_WEAK) * (WEAK_TOGETHER if laws(layer) > 1 else 1.0)
    with _lock:
        mark = cache.digest(depends_on, tolerance, blocks, points)
        cached = _bodies.get(layer)
        if cached is None or cached[0] != mark:
            made = modal_body(
                layer.system, layer.quadrature, layer.surface_operator, lambda: examples(model, skin, posed),
                depends_on, tolerance, blocks, weak, layer.sizes.step_s, points,
            )  # fmt: skip
            if not len(made.modes.elastic):
                raise SceneError(
                    f"the layer has a radius of {1e3 * layer.sizes.radius_m:.3g} mm, and no expected focus moves it; "
                    f"allowed: about the width of the spot, {1e3 * layer.demand.spot_fwhm_m:.3g} mm, or more; set "
                    "patch_radius_m larger, or solver wedges",
                    part.spec.element,
                )
            cached = _bodies[layer] = mark, made
    return ModalStepper(cached[1], layer.system, layer.sizes.step_s, layer.demand.corner_Hz)


def examples(model: HapticModel, skin: int, posed: PosedScene) -> Float:
    """Return the ARP of examples at the quadrature points of a skin [Pa], shape (t, q); posed: the reference.

    If the sound on the skin has shadows, the examples have shadows at all places, independent of the obstacles in the
    reference scene.
    """
    rng, shading = np.random.default_rng(0), np.random.default_rng(1)
    arrays, layer = posed.arrays, model.skins[skin].layer
    surface = SurfaceArp(arrays.field, len(layer.quadrature.weights), model.skins[skin].spec.arp_law)
    frame = posed.skins[skin].body.frame
    middle = np.array(model.skins[skin].spec.patch_centre)
    centre, region = frame.points(middle), region_m(layer)
    axes = frame.rotation @ _skin_axes(layer, middle, region)
    offsets = (posed.skins[skin].quadrature[0] - centre) @ axes
    gap = float(np.linalg.norm(arrays.array.positions - centre, axis=1).min())
    sources = _sources(arrays, centre, axes)
    loads: list[Float] = []
    edges = _has_edges(model.skins[skin].spec)
    for shift, tilt, one, two in MOVES:
        way = np.array(shift) * min(1.0, NEAREST * gap / max(float(np.linalg.norm(shift)), 1e-9))
        single = _foci(rng, offsets, region, -(-one // len(sources)))
        pairs = _foci(rng, offsets, region, 2 * -(-two // len(sources) ** 2))
        phases = np.exp(2j * math.pi * rng.random(pairs.shape[1] // 2))
        lit = [_lit(offsets, region, count, shading) for count in (single.shape[1], len(phases)) if edges]
        for move in _images_of(np.array([*way, *tilt])):
            turn = axes @ Rotation.from_rotvec([*move[3:], 0.0]).as_matrix() @ axes.T
            moved = _moved(model, skin, posed, centre, turn, axes @ move[:3]) if move.any() else posed
            points, normals = moved.skins[skin].quadrature
            here, origin = turn @ axes, moved.skins[skin].body.frame.points(middle)
            drives, numbers = _drives(model, arrays, sources, origin + single @ here.T, origin + pairs @ here.T, phases)
            arp = surface.evaluate_many(points, normals, drives).astype(np.float64)
            arp /= np.sqrt((arp**2 @ layer.quadrature.weights).max())
            loads += [arp, arp * np.concatenate(lit)[numbers]] if edges else [arp]
    return np.concatenate(loads)


def _skin_axes(layer: SceneLayer, middle: Float, region_m: float) -> Float:
    """Return the frame of a skin in the frame of the body: two tangents and the outward normal as columns, (3, 3)."""
    quadrature = layer.quadrature
    near = np.linalg.norm(quadrature.points - middle, axis=1) < region_m
    normal = (quadrature.weights * near) @ quadrature.normals
    normal /= np.linalg.norm(normal)
    first = np.eye(3)[0 if abs(normal[0]) < ALONG else 1]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(normal, first), normal])


def _images() -> list[Float]:
    """Return the quarter turns about the third axis, each also with a mirror, (3, 3) each."""
    turns = [np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return [turn @ np.diag([1.0, mirror, 1.0]) for mirror in (1.0, -1.0) for turn in turns]


def _images_of(move: Float) -> list[Float]:
    """Return the distinct images of a shift [m] and of the two components of a tilt [rad], (5,) each.

    A mirror changes the sign of a rotation.
    """
    images = [np.array([*(g @ move[:3]), *(np.linalg.det(g) * g[:2, :2] @ move[3:])]) for g in _images()]
    return list({tuple(np.round(image, 9) + 0.0): image for image in images}.values())


def _foci(rng: np.random.Generator, offsets: Float, region_m: float, count: int) -> Float:
    """Return foci near the skin and their images, relative to its centre, in the frame of the skin [m].

    offsets: offsets of the quadrature points in that frame, shape (q, 3)
    The result has shape (images, count, 3). Foci are uniform over the area of the region, in distance from the middle
    and in direction. Each takes its height from the nearest point.
    """
    distance = np.linalg.norm(offsets, axis=1)
    near = offsets[distance < region_m]
    across = np.hypot(*near[:, :2].T)
    flat = near[:, :2] * (np.linalg.norm(near, axis=1) / np.maximum(across, 1e-12))[:, None]
    reach = min(region_m, float(np.linalg.norm(flat, axis=1).max()))
    rank = rng.permutation(count) + rng.random(count)
    away, angle = reach * np.sqrt(rank / count), 2.0 * math.pi * rng.random(count)
    places = np.column_stack([away * np.cos(angle), away * np.sin(angle), np.zeros(count)])
    off_skin = rng.uniform(-OFF_SKIN_m, OFF_SKIN_m, (count, 3))
    found, tree = [], cKDTree(flat)
    for image in _images():
        place = places @ image.T
        nearest = tree.query(place[:, :2])[1]
        beside = np.clip(place[:, :2] - flat[nearest], -OFF_SKIN_m, OFF_SKIN_m)
        found.append(near[nearest] + np.column_stack([beside, np.zeros(count)]) + off_skin @ image.T)
    return np.array(found)


def _sources(arrays: PhasedArray, centre: Float, axes: Float) -> list[Int]:
    """Return the groups of transducers of the examples: all, and those of each array.

    Their order depends only on place.
    """
    everything = np.arange(len(arrays), dtype=np.int32)
    if len(arrays.slices) == 1:
        return [everything]
    places = [np.round((arrays.array.positions[own].mean(axis=0) - centre) @ axes, 6) for own in arrays.slices]
    order = sorted(range(len(places)), key=lambda number: tuple(places[number]))
    return [everything, *(everything[arrays.slices[number]] for number in order)]


def _has_edges(skin: SkinSpec) -> bool:
    return skin.config.body_sound == "shadows"


def _lit(offsets: Float, region_m: float, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which points are outside the shadow of a straight finger or a half plane, and of its images.

    offsets: offsets of the points from the middle of the region in the frame of the skin [m], shape (q, 3)
    Returns shape (images * count, q), image by image, in the order of foci.
    """
    angle = 2.0 * math.pi * rng.random((count, 1))
    across = np.hstack([np.cos(angle), np.sin(angle)])
    beyond = np.array([across @ (offsets @ image)[:, :2].T for image in _images()])
    beyond -= rng.uniform(-region_m, region_m, (count, 1))
    half = 0.5 * rng.uniform(*FINGER_m, (count, 1))
    finger = rng.random((count, 1)) < 0.5
    return np.where(finger, np.abs(beyond) > half, beyond > 0.0).reshape(-1, len(offsets))


def _moved(model: HapticModel, skin: int, posed: PosedScene, centre: Float, turn: Float, shift_m: Float) -> PosedScene:
    """Return the scene with the body of a skin rotated about a point and shifted, array frame."""
    part = model.skins[skin]
    before = posed.bodies[part.body]
    frame = Transform(turn @ (before.frame.position - centre) + centre + shift_m, turn @ before.frame.rotation)
    body = PosedSurface(before.model, before.skin, frame, (before.bone_positions, before.bone_rotations))
    bodies = [body if number == part.body else other for number, other in enumerate(posed.bodies)]
    skins = []
    for place, other in zip(posed.skins, model.skins, strict=True):
        obstacles = place.obstacle_positions, place.obstacle_rotations
        skins.append(PosedSkin(other, body, obstacles) if other.body == part.body else place)
    return PosedScene(posed.array_frame, posed.arrays, posed.frames, bodies, skins)


def _drives(
    model: HapticModel, arrays: PhasedArray, sources: Sequence[Int], single: Float, pairs: Float, phases: Complex
) -> tuple[Complex, Int]:
    """Return the drives of each source for single foci, and of each two sources for pairs of foci, shape (d, N).

    The index of the focus or pair of each drive, shape (d,), is also returned. Foci behind an array get no drive.
    sources: groups of transducers, see `_sources`
    single, pairs: foci, array frame [m], shapes (i, s, 3) and (i, 2 p, 3)
    phases: phases of the second focus of each pair, as a factor, shape (p,)
    """
    drives = [ArrayDrive(arrays, chosen, None, None, model.board) for chosen in sources]

    def amplitudes(drive: ArrayDrive, focus: Float) -> Complex | None:
        try:
            return drive.unit_drive(focus).amplitudes
        except SceneError:
            return None  # behind the array

    alone = single.reshape(-1, 3)
    made = [(number, amplitudes(drive, focus)) for number, focus in enumerate(alone) for drive in drives]
    for number, both in enumerate(pairs.reshape(-1, 2, 3)):
        first, second = ([amplitudes(drive, focus) for drive in drives] for focus in both)
        made += [
            (len(alone) + number, 0.5 * (one + phases[number % len(phases)] * other))
            for one in first for other in second if one is not None and other is not None
        ]  # fmt: skip
    sounding = [(number, drive) for number, drive in made if drive is not None]
    if not sounding:
        raise SceneError("no modes for this skin: no transducer faces it in the reference pose")
    return np.array([drive for _, drive in sounding]), np.array([number for number, _ in sounding], dtype=np.int32)
