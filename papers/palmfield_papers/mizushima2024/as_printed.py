"""The law that Mizushima & Sato 2024 (doi 10.18494/SAM5054) print wrongly for their gel, with its corrected form.

A standard linear solid: spring E1 parallel to spring E2 and dashpot eta3 in series, E1, E2 [Pa], eta3 [Pa s], all above
0; f [Hz] is the frequency of the vibration. Complex moduli are E' - iE'' (e^{-i w t}).
"""

import math


def sls_modulus(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> complex:
    """Return the complex modulus E' - iE'' [Pa] of their correct eqs 1 and 2: E1 + i w eta3 E2 / (E2 + i w eta3)."""
    rate = 2j * math.pi * f_Hz * eta3_Pa_s
    return (e1_Pa + rate * e2_Pa / (e2_Pa + rate)).conjugate()


def equivalent_modulus_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> float:
    """Return their eq 4, E_d = (E1 E2 + eta3 f (E1 + E2)) / (E2 + eta3 f) [Pa], for E1 at a frequency.

    It is E1 + i w eta3 E2 / (E2 + i w eta3) with f in place of i w. With f for w the transition is a factor 2 pi too
    high. Without i two parts in quadrature add as if in phase, linear where eq 1 is quadratic in w.
    Corrected: `sls_modulus`, or its magnitude for one number.
    """
    return (e1_Pa * e2_Pa + eta3_Pa_s * f_Hz * (e1_Pa + e2_Pa)) / (e2_Pa + eta3_Pa_s * f_Hz)


def law_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> complex:
    """Return the complex modulus [Pa] of their eq 5: eq 3 with E_d for E1.

    E_d already includes spring E2 and the dashpot, and eq 5 adds them again. Corrected: eq 3 itself, whose
    complex modulus is `sls_modulus`.
    """
    return sls_modulus(f_Hz, equivalent_modulus_as_printed(f_Hz, e1_Pa, e2_Pa, eta3_Pa_s), e2_Pa, eta3_Pa_s)


def vibration_modulus_as_printed(f_Hz: float, e1_Pa: float, e2_Pa: float, eta3_Pa_s: float) -> float:
    """Return stress over strain of their eq 6, E_d + E2 [Pa], with which they compute displacements.

    E2 is counted twice: at high frequency it tends to E1 + 2 E2 instead of E1 + E2, at low frequency to
    E1 + E2 instead of E1. Corrected: |sls_modulus|.
    """
    return equivalent_modulus_as_printed(f_Hz, e1_Pa, e2_Pa, eta3_Pa_s) + e2_Pa


def uniaxial_displacement(pressure_Pa: float, thickness_m: float, modulus_Pa: complex) -> float:
    """Return the amplitude P h / |E| [m] of a layer with free sides, as in their eq 6.

    A nearly incompressible layer bonded to its base moves far less:
    palmfield.skin.analytic.layer_oracle.centre_response.
    """
    return pressure_Pa * thickness_m / abs(modulus_Pa)
