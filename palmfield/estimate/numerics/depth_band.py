"""Uncertainty of the displacement of a skin from the depth to the bone, which is not measured.

It uses the exact static and harmonic response of an infinite flat layer to the same spot, without a mesh.
"""

from typing import NamedTuple

import numpy as np

from palmfield.config.skin import OF_SHAPES
from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

DEPTHS_M = ((8e-3, 20e-3), (4e-3, 6e-3))
"""Depth to the bone on palms, and on the palmar side of fingers [m]: range over people and points (docs/hands.md)."""
DEPTHS = 5
"""Number of depths in a range: waves reflected by bone make the response vary with depth."""
GIVEN = 0.9
"""Fraction of key depth_m above which the depth of a layer counts as that of the scene; near rims it may be thinner."""
SETTLED = 1e-3
"""Relative error of the exact response."""


class DepthBand(NamedTuple):
    """own_m: depth of the layer at a point; least_m, most_m: range at such points; low, high: displacement factors"""

    own_m: float
    least_m: float
    most_m: float
    low: float
    high: float


def depth_band(layer: SceneLayer, point: Float) -> DepthBand | None:
    """Return the band of a layer at a point, body frame [m], shape (3,), for the nearer of DEPTHS_M.

    None for a disc or cylinder, if key depth_m sets the depth, and for bases other than bone. With several sheets the
    response is that of the material of the thickest sheet.
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
    except SceneError:  # raised for a layer without losses
        return None
    return DepthBand(own, least, most, float(min(moved) / moved[0]), float(max(moved) / moved[0]))
