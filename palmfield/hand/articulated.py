"""A hand preset as a tree of bones with joints: its geometry, its poses, and its MJCF."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.mjcf import HEIGHT_m, numbers_text, skin_geom
from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.skeleton import Skeleton, SkinSegment, unit
from palmfield.hand.surface import centred_skeleton
from palmfield.types import Float

RANGES_deg = {
    "wrist_flexion": (-70.0, 75.0),
    "wrist_deviation": (-20.0, 35.0),
    "mcp_abduction": (-20.0, 20.0),
    "mcp_flexion": (-45.0, 90.0),
    "pip_flexion": (0.0, 100.0),
    "dip_flexion": (0.0, 85.0),
    "thumb_cmc_flexion": (-20.0, 15.0),
    "thumb_mp_flexion": (0.0, 55.0),
    "thumb_ip_flexion": (-15.0, 80.0),
}
"""Active range of motion of adults [deg], typical values of clinical goniometry (from memory, to be checked);
negative flexion is extension, negative deviation is radial."""
THUMB_ABDUCTION_deg = 60.0
"""Palmar abduction of the thumb out of the plane of the palm, at most; tables give 45 to 70."""

STIFFNESS_N_m = {"wrist": 10.0, "cmc": 0.8, "mcp": 0.5, "mp": 0.5, "pip": 0.3, "ip": 0.3, "dip": 0.2}
"""Stiffness of the position servos by joint [N m / rad]: 10 mN on a fingertip, which is what an array can push with,
bends a finger by less than 0.3 mm, and no joint alone swings faster than 30 Hz."""
ARMATURE_kg_m2 = 1e-5
"""Added to each joint's inertia, about that of a whole finger: end joints of 5 g would swing within a step."""
WELD_TIME_s = 0.01
DIGITS_IN_FILE = 9
"""Rounding adds up along a chain of bodies: to the nanometre, no fingertip is off by more than a few."""
CONTACT_PARTS = ("forearm", "thenar", "hypothenar")


@dataclass(frozen=True)
class HandBone:
    """A moving part. parent: its index among the bones, -1 for the root; origin: of its frame in the rest pose [m]."""

    name: str
    parent: int
    origin: Float


@dataclass(frozen=True)
class HandJoint:
    """A hinge that moves `bone` against its parent.

    pivot: a point on the axis [m], axis: unit vector, both in the hand frame in the rest pose
    rest_deg: angle of the rest pose; low_deg, high_deg: range
    """

    name: str
    bone: int
    pivot: Float
    axis: Float
    rest_deg: float
    low_deg: float
    high_deg: float


@dataclass(frozen=True)
class ArticulatedHand:
    """Bones from root to tips, every parent before its children, and their joints, the outer one of two first.

    In the rest pose, which is the preset's own, all bone frames are parallel to the hand frame.
    """

    preset: HandPreset
    skeleton: Skeleton
    bones: list[HandBone]
    joints: list[HandJoint]

    def bone(self, name: str) -> int:
        """Index of a bone."""
        return [bone.name for bone in self.bones].index(name)

    @cached_property
    def origins(self) -> Float:
        """Of the bones in the rest pose [m], shape (bones, 3)."""
        return np.array([bone.origin for bone in self.bones])

    @cached_property
    def pivots(self) -> Float:
        """Of the joints in the rest pose [m], shape (joints, 3)."""
        return np.array([joint.pivot for joint in self.joints])

    @cached_property
    def axes(self) -> Float:
        """Of the joints in the rest pose, shape (joints, 3)."""
        return np.array([joint.axis for joint in self.joints])

    @cached_property
    def rest_deg(self) -> Float:
        """Angles of the joints in the rest pose [deg], shape (joints,)."""
        return np.array([joint.rest_deg for joint in self.joints])

    @cached_property
    def turns_from(self) -> list[tuple[int, int]]:
        """Of each joint its bone, and the bone whose frame it turns from: the bone itself for the second of two."""
        seen: set[int] = set()
        pairs = []
        for joint in self.joints:
            pairs.append((joint.bone, joint.bone if joint.bone in seen else self.bones[joint.bone].parent))
            seen.add(joint.bone)
        return pairs


def articulate(preset: HandPreset) -> ArticulatedHand:
    """Bones and joints of a preset: forearm, hand, and three bones to each digit; 2 wrist and 20 finger joints.

    Angles are anatomical: 0 is the flat hand with straight fingers, flexion is positive to the palm. Fingers' abduction
    counts from the preset's own direction, positive away from the middle finger, the middle one's to the little finger;
    so do both angles of the thumb's saddle joint, whose abduction is positive out of the palm. Wrist deviation is
    positive to the little finger. Two joints of one place act as a universal joint, abduction outside.
    """
    skeleton = centred_skeleton(preset)
    ulnar = np.array([1.0 if preset.side == "right" else -1.0, 0.0, 0.0])
    along, dorsal = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    zero = np.zeros(3)
    bones = [HandBone("forearm", -1, zero), HandBone("hand", 0, zero)]
    wrist = skeleton.landmarks["wrist"]
    joints = [
        HandJoint("wrist_flexion", 1, wrist, np.cross(dorsal, along), 0.0, *RANGES_deg["wrist_flexion"]),
        HandJoint("wrist_deviation", 1, wrist, np.cross(along, ulnar), 0.0, *RANGES_deg["wrist_deviation"]),
    ]
    skin = {segment.name: segment for segment in skeleton.skin}
    for digit in DIGITS:
        thumb = digit == "thumb"
        names = ("metacarpal", "proximal", "distal") if thumb else ("proximal", "middle", "distal")
        places = ("cmc", "mp", "ip") if thumb else ("mcp", "pip", "dip")
        bends = (0.0, *preset.digits[digit].flexion_deg) if thumb else preset.digits[digit].flexion_deg
        for level, (name, place, bend) in enumerate(zip(names, places, bends, strict=True)):
            part = skin[f"{digit}_{name}"]
            axis = unit(part.end - part.start)
            parent = 1 if level == 0 else len(bones) - 1
            bones.append(HandBone(part.name, parent, part.start))
            bone = len(bones) - 1
            turn = unit(np.cross(part.dorsal, axis))
            if level == 0:
                # The outer joint belongs to the straight digit: undo the rest pose's flexion.
                straight = Rotation.from_rotvec(-np.deg2rad(bend) * turn).apply(axis)
                joints.append(_abduction(preset, digit, bone, part.start, straight, turn, ulnar))
            kind = f"{place}_flexion"
            low, high = RANGES_deg[f"thumb_{kind}" if thumb else kind]
            joints.append(HandJoint(f"{digit}_{kind}", bone, part.start, turn, bend, low, high))
    return ArticulatedHand(preset, skeleton, bones, joints)


def _abduction(
    preset: HandPreset, digit: str, bone: int, pivot: Float, along: Float, flexion_axis: Float, ulnar: Float
) -> HandJoint:
    """Joint about the digit's own dorsal direction."""
    palmar = np.array([0.0, 0.0, -1.0])
    if digit == "thumb":
        aside, place = palmar, "cmc"
        inside = preset.digits["thumb"].palmar_deg
        low, high = -inside, THUMB_ABDUCTION_deg - inside
    else:
        aside, place = (-ulnar if digit == "index" else ulnar), "mcp"
        low, high = RANGES_deg["mcp_abduction"]
    sideways = flexion_axis * np.sign(flexion_axis @ aside)
    return HandJoint(f"{digit}_{place}_abduction", bone, pivot, unit(np.cross(along, sideways)), 0.0, low, high)


def checked_angles(hand: ArticulatedHand, angles_deg: Mapping[str, float]) -> Float:
    """Angle of every joint [deg], shape (joints,), in the hand's order; joints that are not named stay at rest.

    Raises SceneError for an unknown joint and for an angle that is not a number or outside its range.
    """
    known = {joint.name: joint for joint in hand.joints}
    for name, angle in angles_deg.items():
        if name not in known:
            raise SceneError(f"hand pose: joint '{name}' is unknown; use some of: {', '.join(known)}")
        joint = known[name]
        # Rounding in interpolation and servo models may leave a range by a hair.
        if not joint.low_deg - 1e-6 <= angle <= joint.high_deg + 1e-6:
            raise SceneError(
                f"hand pose: {name} is {angle:g} degrees; use {joint.low_deg:g} to {joint.high_deg:g} degrees"
            )
    return np.array([float(angles_deg.get(joint.name, joint.rest_deg)) for joint in hand.joints])


def bone_poses(hand: ArticulatedHand, angles_deg: Mapping[str, float]) -> tuple[Float, Float]:
    """Origins [m], shape (bones, 3), and rotations, shape (bones, 3, 3), of all bones in the root's frame.

    The root, the forearm, stays where it is in the rest pose. Raises SceneError as `checked_angles`.
    """
    return poses_at(hand, checked_angles(hand, angles_deg))


def poses_at(hand: ArticulatedHand, angles_deg: Float) -> tuple[Float, Float]:
    """`bone_poses` for angles [deg] in the order of the joints, shape (joints,), whatever their range."""
    turns = np.zeros((len(hand.joints), 4, 4))
    turns[:, :3, :3] = Rotation.from_rotvec(np.deg2rad(angles_deg - hand.rest_deg)[:, None] * hand.axes).as_matrix()
    turns[:, :3, 3] = hand.pivots - np.einsum("jab,jb->ja", turns[:, :3, :3], hand.pivots)
    turns[:, 3, 3] = 1.0
    # A point x of the rest pose comes to moved[b] @ (x, 1)
    moved = np.tile(np.eye(4), (len(hand.bones), 1, 1))
    for (bone, before), turn in zip(hand.turns_from, turns, strict=True):
        moved[bone] = moved[before] @ turn
    rotations = moved[:, :3, :3]
    return np.einsum("bij,bj->bi", rotations, hand.origins) + moved[:, :3, 3], rotations


def posed_landmark(hand: ArticulatedHand, name: str, positions: Float, rotations: Float) -> Float:
    """Where a landmark of the skeleton is when the bones are at `positions` and `rotations` [m], shape (3,)."""
    bone = _bone_of_landmark(hand, name)
    return positions[bone] + rotations[bone] @ (hand.skeleton.landmarks[name] - hand.bones[bone].origin)


def _bone_of_landmark(hand: ArticulatedHand, name: str) -> int:
    digit, _, place = name.partition("_")
    return hand.bone(f"{digit}_distal") if place in ("tip", "pad") else hand.bone("hand")


def articulated_mjcf(preset: HandPreset) -> str:
    """MJCF text of the articulated hand, to be named by `<include file=.../>` or opened as it is.

    Body `hand_target` is a mocap body at the hand frame's origin; a weld holds the free body `forearm` to it, so a
    script may put the hand anywhere in any orientation: the weld is soft and solved with the constraints, has no
    orientation at which angles of a gimbal lock, yields to forces, and lets the fingers feel the motion, which a hand
    hung from the mocap body itself would not. Steps of up to 2 ms are stable. `hand` is the palm, in the hand frame.
    Joints as in `articulate` (angles in degrees in the file, so no `<compiler angle="radian">` in what includes it),
    with servos of the same names whose controls are angles [rad]; control 0 is the flat hand. Gravity is compensated.
    Capsules touch other things and each other, but for neighbours that lie within each other.
    """
    hand = articulate(preset)
    root = ET.Element("mujoco", model=f"articulated_{preset.name}")
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "body", name="hand_target", mocap="true", pos=_text([0.0, 0.0, HEIGHT_m]))
    elements: list[ET.Element] = []
    for bone in hand.bones:
        base = np.array([0.0, 0.0, -HEIGHT_m]) if bone.parent < 0 else hand.bones[bone.parent].origin
        above = world if bone.parent < 0 else elements[bone.parent]
        body = ET.SubElement(above, "body", name=bone.name, pos=_text(bone.origin - base), gravcomp="1")
        if bone.parent < 0:
            ET.SubElement(body, "freejoint", name="hand_root")
        elements.append(body)
    for joint in hand.joints:
        attributes = {
            "name": joint.name,
            "pos": _text(joint.pivot - hand.bones[joint.bone].origin),
            "axis": _text(joint.axis),
            "ref": f"{joint.rest_deg:g}",
            "range": _text([joint.low_deg, joint.high_deg]),
            "armature": f"{ARMATURE_kg_m2:g}",
        }
        ET.SubElement(elements[joint.bone], "joint", attributes)
    for segment in hand.skeleton.skin:
        _geom(hand, segment, elements)
    for name in hand.skeleton.landmarks:
        owner = _bone_of_landmark(hand, name)
        at = hand.skeleton.landmarks[name] - hand.bones[owner].origin
        ET.SubElement(elements[owner], "site", name=name, pos=_text(at), size="0.002")
    contact = ET.SubElement(root, "contact")
    for a, b in _excluded(hand):
        ET.SubElement(contact, "exclude", body1=a, body2=b)
    equality = ET.SubElement(root, "equality")
    solref = f"{WELD_TIME_s:g} 1"
    ET.SubElement(equality, "weld", name="hand_root", body1="hand_target", body2="forearm", solref=solref)
    actuators = ET.SubElement(root, "actuator")
    for joint in hand.joints:
        place = joint.name.split("_")[0 if joint.bone == 1 else 1]
        servo = {"name": joint.name, "joint": joint.name, "kp": f"{STIFFNESS_N_m[place]:g}"}
        ET.SubElement(actuators, "position", servo | {"dampratio": "1", "inheritrange": "1"})
    ET.indent(root)
    return (
        f"<!-- Written by scripts/make_hand_mjcf.py from hand_models/{preset.name}.toml. -->\n"
        + ET.tostring(root, encoding="unicode")
        + "\n"
    )


def _geom(hand: ArticulatedHand, segment: SkinSegment, elements: list[ET.Element]) -> None:
    names = [bone.name for bone in hand.bones]
    bone = names.index(segment.name) if segment.name in names else hand.bone("hand")
    touches = segment.group > 0 or segment.name in CONTACT_PARTS or segment.name.endswith("metacarpal")
    geom = skin_geom(segment, hand.bones[bone].origin, DIGITS_IN_FILE, touches)
    ET.SubElement(elements[bone], "geom", geom | {"name": f"{segment.name}_skin"})


def _excluded(hand: ArticulatedHand) -> list[tuple[str, str]]:
    """Pairs of bodies whose capsules lie within each other in every pose: at the webs and about the thumb's root."""
    first = [f"{digit}_proximal" for digit in DIGITS]
    pairs = [("hand", name) for name in first]
    pairs += list(pairwise(first))[1:]
    pairs += [("forearm", "thumb_metacarpal"), ("hand", "thumb_metacarpal"), ("thumb_metacarpal", "index_proximal")]
    return pairs


def _text(numbers: Float | Sequence[float]) -> str:
    return numbers_text(numbers, DIGITS_IN_FILE)
