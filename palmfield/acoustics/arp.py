"""Laws of the acoustic radiation pressure (ARP) on skin, which is rigid for sound in air.

`warp_kernels.arp` evaluates the formula in kernels, with the weights of a law.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import density, sound_speed
from palmfield.device import resolve, run_kernel
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Complex, Field, Float, Float32
from warp_kernels import arp as kernels


class SurfaceSound(NamedTuple):
    """The sound at points of a surface.

    arp: radiation pressure [Pa], positive when it pushes inwards, shape (n,)
    amplitude: peak of the pressure, |p| [Pa], shape (n,)
    flux: Im(p* grad p) [Pa2/m], along the energy flow, shape (n, 3), or None
    """

    arp: Float32
    amplitude: Float32
    flux: Float32 | None = None


@dataclass(frozen=True)
class ArpLaw:
    """ARP = pressure |p|^2/(rho c^2) - along rho |u_t|^2 + across rho |u_n|^2, with peak amplitudes of the field.

    about: description; u_t, u_n: velocity along the surface and along the normal
    """

    about: str
    pressure: float = 1.0
    along: float = 0.0
    across: float = 0.0


LAWS = {
    "default": ArpLaw(
        "|p|^2/(rho c^2) - rho |u_t|^2 of the incident field's peak amplitudes on lit points: the Lagrangian of "
        "the total field on a rigid wall; correct at any angle and for converging beams",
        along=1.0,
    ),
    "alpha": ArpLaw(
        "2 p_rms^2/(rho c^2) on lit points: exact for a plane wave at normal incidence; overstates focused beams"
    ),
}
"""Laws for the incident field, by the value of key `arp_law` of a scene. A new law is a new entry."""

ALPHA_RANGE = 1.0, 2.0
"""Range of the factor alpha, from a fully absorbing to a fully reflecting wall."""

TOTAL_FIELD = ArpLaw(
    "|p|^2/(4 rho c^2) - rho |u_t|^2/4 of the total field's peak amplitudes on a rigid wall, lit or not: the mean "
    "Lagrangian <p^2>/(2 rho c^2) - rho <u^2>/2",
    pressure=0.25,
    along=0.25,
)
"""Law for a total field, which includes the reflection from the body, as from boundary elements."""


def arp(
    field: Field,
    normals: ArrayLike,
    air: Air,
    frequency_Hz: float,
    *,
    law: str | ArpLaw = "default",
    device: str = "auto",
) -> Float32:
    """Return the normal traction of the sound on a surface [Pa], shape (n,), positive inwards.

    It is 0 except at lit points, where the incident sound flows into the surface: Re(p u*)/2 . n < 0, u = grad p/(i w
    rho). The default law gives negative values for grazing sound.

    field: incident pressure and gradient, n points.
    normals: unit outward normals of the surface, in the frame of the field, shape (n, 3).
    law: a key of LAWS or an ArpLaw, for example by `alpha_law`. device: device of the computation.
    Raises SceneError for an unknown law or bad air. Raises PalmfieldError for a field without gradient, for normals of
    another shape or length, and for a field that is not finite.
    """
    law = law_named(law)
    check.frequency(frequency_Hz)
    if field.gradient is None:
        raise PalmfieldError(
            "the field has no gradient, which radiation pressure needs: compute the field with gradient=True"
        )
    count = len(field.pressure)
    outward = unit_normals(normals, count)
    for name, values in (("pressure", field.pressure), ("gradient", field.gradient)):
        if not np.isfinite(values).all():
            raise PalmfieldError(
                f"field {name}[{check.first_bad(values)}] is not finite: correct the points or the drive"
            )
    if count == 0:
        return np.zeros(0, np.float32)

    device = resolve(device)
    pressure = np.ascontiguousarray(field.pressure, np.complex64).view(np.float32).reshape(count, 2)
    gradient = np.ascontiguousarray(field.gradient, np.complex64).view(np.float32).reshape(count, 3, 2)
    result = wp.empty(count, dtype=wp.float32, device=device)
    run_kernel(
        kernels.arp,
        dim=count,
        inputs=[
            wp.array(pressure, dtype=wp.vec2, device=device, copy=False),
            wp.array(gradient, dtype=wp.vec2, device=device, copy=False),
            wp.array(outward, dtype=wp.vec3, device=device, copy=False),
            sound_speed(air) / (2.0 * np.pi * frequency_Hz),
            wp.vec3(*law_weights(law, air)),
            result,
        ],
        device=device,
    )
    return result.numpy()


@lru_cache(maxsize=64)
def law_weights(law: str | ArpLaw, air: Air) -> tuple[float, float, float]:
    """Return the weights of |p|^2, of -|grad p/k|^2 along the surface and of |grad p/k|^2 across it [1/Pa].

    Raises SceneError for an unknown law or bad air.
    """
    kind, scale = law_named(law), 1.0 / (density(air) * sound_speed(air) ** 2)
    return scale * kind.pressure, scale * kind.along, scale * kind.across


def wall_pressure(pressure: Complex, gradient: Complex, wavenumber: float, air: Air) -> Float:
    """Return the ARP [Pa], shape (n,), of the total field on a rigid wall, by the law TOTAL_FIELD.

    pressure: [Pa], shape (n,); gradient: along the wall [Pa/m], shape (n, 3); wavenumber: [rad/m]
    """
    scale = 1.0 / (density(air) * sound_speed(air) ** 2)
    along = (np.abs(gradient) ** 2).sum(axis=1) / wavenumber**2
    return np.asarray(scale * (TOTAL_FIELD.pressure * np.abs(pressure) ** 2 - TOTAL_FIELD.along * along))


def law_named(law: str | ArpLaw) -> ArpLaw:
    """Return the law of this name, or the argument if it is a law. Raises SceneError for a name not in LAWS."""
    if isinstance(law, ArpLaw):
        return law
    if law not in LAWS:
        raise SceneError(f"ARP law '{law}' is unknown: use one of {', '.join(LAWS)}")
    return LAWS[law]


def alpha_law(alpha: float) -> ArpLaw:
    """Return the law ARP = alpha p_rms^2/(rho c^2) on lit points, eq 1 of Hasegawa & Shinoda 2018.

    alpha: 1 + R for skin with energy reflectance R, 1 to 2; 2 is LAWS["alpha"]
    Raises SceneError for an alpha outside 1..2.
    """
    least, most = ALPHA_RANGE
    if not least <= alpha <= most:
        raise SceneError(
            f"alpha of the ARP law is {alpha:g}; allowed: {least:g} (no reflection) to {most:g} (full reflection)"
        )
    if alpha == most:
        return LAWS["alpha"]
    return ArpLaw(
        f"{alpha:g} p_rms^2/(rho c^2) on lit points: exact for a plane wave at normal incidence on skin that "
        f"reflects {100.0 * (alpha - 1.0):.3g} % of its energy; overstates focused beams",
        pressure=0.5 * alpha,
    )


def unit_normals(normals: ArrayLike, count: int) -> Float32:
    """Return the normals as float32, shape (count, 3). Raises PalmfieldError for another shape or length."""
    outward = np.ascontiguousarray(normals, dtype=np.float32)
    if outward.shape != (count, 3):
        raise PalmfieldError(f"normals have shape {outward.shape} but the field has {count} points: give ({count}, 3)")
    excess = np.abs(np.einsum("ij,ij->i", outward, outward) - 1.0)
    if not np.all(excess < 1e-3):
        i = int(np.argmin(excess < 1e-3))
        raise PalmfieldError(f"normals[{i}] = {outward[i].tolist()} is not a unit vector: divide it by its length")
    return outward
