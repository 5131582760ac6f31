"""Regions of the skin: one label per vertex, by parts of the hand."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from palmfield.hand.articulated import ArticulatedHand
from palmfield.hand.preset import DIGITS
from palmfield.hand.skeleton import Skeleton, SkinSegment, unit
from palmfield.hand.skinning import skin_weights
from palmfield.hand.surface import HandSurface, skin_distance
from palmfield.hand.triangles import adjacency
from palmfield.types import Float, Int, Surface

Mask = NDArray[np.bool_]
WEBS = ("thumb_web", *(f"{a}_{b}_web" for a, b in pairwise(DIGITS[1:])))
PADS = tuple(f"{a}_{b}_pad" for a, b in pairwise(DIGITS[1:]))
PALM_AREAS = ("thenar", "hypothenar", *PADS, "palm_centre")

WEB_REACH, FACING_TIPS = 1.0, 0.5
"""Largest distance of a web from both fingers over their half-breadth; smallest y of its normals, without the sides."""


def _of_digit(digit: str) -> tuple[str, ...]:
    sides = [f"{digit}_{bone}_{side}" for bone in _phalanges(digit)[:-1] for side in ("palmar", "back")]
    return (*sides, f"{digit}_pulp", f"{digit}_distal_back")


def _phalanges(digit: str) -> tuple[str, ...]:
    return ("proximal", "distal") if digit == "thumb" else ("proximal", "middle", "distal")


REGIONS = (*(name for digit in DIGITS for name in _of_digit(digit)), *PALM_AREAS, *WEBS, "dorsum", "forearm")
"""Palmar side and back of each phalanx (the pulp is the palmar side of the last one); areas of the palm, with pads each
below the roots of two fingers; webs; back of the hand; forearm beyond the wrist crease."""


def region_labels(hand: ArticulatedHand, surface: Surface) -> tuple[tuple[str, ...], Int]:
    """Return the names of the regions, REGIONS, and the region number of each vertex, shape (n,).

    surface: skin of the hand in its rest pose, with any edge length
    Phalanges are separated by the bones with the largest weights, see `skinning`. A finger begins at its crease, whose
    distance from the knuckle follows from the palm length of the preset; the thumb begins at its second joint.
    Regions are connected: vertices cut off from their region at a border get the region around them.
    """
    number = {name: n for n, name in enumerate(REGIONS)}
    points = surface.vertices
    parts = {part.name: part for part in hand.skeleton.skin}
    owner = np.argmax(skin_weights(hand, surface), axis=1)
    thumb_root = owner == hand.bone("thumb_metacarpal")

    labels = np.full(len(points), number["palm_centre"], dtype=np.int32)
    for area in ("thenar", "hypothenar"):
        part = parts[area]
        # The edge of the palm next to an area belongs to the area
        edge = (np.abs(points[:, 0]) > np.abs(part.start[0])) & (points[:, 0] * part.start[0] > 0.0)
        edge &= points[:, 1] < part.end[1]
        labels[(_outline(part, points) < 0.0) | edge] = number[area]
    labels[thumb_root] = number["thenar"]
    to_pads = np.array([_outline(parts[pad], points) for pad in PADS])
    roots = np.isin(owner, [hand.bone(f"{digit}_proximal") for digit in DIGITS[1:]])
    on_pads = roots | (to_pads.min(axis=0) < 0.0)
    labels[on_pads] = np.array([number[pad] for pad in PADS])[np.argmin(to_pads, axis=0)][on_pads]
    back = np.where(thumb_root, _behind(parts["thumb_metacarpal"], points), surface.normals[:, 2] > 0.0)
    labels[back] = number["dorsum"]

    nearest = np.argmin([skin_distance(Skeleton([part], [], {}), points) for part in hand.skeleton.skin], axis=0)
    labels[nearest == hand.skeleton.skin.index(parts["thumb_web"])] = number["thumb_web"]
    for digit in DIGITS:
        beyond = _beyond_crease(hand, digit, parts[f"{digit}_proximal"], points)
        for bone in _phalanges(digit):
            name = f"{digit}_{bone}"
            here = (owner == hand.bone(name)) & beyond
            palmar = f"{digit}_pulp" if bone == "distal" else f"{name}_palmar"
            labels[here] = np.where(_behind(parts[name], points)[here], number[f"{name}_back"], number[palmar])
    for a, b in pairwise(DIGITS[1:]):
        labels[_between(hand, (a, b), surface)] = number[f"{a}_{b}_web"]
    labels[points[:, 1] < hand.skeleton.landmarks["wrist"][1]] = number["forearm"]
    return REGIONS, _connected(labels, surface)


def depth_by_region(hand: ArticulatedHand, skin: HandSurface) -> dict[str, tuple[float, float, float]]:
    """Return minimum, 10th percentile and median depth from skin to bone of each region [m]."""
    names, labels = region_labels(hand, skin.surface)
    result = {}
    for n, name in enumerate(names):
        least, low, middle = np.percentile(skin.depth_to_bone[labels == n], [0.0, 10.0, 50.0])
        result[name] = float(least), float(low), float(middle)
    return result


def _outline(part: SkinSegment, points: Float) -> Float:
    """Return the distance from points to the outline of a part seen from the palm, negative inside [m], shape (n,)."""
    axis = (part.end - part.start)[:2]
    share = np.clip((points[:, :2] - part.start[:2]) @ axis / (axis @ axis), 0.0, 1.0)
    half = part.semi_start[0] + share * (part.semi_end[0] - part.semi_start[0])
    return np.linalg.norm(points[:, :2] - part.start[:2] - share[:, None] * axis, axis=1) - half


def _between(hand: ArticulatedHand, fingers: tuple[str, str], surface: Surface) -> Mask:
    """Return whether vertices are near the roots of both fingers and face the tips, shape (n,)."""
    near = surface.normals[:, 1] > FACING_TIPS
    for part in hand.skeleton.skin:
        if part.name in [f"{finger}_proximal" for finger in fingers]:
            near &= skin_distance(Skeleton([part], [], {}), surface.vertices) < WEB_REACH * part.semi_start[0]
    return near


def _behind(part: SkinSegment, points: Float) -> Mask:
    """Return whether points are on the dorsal side of the axis of a part, shape (n,)."""
    return (points - part.start) @ part.dorsal > 0.0


def _beyond_crease(hand: ArticulatedHand, digit: str, proximal: SkinSegment, points: Float) -> Mask:
    marks = hand.skeleton.landmarks
    crease = marks["wrist"][1] + hand.preset.palm_length_m - marks["middle_knuckle"][1]
    if digit == "thumb":
        return np.ones(len(points), dtype=bool)
    return (points - proximal.start) @ unit(proximal.end - proximal.start) > crease


def _connected(labels: Int, surface: Surface) -> Int:
    """Return labels in which each region is its largest piece; other pieces get the labels around them."""
    links = adjacency(surface.faces, len(labels)).tocoo()
    same = labels[links.row] == labels[links.col]
    inside = sparse.coo_array((links.data[same], (links.row[same], links.col[same])), shape=links.shape)
    _, piece = sparse.csgraph.connected_components(inside, directed=False)
    size = np.bincount(piece)
    kept = np.zeros(len(size), dtype=bool)
    for label in np.unique(labels):
        pieces = np.unique(piece[labels == label])
        kept[pieces[np.argmax(size[pieces])]] = True
    labels, lost = labels.copy(), ~kept[piece]
    while lost.any():
        votes = np.zeros((len(labels), len(REGIONS)))
        settled = ~lost[links.col] & lost[links.row]
        np.add.at(votes, (links.row[settled], labels[links.col[settled]]), 1.0)
        reached = lost & (votes.sum(axis=1) > 0.0)
        labels[reached] = np.argmax(votes[reached], axis=1)
        lost &= ~reached
    return labels
