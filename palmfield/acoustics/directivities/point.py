"""Point source in the baffle, with the same amplitude in all directions."""

from dataclasses import replace

import numpy as np

from palmfield.acoustics.directivity import Directivity
from palmfield.types import Array, Float


class Point(Directivity):
    name = "point"

    def level(self, s: Float, kb: float) -> Float:
        return np.ones_like(s)

    def of(self, array: Array) -> Array:
        return replace(super().of(array), piston_radius_m=0.0)

    def words(self, array: Array) -> str:
        return "point sources"


FORM = Point()
