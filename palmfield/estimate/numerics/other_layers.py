"""Change of the response of a skin with other cut faces and other materials, on the same mesh."""

from collections.abc import Sequence
from typing import TypeAlias

from palmfield.estimate.numerics.loudest_sound import LoudestSound
from palmfield.estimate.numerics.point_response import Response
from palmfield.skin.materials.sheet import Sheet
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

Ends: TypeAlias = tuple[tuple[Sheet, ...], tuple[Sheet, ...]]
"""The sheets of a layer with the ranges of their materials at the low ends, and at the high ends."""


def other_sides(layer: SceneLayer, sound: LoudestSound, point: Float) -> list[Response]:
    """The layer with other cut faces; None for a disc, which has no cut face."""
    if layer.config.shape == "disc":
        return []
    other = layer.resized(layer.resizing, side="free" if layer.config.side == "fixed" else "fixed")
    return [Response(other, sound.on(other), point)]


def held_anywhere(cut: Sequence[Response]) -> list[Response]:
    """The layers with a rest position: without base or side a layer flies away under a steady load."""
    return [other for other in cut if other.layer.config.base != "free" or other.layer.config.side == "fixed"]


def edge_error(own: Response, cut: Sequence[Response]) -> float:
    """Return half the change of the displacement at rest or of the harmonic one with other cut faces, the larger.

    All of it where only the cut faces hold the layer at rest.
    """
    held = held_anywhere(cut)
    if len(held) < len(cut):
        return 1.0
    changes = [abs(other.harmonic - own.harmonic) / abs(own.harmonic) for other in cut]
    changes += [abs(other.static - own.static) / abs(own.static) for other in held]
    return 0.5 * max(changes, default=0.0)


def other_materials(own: Response, ends: Ends | None) -> list[Response]:
    """Return a response with the material ranges at the soft and at the stiff ends; empty without any."""
    return [own.of(own.layer.resized(own.layer.resizing, sheets=sheets)) for sheets in ends or ()]


def material_band(own: Response, ends: Sequence[Response]) -> dict[str, float]:
    """Factors by which softer and stiffer materials change the displacement, static and harmonic together."""
    if not ends:
        return {}
    factors = [(abs(other.static) + abs(other.harmonic)) / (abs(own.static) + abs(own.harmonic)) for other in ends]
    return {"material_band_low": min(1.0, *factors), "material_band_high": max(1.0, *factors)}
