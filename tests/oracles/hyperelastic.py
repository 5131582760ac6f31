"""Finite strain: compressible neo-Hookean solid with the branches of a Material, as functions of F.

F is the deformation gradient, shape (..., 3, 3); C = F^T F, J = det F. Energies are per reference volume, P is the
first Piola stress dW/dF (force per reference area). At small strain everything is the linear law of the Material.

Elastic: W = G/2 (J^{-2/3} tr C - 3) + K/2 (J - 1)^2. Viscoelastic (Simo 1987, Comput. Methods Appl. Mech. Eng. 60;
Simo & Hughes 1998, ch. 10): every branch keeps an over-stress H_i driven by the isochoric stress
D = G_r DEV[1] of the spring, H_i' + H_i / tau_i = (G_i / G_r) D', with DEV[A] = A - (A : C)/3 C^{-1}, and the second
Piola stress gains J^{-2/3} DEV[H_i]: the over-stress has no pressure, the volume is elastic. Where a Material's bulk
relaxes with its shear, D is the spring's whole second Piola stress instead, and the over-stress is added as it is.
"""

from dataclasses import dataclass

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material
from palmfield.types import Float


@dataclass(frozen=True)
class Memory:
    """What the solid remembers, second Piola stresses [Pa].

    drive: D of the spring, shape (..., 3, 3); over: H_i of the branches, shape (branches, ..., 3, 3)
    """

    drive: Float
    over: Float


def energy(F: Float, shear_Pa: float, bulk_Pa: float) -> Float:
    """Stored energy W [J/m^3], shape (...). Raises SceneError where det F is not above 0."""
    J = jacobian(F)
    return (
        0.5 * shear_Pa * (J ** (-2.0 / 3.0) * np.einsum("...ij,...ij->...", F, F) - 3.0)
        + 0.5 * bulk_Pa * (J - 1.0) ** 2
    )


def piola(F: Float, shear_Pa: float, bulk_Pa: float) -> Float:
    """P = G J^{-2/3} (F - tr C/3 F^{-T}) + K (J - 1) J F^{-T} [Pa]. Raises SceneError where det F is not above 0."""
    J = jacobian(F)
    inverse = inverse_of(F)
    shape = deviator_of(shear_Pa * np.broadcast_to(np.eye(3), F.shape), F, inverse @ transpose(inverse))
    return J[..., None, None] ** (-2.0 / 3.0) * F @ shape + volumetric(F, J, bulk_Pa)


def viscous_piola(F: Float, rate: Float, viscosity_Pa_s: float, bulk_viscosity_Pa_s: float = 0.0) -> Float:
    """Stress of a dashpot, J (2 eta dev d + eta_K tr d) F^{-T} with d = sym(F' F^{-1}) [Pa].

    rate: F' [1/s], shape of F; viscosity_Pa_s: eta, bulk_viscosity_Pa_s: eta_K [Pa s]
    Raises SceneError where det F is not above 0.
    """
    J = jacobian(F)
    inverse = inverse_of(F)
    velocity = rate @ inverse
    stretching = 0.5 * (velocity + transpose(velocity))
    trace = np.trace(stretching, axis1=-2, axis2=-1)[..., None, None]
    stress = 2.0 * viscosity_Pa_s * (stretching - trace / 3.0 * np.eye(3)) + bulk_viscosity_Pa_s * trace * np.eye(3)
    return J[..., None, None] * stress @ transpose(inverse)


def at_rest(material: Material, shape: tuple[int, ...]) -> Memory:
    """Memory of a solid that has always been undeformed; shape: that of F without its last two axes."""
    return Memory(np.zeros((*shape, 3, 3)), np.zeros((len(material.relaxation.branches), *shape, 3, 3)))


def advance(material: Material, memory: Memory, F: Float, rate: Float, step_s: float) -> tuple[Float, Memory]:
    """First Piola stress [Pa] at F, one step [s] after the memory, and the new memory.

    rate: F' at the end of the step [1/s], shape of F; only a dashpot uses it
    Exact where D changes linearly over the step: H1 = e H0 + g (1 - e)/(h/tau) (D1 - D0), e = exp(-h/tau), g = G_i/G_r;
    hence stable for every step, and right for steps far above and far below tau.
    Raises SceneError where det F is not above 0 and for a step that is not.
    """
    if not step_s > 0.0:
        raise SceneError(f"step is {step_s} s; give one above 0")
    J = jacobian(F)
    inverse = inverse_of(F)
    inverse_C = inverse @ transpose(inverse)
    narrowing = J[..., None, None] ** (-2.0 / 3.0)
    shape = deviator_of(material.shear_relaxed_Pa * np.broadcast_to(np.eye(3), F.shape), F, inverse_C)
    spring = narrowing * shape + inverse @ volumetric(F, J, material.bulk_Pa)
    drive = spring if material.bulk_relaxes else shape
    change = drive - memory.drive
    over = np.empty_like(memory.over)
    for i, (ratio, time_s) in enumerate(material.relaxation.branches):
        fade, gain = branch_step(step_s, time_s)
        over[i] = fade * memory.over[i] + ratio * gain * change
    pushed = over.sum(axis=0)
    stress = F @ (spring + (pushed if material.bulk_relaxes else narrowing * deviator_of(pushed, F, inverse_C)))
    if material.viscosity_Pa_s > 0.0:
        bulk = material.relaxation.viscous_time_s * material.bulk_Pa if material.bulk_relaxes else 0.0
        stress = stress + viscous_piola(F, rate, material.viscosity_Pa_s, bulk)
    return stress, Memory(drive, over)


def branch_step(step_s: float, time_s: float) -> tuple[float, float]:
    """e = exp(-h/tau) and (1 - e)/(h/tau) of a step h [s] at relaxation time tau [s]; both 0 at tau = 0."""
    if time_s == 0.0:
        return 0.0, 0.0
    x = step_s / time_s
    return float(np.exp(-x)), float(-np.expm1(-x) / x)


def volumetric(F: Float, J: Float, bulk_Pa: float) -> Float:
    """K (J - 1) J F^{-T} [Pa]."""
    return bulk_Pa * ((J - 1.0) * J)[..., None, None] * transpose(inverse_of(F))


def deviator_of(stress: Float, F: Float, inverse_C: Float) -> Float:
    """DEV[A] = A - (A : C)/3 C^{-1}."""
    pressure = np.einsum("...ij,...ki,...kj->...", stress, F, F)
    return stress - pressure[..., None, None] / 3.0 * inverse_C


def jacobian(F: Float) -> Float:
    """det F, shape (...). Raises SceneError where it is not above 0, with the first such place."""
    J = np.asarray(np.linalg.det(F), dtype=np.float64)
    if not np.all(J > 0.0):
        place = np.argwhere(~(np.atleast_1d(J) > 0.0))[0].tolist()
        raise SceneError(f"deformation: det F is {np.atleast_1d(J)[tuple(place)]:.3g} at {place}; take a smaller step")
    return J


def inverse_of(F: Float) -> Float:
    return np.asarray(np.linalg.inv(F), dtype=np.float64)


def transpose(tensor: Float) -> Float:
    return np.swapaxes(tensor, -1, -2)
