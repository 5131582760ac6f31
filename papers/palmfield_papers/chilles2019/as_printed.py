"""The wrongly printed formula for radiation pressure of Chilles et al. 2019, with its corrected form."""

import numpy as np

from palmfield.acoustics import check, density, sound_speed
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Field, Float


def incident_lagrangian_as_printed(field: Field, air: Air, frequency_Hz: float) -> Float:
    """Return the pressure by the formula of Chilles et al. 2019 (doi 10.1109/WHC.2019.8816097) [Pa], shape (n,).

    The formula is <p^2>/(2 rho c^2) - rho <u.u>/2. The paper prints u^2.u for u.u. It applies the formula to the
    incident sound, without the echo, as a load on the skin. In a travelling wave the two terms are equal, so a plane
    wave exerts no pressure. At a focus, its convergence causes a difference: 2.3 % of the correct pressure, with their
    array at 200 mm. On a rigid wall the formula is correct for the total field; the pressure of a plane wave is then 2
    <p^2>/(rho c^2) of its incident field. Corrected: `palmfield.acoustics.arp.arp`, law default.

    field: incident pressure [Pa], shape (n,), and gradient [Pa/m], shape (n, 3), peak amplitudes
    air: in the paper, rho is 1.225 kg/m3 and c is 343 m/s
    Raises PalmfieldError for a field without gradient or with values that are not finite, SceneError for invalid air or
    frequency.
    """
    check.frequency(frequency_Hz)
    if field.gradient is None:
        raise PalmfieldError(
            "the field has no gradient, which the velocity needs: compute the field with gradient=True"
        )
    for name, values in (("pressure", field.pressure), ("gradient", field.gradient)):
        if not np.isfinite(values).all():
            raise PalmfieldError(
                f"field {name}[{check.first_bad(values)}] is not finite: correct the points or the drive"
            )
    rho, c = density(air), sound_speed(air)
    speed = np.linalg.norm(field.gradient.astype(np.complex128), axis=1) / (2.0 * np.pi * frequency_Hz * rho)
    return np.asarray(np.abs(field.pressure.astype(np.complex128)) ** 2 / (4.0 * rho * c**2) - rho * speed**2 / 4.0)
