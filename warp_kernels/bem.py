"""Double layer of the Helmholtz equation on flat triangles with constant values. All lengths are in wavelengths.

With R = y - x, d = |R| and k = 2 pi, the kernel n_y . grad_y exp(ikd)/(4 pi d) is
n_y . R (ikd - 1) exp(ikd)/(4 pi d^3).
Far triangles are represented by their centroids. Corrections near a triangle are added from a sparse list: the static
part is the solid angle of the triangle (Van Oosterom & Strackee 1983, doi 10.1109/TBME.1983.325207), exact at any
distance, and the bounded remainder is summed over quadrature points. The unbounded term of the centroid is softened:
d^2 is |R|^2 plus a small square, in the sum and where the list subtracts it.
"""

import functools

import warp as wp

from warp_kernels import EXACT, FUSED
from warp_kernels.pressure import TURN, quintic, vec6

wp.set_module_options(EXACT | {"max_unroll": 1})

FOUR_PI = wp.constant(12.566370614359172)
NEAREST = wp.constant(1.0e-12)  # keeps 1/d finite at a quadrature point, where the remainder is 0


@functools.cache
def far(width: int) -> wp.Kernel:
    """Return the kernel of the one-point sum with `width` points per thread: 16 fill CPU registers, 1 is for GPUs."""
    lanes = wp.types.vector(length=width, dtype=wp.float32)

    @wp.kernel(module="unique", module_options=FUSED | {"fast_math": True})
    def far(
        points: wp.array(dtype=wp.vec3),
        centroids: wp.array(dtype=wp.vec3),
        moments: wp.array(dtype=wp.vec3),
        density: wp.array(dtype=wp.vec2),
        sine: vec6,
        cosine: vec6,
        softening: float,
        parts: int,
        result: wp.array(dtype=wp.vec2),
    ):
        """Add the sum to `result` by point.

        moments: normal times area over 4 pi
        sine, cosine: polynomials in f^2 for sin(2 pi f)/f and cos(2 pi f), |f| <= 1/2, lowest power first
        softening: added to the square of the distance
        parts: number of parts of the triangles, the second dimension of the launch
        """
        block, part = wp.tid()
        first = block * width
        count = points.shape[0]
        low = (centroids.shape[0] * part) // parts
        high = (centroids.shape[0] * (part + 1)) // parts
        x = lanes()
        y = lanes()
        z = lanes()
        re = lanes()
        im = lanes()
        for i in range(width):
            point = points[wp.min(first + i, count - 1)]
            x[i] = point[0]
            y[i] = point[1]
            z[i] = point[2]
        for j in range(low, high):
            c = centroids[j]
            m = moments[j]
            q = density[j]
            for i in range(width):
                dx = c[0] - x[i]
                dy = c[1] - y[i]
                dz = c[2] - z[i]
                square = dx * dx + dy * dy + dz * dz + softening
                d = wp.sqrt(square)
                over = 1.0 / square
                gain = (dx * m[0] + dy * m[1] + dz * m[2]) * d * over * over
                f = d - wp.floor(d + 0.5)
                s = f * quintic(sine, f * f)
                t = quintic(cosine, f * f)
                kd = TURN * d
                a = gain * (-t - kd * s)
                b = gain * (kd * t - s)
                re[i] += a * q[0] - b * q[1]
                im[i] += a * q[1] + b * q[0]
        for i in range(width):
            if first + i < count:
                wp.atomic_add(result, first + i, wp.vec2(re[i], im[i]))

    return far


@wp.func
def wave_factor(d: wp.float32):
    """Return (ikd - 1) exp(ikd)."""
    kd = TURN * d
    s = wp.sin(kd)
    t = wp.cos(kd)
    return wp.vec2(-t - kd * s, kd * t - s)


@wp.func
def wave_rest(d: wp.float32):
    """Return 1 + (ikd - 1) exp(ikd), by its series for small d, where the difference would lose digits."""
    x = TURN * d
    if x > 0.5:
        return wave_factor(d) + wp.vec2(1.0, 0.0)
    q = x * x
    return wp.vec2(
        q * (-1.0 / 2.0 + q * (1.0 / 8.0 - q * (1.0 / 144.0))),
        q * x * (-1.0 / 3.0 + q * (1.0 / 30.0 - q * (1.0 / 840.0))),
    )


@wp.func
def solid_angle(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Return the solid angle of a triangle with corners relative to the eye, positive if its normal points away."""
    la = wp.length(a)
    lb = wp.length(b)
    lc = wp.length(c)
    height = wp.dot(a, wp.cross(b, c))
    return 2.0 * wp.atan2(height, la * lb * lc + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb)


@wp.kernel
def near_count(
    grid: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    centroids: wp.array(dtype=wp.vec3),
    reach: wp.array(dtype=float),
    largest: float,
    count: wp.array(dtype=int),
):
    """Count the triangles whose reach contains the point."""
    i = wp.tid()
    total = wp.int32(0)
    for j in wp.hash_grid_query(grid, points[i], largest):
        if wp.length(centroids[j] - points[i]) < reach[j]:
            total += 1
    count[i] = total


@wp.kernel
def near_fill(
    grid: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    centroids: wp.array(dtype=wp.vec3),
    moments: wp.array(dtype=wp.vec3),
    corners: wp.array2d(dtype=wp.vec3),
    reach: wp.array(dtype=float),
    largest: float,
    rule: wp.array(dtype=wp.vec4),
    softening: float,
    own: wp.array(dtype=int),
    start: wp.array(dtype=int),
    column: wp.array(dtype=int),
    value: wp.array(dtype=wp.vec2),
):
    """Compute columns and values of the sparse correction: integral of the triangle minus the one-point term.

    rule: three barycentric coordinates and the weight of each quadrature point
    softening: as in `far`
    own: the triangle whose plane contains a point, or -1; its integral is 0, as the kernel vanishes in the plane
    """
    i = wp.tid()
    x = points[i]
    slot = start[i]
    for j in wp.hash_grid_query(grid, x, largest):
        r = centroids[j] - x
        if wp.length(r) < reach[j]:
            total = wp.vec2()
            if j != own[i]:
                total[0] = -solid_angle(corners[j, 0] - x, corners[j, 1] - x, corners[j, 2] - x) / FOUR_PI
                for q in range(rule.shape[0]):
                    at = rule[q][0] * corners[j, 0] + rule[q][1] * corners[j, 1] + rule[q][2] * corners[j, 2] - x
                    e = wp.sqrt(wp.dot(at, at) + NEAREST)
                    total += rule[q][3] * wp.dot(moments[j], at) / (e * e * e) * wave_rest(e)
            d = wp.sqrt(wp.dot(r, r) + softening)
            column[slot] = j
            value[slot] = total - wp.dot(moments[j], r) / (d * d * d) * wave_factor(d)
            slot += 1


@wp.kernel
def near_apply(
    start: wp.array(dtype=int),
    column: wp.array(dtype=int),
    value: wp.array(dtype=wp.vec2),
    density: wp.array(dtype=wp.vec2),
    result: wp.array(dtype=wp.vec2),
):
    """Add the sparse correction, one row per thread."""
    i = wp.tid()
    total = wp.vec2()
    for slot in range(start[i], start[i + 1]):
        v = value[slot]
        q = density[column[slot]]
        total += wp.vec2(v[0] * q[0] - v[1] * q[1], v[0] * q[1] + v[1] * q[0])
    result[i] = result[i] + total
