"""Geometric shadows by one ray a point, and by one for each point and transducer."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.acoustics.shadow import CLEARANCE_m, REACH_m, points_and_normals, vectors
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Field
from warp_kernels.pressure import NEAREST_M2, TURN, quintic, vec6
from warp_kernels.shadow import sees

wp.set_module_options({"enable_backward": False, "fast_math": True})


@wp.kernel
def lit_kernel(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    towards: wp.array(dtype=wp.vec3),
    clearance: float,
    reach: wp.array(dtype=float),
    result: wp.array(dtype=wp.uint8),
):
    """1 where the ray towards the sound's source meets nothing within its reach."""
    i = wp.tid()
    blocked = wp.mesh_query_ray_anyhit(mesh, points[i] + clearance * towards[i], towards[i], reach[i])
    result[i] = wp.where(blocked, wp.uint8(0), wp.uint8(1))


@wp.kernel
def pressure_gradient(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    clearance: float,
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    drive: wp.array(dtype=wp.vec2),
    turns_per_m: float,
    absorption_Np_m: float,
    directivity_of: vec6,
    slope_of: vec6,
    result: wp.array(dtype=wp.vec2),
    gradient: wp.array2d(dtype=wp.vec2),
):
    """Pressure [Pa] and its gradient [Pa/m] of the transducers that the point sees, with e^{-i w t}.

    outward: normals of the surface; normals: of the transducers; drive: strength [Pa m] and phase [turns]
    directivity_of, slope_of: polynomials in sin^2 of the angle off the axis, lowest power first: the transducer's
        directivity D and its derivative D'

    With q = cos(angle off the axis), s = 1 - q^2, the gradient of exp(ikd - beta d) D(s)/d is exp(ikd - beta d)/d times
    ((ik - beta - 1/d) D + 2 q^2 D'/d) along the ray and -2 q D'/d along the axis.
    """
    i = wp.tid()
    point = points[i]
    total = wp.vec2()
    real = wp.vec3()
    imag = wp.vec3()
    for e in range(positions.shape[0]):
        r = point - positions[e]
        d = wp.sqrt(wp.dot(r, r) + NEAREST_M2)
        inverse = 1.0 / d
        cosine = wp.dot(r, normals[e]) * inverse
        if cosine > 0.0 and drive[e][0] > 0.0:
            seen = sees(mesh, point, outward[i], -r, d, clearance)  # apart: `and` would trace rays for nothing
            if seen:
                s = 1.0 - cosine * cosine
                directivity = quintic(directivity_of, s)
                bend = 2.0 * cosine * inverse * quintic(slope_of, s)
                turns = d * turns_per_m + drive[e][1]
                angle = TURN * (turns - wp.floor(turns + 0.5))
                gain = drive[e][0] * inverse * wp.exp(-absorption_Np_m * d)
                wave_re = gain * wp.cos(angle)
                wave_im = gain * wp.sin(angle)
                decay = cosine * bend - directivity * (absorption_Np_m + inverse)
                swing = directivity * TURN * turns_per_m
                along_re = (decay * wave_re - swing * wave_im) * inverse
                along_im = (decay * wave_im + swing * wave_re) * inverse
                total += directivity * wp.vec2(wave_re, wave_im)
                real += along_re * r - bend * wave_re * normals[e]
                imag += along_im * r - bend * wave_im * normals[e]
    result[i] = total
    for axis in range(3):
        gradient[i, axis] = wp.vec2(real[axis], imag[axis])


def lit(
    points: ArrayLike,
    flux_direction: ArrayLike,
    mesh: wp.Mesh,
    *,
    clearance_m: float = CLEARANCE_m,
    reach_m: ArrayLike = REACH_m,
) -> NDArray[np.bool_]:
    """Whether the way back along the sound is free, shape (n,): one ray a point, the cheapest shadow.

    On a closed body a point where sound leaves the surface is dark, since the ray runs into the body.

    points: [m], shape (n, 3); flux_direction: where the sound goes, any length, shape (3,) or (n, 3), for example
    the energy flux Re(p u*); a point without direction is dark
    reach_m: how far the ray goes, to where the sound comes from [m], a number or shape (n,)
    Raises PalmfieldError for other shapes and numbers that are not finite.
    """
    where = check.points(points, np.float32)
    direction = np.broadcast_to(np.asarray(flux_direction, dtype=np.float64), where.shape)
    if not np.isfinite(direction).all():
        raise PalmfieldError(f"flux_direction[{check.first_bad(direction)}] is not finite: mend the field")
    length = np.linalg.norm(direction, axis=1)
    back = -direction / np.where(length > 0.0, length, 1.0)[:, None]
    far = np.ascontiguousarray(np.broadcast_to(np.asarray(reach_m, dtype=np.float32), length.shape))
    reach: wp.array = wp.array(far, dtype=float, device=mesh.device)
    result = wp.empty(len(where), dtype=wp.uint8, device=mesh.device)
    inputs = [mesh.id, vectors(where, mesh.device), vectors(back, mesh.device), clearance_m, reach, result]
    wp.launch(lit_kernel, dim=len(where), inputs=inputs, device=mesh.device)
    return (result.numpy() > 0) & (length > 0.0)


def shadowed_pressure(
    points: ArrayLike,
    normals: ArrayLike,
    mesh: wp.Mesh,
    array: Array,
    drive: ArrayLike,
    air: Air,
    *,
    clearance_m: float = CLEARANCE_m,
    absorption_Np_m: float | None = None,
) -> Field:
    """Field, with gradient, of the transducers that each point sees: geometric shadow, a ray for each pair.

    Kirchhoff's approximation: on a convex rigid body the total pressure is twice this. Where a point sees the whole
    array it is the incident field of `palmfield.acoustics.field`; where it sees nothing it is 0.

    points: on or near the surface [m], array frame, shape (n, 3); normals: unit outward normals there, shape (n, 3)
    mesh: what casts shadows, of `shadow_mesh`, in the array frame
    drive: complex amplitudes, 1 is full drive, shape (len(array),)
    absorption_Np_m: instead of that of the air, for example 0 for lossless air
    Raises PalmfieldError for wrong shapes and numbers that are not finite, SceneError for a bad array or air.
    """
    check.array(array)
    where, outward = points_and_normals(points, normals)
    strength = array.p0_Pa_m * check.drive(drive, array)
    if array.gain is not None:
        strength = strength * array.gain
    wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    directivity, slope = directivity_coefficients(array, wavenumber)
    absorption = check.absorption(
        air_absorption(air, array.frequency_Hz) if absorption_Np_m is None else absorption_Np_m
    )
    turns = np.column_stack([np.abs(strength), np.angle(strength) / (2.0 * np.pi)]).astype(np.float32)
    device = mesh.device
    pressure = wp.empty(len(where), dtype=wp.vec2, device=device)
    gradient = wp.empty((len(where), 3), dtype=wp.vec2, device=device)
    inputs = [
        mesh.id,
        vectors(where, device),
        vectors(outward, device),
        clearance_m,
        vectors(array.positions, device),
        vectors(array.normals, device),
        wp.array(turns, dtype=wp.vec2, device=device),
        wavenumber / (2.0 * np.pi),
        absorption,
        vec6(*directivity),
        vec6(*slope, 0.0),
        pressure,
        gradient,
    ]
    wp.launch(pressure_gradient, dim=len(where), inputs=inputs, device=device)
    return Field(pressure.numpy().view(np.complex64)[..., 0], gradient.numpy().view(np.complex64)[..., 0])
