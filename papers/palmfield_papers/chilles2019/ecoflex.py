"""Law of Ecoflex 00-10 as Chilles et al. 2019 (doi 10.1109/WHC.2019.8816097) print it wrongly, with corrected forms.

The law is sigma = sigma_1 + sigma_2 with sigma_1 = G_r eps. Complex moduli are G' - iG'' (e^{-i w t}).
"""

import math
from dataclasses import replace

from palmfield.skin import Branch, Material, preset
from palmfield.skin.materials.material import bulk_from_poisson


def ecoflex_time_as_printed() -> Material:
    """Return Ecoflex 00-10 with the printed time, tau = 0.171 us.

    The correct value is eta / G_m = 3.42 Pa s / 20 kPa = 171 us, a thousand times more. With the printed time, the
    material has no loss below 100 kHz. Corrected: preset 'ecoflex_00-10'.
    """
    right = preset("ecoflex_00-10")
    return replace(right, name="ecoflex_00-10, tau as printed", branches=(Branch(20e3, 0.171e-6),))


def ecoflex_bulk_corrected() -> Material:
    """Return Ecoflex 00-10 with Poisson's ratio 0.495 for the instantaneous modulus.

    Preset 'ecoflex_00-10' uses the printed value for the relaxed modulus. Under fast loads the shear modulus then
    rises, and Poisson's ratio falls to 0.487.
    """
    right = preset("ecoflex_00-10")
    bulk = bulk_from_poisson(0.495, right.shear_instant_Pa)
    return replace(right, name="ecoflex_00-10, nu with the instantaneous modulus", bulk_Pa=bulk)


def ecoflex_rate_law_as_printed() -> float:
    """Return the shear modulus [Pa] of Ecoflex 00-10 by the printed law, eps' = sigma_1'/G_m + sigma_2'/eta.

    With sigma_1 = G_r eps, this gives sigma_2 = eta (1 - G_r/G_m) eps. A strain times Pa s is not a stress. With SI
    numbers, the solid would have the same modulus at all frequencies and no loss. Corrected: eps' = sigma_2'/G_m +
    sigma_2/eta, `complex_shear` of the preset.
    """
    material = preset("ecoflex_00-10")
    return material.shear_relaxed_Pa + left_over_viscosity(material)


def ecoflex_rate_law_mixed(f_Hz: float) -> complex:
    """Return the complex shear modulus [Pa] at f [Hz] of the printed law, if its last dot is a misprint.

    The law eps' = sigma_1'/G_m + sigma_2/eta still contains sigma_1 of the spring instead of sigma_2 of the branch. It
    gives G = G_r - i w eta (1 - G_r/G_m), a Kelvin-Voigt solid. Corrected as above.
    """
    material = preset("ecoflex_00-10")
    return complex(material.shear_relaxed_Pa, -2.0 * math.pi * f_Hz * left_over_viscosity(material))


def left_over_viscosity(material: Material) -> float:
    """Return eta (1 - G_r/G_m) of a standard linear solid [Pa s]."""
    branch = material.branches[0]
    return branch.shear_Pa * branch.time_s * (1.0 - material.shear_relaxed_Pa / branch.shear_Pa)
