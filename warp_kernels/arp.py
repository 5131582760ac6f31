"""Acoustic radiation pressure (ARP) of sound on an acoustically rigid surface. The formula is defined only here.

With s = grad p/k, so that |s|^2/(rho c^2) = rho |u|^2, every law is a weighted sum of the squares of p, of s along the
surface and of s normal to it. It applies to lit points, where sound flows into the surface: Im(p* s).n < 0.
"""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

# In C, because `warp_kernels.transfer` uses it in a loop that LLVM must vectorise
FORMULA = """p_re * n_im - p_im * n_re < 0.0f
    ? weights[0] * (p_re * p_re + p_im * p_im) - weights[1] * along2 + weights[2] * (n_re * n_re + n_im * n_im)
    : 0.0f"""


@wp.func_native(snippet=f"return {FORMULA};")
def radiation_pressure(
    p_re: wp.float32, p_im: wp.float32, n_re: wp.float32, n_im: wp.float32, along2: wp.float32, weights: wp.vec3
) -> wp.float32:
    """Return the ARP [Pa] from pressure p [Pa], s along the normal [Pa], and |s|^2 along the surface [Pa2].

    weights: of |p|^2, of -|s|^2 along the surface and of |s|^2 along the normal [1/Pa]
    """
    ...


@wp.func
def pressure_on_surface(p: wp.vec2, g_re: wp.vec3, g_im: wp.vec3, n: wp.vec3, per_wavenumber: float, weights: wp.vec3):
    """Return the ARP [Pa] from pressure, its gradient [Pa/m] and the unit outward normal."""
    s_re = per_wavenumber * g_re
    s_im = per_wavenumber * g_im
    n_re = wp.dot(s_re, n)
    n_im = wp.dot(s_im, n)
    t_re = s_re - n_re * n
    t_im = s_im - n_im * n
    return radiation_pressure(p[0], p[1], n_re, n_im, wp.dot(t_re, t_re) + wp.dot(t_im, t_im), weights)


@wp.kernel
def arp(
    pressure: wp.array(dtype=wp.vec2),
    gradient: wp.array2d(dtype=wp.vec2),
    normals: wp.array(dtype=wp.vec3),
    per_wavenumber: float,
    weights: wp.vec3,
    result: wp.array(dtype=float),
):
    """Compute the ARP [Pa] by point; per_wavenumber: 1/k [m]; weights: as for `radiation_pressure`."""
    i = wp.tid()
    gx = gradient[i, 0]
    gy = gradient[i, 1]
    gz = gradient[i, 2]
    g_re = wp.vec3(gx[0], gy[0], gz[0])
    g_im = wp.vec3(gx[1], gy[1], gz[1])
    result[i] = pressure_on_surface(pressure[i], g_re, g_im, normals[i], per_wavenumber, weights)


@wp.struct
class SurfacePoints:
    """Arguments of `surface_sound` in one struct, because a recorded launch packs each argument again.

    count: number of drives; pressure: [Pa], shape (m, n); gradient: [Pa/m], shape (m, n, 3)
    normals: unit, outward; per_wavenumber, weights: as for `arp`
    arp, amplitude: results of each drive, shape (m, n); flux: result of the first drive
    """

    count: wp.array(dtype=wp.int32)
    pressure: wp.array2d(dtype=wp.vec2)
    gradient: wp.array3d(dtype=wp.vec2)
    normals: wp.array(dtype=wp.vec3)
    per_wavenumber: wp.float32
    weights: wp.vec3
    arp: wp.array2d(dtype=wp.float32)
    amplitude: wp.array2d(dtype=wp.float32)
    flux: wp.array(dtype=wp.vec3)


@wp.kernel
def surface_sound(at: SurfacePoints):
    """Compute ARP [Pa], |p| [Pa] and Im(p* grad p) [Pa2/m], along the energy flow, by point."""
    i = wp.tid()
    for k in range(at.count[0]):
        p = at.pressure[k, i]
        gx = at.gradient[k, i, 0]
        gy = at.gradient[k, i, 1]
        gz = at.gradient[k, i, 2]
        g_re = wp.vec3(gx[0], gy[0], gz[0])
        g_im = wp.vec3(gx[1], gy[1], gz[1])
        at.arp[k, i] = pressure_on_surface(p, g_re, g_im, at.normals[i], at.per_wavenumber, at.weights)
        at.amplitude[k, i] = wp.length(p)
        if k == 0:
            at.flux[i] = p[0] * g_im - p[1] * g_re


@wp.func
def times(a: wp.vec2, b: wp.vec2):
    """Return the product of two complex numbers."""
    return wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.kernel
def arp_of_sums(
    levels: wp.array2d(dtype=wp.vec2),
    pressure: wp.array2d(dtype=wp.vec2),
    gradient: wp.array3d(dtype=wp.vec2),
    normals: wp.array(dtype=wp.vec3),
    per_wavenumber: float,
    weights: wp.vec3,
    result: wp.array2d(dtype=wp.float32),
):
    """Compute the ARP [Pa], shape (m, n), of levels (m, k) @ fields, pressure (k, n) and gradient (k, n, 3)."""
    i = wp.tid()
    for m in range(levels.shape[0]):
        p = wp.vec2()
        gx = wp.vec2()
        gy = wp.vec2()
        gz = wp.vec2()
        for k in range(levels.shape[1]):
            level = levels[m, k]
            p += times(level, pressure[k, i])
            gx += times(level, gradient[k, i, 0])
            gy += times(level, gradient[k, i, 1])
            gz += times(level, gradient[k, i, 2])
        g_re = wp.vec3(gx[0], gy[0], gz[0])
        g_im = wp.vec3(gx[1], gy[1], gz[1])
        result[m, i] = pressure_on_surface(p, g_re, g_im, normals[i], per_wavenumber, weights)
