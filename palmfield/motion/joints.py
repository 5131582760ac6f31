"""The 26 hand joints of OpenXR (XR_EXT_hand_tracking), and their positions in an articulated hand."""

from dataclasses import dataclass

import numpy as np

from palmfield.hand.articulated import ArticulatedHand
from palmfield.hand.preset import DIGITS
from palmfield.types import Float, Int

FINGER_PLACES = ("metacarpal", "proximal", "intermediate", "distal", "tip")
THUMB_PLACES = ("metacarpal", "proximal", "distal", "tip")
JOINTS = (
    "palm",
    "wrist",
    *(f"thumb_{place}" for place in THUMB_PLACES),
    *(f"{digit}_{place}" for digit in DIGITS[1:] for place in FINGER_PLACES),
)
"""Joints in the order of XrHandJointEXT.

Joint palm is the middle of the metacarpal of the middle finger. Each other joint, except the tips, is the end of the
named bone that is nearer to the wrist.
"""
ORIENTATION_VALID, POSITION_VALID, ORIENTATION_TRACKED, POSITION_TRACKED = 1, 2, 4, 8
"""Bits of XrSpaceLocationFlags."""
ALL_FLAGS = ORIENTATION_VALID | POSITION_VALID | ORIENTATION_TRACKED | POSITION_TRACKED
PALM_JOINTS = tuple(n for n, name in enumerate(JOINTS) if name in ("palm", "wrist") or name.endswith("metacarpal"))
KNUCKLES = tuple(JOINTS.index(f"{digit}_proximal") for digit in DIGITS[1:])
FARTHEST_M = 10.0
"""Largest distance of a hand from a tracker. Larger values indicate a wrong unit."""
USUAL_M = (0.05, 0.4)
"""Usual range of the distance from the wrist to the tip of the middle finger."""


@dataclass(frozen=True)
class HandJoints:
    """Joints of OpenXR in an articulated hand at rest, in the hand frame.

    bones: index of the bone that carries each joint, shape (26,); positions: [m], shape (26, 3)
    frames: orientations with columns x, y, z, shape (26, 3, 3); -z is along the bone to the tip, y to the back
    radii: radii from the joint to the skin at its side [m], shape (26,)
    """

    bones: Int
    positions: Float
    frames: Float
    radii: Float


def hand_joints(hand: ArticulatedHand) -> HandJoints:
    """Return the joints of a hand at rest; the tips are points of the skin."""
    skin = {part.name: part for part in hand.skeleton.skin}
    marks = hand.skeleton.landmarks
    middle = skin["middle_metacarpal"]
    palm = skin["palm_body"]
    bones, positions, along, dorsal, radii = [], [], [], [], []
    for name in JOINTS:
        digit, _, place = name.partition("_")
        if name in ("palm", "wrist"):
            bone = "hand"
            position = marks["wrist"] if name == "wrist" else 0.5 * (middle.start + middle.end)
            direction, back = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
            radius = skin["forearm"].semi_end[1] if name == "wrist" else palm.semi_start[1]
        else:
            part = skin[f"{digit}_{'distal' if place == 'tip' else place.replace('intermediate', 'middle')}"]
            bone = part.name if part.name in [b.name for b in hand.bones] else "hand"
            position = marks[name] if place == "tip" else part.start
            direction, back = part.end - part.start, part.dorsal
            radius = (part.semi_end if place == "tip" else part.semi_start)[0]
        bones.append(hand.bone(bone))
        positions.append(position)
        along.append(direction / np.linalg.norm(direction))
        dorsal.append(back)
        radii.append(radius)
    z = -np.array(along)
    across = np.cross(np.array(dorsal), z)
    x = across / np.linalg.norm(across, axis=1, keepdims=True)
    frames = np.stack([x, np.cross(z, x), z], axis=2)
    return HandJoints(np.array(bones, dtype=np.int32), np.array(positions), frames, np.array(radii))


def joints_at(hand: ArticulatedHand, joints: HandJoints, origins: Float, rotations: Float) -> Float:
    """Return the positions of the joints [m], shape (26, 3), of a posed hand.

    origins: origins of the bones [m], shape (bones, 3); rotations: their rotations
    """
    arms = joints.positions - hand.origins[joints.bones]
    return origins[joints.bones] + np.einsum("jab,jb->ja", rotations[joints.bones], arms)
