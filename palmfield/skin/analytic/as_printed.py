"""Formulas that papers print wrongly, each with its corrected form.

They reproduce the numbers of the papers; no other code in palmfield uses them. Complex moduli are E' - iE'' and
G' - iG'' (e^{-i w t}).
"""

import math
from dataclasses import replace

from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Branch, Material, bulk_from_poisson

# Mizushima & Sato 2024 (doi 10.18494/SAM5054): standard linear solid with spring E1 parallel to spring E2 and dashpot
# eta3 in series, moduli E1, E2 [Pa], eta3 [Pa s], all above 0; f [Hz] is the frequency of the vibration.


def sls_modulus(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> complex:
    """Complex modulus E' - iE'' [Pa] of their eqs 1 and 2, which are right: E1 + i w eta3 E2 / (E2 + i w eta3)."""
    rate = 2j * math.pi * f_Hz * eta3_Pa_s
    return (e1_Pa + rate * e2_Pa / (e2_Pa + rate)).conjugate()


def equivalent_modulus_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> float:
    """Their eq 4, E_d = (E1 E2 + eta3 f (E1 + E2)) / (E2 + eta3 f) [Pa], for E1 at a frequency.

    It is E1 + i w eta3 E2 / (E2 + i w eta3) with f in place of i w. With f for w the transition is a factor 2 pi too
    high. Without i two parts in quadrature add as if in phase, linear where eq 1 is quadratic in w.
    Corrected: `sls_modulus`, or its magnitude for one number.
    """
    return (e1_Pa * e2_Pa + eta3_Pa_s * f_Hz * (e1_Pa + e2_Pa)) / (e2_Pa + eta3_Pa_s * f_Hz)


def law_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> complex:
    """Complex modulus [Pa] of their eq 5: eq 3 with E_d for E1.

    E_d already holds what spring E2 and the dashpot add, and eq 5 adds it once more. Corrected: eq 3 itself, whose
    complex modulus is `sls_modulus`.
    """
    return sls_modulus(f_Hz, equivalent_modulus_as_printed(f_Hz, e1_Pa, e2_Pa, eta3_Pa_s), e2_Pa, eta3_Pa_s)


def vibration_modulus_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> float:
    """Stress over strain of their eq 6, E_d + E2 [Pa], with which they compute displacements.

    E2 is counted twice: at high frequency it tends to E1 + 2 E2 where the solid has E1 + E2, at low frequency to
    E1 + E2 where it has E1. Corrected: |sls_modulus|.
    """
    return equivalent_modulus_as_printed(f_Hz, e1_Pa, e2_Pa, eta3_Pa_s) + e2_Pa


def uniaxial_displacement(pressure_Pa: float, thickness_m: float, modulus_Pa: complex) -> float:
    """Amplitude P h / |E| [m] of a layer that may widen freely, as their eq 6 is used.

    A nearly incompressible layer bonded to its base moves far less:
    palmfield.skin.analytic.layer_oracle.centre_response.
    """
    return pressure_Pa * thickness_m / abs(modulus_Pa)


# Chilles et al. 2019 (doi 10.1109/WHC.2019.8816097): Ecoflex 00-10, sigma = sigma_1 + sigma_2 with sigma_1 = G_r eps.


def ecoflex_time_as_printed() -> Material:
    """Ecoflex 00-10 with their printed time, tau = 0.171 us.

    eta / G_m = 3.42 Pa s / 20 kPa is 171 us, a thousand times more: with the printed time the material shows no loss
    below 100 kHz. Corrected: preset 'ecoflex_00-10'.
    """
    right = preset("ecoflex_00-10")
    return replace(right, name="ecoflex_00-10, tau as printed", branches=(Branch(20e3, 0.171e-6),))


def ecoflex_bulk_corrected() -> Material:
    """Ecoflex 00-10 with nu 0.495 of the instantaneous modulus.

    Preset 'ecoflex_00-10' reads nu as printed, of the relaxed modulus: it softens in volume as it stiffens in shear, to
    nu 0.487 at once.
    """
    right = preset("ecoflex_00-10")
    bulk = bulk_from_poisson(0.495, right.shear_instant_Pa)
    return replace(right, name="ecoflex_00-10, nu with the instantaneous modulus", bulk_Pa=bulk)


def ecoflex_rate_law_as_printed() -> float:
    """Shear modulus [Pa] of Ecoflex 00-10 by their law as printed, eps' = sigma_1'/G_m + sigma_2'/eta.

    With sigma_1 = G_r eps it says sigma_2 = eta (1 - G_r/G_m) eps: a strain times Pa s is no stress, and, taken in SI
    numbers, the solid has the same modulus at all frequencies and no loss. Corrected: eps' = sigma_2'/G_m +
    sigma_2/eta, `complex_shear` of the preset.
    """
    material = preset("ecoflex_00-10")
    return material.shear_relaxed_Pa + left_over_viscosity(material)


def ecoflex_rate_law_mixed(f_Hz: float) -> complex:
    """Complex shear modulus [Pa] at f [Hz] of their law with its last dot treated as a misprint.

    eps' = sigma_1'/G_m + sigma_2/eta still has sigma_1 of the spring in the place of sigma_2 of the branch: G = G_r -
    i w eta (1 - G_r/G_m), a Kelvin-Voigt solid that never stiffens. Corrected as above.
    """
    material = preset("ecoflex_00-10")
    return complex(material.shear_relaxed_Pa, -2.0 * math.pi * f_Hz * left_over_viscosity(material))


def left_over_viscosity(material: Material) -> float:
    """eta (1 - G_r/G_m) of a standard linear solid [Pa s]."""
    branch = material.branches[0]
    return branch.shear_Pa * branch.time_s * (1.0 - material.shear_relaxed_Pa / branch.shear_Pa)
