"""Baffled piston: 2 J1(x)/x, x = k b sin(angle)."""

import numpy as np

from palmfield.acoustics.directivity import Directivity
from palmfield.acoustics.polynomials import piston
from palmfield.types import Array, Float


class Piston(Directivity):
    name = "piston"
    misfit = 2e-6  # up to kb of about 4.5
    sized = True

    def level(self, s: Float, kb: float) -> Float:
        return piston(kb * np.sqrt(s))

    def words(self, array: Array) -> str:
        radius = array.piston_radius_m
        return "point sources" if radius == 0.0 else f"pistons with a radius of {1e3 * radius:g} mm"


FORM = Piston()
