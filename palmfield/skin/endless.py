"""Tissue that goes on downwards without end, as the base of a layer."""

import math

from palmfield.skin.base import Foundation, Springs
from palmfield.skin.materials.material import Material, Sheet

HEIGHTS_M = (0.0053, 0.0095, 0.0172, 0.0311, 0.0563, 0.102)
"""Heights of the sheets of a half space [m]."""


def half_space(material: Material) -> Foundation:
    """Return a base on which the tissue goes on downwards without end.

    HEIGHTS_M of sheets with one point of integration each: the impedance at their top converges exponentially with
    their number for motion that decays with depth (Guddati & Tassoulas 2000, J. Comput. Acoust. 8:139). Shear waves end
    in dashpots below the lowest sheet (Lysmer & Kuhlemeyer 1969), and springs hold what rests on them. So all matrices
    are semi-definite: the base never gives energy. Heights and factors are fitted to Gaussian spots of 10.3 mm on
    palm, forearm and ecoflex_00-10, 6 and 20 mm deep, at 0.5 to 1000 Hz. Along the normal, rho c_p would hold the skin
    like bone; so pressure waves, which need a load much wider than a hand, are reflected.
    """
    speed = math.sqrt(material.shear_instant_Pa / material.density_kg_m3)
    spring, dashpot = material.shear_relaxed_Pa / sum(HEIGHTS_M), material.density_kg_m3 * speed
    below = Springs(2.0 * spring, spring, 5.1 * dashpot, dashpot)
    return Foundation(tuple(Sheet(material, height) for height in HEIGHTS_M), below, 0, walled=True)
