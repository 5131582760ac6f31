"""Text of palmfield's MJCF files, and a surface on bones as a <skin>, which viewers show and the physics ignores."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palmfield.types import Float, Surface

SKIN_RGBA = "0.87 0.68 0.58 1"
VIEW_GROUP = "3"
"""Group of geoms and sites that viewers hide by default and replace by the skin."""
DENSITY_kg_m3 = 1100.0
HEIGHT_m = 0.2
ARMATURE_kg_m2 = 1e-5
"""Inertia added to each joint, about that of a finger; without it, end joints of 5 g oscillate faster than the step."""
DIGITS_IN_FILE = 9
"""Decimals of positions [m]: 1 nm, as rounding accumulates along a chain of bodies to a few nm at the fingertips."""
DIGITS_OF_PLACE, DIGITS_OF_SHARE = 5, 3
"""Decimals of positions [m]: 10 um, less than the error of triangles of 4 mm."""


def numbers_text(numbers: Float | Sequence[float], digits: int) -> str:
    """Return numbers as MJCF text, rounded to `digits` decimals."""
    return " ".join(f"{number + 0.0:.{digits}g}" for number in np.round(numbers, digits))


def file_text(root: ET.Element, note: str) -> str:
    """Return the indented text of a file with a note in the first line."""
    ET.indent(root)
    return f"<!-- {note} -->\n{ET.tostring(root, encoding='unicode')}\n"


class SkinBone(NamedTuple):
    """A body that moves skin.

    place: origin with the skin at rest [m], shape (3,); shares: weight at each vertex, shape (n,)
    """

    body: str
    place: Float
    shares: Float


def add_skin(root: ET.Element, name: str, surface: Surface, bones: Sequence[SkinBone]) -> None:
    """Add a surface to a model as its skin `name`.

    surface: skin in the pose in which the bodies have no rotation; bones without weight are omitted
    """
    attributes = {
        "name": name,
        "rgba": SKIN_RGBA,
        "vertex": numbers_text(surface.vertices.ravel(), DIGITS_OF_PLACE),
        "face": " ".join(map(str, surface.faces.ravel().tolist())),
    }
    skin = ET.SubElement(ET.SubElement(root, "deformable"), "skin", attributes)
    for bone in bones:
        moved = np.flatnonzero(np.round(bone.shares, DIGITS_OF_SHARE))
        if len(moved):
            weights = numbers_text(bone.shares[moved], DIGITS_OF_SHARE)
            numbers = " ".join(map(str, moved.tolist()))
            place = numbers_text(bone.place, DIGITS_OF_PLACE + 4)
            rest = {"bindpos": place, "bindquat": "1 0 0 0", "vertid": numbers, "vertweight": weights}
            ET.SubElement(skin, "bone", {"body": bone.body} | rest)
