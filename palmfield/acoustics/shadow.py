"""Shadow of a body in an array's sound: geometric acoustics with rays, the cheap stand-in for scattering."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.device import resolve
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Field, Float32, Surface
from warp_kernels import shadow as kernels

CLEARANCE_m = 2e-4
"""How far above the surface a ray starts: coarse meshes of a hand lie that far off its fine ones."""

REACH_m = 10.0


def shadow_mesh(surface: Surface, device: str = "auto") -> wp.Mesh:
    """Bounding volume hierarchy of what casts shadows; `device` is where all work with it is done."""
    where = resolve(device)
    vertices: wp.array = wp.array(surface.vertices.astype(np.float32), dtype=wp.vec3, device=where)
    faces: wp.array = wp.array(surface.faces.astype(np.int32).ravel(), dtype=wp.int32, device=where)
    return wp.Mesh(vertices, faces)


def visibility(
    points: ArrayLike,
    normals: ArrayLike,
    surface_mesh: wp.Mesh,
    source_positions: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    clearance_m: float = CLEARANCE_m,
) -> Float32:
    """Share of the sources that each point sees in front of its surface with nothing in between, shape (n,), 0 to 1.

    points: on or near the surface [m], shape (n, 3); normals: unit outward normals there, shape (n, 3)
    surface_mesh: what casts shadows, of `shadow_mesh`, in the same frame
    source_positions: [m], shape (s, 3); weights: 0 or more, for example |drive|^2, shape (s,); equal by default
    Raises PalmfieldError for other shapes, numbers that are not finite, and weights that are negative or sum to 0.
    """
    where, outward = _points_and_normals(points, normals)
    sources = check.points(source_positions, np.float32)
    share = np.ones(len(sources)) if weights is None else np.asarray(weights, dtype=float)
    if share.shape != (len(sources),) or not np.all(share >= 0.0) or not 0.0 < share.sum() < np.inf:
        raise PalmfieldError(
            f"weights of shape {share.shape}, sum {share.sum():g}, for {len(sources)} sources: give shape "
            f"({len(sources)},), 0 or more, not all 0"
        )
    device = surface_mesh.device
    result = wp.empty(len(where), dtype=float, device=device)
    inputs = [
        surface_mesh.id,
        _vectors(where, device),
        _vectors(outward, device),
        _vectors(sources, device),
        wp.array((share / share.sum()).astype(np.float32), dtype=float, device=device),
        clearance_m,
        result,
    ]
    wp.launch(kernels.visibility, dim=len(where), inputs=inputs, device=device)
    return np.clip(result.numpy(), 0.0, 1.0)


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
    inputs = [mesh.id, _vectors(where, mesh.device), _vectors(back, mesh.device), clearance_m, reach, result]
    wp.launch(kernels.lit, dim=len(where), inputs=inputs, device=mesh.device)
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
    where, outward = _points_and_normals(points, normals)
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
        _vectors(where, device),
        _vectors(outward, device),
        clearance_m,
        _vectors(array.positions, device),
        _vectors(array.normals, device),
        wp.array(turns, dtype=wp.vec2, device=device),
        wavenumber / (2.0 * np.pi),
        absorption,
        kernels.vec6(*directivity),
        kernels.vec6(*slope, 0.0),
        pressure,
        gradient,
    ]
    wp.launch(kernels.pressure_gradient, dim=len(where), inputs=inputs, device=device)
    return Field(pressure.numpy().view(np.complex64)[..., 0], gradient.numpy().view(np.complex64)[..., 0])


def _points_and_normals(points: ArrayLike, normals: ArrayLike) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    where, outward = check.points(points, np.float32), check.points(normals, np.float32)
    if len(where) != len(outward):
        raise PalmfieldError(f"{len(where)} points but {len(outward)} normals: give one normal a point")
    return where, outward


def _vectors(values: NDArray[np.floating], device: wp.Device | None) -> wp.array:
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device=device)
