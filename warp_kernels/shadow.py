"""Which sources each point of a body sees, and the sound of just these."""

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": True})


@wp.func
def sees(mesh: wp.uint64, point: wp.vec3, normal: wp.vec3, ray: wp.vec3, distance: wp.float32, clearance: wp.float32):
    """Whether the source `ray` away is in front of the surface and nothing of the mesh lies between.

    The ray starts `clearance` above the surface: the point may lie on a finer mesh of the same body, a little below.
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
    """Sum of the weights of the sources that each point sees."""
    i = wp.tid()
    total = wp.float32(0.0)
    for e in range(sources.shape[0]):
        ray = sources[e] - points[i]
        if sees(mesh, points[i], normals[i], ray, wp.length(ray), clearance):
            total += weights[e]
    result[i] = total


@wp.struct
class Rays:
    """What `lit_by_flux` takes, in one piece.

    mesh: what casts shadows; points [m]; flux: where the sound goes there, any length; reach: of each ray [m]
    clearance: how far above the surface a ray starts [m]; lit: result
    """

    mesh: wp.uint64
    points: wp.array(dtype=wp.vec3)
    flux: wp.array(dtype=wp.vec3)
    reach: wp.array(dtype=wp.float32)
    clearance: wp.float32
    lit: wp.array(dtype=wp.uint8)


@wp.kernel
def lit_by_flux(rays: Rays):
    """1 where the way back along the sound meets nothing within its reach; 0 too where there is no sound."""
    i = wp.tid()
    flux = rays.flux[i]
    # Divided by its largest part first: the squares of a faint sound's would be 0
    largest = wp.max(wp.max(wp.abs(flux[0]), wp.abs(flux[1])), wp.abs(flux[2]))
    rays.lit[i] = wp.uint8(0)
    if largest > 0.0:
        back = -wp.normalize(flux / largest)
        start = rays.points[i] + rays.clearance * back
        if not wp.mesh_query_ray_anyhit(rays.mesh, start, back, rays.reach[i]):
            rays.lit[i] = wp.uint8(1)
