"""A hand preset as MJCF: one body of plain geoms, or an articulated hand with joints and servos; and the skin."""

import xml.etree.ElementTree as ET
from functools import partial
from itertools import pairwise

import numpy as np

from palmfield.hand.articulated import ArticulatedHand, articulate, bone_of_landmark
from palmfield.hand.mjcf_text import (
    DIGITS_IN_FILE,
    SKIN_RGBA,
    VIEW_GROUP,
    ARMATURE_kg_m2,
    DENSITY_kg_m3,
    HEIGHT_m,
    SkinBone,
    add_skin,
    file_text,
    numbers_text,
)
from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.skeleton import SkinSegment
from palmfield.hand.skinning import skin_weights
from palmfield.hand.surface import centred_skeleton, hand_surface
from palmfield.types import Float

EDGE_m = 0.004
"""Edge length of the triangles of the visual skin."""
# A force of 50 mN moves the hand by 0.05 / 2000 m = 25 um.
SERVO_N_m = 2000.0
# Smooth unions of the skin enlarge the palm by up to a quarter of their radius (11 mm); geoms have no unions.
PALM_SWELL_m = 0.002
PARTS_OF_ONE_MASS = ("forearm", "carpus", "palm_body")
DIGITS_OF_BODY = 6
STIFFNESS_N_m = {"wrist": 10.0, "cmc": 0.8, "mcp": 0.5, "mp": 0.5, "pip": 0.3, "ip": 0.3, "dip": 0.2}
"""Stiffness of the position servos by joint [N m / rad]. The force of an array on a fingertip (10 mN) bends a finger by
less than 0.3 mm, and each joint alone oscillates at 30 Hz or less."""
WELD_TIME_s = 0.01
_text = partial(numbers_text, digits=DIGITS_IN_FILE)
CONTACT_PARTS = ("forearm", "thenar", "hypothenar")
_short = partial(numbers_text, digits=DIGITS_OF_BODY)


def hand_mjcf(preset: HandPreset) -> str:
    """Return MJCF text with one body `hand`, in the hand frame, for `<include file=.../>` or to open directly.

    Viewers show the skin, of triangles of 4 mm; geoms and sites are in group 3. Geoms are capsules on the bones with
    the mean radius of the skin (ellipsoids for the palm), without contacts. MuJoCo computes mass and inertia from them
    at 1100 kg/m3; parts inside others have no mass. Slide joints hand_x, hand_y, hand_z have position servos of the
    same names (2 kN/m, critically damped). Gravity is compensated.
    """
    skeleton = centred_skeleton(preset)
    root = ET.Element("mujoco", model=preset.name)
    world = ET.SubElement(root, "worldbody")
    body = ET.SubElement(world, "body", name="hand", pos=_short([0.0, 0.0, HEIGHT_m]), gravcomp="1")
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        ET.SubElement(body, "joint", name=f"hand_{axis}", type="slide", axis=_short(direction))
    for segment in skeleton.skin:
        ET.SubElement(body, "geom", skin_geom(segment, np.zeros(3), DIGITS_OF_BODY, touches=False))
    for name in (
        "palm_centre",
        "thenar",
        "hypothenar",
        *(f"{digit}_{at}" for digit in DIGITS for at in ("tip", "pad")),
    ):
        ET.SubElement(body, "site", name=name, pos=_short(skeleton.landmarks[name]), size="0.002", group=VIEW_GROUP)
    actuators = ET.SubElement(root, "actuator")
    for axis in "xyz":
        name = f"hand_{axis}"
        ET.SubElement(actuators, "position", name=name, joint=name, kp=f"{SERVO_N_m:g}", dampratio="1")
    surface = hand_surface(preset, EDGE_m).surface
    add_skin(root, "hand", surface, [SkinBone("hand", np.zeros(3), np.ones(len(surface.vertices)))])
    return file_text(root, f"Written by scripts/make_hand_mjcf.py from hand_models/{preset.name}.toml.")


def skin_geom(segment: SkinSegment, origin: Float, digits: int, touches: bool) -> dict[str, str]:
    """Return the attributes of the geom for a part of the skin, in a frame at `origin` [m], shape (3,).

    The geom is a capsule, or an ellipsoid for the palm. digits: as for `numbers_text`; touches: whether it has contacts
    """
    semi = 0.5 * (segment.semi_start + segment.semi_end) + (0.0 if segment.group else PALM_SWELL_m)
    # The axis of the skin is nearer to the back; the capsule is centred between back and palmar side.
    shift = 0.5 * (semi[1] - semi[2]) * segment.dorsal - origin
    height = 0.5 * (semi[1] + semi[2])
    # Parts inside others have no mass.
    weighs = segment.group > 0 or segment.name in PARTS_OF_ONE_MASS
    geom = {"name": segment.name, "group": VIEW_GROUP}
    if not touches:
        geom |= {"contype": "0", "conaffinity": "0"}
    geom |= {"rgba": SKIN_RGBA, "density": f"{DENSITY_kg_m3 if weighs else 0:g}"}
    if segment.name in PARTS_OF_ONE_MASS:
        middle = 0.5 * (segment.start + segment.end) + shift
        half = float(0.5 * np.linalg.norm(segment.end - segment.start) + 0.75 * semi[0])
        size = numbers_text([semi[0], half, height], digits)
        return geom | {"type": "ellipsoid", "pos": numbers_text(middle, digits), "size": size}
    ends = np.concatenate([segment.start + shift, segment.end + shift])
    radius = 0.5 * (semi[0] + height) if segment.group else height
    return geom | {"type": "capsule", "fromto": numbers_text(ends, digits), "size": numbers_text([radius], digits)}


def articulated_mjcf(preset: HandPreset, skin: bool = True) -> str:
    """Return MJCF text of the articulated hand, for `<include file=.../>` or to open directly.

    A soft weld attaches the free body `forearm` to the mocap body `hand_target` at the origin of the hand frame, so a
    script may place the hand in any position and orientation. Unlike a child of the mocap body, the welded hand yields
    to forces and transmits the motion to the fingers. Steps of up to 2 ms are stable. `hand` is the palm, in the hand
    frame. Joints are those of `articulate`; their angles are in degrees in the file, so a file that includes it must
    not have `<compiler angle="radian">`. Servos have the names of the joints; their controls are angles [rad], and
    control 0 is the flat hand. Gravity is compensated. Capsules, in group 3, collide with other objects and each other,
    except overlapping neighbours. skin: whether to add the visual skin, of triangles of 4 mm with the weights of
    `palmfield.hand.skinning.skin_weights`.
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
    """Return pairs of bodies whose capsules overlap in every pose: at the webs and the root of the thumb."""
    first = [f"{digit}_proximal" for digit in DIGITS]
    pairs = [("hand", name) for name in first]
    pairs += list(pairwise(first))[1:]
    pairs += [("forearm", "thumb_metacarpal"), ("hand", "thumb_metacarpal"), ("thumb_metacarpal", "index_proximal")]
    return pairs
