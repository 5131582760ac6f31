"""Region of a hand preset in which a point of its skin lies, from labels that are computed once per preset."""

from functools import lru_cache

import numpy as np
import scipy  # loads its parts at first use
from numpy.typing import NDArray

from palmfield import cache
from palmfield.hand.articulated import articulate
from palmfield.hand.labels import PALM_AREAS, REGIONS, region_labels
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.types import Float, Int


def region_at(hand: str, point: Float) -> str:
    """Return the region (`palmfield.hand.labels.REGIONS`) of a hand in which a point of its skin lies.

    hand: name of a preset, or file; point: point in the hand frame, at rest [m], shape (3,)
    """
    return regions_at(hand, point[None])[0]


def regions_at(hand: str, points: Float) -> list[str]:
    """Return `region_at` for several points [m], shape (n, 3)."""
    vertices, labels = _labelled(hand)
    return [REGIONS[int(number)] for number in labels[scipy.spatial.cKDTree(vertices).query(points)[1]]]


def part_of(region: str) -> str | None:
    """Return the part of the glabrous skin with a region: palm, finger or fingertip; None for other skin."""
    if region in PALM_AREAS or region.endswith("_web"):
        return "palm"
    if region.endswith("_pulp"):
        return "fingertip"
    return "finger" if region.endswith("_palmar") else None


def glabrous(hand: str) -> NDArray[np.bool_]:
    """Return whether each vertex of `hand_surface` of a preset is on a part of the glabrous skin, shape (n,)."""
    return np.array([part_of(name) is not None for name in REGIONS])[_labelled(hand)[1]]


@lru_cache(maxsize=8)
def _labelled(hand: str) -> tuple[Float, Int]:
    """Return the vertices of a hand [m], shape (n, 3), and the region number of each, shape (n,)."""
    preset = load_preset(hand)

    def made() -> cache.Arrays:
        surface = hand_surface(preset).surface
        return {"vertices": surface.vertices, "labels": region_labels(articulate(preset), surface)[1]}

    kept = cache.kept("regions", (preset,), made)
    return kept["vertices"], kept["labels"]
