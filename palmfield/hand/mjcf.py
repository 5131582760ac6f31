"""A hand preset as an MJCF body of plain geoms, which opens in any MuJoCo."""

import xml.etree.ElementTree as ET

import numpy as np

from palmfield.hand.preset import DIGITS, HandPreset
from palmfield.hand.skeleton import SkinSegment
from palmfield.hand.surface import centred_skeleton
from palmfield.types import Float

# 50 mN moves the hand by 0.05 / 2000 m = 25 um.
STIFFNESS_N_m = 2000.0
DENSITY_kg_m3 = 1100.0
HEIGHT_m = 0.2
# Smooth unions swell the palm by up to a quarter of their radius of 11 mm; plain geoms have no unions.
PALM_SWELL_m = 0.002
PARTS_OF_ONE_MASS = ("forearm", "carpus", "palm_body")
SKIN_RGBA = "0.87 0.68 0.58 1"


def hand_mjcf(preset: HandPreset) -> str:
    """MJCF text with one body `hand`, in the hand frame, to be named by `<include file=.../>` or opened as it is.

    Geoms are capsules on the bones with the skin's mean radius (the palm's body: ellipsoids); they touch nothing.
    MuJoCo takes mass and inertia from them at 1100 kg/m3; parts that lie inside others weigh nothing. Slide joints
    hand_x, hand_y, hand_z carry position servos of the same names (2 kN/m, critically damped); gravity is compensated.
    """
    skeleton = centred_skeleton(preset)
    root = ET.Element("mujoco", model=preset.name)
    world = ET.SubElement(root, "worldbody")
    body = ET.SubElement(world, "body", name="hand", pos=_text([0.0, 0.0, HEIGHT_m]), gravcomp="1")
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        ET.SubElement(body, "joint", name=f"hand_{axis}", type="slide", axis=_text(direction))
    for segment in skeleton.skin:
        _geom(body, segment)
    for name in ("palm_centre", *(f"{digit}_tip" for digit in DIGITS)):
        ET.SubElement(body, "site", name=name, pos=_text(skeleton.landmarks[name]), size="0.002")
    actuators = ET.SubElement(root, "actuator")
    for axis in "xyz":
        name = f"hand_{axis}"
        ET.SubElement(actuators, "position", name=name, joint=name, kp=f"{STIFFNESS_N_m:g}", dampratio="1")
    ET.indent(root)
    return (
        f"<!-- Written by scripts/make_hand_mjcf.py from hand_models/{preset.name}.toml. -->\n"
        + ET.tostring(root, encoding="unicode")
        + "\n"
    )


def _geom(body: ET.Element, segment: SkinSegment) -> None:
    semi = 0.5 * (segment.semi_start + segment.semi_end) + (0.0 if segment.group else PALM_SWELL_m)
    # The axis of the skin lies nearer to the back; the capsule is centred between back and palmar side.
    shift = 0.5 * (semi[1] - semi[2]) * segment.dorsal
    height = 0.5 * (semi[1] + semi[2])
    geom = {"name": segment.name, "contype": "0", "conaffinity": "0", "rgba": SKIN_RGBA}
    geom["density"] = f"{DENSITY_kg_m3:g}" if _counts(segment) else "0"
    if segment.name in PARTS_OF_ONE_MASS:
        middle = 0.5 * (segment.start + segment.end) + shift
        half = 0.5 * np.linalg.norm(segment.end - segment.start)
        geom |= {"type": "ellipsoid", "pos": _text(middle), "size": _text([semi[0], half + 0.75 * semi[0], height])}
    else:
        ends = np.concatenate([segment.start + shift, segment.end + shift])
        radius = 0.5 * (semi[0] + height) if segment.group else height
        geom |= {"type": "capsule", "fromto": _text(ends), "size": _text([radius])}
    ET.SubElement(body, "geom", geom)


def _counts(segment: SkinSegment) -> bool:
    return segment.group > 0 or segment.name in PARTS_OF_ONE_MASS


def _text(numbers: Float | list[float]) -> str:
    return " ".join(f"{number + 0.0:.6g}" for number in np.round(numbers, 6))
