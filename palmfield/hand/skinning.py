"""Skin that follows bones: of the articulated hand, and of a user's rigged mesh."""

import threading
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

import warp_kernels.skinning as kernels
from palmfield.blas import one_blas_thread
from palmfield.device import SharedArray, recorded, resolve
from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand, HandBone, articulate
from palmfield.hand.blend import bone_shifts
from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.rigged import RiggedMesh, strongest
from palmfield.hand.subdivide import EDGE_m
from palmfield.hand.surface import capsule_distance, hand_surface
from palmfield.hand.triangles import adjacency, unique_edges
from palmfield.types import Float, Int, Surface

KNUCKLE_BLEND, JOINT_BLEND = 1.5, 0.8
"""Length of the transition between the motions of two bones, in breadths of the digit at the joint. It is longer at the
knuckles, where the skin of the thick palm would otherwise fold into itself."""
WRIST_BLEND_m, THUMB_ROOT_BLEND_m, THENAR_BLEND_m = 0.050, 0.030, 0.040
SMOOTHING_m = 0.004
"""Length over which weights are smoothed along the skin; it rounds the webs between fingers."""
BONES_PER_VERTEX = 4


def skin_weights(hand: ArticulatedHand, surface: Surface) -> Float:
    """Return the weight of each bone at each vertex, shape (n, bones), at most four per vertex, rows of sum 1.

    A vertex belongs to the digit with the nearest skin. Along a digit the weight changes from bone to bone by a linear
    ramp (KNUCKLE_BLEND, JOINT_BLEND); wrist and root of the thumb have own ramp lengths. The weights are then diffused
    along the mesh. All other vertices belong to the root or the hand.
    """
    points = surface.vertices
    names = [bone.name for bone in hand.bones]
    weights = np.zeros((len(points), len(names)))
    gaps = np.array([_gap(hand, digit, points) for digit in DIGITS])
    fingers = DIGITS[1:]
    nearest = np.argmin(gaps[1:], axis=0)
    thumb_share = np.clip(0.5 + (gaps[1:].min(axis=0) - gaps[0]) / THENAR_BLEND_m, 0.0, 1.0)
    for number, digit in enumerate(fingers):
        share = np.where(nearest == number, 1.0 - thumb_share, 0.0)
        _along_digit(hand, digit, points, share, weights, names)
    _along_digit(hand, "thumb", points, thumb_share, weights, names)
    beyond = np.clip(0.5 - (points[:, 1] - hand.skeleton.landmarks["wrist"][1]) / WRIST_BLEND_m, 0.0, 1.0)
    weights *= 1.0 - beyond[:, None]
    weights[:, names.index("forearm")] += beyond
    weights = _diffused(weights, surface)
    threshold = np.partition(weights, -BONES_PER_VERTEX, axis=1)[:, -BONES_PER_VERTEX]
    weights[weights < np.maximum(threshold, 1e-3)[:, None]] = 0.0
    return weights / weights.sum(axis=1, keepdims=True)


def _gap(hand: ArticulatedHand, digit: str, points: Float) -> Float:
    """Return the distance from points to the capsules of a digit and its metacarpal [m], shape (n,)."""
    parts = [
        part
        for part in hand.skeleton.skin
        if part.name.startswith(f"{digit}_") and not part.name.endswith(("_pad", "_web"))
    ]
    return capsule_distance(points, [(one.start, one.end, one.semi_start[0], one.semi_end[0]) for one in parts])


def _along_digit(
    hand: ArticulatedHand, digit: str, points: Float, share: Float, weights: Float, names: list[str]
) -> None:
    """Split `share` among the hand and the three bones of a digit, by the length along its bones."""
    chain = [names.index("hand")] + [i for i, name in enumerate(names) if name.startswith(f"{digit}_")]
    breadths = hand.preset.digits[digit].breadth_m
    if digit == "thumb":
        lengths = [THUMB_ROOT_BLEND_m] + [JOINT_BLEND * breadth for breadth in breadths[:2]]
    else:
        lengths = [KNUCKLE_BLEND * breadths[0]] + [JOINT_BLEND * breadth for breadth in breadths[1:3]]
    rest = share
    for level, length in enumerate(lengths):
        bone = hand.bones[chain[level + 1]]
        flexion = next(j for j in hand.joints if j.bone == chain[level + 1] and j.name.endswith("_flexion"))
        part = next(s for s in hand.skeleton.skin if s.name == bone.name)
        along = (part.end - part.start) / np.linalg.norm(part.end - part.start)
        # The ramp runs along the mean direction of the two bones
        if level > 0 or digit != "thumb":
            half = -0.5 * np.deg2rad(flexion.rest_deg) * flexion.axis
            along = along + np.cross(half, along)
        passed = np.clip(0.5 + (points - bone.origin) @ along / length, 0.0, 1.0)
        weights[:, chain[level]] += rest * (1.0 - passed)
        rest = rest * passed
    weights[:, chain[-1]] += rest


def _diffused(weights: Float, surface: Surface) -> Float:
    """Diffuse weights over SMOOTHING_m along the mesh by one implicit step, which keeps row sums and signs."""
    links = adjacency(surface.faces, len(surface.vertices))
    edges, _ = unique_edges(surface.faces)
    squared = float(np.mean(np.sum((surface.vertices[edges[:, 0]] - surface.vertices[edges[:, 1]]) ** 2, axis=1)))
    degree = sparse.diags_array(np.asarray(links.sum(axis=1)).ravel())
    # The mean over neighbours minus the value is a quarter of the squared edge times the Laplacian.
    matrix = degree + 4.0 * SMOOTHING_m**2 / squared * (degree - links)
    with one_blas_thread:
        return splu(sparse.csc_array(matrix)).solve(degree @ weights)


class SkinnedSurface:
    """A skin that follows bones, whose frames are parallel to that of the surface in the rest pose.

    bones: names and rest origins; surface: skin in the rest pose; origins: origins of the bones at rest [m], shape
    (bones, 3)
    weights: weight of each bone at each vertex, shape (n, bones), at most four per vertex, rows of sum 1
    The methods are thread-safe; threads wait for each other. After `pose` the arrays `vertices` and `normals` contain
    the posed skin on the device (Warp, vec3), until the next pose of any thread.
    """

    def __init__(self, bones: Sequence[HandBone], surface: Surface, weights: Float, device: str = "cpu") -> None:
        """Raises PalmfieldError for an unknown device."""
        self.bones, self.surface, self.weights = list(bones), surface, weights
        self._device = resolve(device)
        self.origins: Float = np.array([bone.origin for bone in self.bones])
        self._shapes = self.origins.shape, (len(self.bones), 3, 3)
        self._lock = threading.Lock()
        count = len(surface.vertices)
        self._turns = SharedArray(len(self.bones), wp.mat33, self._device)
        self._shifts = SharedArray(len(self.bones), wp.vec3, self._device)
        self._vertices = SharedArray(count, wp.vec3, self._device)
        self._normals = SharedArray(count, wp.vec3, self._device)
        self.vertices, self.normals = self._vertices.array, self._normals.array

    def posed(self, bone_positions: Float, bone_rotations: Float) -> Float:
        """Return the posed vertices [m], shape (n, 3), by linear blend skinning in float32.

        bone_positions, bone_rotations: poses of the frames of `bones` in any common frame, shapes (bones, 3) [m] and
        (bones, 3, 3). Raises SceneError for other shapes.
        """
        with self._lock:
            self._blend_to(bone_positions, bone_rotations)
            self._fetch(self._vertices)
            return self._vertices.host.astype(np.float64)

    def posed_surface(self, bone_positions: Float, bone_rotations: Float) -> Surface:
        """Return the surface of `posed`, with faces and angle-weighted normals."""
        with self._lock:
            self._blend_to(bone_positions, bone_rotations)
            self._make_normals()
            self._fetch(self._vertices, self._normals)
            vertices, normals = (array.host.astype(np.float64) for array in (self._vertices, self._normals))
        return Surface(vertices, self.surface.faces, normals)

    def pose(self, bone_positions: Float, bone_rotations: Float) -> None:
        """Compute `vertices` and `normals` on the device asynchronously. Raises SceneError like `posed`."""
        with self._lock:
            self._blend_to(bone_positions, bone_rotations)
            self._make_normals()

    def _blend_to(self, bone_positions: Float, bone_rotations: Float) -> None:
        """Compute `vertices` on the device."""
        if (bone_positions.shape, bone_rotations.shape) != self._shapes:
            number = len(self.bones)
            raise SceneError(
                f"skin on bones: positions have shape {bone_positions.shape} and rotations {bone_rotations.shape}; "
                f"give ({number}, 3) and ({number}, 3, 3), one for each bone"
            )
        self._turns.put(bone_rotations)
        self._shifts.put(bone_shifts(self.origins, bone_positions, bone_rotations))
        self._blend()

    def _fetch(self, *arrays: SharedArray) -> None:
        """Copy results of kernels to NumPy arrays."""
        if self._device != "cpu":
            for array in arrays:
                array.download()
            wp.synchronize_stream(self._device)

    @cached_property
    def _blend(self) -> Callable[[], object]:
        shares, order = strongest(sparse.csr_array(self.weights))
        inputs = [
            self._put(self.surface.vertices, wp.vec3), self._put(order, wp.vec4i), self._put(shares, wp.vec4),
            self._turns.array, self._shifts.array, self.vertices,
        ]  # fmt: skip
        return recorded(kernels.blend_bones, len(self.surface.vertices), inputs, self._device)

    @cached_property
    def _make_normals(self) -> Callable[[], object]:
        faces, number = self.surface.faces, len(self.surface.vertices)
        count = np.bincount(faces.ravel(), minlength=number)
        corners: wp.array = wp.array(faces, dtype=wp.int32, device=self._device)
        first = self._put(np.concatenate([[0], np.cumsum(count)]), wp.int32)
        inputs = [self.vertices, corners, first, self._put(np.argsort(faces.ravel(), kind="stable"), wp.int32)]
        return recorded(kernels.normals_by_angle, number, [*inputs, self.normals], self._device)

    def dominant_bone(self) -> Int:
        """Return the index of the bone with the largest weight at each vertex, shape (n,)."""
        return np.argmax(self.weights, axis=1).astype(np.int32)

    def _put(self, values: ArrayLike, dtype: Any) -> wp.array:
        whole = dtype in (wp.int32, wp.vec4i)
        return wp.array(np.asarray(values, dtype=np.int32 if whole else np.float32), dtype=dtype, device=self._device)


class SkinnedHand(SkinnedSurface):
    """Skin of an articulated hand that follows its bones.

    hand: bones and joints; weights: as returned by `skin_weights`
    """

    def __init__(self, preset: HandPreset, edge_m: float = 0.003, device: str = "cpu") -> None:
        """Raises SceneError like `hand_surface`, and PalmfieldError for an unknown device."""
        self.hand, surface, weights = _hand_with_weights(preset.model_dump_json(), edge_m)
        super().__init__(self.hand.bones, surface, weights, device)


@lru_cache(maxsize=4)
def _hand_with_weights(preset: str, edge_m: float) -> tuple[ArticulatedHand, Surface, Float]:
    """Return bones, skin and weights of a preset in JSON; cached, since it takes half a second."""
    read = HandPreset.model_validate_json(preset)
    hand, surface = articulate(read), hand_surface(read, edge_m).surface
    return hand, surface, skin_weights(hand, surface)


@lru_cache(maxsize=2)
def rigged_file(path: str, unit: str) -> RiggedMesh:
    """Return a user's rigged mesh with edges up to EDGE_m, cached. Raises SceneError like `load_rigged`."""
    from palmfield.hand.meshfile import load_rigged

    return load_rigged(path, unit, EDGE_m)


def skinned_mesh(mesh: RiggedMesh, origin: Float) -> SkinnedSurface:
    """Return a user's skin and bones in a frame parallel to that of the file, with its origin at `origin` [m], (3,)."""
    weights = np.zeros((len(mesh.weights), len(mesh.joints.names)))
    np.add.at(weights, (np.arange(len(weights))[:, None], mesh.indices), mesh.weights)
    surface = Surface(mesh.surface.vertices - origin, mesh.surface.faces, mesh.surface.normals)
    return SkinnedSurface(bones_of_mesh(mesh, origin), surface, weights)


def bones_of_mesh(mesh: RiggedMesh, origin: Float) -> list[HandBone]:
    """Return the joints of a user's mesh as bones in the frame of `skinned_mesh`; origin: [m], shape (3,)."""
    joints = mesh.joints
    places = joints.rest[:, :3, 3] - origin
    return [HandBone(*bone) for bone in zip(joints.names, joints.parents.tolist(), places, strict=True)]
