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


def edge_error(own: Response, cut: Sequence[Response]) -> tuple[float, float]:
    """Return half of the change with other cut faces, of the first point, of its displacement and of its velocity.

    It is the larger one of the static and harmonic displacement; for the velocity, that of the harmonic one. Both are 1
    if only the cut faces support the layer.
    """
    supported = held_anywhere(cut)
    if len(supported) < len(cut):
        return 1.0, 1.0
    swung = [abs(other.harmonic - own.harmonic)[0] / abs(own.harmonic)[0] for other in cut]
    still = [abs(other.static - own.static)[0] / abs(own.static)[0] for other in supported]
    return 0.5 * max([*swung, *still], default=0.0), 0.5 * max(swung, default=0.0)


def other_materials(own: Response, ends: Ends | None) -> list[Response]:
    """Return responses with all material ranges at the soft and at the stiff ends; empty without ranges."""
    return [own.of(own.layer.altered(sheets=sheets)) for sheets in ends or ()]


def material_band(own: Response, ends: Sequence[Response]) -> dict[str, float]:
    """Return the range of factors of the first displacement, static and harmonic, for softer and stiffer materials."""
    if not ends:
        return {}
    size, *sizes = ((abs(each.static) + abs(each.harmonic))[0] for each in (own, *ends))
    factors = [float(other / size) for other in sizes]
    return {"material_band_low": min(1.0, *factors), "material_band_high": max(1.0, *factors)}
