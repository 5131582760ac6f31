"""Key `array_face`: distance from a rigid array face to a flat disc, and scenes that the key cannot represent."""

import math

from palmfield.acoustics.phased_array import BoardOutline
from palmfield.errors import SceneError
from palmfield.simulation.spec import ArraySpec, SceneSpec
from palmfield.types import Array

TILT_RAD = 5e-4
"""Largest accepted tilt.

With it, the path after two round trips is wrong by 1/70 wavelength at 60 mm from the middle.
"""


def wall_distance(spec: SceneSpec, array: Array) -> float:
    """Return the distance from the transducer plane to the disc [m], for a scene with a rigid array face.

    array: transducers of the first array, in its own frame.
    Raises SceneError, with the reason and the remedy, for scenes that image sources of the array cannot represent.
    """
    rigid = next(array for array in spec.arrays if array.config.array_face == "rigid")
    if len(spec.arrays) > 1:
        raise refused(rigid, f"the scene has {len(spec.arrays)} arrays", "one array")
    if len(spec.skins) > 1:
        raise refused(rigid, f"the scene has {len(spec.skins)} skins", "one skin, a disc")
    skin = spec.skins[0]
    if skin.config.shape != "disc":
        raise refused(rigid, f"skin '{skin.name}' has shape '{skin.config.shape}'", "shape disc, whose face is flat")
    if skin.config.body_sound != "none" or skin.obstacles:
        what = "obstacles" if skin.obstacles else f"body_sound '{skin.config.body_sound}'"
        raise refused(rigid, f"skin '{skin.name}' has {what}", "body_sound none and no obstacle")
    board = BoardOutline.of(array)
    if rigid.config.layout == "sites" or board.nearest is not None or array.normals[:, 2].min() < math.cos(TILT_RAD):
        raise refused(
            rigid, f"layout '{rigid.config.layout}' is not a flat face", "a layout with all transducers in one plane"
        )
    disc = skin.body.transform
    tilt = math.acos(max(-1.0, min(1.0, float(-disc.rotation[2, 2]))))
    if tilt > TILT_RAD:
        raise refused(
            rigid,
            f"body '{skin.config.body}' is tilted by {math.degrees(tilt):.3g} degrees relative to the array",
            f"a disc parallel to the board, to {math.degrees(TILT_RAD):.2g} degrees",
        )
    return float(disc.position[2]) - board.height


def refused(array: ArraySpec, why: str, allowed: str) -> SceneError:
    """Return the error for a rigid face that cannot be computed."""
    return SceneError(
        f"{array.element}: key 'array_face' has value 'rigid', but {why}; allowed: {allowed}; or set array_face to "
        "absorbing: the error budget then includes a band for the echo"
    )
