"""Write a surface on bones as a <skin> of MuJoCo, which viewers show instead of capsules; the physics ignores it."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palmfield.hand.mjcf_text import SKIN_RGBA, numbers_text
from palmfield.types import Float, Surface

EDGE_m = 0.004
"""Edge length of the triangles of the skins of the hand presets."""
DIGITS_OF_PLACE, DIGITS_OF_SHARE = 5, 3
"""Decimals of positions [m]: 10 um, less than the error of triangles of 4 mm."""


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
