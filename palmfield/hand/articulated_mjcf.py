"""The articulated hand as MJCF: bodies, joints, servos, capsules, and the visual skin."""

import xml.etree.ElementTree as ET
from functools import partial
from itertools import pairwise

import numpy as np

from palmfield.hand.articulated import ArticulatedHand, articulate, bone_of_landmark
from palmfield.hand.mjcf import VIEW_GROUP, HEIGHT_m, skin_geom
from palmfield.hand.mjcf_text import file_text, numbers_text
from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.skeleton import SkinSegment
from palmfield.hand.skinning import skin_weights
from palmfield.hand.surface import hand_surface
from palmfield.hand.visual_skin import EDGE_m, SkinBone, add_skin

STIFFNESS_N_m = {"wrist": 10.0, "cmc": 0.8, "mcp": 0.5, "mp": 0.5, "pip": 0.3, "ip": 0.3, "dip": 0.2}
"""Stiffness of the position servos by joint [N m / rad]: 10 mN on a fingertip, the force of an array, bends a finger by
less than 0.3 mm, and no single joint oscillates faster than 30 Hz."""
ARMATURE_kg_m2 = 1e-5
"""Added to each joint's inertia, about that of a whole finger: end joints of 5 g would oscillate within a step."""
WELD_TIME_s = 0.01
DIGITS_IN_FILE = 9
"""Rounding accumulates along a chain of bodies: with nanometres, errors of fingertips are a few nanometres."""
_text = partial(numbers_text, digits=DIGITS_IN_FILE)
CONTACT_PARTS = ("forearm", "thenar", "hypothenar")


def articulated_mjcf(preset: HandPreset, skin: bool = True) -> str:
    """Return MJCF text of the articulated hand, for `<include file=.../>` or to open directly.

    Body `hand_target` is a mocap body at the hand frame's origin; a weld holds the free body `forearm` to it, so a
    script may place the hand anywhere in any orientation. The weld is soft and solved with the constraints, has no
    gimbal lock, yields to forces, and transmits the motion to the fingers, unlike a hand attached to the mocap body
    itself. Steps of up to 2 ms are stable. `hand` is the palm, in the hand frame. Joints as in `articulate` (angles in
    degrees in the file, so no `<compiler angle="radian">` in what includes it), with servos of the same names whose
    controls are angles [rad]; control 0 is the flat hand. Gravity is compensated. Capsules, in group 3, collide with
    other objects and each other, except neighbours that overlap. Viewers show the skin, of triangles of 4 mm, with the
    weights of `palmfield.hand.skinning.skin_weights`, unless it is left out.
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
        owner = bone_of_landmark(hand, name)
        at = hand.skeleton.landmarks[name] - hand.bones[owner].origin
        ET.SubElement(elements[owner], "site", name=name, pos=_text(at), size="0.002", group=VIEW_GROUP)
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
    if skin:
        surface, names = hand_surface(preset, EDGE_m).surface, [bone.name for bone in hand.bones]
        shares = skin_weights(hand, surface).T
        add_skin(root, "hand", surface, [SkinBone(*one) for one in zip(names, hand.origins, shares, strict=True)])
    return file_text(root, f"Written by scripts/make_hand_mjcf.py from hand_models/{preset.name}.toml.")


def _geom(hand: ArticulatedHand, segment: SkinSegment, elements: list[ET.Element]) -> None:
    names = [bone.name for bone in hand.bones]
    bone = names.index(segment.name) if segment.name in names else hand.bone("hand")
    touches = segment.group > 0 or segment.name in CONTACT_PARTS or segment.name.endswith("metacarpal")
    geom = skin_geom(segment, hand.bones[bone].origin, DIGITS_IN_FILE, touches)
    ET.SubElement(elements[bone], "geom", geom | {"name": f"{segment.name}_skin"})


def _excluded(hand: ArticulatedHand) -> list[tuple[str, str]]:
    """Return pairs of bodies whose capsules overlap in every pose: at the webs and about the thumb's root."""
    first = [f"{digit}_proximal" for digit in DIGITS]
    pairs = [("hand", name) for name in first]
    pairs += list(pairwise(first))[1:]
    pairs += [("forearm", "thumb_metacarpal"), ("hand", "thumb_metacarpal"), ("thumb_metacarpal", "index_proximal")]
    return pairs
