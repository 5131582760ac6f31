"""Poses of an articulated hand, by name and by joint angles, and their skin, checked."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy  # which loads its parts when they are used

from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand, bone_poses, posed_landmark, poses_at
from palmfield.hand.preset import DIGITS
from palmfield.hand.selfcross import crossings
from palmfield.hand.skeleton import SkinSegment
from palmfield.hand.skinning import SkinnedHand
from palmfield.hand.triangles import adjacency, neighbour_mean, vertex_normals
from palmfield.types import Float, Int, Surface

POSE_NAMES = ("flat", "relaxed", "splay", "point", "pinch")
SPLAY_deg = {"index_mcp_abduction": 10.0, "ring_mcp_abduction": 7.0, "little_mcp_abduction": 12.0}
CURL_deg = {"mcp_flexion": 48.0, "pip_flexion": 75.0, "dip_flexion": 25.0}
"""Flexion of curled fingers: the largest without self-intersection of the palmar skin at the knuckles."""
PINCH_GAP_m = 0.002
"""Gap between the pulps of thumb and index finger, because skins in contact would intersect."""
REPAIR_ROUNDS = 40
MOST_REPAIR_m = 0.005


def named_pose(hand: ArticulatedHand, name: str) -> dict[str, float]:
    """Return the angles of all joints [deg] for one of POSE_NAMES.

    flat: straight fingers; relaxed: pose of the preset; splay: flat with fingers spread; point: index finger straight,
    others curled; pinch: pulps of thumb and index finger opposite at a gap of about PINCH_GAP_m. The skins of the
    presets do not intersect themselves in these poses, except the webs of large hands in `point`, which can be
    repaired. Raises SceneError for an unknown name.
    """
    rest = {joint.name: joint.rest_deg for joint in hand.joints}
    flat = dict.fromkeys(rest, 0.0)
    if name == "flat":
        return flat
    if name == "relaxed":
        return rest
    if name == "splay":
        return flat | SPLAY_deg
    if name == "point":
        curled = {f"{digit}_{joint}": a for digit in DIGITS[2:] for joint, a in CURL_deg.items()}
        straight = {f"index_{joint}": 0.0 for joint in CURL_deg}
        return rest | curled | straight
    if name == "pinch":
        return _pinch(hand, rest)
    raise SceneError(f"hand pose '{name}' is unknown; use one of: {', '.join(POSE_NAMES)}")


def _pinch(hand: ArticulatedHand, rest: dict[str, float]) -> dict[str, float]:
    """Return the angles that bring the pulps together with the least bending."""
    moving = [
        n
        for n, joint in enumerate(hand.joints)
        if joint.name.startswith("thumb_") or (joint.name.startswith("index_") and joint.name.endswith("flexion"))
    ]
    low = np.array([hand.joints[n].low_deg for n in moving])
    high = np.array([hand.joints[n].high_deg for n in moving])
    start = np.array([rest[hand.joints[n].name] for n in moving])
    parts = {segment.name: segment for segment in hand.skeleton.skin}
    joints = {joint.name: joint for joint in hand.joints}
    tips = {}
    for digit, last in (("thumb", "ip"), ("index", "dip")):
        part, flexion = parts[f"{digit}_distal"], joints[f"{digit}_{last}_flexion"]
        palmar = np.cross(flexion.axis, part.end - part.start)
        tips[digit] = flexion.bone, palmar / np.linalg.norm(palmar)
    angles = np.array([joint.rest_deg for joint in hand.joints])
    capsules = {
        digit: [(hand.bone(f"{digit}_{name}"), parts[f"{digit}_{name}"]) for name in names]
        for digit, names in (("thumb", ("proximal", "distal")), ("index", ("proximal", "middle", "distal")))
    }

    def residuals(x: Float) -> Float:
        angles[moving] = x
        positions, rotations = poses_at(hand, angles)
        thumb, index = (posed_landmark(hand, f"{digit}_pad", positions, rotations) for digit in tips)
        out_thumb, out_index = (rotations[bone] @ palmar for bone, palmar in tips.values())
        to_index = np.linalg.norm(index - thumb) - PINCH_GAP_m
        lines = {
            digit: [(_line(hand, bone, part, positions, rotations), part) for bone, part in chain]
            for digit, chain in capsules.items()
        }
        overlaps = [
            max(0.0, a.semi_end[0] + b.semi_end[0] + PINCH_GAP_m - _nearest(line_a, line_b))
            for line_a, a in lines["thumb"]
            for line_b, b in lines["index"]
        ]
        # An error of 1 mm has the weight of 0.5 mm of overlap, 1/3 rad between the pulps and 50 degrees of bending.
        return np.concatenate(
            [[1e3 * to_index], 2e3 * np.array(overlaps), 3.0 * (out_thumb + out_index), 0.02 * (x - start)]
        )

    # The start is in the middle of the ranges, because the method needs a start inside the bounds.
    solution = scipy.optimize.least_squares(residuals, 0.7 * start + 0.15 * (low + high), bounds=(low, high)).x
    return rest | {hand.joints[n].name: float(a) for n, a in zip(moving, solution, strict=True)}


def _line(hand: ArticulatedHand, bone: int, part: SkinSegment, positions: Float, rotations: Float) -> Float:
    """Return points along the posed axis of a part [m], shape (n, 3)."""
    share = np.linspace(0.0, 1.0, 9)[:, None]
    rest = part.start + share * (part.end - part.start) - hand.bones[bone].origin
    return rest @ rotations[bone].T + positions[bone]


def _nearest(a: Float, b: Float) -> float:
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


@dataclass(frozen=True)
class Repair:
    """Report on the repair of a posed skin that intersected itself.

    crossings: number of intersecting pairs of faces; places: number of them for each pair of parts
    moved: number of moved vertices; largest_m: largest displacement [m]
    """

    crossings: int
    places: dict[str, int]
    moved: int
    largest_m: float


def posed_surface(hand: SkinnedHand, angles_deg: Mapping[str, float], repair_m: float = 0.0) -> Surface:
    """Return the skin in a pose, in the frame of the hand at rest; the forearm is fixed.

    repair_m: largest displacement of vertices [m] to remove self-intersections; `posed_and_repaired` reports it
    Raises SceneError like `checked_angles`, and with parts and places if the skin still intersects itself.
    """
    return posed_and_repaired(hand, angles_deg, repair_m)[0]


def posed_and_repaired(
    hand: SkinnedHand, angles_deg: Mapping[str, float], repair_m: float
) -> tuple[Surface, Repair | None]:
    """Return the skin like `posed_surface`, and a report of the repair, None if no repair was needed."""
    if not 0.0 <= repair_m <= MOST_REPAIR_m:
        raise SceneError(
            f"hand pose: repair_m is {repair_m:g}; allowed: 0 to {MOST_REPAIR_m:g} m, because larger values change "
            "the hand"
        )
    surface = hand.posed_surface(*bone_poses(hand.hand, angles_deg))
    pairs = crossings(surface.vertices, surface.faces)
    if len(pairs) == 0:
        return surface, None
    vertices = _pushed_apart(surface, pairs, repair_m) if repair_m > 0.0 else surface.vertices
    crossed = crossings(vertices, surface.faces)
    if len(crossed):
        tried = f" even with repairs of up to {1e3 * repair_m:g} mm" if repair_m > 0.0 else ""
        raise SceneError(
            f"hand pose: the skin intersects itself{tried}: {_described(hand, surface, crossed)}; bend these joints "
            "less" + ("" if repair_m > 0.0 else ", or allow a repair (repair_m)")
        )
    moves = np.linalg.norm(vertices - surface.vertices, axis=1)
    places = {parts: len(numbers) for parts, numbers in _places(hand, pairs).items()}
    report = Repair(len(pairs), places, int(np.count_nonzero(moves)), float(moves.max()))
    return Surface(vertices, surface.faces, vertex_normals(vertices, surface.faces)), report


def _pushed_apart(surface: Surface, pairs: Int, repair_m: float) -> Float:
    """Move vertices around intersecting faces inwards and smooth them, by at most `repair_m`, until none intersect."""
    start = surface.vertices
    links = adjacency(surface.faces, len(start))
    vertices = start.copy()
    chosen = np.zeros(len(start))
    step = 0.15 * repair_m
    for _ in range(REPAIR_ROUNDS):
        chosen[surface.faces[pairs].ravel()] = 1.0
        near = (chosen + links @ chosen) > 0.0
        inwards = -vertex_normals(vertices, surface.faces)
        smoother = neighbour_mean(vertices, links) - vertices
        vertices[near] += 0.5 * smoother[near] + step * chosen[near, None] * inwards[near]
        move = vertices - start
        length = np.linalg.norm(move, axis=1, keepdims=True)
        vertices = start + move * np.minimum(1.0, repair_m / np.maximum(length, 1e-12))
        pairs = crossings(vertices, surface.faces)
        if len(pairs) == 0:
            break
    return vertices


def _places(hand: SkinnedHand, pairs: Int) -> dict[str, list[int]]:
    """Return the numbers of intersecting pairs by parts of the hand, the parts with most pairs first."""
    owner = hand.dominant_bone()[hand.surface.faces[:, 0]]
    names = [bone.name for bone in hand.hand.bones]
    places: dict[str, list[int]] = {}
    for number, (a, b) in enumerate(pairs):
        places.setdefault(" and ".join(sorted({names[owner[a]], names[owner[b]]})), []).append(number)
    return dict(sorted(places.items(), key=lambda place: -len(place[1])))


def _described(hand: SkinnedHand, surface: Surface, pairs: Int) -> str:
    descriptions = []
    places = _places(hand, pairs)
    for parts, numbers in list(places.items())[:3]:
        x, y, z = 1e3 * surface.vertices[surface.faces[pairs[numbers]]].mean(axis=(0, 1, 2))
        descriptions.append(f"{parts} in {len(numbers)} places about ({x:.0f}, {y:.0f}, {z:.0f}) mm")
    more = f" and {len(places) - 3} more pairs of parts" if len(places) > 3 else ""
    return "; ".join(descriptions) + more
