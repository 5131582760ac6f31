"""Which sources each point of a body sees, and the sound of just these."""

import warp as wp

from warp_kernels.pressure import NEAREST_M2, TURN, quintic, vec6

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


@wp.kernel
def lit(
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
