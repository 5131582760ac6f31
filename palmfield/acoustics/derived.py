"""What follows from pressure and its gradient: velocity of the air's particles, and flow of energy."""

import numpy as np

from palmfield.acoustics import check
from palmfield.acoustics.air import density
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Complex, Field, Float


def particle_velocity(field: Field, air: Air, frequency_Hz: float) -> Complex:
    """Complex peak velocity u = grad p/(i w rho) [m/s], shape (n, 3), complex128: Euler's equation for e^{-iwt}.

    field: pressure with gradient, n points; frequency_Hz: the carrier
    Raises PalmfieldError for a field without gradient, SceneError for a frequency that is not positive and bad air.
    """
    if field.gradient is None:
        raise PalmfieldError("the field has no gradient, but velocity needs it: compute it with gradient=True")
    return field.gradient.astype(np.complex128) / (1j * angular_frequency(frequency_Hz) * density(air))


def intensity(field: Field, air: Air, frequency_Hz: float) -> Float:
    """Active intensity Re(p u*)/2 [W/m2], shape (n, 3): the energy that flows through an area, mean over a period.

    In lossless air its flux out of any closed surface without sources is zero. Arguments and errors: particle_velocity.
    """
    return (field.pressure[:, None] * particle_velocity(field, air, frequency_Hz).conj()).real / 2.0


def angular_frequency(frequency_Hz: float) -> float:
    """2 pi f [rad/s]. Raises SceneError for a frequency that is not positive and finite."""
    return 2.0 * np.pi * check.frequency(frequency_Hz)
