"""Choose the palmar side of a hand for a skin layer: labelled skin, or skin of a mesh that looks out of the palm."""

import numpy as np

from palmfield.errors import SceneError
from palmfield.hand.chirality import chirality
from palmfield.hand.cover import MEND, ABOVE_m, Cover, GAUGE_m, OUTLINE_STEP_m, place
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.preset import DIGITS, load_preset
from palmfield.hand.region import FACING_COSINE
from palmfield.hand.regions import glabrous
from palmfield.hand.surface import centred_skeleton
from palmfield.hand.triangles import adjacency, neighbour_mean
from palmfield.hand.wholelayer import PALMAR
from palmfield.types import Float, Surface

SMOOTHING_ROUNDS = 3
"""Rounds of means over neighbours that smooth the border of labelled skin."""
MOST_HIDDEN = 0.05
"""Largest share of palmar vertices behind other skin, which a cover leaves out; a thumb hides some of its web."""
TO_WRIST = 0.55
"""Distance from the middle of the palm to the end of a cover at the wrist, over that to the farthest fingertip. It is
0.44 to the wrist crease of the presets."""


def labelled_cover(surface: Surface, hand: str, centre: Float) -> Cover:
    """Return the extent of a layer on the palm, webs and palmar sides of the fingers of a preset.

    surface: `hand_surface` of the preset [m]; hand: name of the preset, or file; centre: of the layer [m], shape (3,)
    """
    inside = np.where(glabrous(hand), 1.0, -1.0)
    links = adjacency(surface.faces, len(inside))
    for _ in range(SMOOTHING_ROUNDS):
        inside = neighbour_mean(inside, links)
    marks = centred_skeleton(load_preset(hand)).landmarks
    tips = np.array([marks[f"{digit}_tip"] for digit in DIGITS[1:]])
    return _cover(surface, np.array(PALMAR), inside, centre, tips)


def shaped_cover(surface: Surface, centre: Float, named: str = "unknown") -> Cover:
    """Return the extent of a layer on the palmar side of the mesh of a flat hand, without its forearm.

    surface: closed mesh [m]; centre: of the layer [m], shape (3,); named: see `palmfield.hand.chirality.chirality`
    Raises SceneError if the shape does not determine the direction out of the palm.
    """
    hand = chirality(surface.vertices, surface.faces, named)
    if hand.side == "unknown":
        raise SceneError(
            f"the direction out of the palm is unknown ({hand.reason}); allowed: a flat hand with five separate "
            "digits, whose thumb points out of the palm, or joints with left or right in their names. Correct the "
            "mesh, or set cover to patch"
        )
    fingers = hand.tips[1:]
    along = fingers.mean(axis=0) - hand.middle
    along -= (along @ hand.palm) * hand.palm
    along /= np.linalg.norm(along)
    beyond = (surface.vertices - hand.middle) @ along
    inside = (beyond + TO_WRIST * ((fingers - hand.middle) @ along).max()) / GAUGE_m
    return _cover(surface, hand.palm, inside, centre, fingers)


def _cover(surface: Surface, facing: Float, inside: Float, centre: Float, tips: Float) -> Cover:
    within = (inside > 0.0) & (surface.normals @ facing > FACING_COSINE)
    faces = surface.faces[within[surface.faces].any(axis=1)]
    above = surface.vertices[faces].mean(axis=1) + ABOVE_m * facing
    span = float(np.ptp(surface.vertices, axis=0).sum())
    way = exit_distances(surface.vertices, surface.faces, above, np.tile(facing, (len(faces), 1)), span)
    hidden = np.zeros(len(within), dtype=bool)
    hidden[faces[np.isfinite(way)]] = True
    share = float((hidden & within).sum() / within.sum())
    if share > MOST_HIDDEN:
        raise SceneError(
            f"{100 * share:.0f} % of the palmar skin lies behind other skin, seen out of the palm, for example at "
            f"{place(surface.vertices[np.argmax(hidden)])}{MEND}"
        )
    inside = np.where(hidden, -np.abs(inside), inside)
    within &= ~hidden
    away = surface.vertices[within] - centre
    reach = np.linalg.norm(away - np.outer(away @ facing, facing), axis=1).max()
    corners = surface.vertices[surface.faces[within[surface.faces].all(axis=1)]]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ facing
    return Cover(facing, inside, float(reach) + OUTLINE_STEP_m, 0.5 * float(doubled.sum()), tips)
