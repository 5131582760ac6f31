"""Compute the skin layers that a scene would have at the palm and the fingertips of a user's mesh."""

from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.chirality import Chirality, fingers_direction
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import DIGITS
from palmfield.hand.triangles import adjacency
from palmfield.types import Float, Surface

DEPTH_m = 0.02
"""Default of key depth_m of a skin."""
OF_A_MESH = 0.45
"""Largest layer depth in a scene as a share of the distance through the body, for meshes, which have no bones."""
PALM_RADIUS_m, TIP_RADIUS_m = 0.02, 0.008
EDGE_SHARE = 0.25
"""Edge length of the elements of small patches in scenes, as a share of their radius."""
TIP_PIECE_m, PAD_FROM_TIP_m = 0.015, 0.009


def scene_layers(surface: Surface, hand: Chirality, depth_m: float = DEPTH_m) -> list[dict[str, Any]]:
    """Return the layers under the palm and the pads of the digit tips that a scene of shape mesh or rigged would have.

    surface: closed mesh [m]; hand: its `chirality`; depth_m: key of the scene [m]
    Each layer has place ("palm", "thumb tip", ...), centre_mm, radius_mm, and the depths least_mm, p10_mm and mean_mm,
    or error if it folds. Digits have names if there are five tips, otherwise numbers.
    """
    places = [("palm", _out_of(surface, hand.middle, hand.palm), PALM_RADIUS_m)]
    names = DIGITS if len(hand.tips) == len(DIGITS) else [f"digit {n}" for n in range(1, len(hand.tips) + 1)]
    places += [
        (f"{name} tip", _pad(surface, hand, tip), TIP_RADIUS_m) for name, tip in zip(names, hand.tips, strict=True)
    ]
    return [_layer(surface, name, centre, radius, depth_m) for name, centre, radius in places]


def _layer(surface: Surface, place: str, centre: Float, radius_m: float, depth_m: float) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "place": place, "centre_mm": (1e3 * centre).round(2).tolist(), "radius_mm": 1e3 * radius_m,
    }  # fmt: skip
    edge = EDGE_SHARE * radius_m
    try:
        report = surface_patch(
            surface, depth_m, centre, radius_m, edge, edge, radius_m, max_depth_m=depth_m, max_fraction=OF_A_MESH
        ).report
    except SceneError as error:
        return facts | {"error": str(error)}
    depths = {name: round(1e3 * report[f"depth_got_{key}_m"], 3) for name, key in
              (("least_mm", "min"), ("p10_mm", "p10"), ("mean_mm", "mean"))}  # fmt: skip
    return facts | depths


def _out_of(surface: Surface, point: Float, out: Float) -> Float:
    """Return the point where a ray from inside leaves the body, shape (3,), or the vertex nearest to its origin."""
    reach = float(np.ptp(surface.vertices, axis=0).sum())
    way = float(exit_distances(surface.vertices, surface.faces, point[None], out[None], reach)[0])
    if np.isfinite(way):
        return point + way * out
    return surface.vertices[np.argmin(np.linalg.norm(surface.vertices - point, axis=1))]


def _pad(surface: Surface, hand: Chirality, tip: Float) -> Float:
    """Return the centre of the pad behind a fingertip, shape (3,): on the palmar side of the finger, also if bent."""
    near = np.flatnonzero(np.linalg.norm(surface.vertices - tip, axis=1) < TIP_PIECE_m)
    links = adjacency(surface.faces, len(surface.vertices))[near][:, near]
    label = sparse.csgraph.connected_components(links, directed=False)[1]
    own = label == label[np.argmin(np.linalg.norm(surface.vertices[near] - tip, axis=1))]
    middle = surface.vertices[near[own]].mean(axis=0)
    along = (tip - middle) / np.linalg.norm(tip - middle)
    straight = fingers_direction(surface.vertices, surface.faces)
    straight = straight - (straight @ hand.palm) * hand.palm
    bend = Rotation.align_vectors(along, straight / np.linalg.norm(straight))[0]
    palm = bend.apply(hand.palm)
    return _out_of(surface, middle + ((tip - middle) @ along - PAD_FROM_TIP_m) * along, palm)
