"""Closed skin surface of a hand preset, by signed distance, marching cubes and relaxation; cached on disk."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
import warp as wp

import warp_kernels.sdf as kernels
from palmfield import cache
from palmfield.device import load_kernels, resolve, run_kernel
from palmfield.errors import SceneError
from palmfield.hand import preset as preset_module
from palmfield.hand import skeleton as skeleton_module
from palmfield.hand.preset import HandPreset
from palmfield.hand.skeleton import (
    MIRROR,
    BETWEEN_FINGERS_BLEND_m,
    Bone,
    FINGER_BLEND_m,
    Skeleton,
    THUMB_BLEND_m,
    build_skeleton,
)
from palmfield.hand.triangles import adjacency, neighbour_mean, vertex_normals
from palmfield.types import Float, Int, Surface
from warp_kernels import EXACT

GRADIENT_STEP_m = 1e-4
# The memory layout of warp_kernels.sdf.Segment.
SEGMENT_RECORD = np.dtype(
    [(name, np.float32, 3) for name in ("start", "end", "semi_start", "semi_end", "dorsal")]
    + [("group", np.int32), ("blend", np.float32)]
)
# Relaxed marching-cubes triangles have edges of about this many voxels.
EDGE_PER_VOXEL = 0.87
_palmar_skins: dict[str, float] = {}
"""Height of the palmar skin [m] by the text of a preset; opening a scene needs it several times."""


@dataclass(frozen=True)
class HandSurface:
    """Skin of a hand in the hand frame.

    surface: closed triangle mesh
    depth_to_bone: distance from each vertex to the nearest bone surface [m], shape (n,), float64
    landmarks: positions [m], shape (3,), by name: palm_centre, wrist, <digit>_tip, <digit>_pad, <digit>_knuckle
    """

    surface: Surface
    depth_to_bone: Float
    landmarks: dict[str, Float]


def hand_surface(preset: HandPreset, edge_m: float = 0.003) -> HandSurface:
    """Return the watertight skin mesh of a preset, with mean edge length close to `edge_m` [m].

    The mesh is stored in the user's cache folder (`palmfield.cache`) by preset, edge length and generating code,
    because it takes seconds.

    Raises SceneError for an edge length outside 1 to 4 mm (a coarser grid closes the gaps between fingers), and if
    digits of the preset touch.
    """
    if not 0.001 <= edge_m <= 0.004:
        raise SceneError(f"hand surface edge length {edge_m:g} m is out of range; use 0.001 to 0.004 m")
    skeleton = centred_skeleton(preset)
    _check_gaps(skeleton)
    # The mesh of a left hand is the mirror image of the right one, vertex by vertex
    right = preset.model_copy(update={"side": "right"})
    sources = (__file__, preset_module.__file__, skeleton_module.__file__, kernels.__file__)
    mesh = cache.kept(
        "hand",
        (right, edge_m),
        lambda: _generate(centred_skeleton(right), edge_m),
        where=Path(platformdirs.user_cache_dir("palmfield")) / "hands",
        code=cache.digest(*(Path(source).read_bytes() for source in sources)),
    )
    vertices, faces = mesh["vertices"].astype(np.float64), mesh["faces"]
    surface = Surface(vertices, faces, vertex_normals(vertices, faces))
    if preset.side == "left":
        surface = mirrored_surface(surface)
    return HandSurface(surface, bone_distance(surface.vertices, skeleton.bones), skeleton.landmarks)


def mirrored_surface(surface: Surface) -> Surface:
    """Return the surface of the other hand, mirrored at x = 0."""
    faces = np.ascontiguousarray(surface.faces[:, ::-1])
    return Surface(surface.vertices * MIRROR, faces, surface.normals * MIRROR)


def centred_skeleton(preset: HandPreset) -> Skeleton:
    """Return the skeleton in the hand frame, in which the palmar skin passes through the origin."""
    skeleton = build_skeleton(preset)
    key = preset.model_dump_json()
    if key not in _palmar_skins:
        _palmar_skins[key] = _palmar_skin(_segments(skeleton))
    up = np.array([0.0, 0.0, -_palmar_skins[key]])
    fixed = {"palm_centre": np.zeros(3)}
    return Skeleton(
        [replace(s, start=s.start + up, end=s.end + up) for s in skeleton.skin],
        [replace(b, start=b.start + up, end=b.end + up) for b in skeleton.bones],
        {name: position + up for name, position in skeleton.landmarks.items()} | fixed,
    )


def _palmar_skin(segments: wp.array) -> float:
    """Return the height of the palmar skin on the z axis [m], by bisection."""
    low, high = -0.08, 0.0
    while high - low > 1e-7:
        middle = 0.5 * (low + high)
        outside = _distance_and_gradient(segments, np.array([[0.0, 0.0, middle]]))[0][0] > 0.0
        low, high = (middle, high) if outside else (low, middle)
    return 0.5 * (low + high)


def skin_distance(skeleton: Skeleton, points: Float) -> Float:
    """Return the first-order signed distance to the skin, negative inside [m], shape (n,)."""
    return _distance_and_gradient(_segments(skeleton), points)[0]


def bone_distance(points: Float, bones: list[Bone]) -> Float:
    """Return the distance to the nearest bone surface [m], shape (n,); negative inside a bone."""
    return capsule_distance(points, [(b.start, b.end, b.radius_start_m, b.radius_end_m) for b in bones])


def capsule_distance(points: Float, capsules: Iterable[tuple[Float, Float, float, float]]) -> Float:
    """Return the distance to the nearest of some tapered capsules [m], shape (n,); negative inside.

    capsules: start and end of the axis [m], shape (3,), and the radius at each [m]
    """
    best = np.full(len(points), np.inf)
    for start, end, radius_start, radius_end in capsules:
        axis = end - start
        t = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
        radius = radius_start + t * (radius_end - radius_start)
        best = np.minimum(best, np.linalg.norm(points - start - t[:, None] * axis, axis=1) - radius)
    return best


def _segments(skeleton: Skeleton) -> wp.array:
    records: Any = np.zeros(len(skeleton.skin), dtype=SEGMENT_RECORD)
    for name in ("start", "end", "semi_start", "semi_end", "dorsal", "group"):
        records[name] = [getattr(s, name) for s in skeleton.skin]
    records["blend"] = [s.blend_m for s in skeleton.skin]
    return wp.array(records, dtype=kernels.Segment, device=resolve("cpu"))


def _distance_and_gradient(segments: wp.array, points: Float) -> tuple[Float, Float]:
    at: wp.array = wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu")
    distance = wp.empty(len(points), dtype=wp.float32, device="cpu")
    gradient = wp.empty(len(points), dtype=wp.vec3, device="cpu")
    blends = [THUMB_BLEND_m, FINGER_BLEND_m, BETWEEN_FINGERS_BLEND_m]
    run_kernel(
        kernels.hand_distance_at_points,
        dim=len(points),
        inputs=[segments, *blends, at, GRADIENT_STEP_m],
        outputs=[distance, gradient],
        device="cpu",
    )
    return distance.numpy().astype(np.float64), gradient.numpy().astype(np.float64)


def _check_gaps(skeleton: Skeleton) -> None:
    """Raise SceneError if skins of digits overlap beyond the webs, where the smooth union would fuse them."""
    free = [s for s in skeleton.skin if s.name.endswith(("_middle", "_distal"))]
    share = np.linspace(0.0, 1.0, 21)[:, None]
    for a, b in combinations(free, 2):
        if a.group == b.group:
            continue
        difference = (a.start + share * (a.end - a.start))[:, None] - (b.start + share * (b.end - b.start))[None]
        across = [s.semi_start[0] + share * (s.semi_end[0] - s.semi_start[0]) for s in (a, b)]
        gap = float((np.linalg.norm(difference, axis=2) - across[0] - across[1].T).min())
        if gap < BETWEEN_FINGERS_BLEND_m:
            raise SceneError(
                f"hand preset: digits touch, {a.name} and {b.name} have a gap of {1e3 * gap:.1f} mm and "
                f"{1e3 * BETWEEN_FINGERS_BLEND_m:g} mm are needed; spread them more or make them thinner"
            )


def _generate(skeleton: Skeleton, edge_m: float) -> cache.Arrays:
    """Return vertices and faces of the relaxed mesh."""
    import trimesh
    from warp.geometry import IsoSurfaceMarchingCubes

    cubes = wp.get_module("warp.geometry.marching_cubes")
    cubes.options |= EXACT  # for whose flags Warp has parsed its headers
    segments = _segments(skeleton)
    step = edge_m / EDGE_PER_VOXEL
    ends = np.array([end for s in skeleton.skin for end in (s.start, s.end)])
    widest = max(float(max(s.semi_start.max(), s.semi_end.max())) for s in skeleton.skin)
    # Off any plane of symmetry, so that no grid plane is on a flat part of the surface.
    lower = ends.min(axis=0) - widest - step * np.array([2.31, 2.47, 2.59])
    shape = np.ceil((ends.max(axis=0) + widest + 3.0 * step - lower) / step).astype(int)
    field: Any = wp.empty(tuple(shape.tolist()), dtype=wp.float32, device="cpu")
    blends = [THUMB_BLEND_m, FINGER_BLEND_m, BETWEEN_FINGERS_BLEND_m]
    run_kernel(
        kernels.hand_distance_on_grid,
        dim=field.shape,
        inputs=[segments, *blends, wp.vec3(*lower), step],
        outputs=[field],
        device="cpu",
    )
    upper = lower + step * (shape - 1)
    load_kernels(cubes, "cpu")
    points, indices = IsoSurfaceMarchingCubes.extract(field, 0.0, lower=wp.vec3(*lower), upper=wp.vec3(*upper))
    vertices = points.numpy().astype(np.float64)
    faces = indices.numpy().reshape(-1, 3).astype(np.int32)
    vertices = _relax(segments, vertices, faces, rounds=12)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if not mesh.is_watertight or mesh.euler_number != 2:
        raise SceneError(
            f"hand preset gives a skin with Euler number {mesh.euler_number} and not 2: digits touch; "
            "spread them more, make them thinner, or use a smaller edge length"
        )
    if mesh.volume < 0.0:
        mesh.invert()
    return {"vertices": mesh.vertices.astype(np.float32), "faces": mesh.faces.astype(np.int32)}


def _relax(segments: wp.array, vertices: Float, faces: Int, rounds: int) -> Float:
    """Smooth vertices tangentially, and project them back onto the zero level after each round."""
    links = adjacency(faces, len(vertices))
    for _ in range(rounds):
        move = neighbour_mean(vertices, links) - vertices
        _, gradient = _distance_and_gradient(segments, vertices)
        normal = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        move -= np.einsum("ij,ij->i", move, normal)[:, None] * normal
        vertices = _project(segments, vertices + 0.6 * move)
    return _project(segments, vertices)


def _project(segments: wp.array, points: Float) -> Float:
    for _ in range(2):
        distance, gradient = _distance_and_gradient(segments, points)
        squared = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 0.25)
        points = points - (distance / squared)[:, None] * gradient
    return points
