"""Displacement of a skin with other tissue below its layer: bone, the deepest material, or muscle, without end.

It uses the static and harmonic response of an infinite flat layer to the same spot, without a mesh.
"""

import math
from collections.abc import Sequence

import numpy as np

from palmfield.config.skin import ENDLESS, OF_SHAPES
from palmfield.hand.preset import DIGITS, load_preset
from palmfield.hand.surface import bone_distance, centred_skeleton
from palmfield.skin.base import Base, Foundation
from palmfield.skin.fem.depth import condensed, impedance, on_impedance
from palmfield.skin.from_config import base_of
from palmfield.skin.materials.material import Sheet
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Complex, Float

ALTERNATIVES = ("bonded", *ENDLESS)
"""Bases between which tissue below a layer lies, by key `base`; muscle is the last."""
PANELS, POINTS = 16, 8
"""Panels of wavenumbers, growing geometrically, and Gauss points in each."""


def base_band(layer: SceneLayer) -> dict[str, float] | None:
    """Return the displacement under a spot on each of ALTERNATIVES, relative to the base of the layer.

    The depth is that at the middle of the layer; the response is the sum at rest and at the main frequency. None for a
    disc or cylinder, a free base, springs and key foundation_normal_Pa_m. Below fingers there is no muscle.
    """
    config, patch, demand = layer.config, layer.patch, layer.demand
    shapes = (*OF_SHAPES["hand"], *OF_SHAPES["mesh"])
    if config.shape not in shapes or config.foundation or config.base not in ("free_slip", *ALTERNATIVES):
        return None
    own = float(patch.depth[np.linalg.norm(patch.vertices - layer.centre_m, axis=1).argmin()])
    sheets = [Sheet(sheet.material, own * sheet.thickness_m) for sheet in layer.sheets]
    others = ALTERNATIVES[:-1] if on_finger(layer) else ALTERNATIVES
    names = dict.fromkeys((config.base, *others))
    bases = [base_of(config.model_copy(update={"base": name}), layer.sheets) for name in names]
    still, moving = (responses(sheets, demand.spot_fwhm_m, f, bases) for f in (0.0, demand.main_frequency_Hz))
    of = dict(zip(names, still + moving, strict=True))
    return {name: float(of[name] / of[config.base]) for name in others}


def on_finger(layer: SceneLayer) -> bool:
    """Return whether a layer is on a hand, and the bone nearest to its middle is that of a finger.

    `palmfield.hand.regions` would need the labels of the whole surface, which a plan does not compute.
    """
    if layer.config.shape not in OF_SHAPES["hand"]:
        return False
    bones = centred_skeleton(load_preset(layer.config.hand)).bones
    nearest = min(bones, key=lambda bone: float(bone_distance(layer.centre_m[None], [bone])[0]))
    digit, _, part = nearest.name.partition("_")
    return digit in DIGITS and part != "metacarpal"


def responses(sheets: Sequence[Sheet], fwhm_m: float, f_Hz: float, bases: Sequence[Base]) -> Float:
    """Return the displacement at the centre of a Gaussian spot of 1 Pa [m], its amplitude at f_Hz, on each base, (b,).

    sheets: an infinite flat layer. A half space is within 2 % (docs/skin.md), the others are exact.
    """
    width = fwhm_m / math.sqrt(8.0 * math.log(2.0))
    nodes, rule = np.polynomial.legendre.leggauss(POINTS)
    edges = np.geomspace(0.02, 5.0, PANELS + 1) / width
    half = 0.5 * np.diff(edges)[:, None]
    k = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes).ravel()
    weights = (half * rule).ravel() * k * width**2 * np.exp(-0.5 * (k * width) ** 2)

    def compliance(base: Base) -> Complex:
        if isinstance(base, Foundation):
            below = impedance(k, f_Hz, base.sheets, base.base, base.degree)
            return on_impedance(condensed(k, f_Hz, sheets), below)
        return np.linalg.inv(impedance(k, f_Hz, sheets, base))[:, 1, 1].astype(complex)

    return np.array([abs(weights @ compliance(base)) for base in bases])
