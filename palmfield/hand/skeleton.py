"""Bones and skin capsules of a hand preset, posed, in the hand frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from palmfield.hand.preset import DIGITS, Digit, HandPreset
from palmfield.types import Float

Palm = Callable[[str, ArrayLike, ArrayLike, ArrayLike, ArrayLike], None]
MIRROR = np.array([-1.0, 1.0, 1.0])
"""Mirror from a right hand to a left one."""
PALM, THUMB = 0, 1
PALM_BLEND_m, JOINT_BLEND_m = 0.011, 0.003
THUMB_BLEND_m, FINGER_BLEND_m, BETWEEN_FINGERS_BLEND_m = 0.012, 0.008, 0.0025


@dataclass(frozen=True)
class SkinSegment:
    """A tapered capsule of skin about an axis.

    start, end: [m], shape (3,); dorsal: unit vector across the axis, shape (3,)
    semi_start, semi_end: half-widths at the ends, lateral, dorsal, palmar [m], shape (3,)
    group: 0 palm, 1 thumb, 2..5 index to little finger; blend_m: radius of its union with its group [m]
    """

    name: str
    start: Float
    end: Float
    semi_start: Float
    semi_end: Float
    dorsal: Float
    group: int
    blend_m: float


@dataclass(frozen=True)
class Bone:
    """A bone as a tapered capsule: axis [m], shape (3,) each, and the radius at its ends [m]."""

    name: str
    start: Float
    end: Float
    radius_start_m: float
    radius_end_m: float


@dataclass(frozen=True)
class Skeleton:
    """Bones, skin capsules and landmarks: the input of the surface, the depth to bone and the MJCF model."""

    skin: list[SkinSegment]
    bones: list[Bone]
    landmarks: dict[str, Float]


def build_skeleton(preset: HandPreset) -> Skeleton:
    """Return the posed bones, skin capsules and landmarks of a preset.

    Axes are those of the hand frame. The height of the origin is that of the middle metacarpal; `centred_skeleton`
    moves everything along z so that the palmar skin passes through the origin.
    """
    wrist_y = -0.5 * preset.palm_length_m
    wide = preset.breadth_m / 0.0883
    long = preset.palm_length_m / 0.1165
    thick = preset.thickness_m / 0.033
    scale = np.array([wide, long, thick])

    knuckles, bases = _knuckles(preset, wrist_y)
    skin: list[SkinSegment] = []
    bones: list[Bone] = []
    landmarks = {"palm_centre": np.zeros(3), "wrist": np.array([0.0, wrist_y, 0.0])}

    def palm(name: str, start: ArrayLike, end: ArrayLike, semi_start: ArrayLike, semi_end: ArrayLike) -> None:
        a, b = np.asarray(start, float), np.asarray(end, float)
        semi = np.asarray(semi_start, float), np.asarray(semi_end, float)
        dorsal = _across(np.array([0.0, 0.0, 1.0]), b - a)
        skin.append(SkinSegment(name, a, b, *semi, dorsal, PALM, PALM_BLEND_m * wide))

    def from_wrist(x_mm: float, y_mm: float, z_mm: float) -> Float:
        return np.array([0.0, wrist_y, 0.0]) + 1e-3 * scale * np.array([x_mm, y_mm, z_mm])

    def mm(lateral: float, dorsal: float, palmar: float, along: float = wide) -> Float:
        return 1e-3 * np.array([lateral * along, dorsal * thick, palmar * thick])

    # The wrist ends in a rounded stump, because a flat cut on a grid plane gives degenerate triangles.
    half_wrist = preset.wrist_circumference_m / 5.65
    stump = np.array([half_wrist, 0.68 * half_wrist, 0.82 * half_wrist])
    palm("forearm", from_wrist(0, -2, -3), from_wrist(0, 12, -3), stump, stump)
    palm("carpus", from_wrist(0, 16, -3), from_wrist(0, 38, -2), mm(29, 13, 19), mm(29, 12, 17))
    # The flesh between the metacarpals: without it they would show as ridges.
    palm("palm_body", from_wrist(0, 42, -2), from_wrist(2, 84, -1), mm(30, 9, 16.5), mm(31, 8, 16))
    for name in DIGITS[1:]:
        head = 0.5 * preset.digits[name].breadth_m[0]
        semi_head = np.array([0.95 * head, 8.0e-3 * thick, 11.5e-3 * thick])
        palm(f"{name}_metacarpal", bases[name], knuckles[name], mm(9.5, 11.0, 14.0), semi_head)
    _pads(preset, knuckles, palm, from_wrist, mm, long)
    for part in skin:
        if part.name in ("thenar", "hypothenar"):
            palmar = 0.5 * (part.semi_start[2] + part.semi_end[2])
            landmarks[part.name] = 0.5 * (part.start + part.end) - palmar * part.dorsal

    for number, name in enumerate(DIGITS):
        _digit(preset, name, number + THUMB, bases[name], knuckles.get(name), skin, bones, landmarks)
    _web_of_thumb(skin, palm, bases, knuckles, mm)
    _carpal_bones(from_wrist, wide, bones)
    skin.sort(key=lambda s: s.group)
    skeleton = Skeleton(skin, bones, landmarks)
    return skeleton if preset.side == "right" else _reflected(skeleton)


def _reflected(skeleton: Skeleton) -> Skeleton:
    """Return the other hand, with x reversed."""
    return Skeleton(
        [replace(s, start=MIRROR * s.start, end=MIRROR * s.end, dorsal=MIRROR * s.dorsal) for s in skeleton.skin],
        [replace(b, start=MIRROR * b.start, end=MIRROR * b.end) for b in skeleton.bones],
        {name: MIRROR * position for name, position in skeleton.landmarks.items()},
    )


def _knuckles(preset: HandPreset, wrist_y: float) -> tuple[dict[str, Float], dict[str, Float]]:
    """Return metacarpal heads and bases; breadth sets the heads across the hand, length the middle one along it."""
    digits = preset.digits
    index, little = digits["index"], digits["little"]
    # Between two equal parts, a smooth union of radius k adds k / 4 to either side; the palm adds slightly more.
    bulge = 0.30 * FINGER_BLEND_m
    first = bulge - 0.5 * (preset.breadth_m - index.breadth_m[0])
    last = 0.5 * (preset.breadth_m - little.breadth_m[0]) - bulge
    across = dict(zip(DIGITS[1:], first + (last - first) * np.array([0.0, 0.335, 0.66, 1.0]), strict=True))
    middle = digits["middle"]
    middle_y = wrist_y + preset.length_m - sum(middle.bones_m[1:]) - middle.tip_m
    base_x = {name: 0.5 * x for name, x in across.items()}

    def run(name: str) -> float:
        return float(np.sqrt(digits[name].bones_m[0] ** 2 - (across[name] - base_x[name]) ** 2))

    base_middle_y = middle_y - run("middle")
    knuckles, bases = {}, {}
    for name in DIGITS[1:]:
        y = base_middle_y + digits[name].base_y_m
        bases[name] = np.array([base_x[name], y, -0.4 * digits[name].arch_m])
        knuckles[name] = np.array([across[name], y + run(name), -digits[name].arch_m])
    thumb = digits["thumb"]
    bases["thumb"] = np.array([first * 0.62, base_middle_y + thumb.base_y_m, -thumb.arch_m])
    return knuckles, bases


def _pads(
    preset: HandPreset,
    knuckles: dict[str, Float],
    palm: Palm,
    from_wrist: Callable[[float, float, float], Float],
    mm: Callable[..., Float],
    long: float,
) -> None:
    """Add the thenar, hypothenar and distal pads, and the webs between the fingers."""
    palm("thenar", from_wrist(-17, 17, -10), from_wrist(-31, 45, -11), mm(13, 10, 15.5), mm(13.5, 10, 15))
    palm("hypothenar", from_wrist(24, 15, -9), from_wrist(29, 62, -8), mm(13, 10, 13.5), mm(12.5, 10, 13.5))
    for a, b in pairwise(DIGITS[1:]):
        ends = [knuckles[d] + np.array([0.0, -0.001, -0.0088 * preset.thickness_m / 0.033]) for d in (a, b)]
        inset = 0.15 * (ends[1] - ends[0])
        palm(f"{a}_{b}_pad", ends[0] + inset, ends[1] - inset, mm(11.5, 8, 7.2, long), mm(11.5, 8, 7.2, long))
    # The free edges of the webs are at the end of the palm.
    web_y = 0.5 * preset.palm_length_m - 0.006 * long
    for a, b in pairwise(DIGITS[1:]):
        ends = []
        for name, sign in ((a, 0.35), (b, -0.35)):
            digit = preset.digits[name]
            out = max(web_y - knuckles["middle"][1], 0.004)
            spread = np.deg2rad(digit.spread_deg)
            ends.append(
                knuckles[name]
                + out * np.array([np.sin(spread), np.cos(spread), -0.25])
                + np.array([sign * digit.breadth_m[0], 0.0, -0.001])
            )
        palm(f"{a}_{b}_web", ends[0], ends[1], mm(5.5, 4.5, 7.0, long), mm(5.5, 4.5, 7.0, long))


def _web_of_thumb(
    skin: list[SkinSegment], palm: Palm, bases: dict[str, Float], knuckles: dict[str, Float], mm: Callable[..., Float]
) -> None:
    thumb = next(s for s in skin if s.name == "thumb_metacarpal")
    start = thumb.start + 0.72 * (thumb.end - thumb.start)
    end = bases["index"] + 0.74 * (knuckles["index"] - bases["index"])
    palm("thumb_web", start, end + np.array([0.0, 0.0, -0.004]), mm(9, 5.5, 7), mm(12, 7, 9))


def _digit(
    preset: HandPreset,
    name: str,
    group: int,
    base: Float,
    knuckle: Float | None,
    skin: list[SkinSegment],
    bones: list[Bone],
    landmarks: dict[str, Float],
) -> None:
    """Add the chain of one digit; a finger starts at its knuckle, the thumb at its metacarpal base."""
    digit: Digit = preset.digits[name]
    spread, palmar, twist = np.deg2rad([digit.spread_deg, digit.palmar_deg, digit.twist_deg])
    along = np.array([np.cos(palmar) * np.sin(spread), np.cos(palmar) * np.cos(spread), -np.sin(palmar)])
    dorsal = _across(np.array([0.0, 0.0, 1.0]), along)
    # Positive twist turns the nail to the radial side, -x on a right hand.
    dorsal = np.cos(twist) * dorsal + np.sin(twist) * np.cross(dorsal, along)
    size = digit.breadth_m[0] / 0.0215
    if knuckle is None:
        knuckle = base + digit.bones_m[0] * along
        semi = _semi(preset, digit.breadth_m[0]) * np.array([1.0, 1.0, 1.1])
        skin.append(SkinSegment(f"{name}_metacarpal", base, knuckle, semi, semi, dorsal, group, JOINT_BLEND_m))
    bones.append(Bone(f"{name}_metacarpal", base, knuckle, 0.0050 * size, 0.0052 * size))
    landmarks[f"{name}_knuckle"] = knuckle

    start = knuckle
    phalanges = digit.bones_m[1:]
    radii = {3: (0.0052, 0.0044, 0.0038, 0.0026), 2: (0.0052, 0.0042, 0.0028)}[len(phalanges)]
    for i, (length, bend) in enumerate(zip(phalanges, np.deg2rad(digit.flexion_deg), strict=True)):
        along, dorsal = np.cos(bend) * along - np.sin(bend) * dorsal, np.cos(bend) * dorsal + np.sin(bend) * along
        label = f"{name}_{('proximal', 'middle', 'distal')[i] if len(phalanges) == 3 else ('proximal', 'distal')[i]}"
        end = start + length * along
        semi_start, semi_end = _semi(preset, digit.breadth_m[i]), _semi(preset, digit.breadth_m[i + 1])
        skin_end = end
        if i == len(phalanges) - 1:
            skin_end = end + (digit.tip_m - semi_end[0]) * along
            landmarks[f"{name}_tip"] = end + digit.tip_m * along
            landmarks[f"{name}_pad"] = skin_end - 0.25 * length * along - semi_end[2] * dorsal
        skin.append(SkinSegment(label, start, skin_end, semi_start, semi_end, dorsal, group, JOINT_BLEND_m))
        # The round end of the last bone, not the end of its axis, is where the soft tip begins.
        bone_end = end - radii[-1] * size * along if i == len(phalanges) - 1 else end
        bones.append(Bone(label, start, bone_end, radii[i] * size, radii[i + 1] * size))
        start = end


def _semi(preset: HandPreset, breadth: float) -> Float:
    """Return the half-widths of a digit; the back is flatter than the palmar side."""
    depth = preset.finger_depth_ratio * breadth
    return np.array([0.5 * breadth, 0.46 * depth, 0.54 * depth])


def _carpal_bones(from_wrist: Callable[[float, float, float], Float], wide: float, bones: list[Bone]) -> None:
    bones.append(Bone("carpus_distal", from_wrist(-14, 28, 0), from_wrist(15, 28, -1), 0.008 * wide, 0.007 * wide))
    bones.append(Bone("carpus_proximal", from_wrist(-14, 14, -1), from_wrist(15, 14, -1), 0.008 * wide, 0.007 * wide))
    bones.append(Bone("radius", from_wrist(-12, -18, -2), from_wrist(-10, 3, -2), 0.009 * wide, 0.010 * wide))
    bones.append(Bone("ulna", from_wrist(15, -18, -1), from_wrist(14, 1, -1), 0.007 * wide, 0.007 * wide))


def _across(vector: Float, axis: Float) -> Float:
    """Return the component of `vector` normal to `axis`, at unit length."""
    along = unit(axis)
    return unit(vector - (vector @ along) * along)


def unit(vector: Float) -> Float:
    """Return the vector at length 1, shape (3,)."""
    return vector / np.linalg.norm(vector)
