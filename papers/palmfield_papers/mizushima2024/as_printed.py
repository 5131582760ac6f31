"""Wrongly printed law of Mizushima & Sato 2024 (doi 10.18494/SAM5054) for their gel, with its corrected form.

The material is a standard linear solid: spring E1 parallel to spring E2 and dashpot eta3 in series. E1, E2 [Pa] and
eta3 [Pa s] are above 0; f [Hz] is the frequency of the vibration. Complex moduli are E' - iE'' (e^{-i w t}).
"""

import math


def sls_modulus(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> complex:
    """Return the complex modulus E' - iE'' [Pa] of the correct eqs 1 and 2: E1 + i w eta3 E2 / (E2 + i w eta3)."""
    rate = 2j * math.pi * f_Hz * eta3_Pa_s
    return (e1_Pa + rate * e2_Pa / (e2_Pa + rate)).conjugate()


def equivalent_modulus_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> float:
    """Return eq 4 of the paper, E_d = (E1 E2 + eta3 f (E1 + E2)) / (E2 + eta3 f) [Pa], used for E1 at a frequency.

    It is E1 + i w eta3 E2 / (E2 + i w eta3) with f in place of i w. With f instead of w, the transition frequency is
    too high by a factor 2 pi. Without i, two parts in quadrature are added as if they were in phase. So eq 4 is linear
    in w where eq 1 is quadratic.
    Corrected: `sls_modulus`, or its magnitude for one number.
    """
    return (e1_Pa * e2_Pa + eta3_Pa_s * f_Hz * (e1_Pa + e2_Pa)) / (e2_Pa + eta3_Pa_s * f_Hz)


def law_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> complex:
    """Return the complex modulus [Pa] of eq 5 of the paper: eq 3 with E_d for E1.

    E_d already includes spring E2 and the dashpot, and eq 5 adds them again. Corrected: eq 3 itself, whose complex
    modulus is `sls_modulus`.
    """
    return sls_modulus(f_Hz, equivalent_modulus_as_printed(f_Hz, e1_Pa, e2_Pa, eta3_Pa_s), e2_Pa, eta3_Pa_s)


def vibration_modulus_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> float:
    """Return stress over strain of eq 6 of the paper, E_d + E2 [Pa], which the authors use for displacements.

    E2 is counted twice. At high frequency the result tends to E1 + 2 E2 instead of E1 + E2, and at low frequency to E1
    + E2 instead of E1. Corrected: |sls_modulus|.
    """
    return equivalent_modulus_as_printed(f_Hz, e1_Pa, e2_Pa, eta3_Pa_s) + e2_Pa


def uniaxial_displacement(pressure_Pa: float, thickness_m: float, modulus_Pa: complex) -> float:
    """Return the amplitude P h / |E| [m] of a layer with free sides, as in eq 6 of the paper.

    A nearly incompressible layer bonded to its base moves far less:
    palmfield.skin.analytic.layer_oracle.centre_response.
    """
    return pressure_Pa * thickness_m / abs(modulus_Pa)
