"""Sound that goes back and forth between the rigid face of an array and a flat rigid wall in front of it.

Both are taken as endless planes with reflection 1. The sound at the wall after m round trips is then the sound of the
array moved back by 2 m distances: its image, all of whose sound comes from the side of the array.
"""

import math

import numpy as np

from palmfield.acoustics.air import absorption_Np_m
from palmfield.errors import SceneError
from palmfield.types import Air, Float

REST = 2e-3
"""Bound on the pressure of all images that are left out, as a share of what all transducers at full drive would give
at the wall if each were straight below the point."""
MOST_IMAGES = 400


def rest_beyond(images: int, absorption_Np_m: float, distance_m: float) -> float:
    """Bound on what the images beyond some number add, as a share as REST has it.

    Image m is at least 2 m + 1 distances away, and its sound in the worst case all in phase.
    """
    loss = 2.0 * absorption_Np_m * distance_m
    return math.exp(-loss * (images + 1)) / ((2 * images + 3) * -math.expm1(-loss))


def image_count(air: Air, frequency_Hz: float, distance_m: float) -> int:
    """Number of images that leave out less than REST.

    Raises SceneError for more than MOST_IMAGES: where air takes too little on so short a way.
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
    """Places of the images of an array, from the array itself [m], shape (images, 3).

    distance_m: from the plane of the transducers to the wall; outward: unit normal of that plane, shape (3,)
    Raises SceneError as `image_count`.
    """
    numbers = np.arange(1, image_count(air, frequency_Hz, distance_m) + 1)
    return np.asarray(-2.0 * distance_m * numbers[:, None] * outward)
