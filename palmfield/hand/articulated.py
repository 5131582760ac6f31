"""A hand preset as a tree of bones with joints: its geometry and its poses."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.skeleton import Skeleton, unit
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
"""Largest palmar abduction of the thumb out of the plane of the palm; tables give 45 to 70."""


class HandBone(NamedTuple):
    """A moving part. parent: index of the parent bone, -1 for the root; origin: origin of the frame at rest [m]."""

    name: str
    parent: int
    origin: Float


@dataclass(frozen=True)
class HandJoint:
    """A hinge that moves `bone` relative to its parent.

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
    """Bones and joints of a hand. Parents precede their children; of two joints of a bone the outer one is first.

    In the rest pose, which is the pose of the preset, all bone frames are parallel to the hand frame.
    """

    preset: HandPreset
    skeleton: Skeleton
    bones: list[HandBone]
    joints: list[HandJoint]

    def bone(self, name: str) -> int:
        """Return the index of a bone."""
        return [bone.name for bone in self.bones].index(name)

    @cached_property
    def origins(self) -> Float:
        """Origins of the bones in the rest pose [m], shape (bones, 3)."""
        return np.array([bone.origin for bone in self.bones])

    @cached_property
    def pivots(self) -> Float:
        """Pivots of the joints in the rest pose [m], shape (joints, 3)."""
        return np.array([joint.pivot for joint in self.joints])

    @cached_property
    def axes(self) -> Float:
        """Axes of the joints in the rest pose, shape (joints, 3)."""
        return np.array([joint.axis for joint in self.joints])

    @cached_property
    def rest_deg(self) -> Float:
        """Angles of the joints in the rest pose [deg], shape (joints,)."""
        return np.array([joint.rest_deg for joint in self.joints])

    @cached_property
    def turns_from(self) -> list[tuple[int, int]]:
        """Bone and reference bone of each joint; the second of two joints at a bone refers to the bone itself."""
        seen: set[int] = set()
        pairs = []
        for joint in self.joints:
            pairs.append((joint.bone, joint.bone if joint.bone in seen else self.bones[joint.bone].parent))
            seen.add(joint.bone)
        return pairs


def articulate(preset: HandPreset) -> ArticulatedHand:
    """Return bones and joints of a preset: forearm, hand, three bones per digit; 2 wrist and 20 finger joints.

    Angles are anatomical: 0 is the flat hand with straight fingers. Flexion is positive to the palm. Abduction of a
    finger is relative to the preset and positive away from the middle finger, for the middle finger to the little one.
    Both angles of the saddle joint of the thumb are relative to the preset; its abduction is positive out of the palm.
    Wrist deviation is positive to the little finger. Two joints at one point act as a universal joint, abduction
    outside.
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
                # The outer joint belongs to the straight digit: undo the flexion of the rest pose
                straight = Rotation.from_rotvec(-np.deg2rad(bend) * turn).apply(axis)
                joints.append(_abduction(preset, digit, bone, part.start, straight, turn, ulnar))
            kind = f"{place}_flexion"
            low, high = RANGES_deg[f"thumb_{kind}" if thumb else kind]
            joints.append(HandJoint(f"{digit}_{kind}", bone, part.start, turn, bend, low, high))
    return ArticulatedHand(preset, skeleton, bones, joints)


def _abduction(
    preset: HandPreset, digit: str, bone: int, pivot: Float, along: Float, flexion_axis: Float, ulnar: Float
) -> HandJoint:
    """Return the joint about the dorsal direction of the digit."""
    palmar = np.array([0.0, 0.0, -1.0])
    if digit == "thumb":
        side, place = palmar, "cmc"
        inside = preset.digits["thumb"].palmar_deg
        low, high = -inside, THUMB_ABDUCTION_deg - inside
    else:
        side, place = (-ulnar if digit == "index" else ulnar), "mcp"
        low, high = RANGES_deg["mcp_abduction"]
    sideways = flexion_axis * np.sign(flexion_axis @ side)
    return HandJoint(f"{digit}_{place}_abduction", bone, pivot, unit(np.cross(along, sideways)), 0.0, low, high)


def checked_angles(hand: ArticulatedHand, angles_deg: Mapping[str, float]) -> Float:
    """Return the angle of every joint [deg], shape (joints,), in the order of the hand; other joints are at rest.

    Raises SceneError for an unknown joint and for an angle that is not a number or outside its range.
    """
    joints = {joint.name: joint for joint in hand.joints}
    for name, angle in angles_deg.items():
        if name not in joints:
            raise SceneError(f"hand pose: joint '{name}' is unknown; use some of: {', '.join(joints)}")
        joint = joints[name]
        # Rounding in interpolation and servo models may exceed a range slightly.
        if not joint.low_deg - 1e-6 <= angle <= joint.high_deg + 1e-6:
            raise SceneError(
                f"hand pose: {name} is {angle:g} degrees; use {joint.low_deg:g} to {joint.high_deg:g} degrees"
            )
    return np.array([float(angles_deg.get(joint.name, joint.rest_deg)) for joint in hand.joints])


def bone_poses(hand: ArticulatedHand, angles_deg: Mapping[str, float]) -> tuple[Float, Float]:
    """Return origins [m], shape (bones, 3), and rotations, shape (bones, 3, 3), of all bones in the frame of the root.

    The root (forearm) does not move. Raises SceneError like `checked_angles`.
    """
    return poses_at(hand, checked_angles(hand, angles_deg))


def poses_at(hand: ArticulatedHand, angles_deg: Float) -> tuple[Float, Float]:
    """Return `bone_poses` for angles [deg] in the order of the joints, shape (joints,), without range checks."""
    turns = np.zeros((len(hand.joints), 4, 4))
    turns[:, :3, :3] = Rotation.from_rotvec(np.deg2rad(angles_deg - hand.rest_deg)[:, None] * hand.axes).as_matrix()
    turns[:, :3, 3] = hand.pivots - np.einsum("jab,jb->ja", turns[:, :3, :3], hand.pivots)
    turns[:, 3, 3] = 1.0
    # A point x of bone b in the rest pose moves to moved[b] @ (x, 1)
    moved = np.tile(np.eye(4), (len(hand.bones), 1, 1))
    for (bone, before), turn in zip(hand.turns_from, turns, strict=True):
        moved[bone] = moved[before] @ turn
    rotations = moved[:, :3, :3]
    return np.einsum("bij,bj->bi", rotations, hand.origins) + moved[:, :3, 3], rotations


def posed_landmark(hand: ArticulatedHand, name: str, positions: Float, rotations: Float) -> Float:
    """Return the position of a skeleton landmark [m], shape (3,), with the bones at `positions` and `rotations`."""
    bone = bone_of_landmark(hand, name)
    return positions[bone] + rotations[bone] @ (hand.skeleton.landmarks[name] - hand.bones[bone].origin)


def bone_of_landmark(hand: ArticulatedHand, name: str) -> int:
    """Return the index of the bone that carries a landmark of the skeleton."""
    digit, _, place = name.partition("_")
    return hand.bone(f"{digit}_distal") if place in ("tip", "pad") else hand.bone("hand")
