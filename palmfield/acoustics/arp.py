"""Acoustic radiation pressure (ARP) of the incident field on skin, which is rigid for sound in air."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import density, sound_speed
from palmfield.device import resolve
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Field, Float32
from warp_kernels import arp as kernels

LAWS = {
    "default": "|p|^2/(rho c^2) - rho |u_t|^2 of the incident field's peak amplitudes on lit points: the Lagrangian of "
    "the total field on a rigid wall; right at any angle and on converging beams",
    "alpha": "2 p_rms^2/(rho c^2) on lit points: right for a plane wave at normal incidence, overstates focused beams",
}


def arp(
    field: Field, normals: ArrayLike, air: Air, frequency_Hz: float, *, law: str = "default", device: str = "auto"
) -> Float32:
    """Normal traction of the sound on a surface [Pa], shape (n,), positive when it pushes inwards.

    Lit points are those into which the incident sound flows, Re(p u*)/2 . n < 0 with u = grad p/(i w rho); elsewhere it
    is 0. The default law may be negative: grazing sound sucks.

    field: incident pressure and gradient, n points
    normals: unit outward normals of the surface, in the field's frame, shape (n, 3)
    law: a key of LAWS
    Raises SceneError for an unknown law or bad air, PalmfieldError for a field without gradient, for normals of another
    shape or length, and for a field that is not finite.
    """
    check_law(law)
    check.frequency(frequency_Hz)
    if field.gradient is None:
        raise PalmfieldError(
            "the field has no gradient, but radiation pressure needs it: compute it with gradient=True"
        )
    count = len(field.pressure)
    outward = unit_normals(normals, count)
    for name, values in (("pressure", field.pressure), ("gradient", field.gradient)):
        if not np.isfinite(values).all():
            raise PalmfieldError(f"field {name}[{check.first_bad(values)}] is not finite: mend the points or the drive")
    if count == 0:
        return np.zeros(0, np.float32)

    rho, c = density(air), sound_speed(air)
    device = resolve(device)
    pressure = np.ascontiguousarray(field.pressure, np.complex64).view(np.float32).reshape(count, 2)
    gradient = np.ascontiguousarray(field.gradient, np.complex64).view(np.float32).reshape(count, 3, 2)
    result = wp.empty(count, dtype=wp.float32, device=device)
    wp.launch(
        kernels.arp,
        dim=count,
        inputs=[
            wp.array(pressure, dtype=wp.vec2, device=device, copy=False),
            wp.array(gradient, dtype=wp.vec2, device=device, copy=False),
            wp.array(outward, dtype=wp.vec3, device=device, copy=False),
            1.0 / (rho * c**2),
            rho if law == "default" else 0.0,
            1.0 / (2.0 * np.pi * frequency_Hz * rho),
            result,
        ],
        device=device,
    )
    return result.numpy()


def check_law(law: str) -> None:
    """Raise SceneError for a law that is not in LAWS."""
    if law not in LAWS:
        raise SceneError(f"ARP law '{law}' is unknown: use one of {', '.join(LAWS)}")


def unit_normals(normals: ArrayLike, count: int) -> Float32:
    """The normals, shape (count, 3), float32. Raises PalmfieldError for another shape or length."""
    outward = np.ascontiguousarray(normals, dtype=np.float32)
    if outward.shape != (count, 3):
        raise PalmfieldError(f"normals have shape {outward.shape} but the field has {count} points: give ({count}, 3)")
    excess = np.abs(np.einsum("ij,ij->i", outward, outward) - 1.0)
    if not np.all(excess < 1e-3):
        i = int(np.argmin(excess < 1e-3))
        raise PalmfieldError(f"normals[{i}] = {outward[i].tolist()} is not a unit vector: divide it by its length")
    return outward
