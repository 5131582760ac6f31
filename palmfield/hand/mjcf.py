"""A hand preset as an MJCF body of plain geoms, which opens in any MuJoCo."""

import xml.etree.ElementTree as ET
from functools import partial

import numpy as np

from palmfield.hand.mjcf_text import SKIN_RGBA, file_text, numbers_text
from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.skeleton import SkinSegment
from palmfield.hand.surface import centred_skeleton, hand_surface
from palmfield.hand.visual_skin import EDGE_m, SkinBone, add_skin
from palmfield.types import Float

# A force of 50 mN moves the hand by 0.05 / 2000 m = 25 um.
STIFFNESS_N_m = 2000.0
DENSITY_kg_m3 = 1100.0
HEIGHT_m = 0.2
# Smooth unions of the skin enlarge the palm by up to a quarter of their radius (11 mm); geoms have no unions.
PALM_SWELL_m = 0.002
PARTS_OF_ONE_MASS = ("forearm", "carpus", "palm_body")
DIGITS_IN_FILE = 6
_text = partial(numbers_text, digits=DIGITS_IN_FILE)
VIEW_GROUP = "3"
"""Group of geoms and sites that viewers hide by default and replace by the skin."""


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
    body = ET.SubElement(world, "body", name="hand", pos=_text([0.0, 0.0, HEIGHT_m]), gravcomp="1")
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        ET.SubElement(body, "joint", name=f"hand_{axis}", type="slide", axis=_text(direction))
    for segment in skeleton.skin:
        ET.SubElement(body, "geom", skin_geom(segment, np.zeros(3), DIGITS_IN_FILE, touches=False))
    for name in (
        "palm_centre",
        "thenar",
        "hypothenar",
        *(f"{digit}_{at}" for digit in DIGITS for at in ("tip", "pad")),
    ):
        ET.SubElement(body, "site", name=name, pos=_text(skeleton.landmarks[name]), size="0.002", group=VIEW_GROUP)
    actuators = ET.SubElement(root, "actuator")
    for axis in "xyz":
        name = f"hand_{axis}"
        ET.SubElement(actuators, "position", name=name, joint=name, kp=f"{STIFFNESS_N_m:g}", dampratio="1")
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
