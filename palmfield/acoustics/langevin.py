"""Radiation stress of any sound field in air, and the force on the bodies inside a closed surface."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import density, sound_speed
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Field, Float


def radiation_stress(field: Field, air: Air, frequency_Hz: float) -> Float:
    """Return the time-averaged momentum flux [Pa], shape (n, 3, 3): entry (i, j) is the flux of i-momentum along j.

    Brillouin's tensor, to second order: (<p^2>/(2 rho c^2) - rho <u^2>/2) I + rho <u u>. With peak amplitudes it is
    (|p|^2/(4 rho c^2) - rho |u|^2/4) I + (rho/2) Re(u u*^T), u = grad p/(i w rho). In a travelling plane wave it is
    E = |p|^2/(2 rho c^2) along the direction of the wave and 0 across it.

    field: total pressure and gradient, n points
    Raises PalmfieldError for a field without gradient, SceneError for a frequency that is not positive and bad air.
    """
    if field.gradient is None:
        raise PalmfieldError(
            "the field has no gradient, which radiation stress needs: compute the field with gradient=True"
        )
    check.frequency(frequency_Hz)
    rho, c = density(air), sound_speed(air)
    pressure = field.pressure.astype(np.complex128)
    velocity = field.gradient.astype(np.complex128) / (2j * np.pi * frequency_Hz * rho)
    speed_squared = (np.abs(velocity) ** 2).sum(axis=1)
    lagrangian = np.abs(pressure) ** 2 / (4.0 * rho * c**2) - rho * speed_squared / 4.0
    flux = 0.5 * rho * np.real(velocity[:, :, None] * velocity[:, None, :].conj())
    return lagrangian[:, None, None] * np.eye(3) + flux


def radiation_force(field: Field, normals: ArrayLike, areas: ArrayLike, air: Air, frequency_Hz: float) -> Float:
    """Return the force on the bodies inside a closed surface [N], shape (3,): minus the outward momentum flux.

    In lossless air all surfaces around the same bodies give the same force.

    field: total sound at the centre of each surface element, n points
    normals: unit, outward, shape (n, 3); areas: areas or quadrature weights [m2], shape (n,)
    Raises like `radiation_stress`, and PalmfieldError for normals or areas of another length.
    """
    outward, weight = np.asarray(normals, dtype=float), np.asarray(areas, dtype=float)
    count = len(field.pressure)
    if outward.shape != (count, 3) or weight.shape != (count,):
        raise PalmfieldError(
            f"normals of shape {outward.shape} and areas of shape {weight.shape} for {count} points: "
            f"give ({count}, 3) and ({count},)"
        )
    return -np.einsum("nij,nj,n->i", radiation_stress(field, air, frequency_Hz), outward, weight)
