"""Radiation pressure of an incident field on a surface that is rigid for sound, one point per thread."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def arp(
    pressure: wp.array(dtype=wp.vec2),
    gradient: wp.array2d(dtype=wp.vec2),
    normals: wp.array(dtype=wp.vec3),
    per_pressure: float,
    per_velocity: float,
    velocity_per_gradient: float,
    result: wp.array(dtype=float),
):
    """per_pressure |p|^2 - per_velocity |u_t|^2 where sound comes in, 0 elsewhere.

    With e^{-i w t}, u = grad p/(i w rho): re(u) = im(grad p)/(w rho) and im(u) = -re(grad p)/(w rho).
    """
    i = wp.tid()
    p = pressure[i]
    n = normals[i]
    gx = gradient[i, 0]
    gy = gradient[i, 1]
    gz = gradient[i, 2]
    u_re = velocity_per_gradient * wp.vec3(gx[1], gy[1], gz[1])
    u_im = -velocity_per_gradient * wp.vec3(gx[0], gy[0], gz[0])
    inflow = p[0] * wp.dot(u_re, n) + p[1] * wp.dot(u_im, n)
    if inflow >= 0.0:
        result[i] = 0.0
        return
    t_re = u_re - wp.dot(u_re, n) * n
    t_im = u_im - wp.dot(u_im, n) * n
    result[i] = per_pressure * wp.dot(p, p) - per_velocity * (wp.dot(t_re, t_re) + wp.dot(t_im, t_im))
