"""Visibility of sources from the points of a body."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT | {"fast_math": True})


@wp.func
def sees(mesh: wp.uint64, point: wp.vec3, normal: wp.vec3, ray: wp.vec3, distance: wp.float32, clearance: wp.float32):
    """Return whether the source at `ray` is in front of the surface and not hidden by the mesh.

    The ray starts `clearance` above the surface, because the point may be on a finer mesh of the body, slightly below.
    """
    if wp.dot(ray, normal) <= 0.0:
        return False
    away = ray / distance
    return not wp.mesh_query_ray_anyhit(mesh, point + clearance * normal, away, distance)


@wp.kernel
def visibility(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    sources: wp.array(dtype=wp.vec3),
    weights: wp.array(dtype=float),
    clearance: float,
    result: wp.array(dtype=float),
):
    """Sum the weights of the sources that are visible from each point."""
    i = wp.tid()
    total = wp.float32(0.0)
    for e in range(sources.shape[0]):
        ray = sources[e] - points[i]
        if sees(mesh, points[i], normals[i], ray, wp.length(ray), clearance):
            total += weights[e]
    result[i] = total


@wp.struct
class Rays:
    """Arguments of `lit_by_flux` in one struct.

    mesh: mesh that casts shadows; points: [m]; flux: direction of the sound, any length; reach: ray lengths [m]
    clearance: height above the surface at which a ray starts [m]; lit: result
    """

    mesh: wp.uint64
    points: wp.array(dtype=wp.vec3)
    flux: wp.array(dtype=wp.vec3)
    reach: wp.array(dtype=wp.float32)
    clearance: wp.float32
    lit: wp.array(dtype=wp.uint8)


@wp.kernel
def lit_by_flux(rays: Rays):
    """Set 1 if the ray back along the sound has no hit within its reach, else 0; also 0 in silence."""
    i = wp.tid()
    flux = rays.flux[i]
    # Divided by its largest part first, because the squares of weak sound would underflow
    largest = wp.max(wp.max(wp.abs(flux[0]), wp.abs(flux[1])), wp.abs(flux[2]))
    rays.lit[i] = wp.uint8(0)
    if largest > 0.0:
        back = -wp.normalize(flux / largest)
        start = rays.points[i] + rays.clearance * back
        if not wp.mesh_query_ray_anyhit(rays.mesh, start, back, rays.reach[i]):
            rays.lit[i] = wp.uint8(1)
