"""Change of the response of a skin with other cut faces and other materials, on the same mesh."""

from collections.abc import Sequence
from typing import TypeAlias

from palmfield.estimate.numerics.loudest_sound import LoudestSound
from palmfield.estimate.numerics.point_response import Response
from palmfield.skin.materials.material import Sheet
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

Ends: TypeAlias = tuple[tuple[Sheet, ...], tuple[Sheet, ...]]
"""Sheets of a layer with all material ranges at the low ends, and at the high ends."""


def other_sides(layer: SceneLayer, sound: LoudestSound, point: Float) -> list[Response]:
    """Return responses of the layer with other cut faces; empty for a disc, which has no cut face."""
    if layer.config.shape == "disc":
        return []
    other = layer.altered(side="free" if layer.config.side == "fixed" else "fixed")
    return [Response(other, sound.on(other), point)]


def held_anywhere(cut: Sequence[Response]) -> list[Response]:
    """Return the layers with a rest position: without base or side support a steady load moves a layer away."""
    return [other for other in cut if other.layer.config.base != "free" or other.layer.config.side == "fixed"]


def edge_error(own: Response, cut: Sequence[Response]) -> float:
    """Return half of the larger change of the static or harmonic displacement with other cut faces.

    The result is 1 if only the cut faces support the layer.
    """
    supported = held_anywhere(cut)
    if len(supported) < len(cut):
        return 1.0
    changes = [abs(other.harmonic - own.harmonic) / abs(own.harmonic) for other in cut]
    changes += [abs(other.static - own.static) / abs(own.static) for other in supported]
    return 0.5 * max(changes, default=0.0)


def other_materials(own: Response, ends: Ends | None) -> list[Response]:
    """Return responses with all material ranges at the soft and at the stiff ends; empty without ranges."""
    return [own.of(own.layer.altered(sheets=sheets)) for sheets in ends or ()]


def material_band(own: Response, ends: Sequence[Response]) -> dict[str, float]:
    """Return the range of factors of the displacement, static and harmonic, for softer and stiffer materials."""
    if not ends:
        return {}
    factors = [(abs(other.static) + abs(other.harmonic)) / (abs(own.static) + abs(own.harmonic)) for other in ends]
    return {"material_band_low": min(1.0, *factors), "material_band_high": max(1.0, *factors)}
