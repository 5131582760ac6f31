"""The uncertainty of the displacement of a skin from the depth to the bone, which is not measured on any hand.

Uses the exact response of an endless flat layer to the same spot, at rest and at the main frequency, without a mesh.
"""

from typing import NamedTuple

import numpy as np

from palmfield.config.skin import OF_SHAPES
from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

DEPTHS_M = ((8e-3, 20e-3), (4e-3, 6e-3))
"""From skin to bone on palms, and on the palmar side of fingers [m], over people and places: docs/hands.md."""
DEPTHS = 5
"""Number of depths of a range: waves reflected by bones make the response rise and fall with depth."""
GIVEN = 0.9
"""Share of key depth_m above which a layer has the depth of the scene; near rims it may be somewhat thinner."""
SETTLED = 1e-3
"""Relative error of the exact response."""


class DepthBand(NamedTuple):
    """own_m: depth of the layer at a place; least_m, most_m: of such places; low, high: factors on the displacement"""

    own_m: float
    least_m: float
    most_m: float
    low: float
    high: float


def depth_band(layer: SceneLayer, point: Float) -> DepthBand | None:
    """Return the band of a layer at a point, body frame [m], shape (3,), for the nearer of DEPTHS_M.

    None of a disc or cylinder, where key depth_m sets the depth, and on other bases than bone. With several sheets the
    response is that of the material of the thickest one.
    """
    config, patch = layer.config, layer.patch
    shapes = (*OF_SHAPES["hand"], *OF_SHAPES["mesh"])
    if config.shape not in shapes or config.base not in ("bonded", "free_slip") or config.foundation is not None:
        return None
    own = float(patch.depth[np.linalg.norm(patch.vertices - point, axis=1).argmin()])
    if "depth_m" in config.model_fields_set and own >= GIVEN * config.depth_m:
        return None
    least, most = min(DEPTHS_M, key=lambda ends: abs(np.log(own / np.sqrt(ends[0] * ends[1]))))
    least, most = min(least, own), max(most, own)
    material = max(layer.sheets, key=lambda sheet: sheet.thickness_m).material
    frequencies = 0.0, layer.demand.main_frequency_Hz
    try:
        moved = [
            sum(
                abs(centre_response(f, material, depth, layer.demand.spot_fwhm_m, base=config.base, settled=SETTLED))
                for f in frequencies
            )
            for depth in (own, *np.geomspace(least, most, DEPTHS))
        ]
    except SceneError:  # of a layer without losses
        return None
    return DepthBand(own, least, most, float(min(moved) / moved[0]), float(max(moved) / moved[0]))
