"""Sound that a rigid body adds around it, and the force on it, from boundary elements' sound on its wall."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.scattering import NEAR_EDGES, DoubleLayer, Incident, Scattering, mean_edge_m, wall_arp
from palmfield.device import resolve
from palmfield.errors import PalmfieldError
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.types import Air, Array, Complex, Field, Float
from warp_kernels.bem import NEAREST, TURN

wp.set_module_options({"enable_backward": False, "fast_math": True})

WALL_EDGES = 1e-3
"""Over this part of an edge the pressure changes by its square only, as the wall's normal velocity is 0."""


@wp.kernel
def far_gradient(
    points: wp.array(dtype=wp.vec3),
    centroids: wp.array(dtype=wp.vec3),
    moments: wp.array(dtype=wp.vec3),
    density: wp.array(dtype=wp.vec2),
    gradient: wp.array2d(dtype=wp.vec2),
):
    """Gradient by the point of the one-point sum, per wavelength.

    Of m.R F(d) with F = (ikd - 1) exp(ikd)/d^3 it is -m F - R (m.R) F'/d, F' = ((ikd)^2 - 3 ikd + 3) exp(ikd)/d^4.
    """
    i = wp.tid()
    real = wp.vec3()
    imag = wp.vec3()
    for j in range(centroids.shape[0]):
        r = centroids[j] - points[i]
        d = wp.sqrt(wp.dot(r, r) + NEAREST)
        kd = TURN * d
        angle = TURN * (d - wp.floor(d + 0.5))
        s = wp.sin(angle)
        t = wp.cos(angle)
        over = 1.0 / (d * d * d)
        q = density[j]
        wave_re = (t * q[0] - s * q[1]) * over
        wave_im = (t * q[1] + s * q[0]) * over
        f_re = -wave_re - kd * wave_im
        f_im = -wave_im + kd * wave_re
        bend = wp.dot(moments[j], r) / (d * d)
        g_re = bend * ((3.0 - kd * kd) * wave_re + 3.0 * kd * wave_im)
        g_im = bend * ((3.0 - kd * kd) * wave_im - 3.0 * kd * wave_re)
        real -= f_re * moments[j] + g_re * r
        imag -= f_im * moments[j] + g_im * r
    for axis in range(3):
        gradient[i, axis] = wp.vec2(real[axis], imag[axis])


def gradient_of(layer: DoubleLayer, density: Complex) -> Complex:
    """Gradient at the layer's points [1/m], shape (n, 3), by the one-point sum alone: for points away from the mesh."""
    result = wp.empty((layer.count, 3), dtype=wp.vec2, device=layer.device)
    inputs = [layer.points, layer.centroids, layer.moments, layer.pairs(density), result]
    wp.launch(far_gradient, dim=layer.count, inputs=inputs, device=layer.device)
    return layer.per_m * result.numpy().view(np.complex64)[..., 0].astype(np.complex128)


def array_sound(
    array: Array, drive: ArrayLike, air: Air, device: str = "auto", *, absorption_Np_m: float | None = None
) -> Incident:
    """Incident sound of an array for `scatter`, in the array frame.

    drive: complex amplitudes, 1 is full drive, shape (len(array),)
    absorption_Np_m: on the way to the body, instead of that of the air; between parts of the body there is none
    Raises as `palmfield.acoustics.field.FieldEvaluator`.
    """
    evaluator = FieldEvaluator(array, air, device, absorption_Np_m=absorption_Np_m)
    amplitudes = check.drive(drive, array)
    return lambda points: evaluator.pressure(points, amplitudes).pressure.astype(np.complex128)


def wall_force(scattering: Scattering, air: Air) -> Float:
    """Radiation force on the whole body [N], shape (3,), from the pressure on its wall.

    Right to 1 % on smooth bodies at 8 elements a wavelength. A sharp rim in full sound has a suction that faces cannot
    resolve (23 % of the force on the benchmark's turned sheet): there take `radiation_force` of
    palmfield.acoustics.langevin on a surface around the body, with `scattered_field` added to the incident sound.
    """
    return -(scattering.areas * wall_arp(scattering, air)) @ scattering.normals


def scattered_field(
    scattering: Scattering, points: ArrayLike, *, gradient: bool = False, device: str = "auto"
) -> Field:
    """Sound that the body adds at points outside it, in the mesh's frame; the incident sound is not in it.

    points: [m], shape (n, 3); one nearer to the wall than a thousandth of an edge, on either side, gets the limit from
        outside; where it is on a sharp edge, that on one of the faces
    gradient: also its gradient; then every point must lie 3 edge lengths or more from the body
    Returns Field: complex peak pressure [Pa], shape (n,), and gradient [Pa/m], shape (n, 3), or None.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points, and for a gradient wanted too near the body.
    """
    where = np.asarray(check.points(points, np.float64))
    layer = DoubleLayer(
        off_wall(scattering, where), scattering.vertices, scattering.faces, scattering.wavenumber, resolve(device)
    )
    pressure = layer.apply(scattering.pressure).astype(np.complex64)
    if not gradient:
        return Field(pressure)
    close = np.diff(layer.start.numpy()) > 0
    if close.any():
        i = int(np.argmax(close))
        raise PalmfieldError(
            f"points[{i}] = {where[i].tolist()} is within {NEAR_EDGES:g} edges of the body, where the gradient is not "
            "accurate: move it away or do without the gradient"
        )
    return Field(pressure, gradient_of(layer, scattering.pressure).astype(np.complex64))


def off_wall(scattering: Scattering, points: Float) -> Float:
    """The points, those nearer to the wall than WALL_EDGES moved out to there, where float32 knows the side."""
    least = WALL_EDGES * mean_edge_m(scattering.vertices, scattering.faces)
    face = closest_faces(build_mesh(scattering.vertices, scattering.faces), points, 2.0 * least)
    near = np.flatnonzero(face >= 0)
    corners = scattering.vertices[scattering.faces[face[near]]]
    feet = np.einsum("ij,ijk->ik", barycentric(corners, points[near]), corners)
    close = np.linalg.norm(points[near] - feet, axis=1) < least
    moved = points.copy()
    moved[near[close]] = feet[close] + least * scattering.normals[face[near[close]]]
    return moved
