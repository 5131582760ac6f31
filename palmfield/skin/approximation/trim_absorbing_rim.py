"""Smaller part of a layer, to estimate the reflection of absorbing sides, and a check of the direction of its face."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from palmfield.hand.remesh import outward
from palmfield.hand.triangles import face_components
from palmfield.skin.approximation.load_scales import load_centre
from palmfield.skin.approximation.truncate_domain import part_of
from palmfield.skin.problem import Body, Layer, Load, Spot
from palmfield.types import Float

FLATTEST = 0.5
"""Least |z component| of the mean outward direction of a patch under a spot, because a spot is defined in x and y."""


def refusal_of_spot(body: Body, load: Load) -> str | None:
    """Return the reason why a spot cannot act on this layer, in a sentence, or None."""
    if not isinstance(body, Layer) or not isinstance(load, Spot):
        return None
    if not body.patch.rim.any() or abs(outward(body.patch)[2]) < FLATTEST:
        return (
            "a Spot is defined in x and y, but the normal of this layer is not along z: rotate the patch, or give "
            "pressures at points (Traction)"
        )
    return None


def trim_absorbing_rim(body: Body, load: Load, points: Float, reach: float) -> Body:
    """Return a layer without a belt along its rim; other bodies are unchanged.

    The width of the belt is (1 - reach) of the distance from the middle of the load to the rim. It is at most half of
    the distance from load or requested points (n, 3) to the rim. A layer without room for a belt is unchanged."""
    if reach == 1.0 or not isinstance(body, Layer):
        return body
    patch = body.patch
    rim = cKDTree(patch.vertices[patch.rim, :2])
    pressed = load.centres() if isinstance(load, Spot) else load.points[np.any(load.pressure_Pa != 0.0, axis=0), :2]
    room = float(rim.query(np.concatenate([pressed, points[:, :2]]))[0].min())
    width = min((1.0 - reach) * float(rim.query(load_centre(load)[0])[0]), 0.5 * room)
    kept = rim.query(patch.vertices[patch.faces].mean(axis=1)[:, :2])[0] > width
    if kept.all() or not kept.any() or face_components(patch.faces[kept]).max() > 0:
        return body
    return replace(body, patch=part_of(patch, kept))
