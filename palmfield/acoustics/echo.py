"""Multiple reflections between the rigid face of an array and a flat rigid wall in front of it.

Both are modelled as infinite planes with reflection 1. After m round trips, the sound at the wall is then the sound of
an image of the array, farther back by 2 m times the distance.
"""

import math

import numpy as np

from palmfield.acoustics.air import absorption_Np_m
from palmfield.errors import SceneError
from palmfield.types import Air, Float

REST = 2e-3
"""Bound on the pressure of all omitted images, relative to the pressure at the wall of all transducers at full drive if
each of them were straight above the point."""
MOST_IMAGES = 400


def rest_beyond(images: int, absorption_Np_m: float, distance_m: float) -> float:
    """Return a bound of the pressure of all images after a number of them, relative to the same value as REST.

    Image m is at least 2 m + 1 distances away; in the worst case all sound is in phase.
    """
    loss = 2.0 * absorption_Np_m * distance_m
    return math.exp(-loss * (images + 1)) / ((2 * images + 3) * -math.expm1(-loss))


def image_count(air: Air, frequency_Hz: float, distance_m: float) -> int:
    """Return the number of images for which the omitted pressure is below REST.

    Raises SceneError if more than MOST_IMAGES are needed, as for short distances with little absorption.
    """
    absorption = absorption_Np_m(air, frequency_Hz)
    for images in range(MOST_IMAGES + 1):
        if rest_beyond(images, absorption, distance_m) <= REST:
            return images
    raise SceneError(
        f"the echo between a rigid array face and a disc at {1e3 * distance_m:.3g} mm, with absorption "
        f"{absorption:.3g} Np/m, takes more than {MOST_IMAGES} round trips to decay: move the disc farther away, "
        "or use an absorbing face"
    )


def image_shifts(air: Air, frequency_Hz: float, distance_m: float, outward: Float) -> Float:
    """Return the offsets of the images from the array [m], shape (images, 3).

    distance_m: distance from the plane of the transducers to the wall; outward: unit normal of that plane, shape (3,)
    Raises SceneError like `image_count`.
    """
    numbers = np.arange(1, image_count(air, frequency_Hz, distance_m) + 1)
    return np.asarray(-2.0 * distance_m * numbers[:, None] * outward)
