"""Pressure of transducers and its gradient; parts are shared with pressure.py.

All lengths are in units of 1/k: rotations into the group frames and x, y, z of elements are multiplied by k, and
absorption is per radian. Spreading and phase of a wave then need no factor.
"""

import functools
from typing import Any

import warp as wp

from warp_kernels import FUSED
from warp_kernels.arp import times
from warp_kernels.pressure import (
    BLOCK,
    GPU,
    NEAREST_M2,
    STEEPNESS,
    WIDTH,
    Form,
    Sound,
    cubic,
    from_front,
    quartic,
    quintic,
    root32,
    root64,
    row32,
    row64,
    vec6,
)

vec8 = wp.types.vector(length=8, dtype=wp.float32)
MOST = 16
"""Largest number of drives in one call of `gradient`."""
TILE = 16
"""Number of transducers whose sound is stored for all drives, on the CPU; with the sums it fills half the L1 cache."""
NUMBERS = 8 * WIDTH["cpu"]
SCRATCH = (TILE + MOST) * NUMBERS
"""Size of the work array of `gradient` on the CPU."""


@wp.func_native(
    snippet=f"""
    float* const to = scratch.data + slot * {NUMBERS} + i;
    for (int j = 0; j < 8; ++j) to[{WIDTH["cpu"]} * j] = values.c[j];
"""
)
def keep(scratch: wp.array(dtype=wp.float32), slot: wp.int32, i: wp.int32, values: vec8):
    """Store the sound of a transducer at a point in the tile, in C because LLVM does not vectorise Warp's indexing."""
    ...


@wp.func_native(
    snippet=f"for (int i = ({TILE} + low) * {NUMBERS}; i < ({TILE} + high) * {NUMBERS}; ++i) scratch.data[i] = 0.0f;"
)
def clear(scratch: wp.array(dtype=wp.float32), low: wp.int32, high: wp.int32):
    """Set the sums of drives from `low` up to `high` to zero."""
    ...


@wp.func_native(
    snippet=f"""
    typedef float lanes __attribute__((vector_size(32)));
    for (int k = low; k < high; ++k) {{
        const float* const drive = reinterpret_cast<const float*>(
            reinterpret_cast<const char*>(drives.data) + k * size_t(drives.strides[0])) + 2 * first;
        for (int half = 0; half < 2; ++half) {{
            const lanes* tile = reinterpret_cast<const lanes*>(scratch.data) + half;
            lanes* const sums = reinterpret_cast<lanes*>(scratch.data + ({TILE} + k) * {NUMBERS}) + half;
            lanes s[8] = {{}};
            for (int n = 0; n < size; ++n, tile += 16) {{
                const float re = drive[2 * n], im = drive[2 * n + 1];
                for (int j = 0; j < 8; j += 2) {{ s[j] += re * tile[2 * j]; s[j + 1] += im * tile[2 * j]; }}
                for (int j = 0; j < 8; j += 2) {{ s[j] -= im * tile[2 * j + 2]; s[j + 1] += re * tile[2 * j + 2]; }}
            }}
            for (int j = 0; j < 8; ++j) sums[2 * j] += s[j];
        }}
    }}
"""
)
def add_tile(
    scratch: wp.array(dtype=wp.float32),
    size: wp.int32,
    drives: wp.array2d(dtype=wp.vec2),
    first: wp.int32,
    low: wp.int32,
    high: wp.int32,
):
    """Add the sound of `size` transducers in the tile to the sums of drives from `low` up to `high`.

    In C, with vectors for half of the points of a thread: eight sums stay in registers over a tile, with less rounding.
    """
    ...


@functools.cache
def gradient(form: Form) -> Any:
    """Return the kernel of pressure and gradient for up to MOST drives, WIDTH points per thread; dim (1, threads).

    With r from transducer to point, d = |r|, q = z^2/d^2, D the directivity and S = 2 dD/dq, the gradient of
    exp(id - bd) D/d over exp(id - bd)/d is [(i - b - 1/d) D/d - q S/d^2] r + S z/d^2 along the axis.

    On the CPU a thread computes all drives: the sound of a transducer at a point is computed once and multiplied by the
    amplitude of each drive. On a GPU each drive has its own threads, dim (drives, threads).
    """
    vec3, vec4, mat33 = form.vectors
    width = WIDTH["gpu" if form.gpu else "cpu"]
    real = wp.float64 if form.accurate else wp.float32
    places = wp.types.vector(length=width, dtype=real)
    lanes = wp.types.vector(length=width, dtype=wp.float32)
    parts = wp.types.matrix(shape=(8, width), dtype=wp.float32)
    row = row64 if form.accurate else row32
    root = root64 if form.accurate else root32
    angle, fall_of = form.angle, form.fall_of
    gpu, flat, shaded, faced = form.gpu, form.flat, form.shaded, form.faced
    directivity = quartic if form.smooth else quintic
    slope = cubic if form.smooth else quartic

    @wp.kernel(module="unique", module_options=GPU if form.gpu else FUSED)
    def kernel(
        points: wp.array(dtype=vec3),
        origins: wp.array(dtype=vec3),
        turns: wp.array(dtype=mat33),
        ranges: wp.array(dtype=wp.vec4i),
        elements: wp.array(dtype=vec4),
        drives: wp.array2d(dtype=wp.vec2),
        sound: Sound,
        shapes: wp.array(dtype=vec6),
        fall: wp.array(dtype=wp.vec4),
        count: wp.array(dtype=wp.int32),
        adds: wp.bool,
        result: wp.array2d(dtype=wp.vec2),
        rows: wp.array3d(dtype=wp.vec2),
        weights_re: wp.array3d(dtype=wp.float32),
        weights_im: wp.array3d(dtype=wp.float32),
        normals: wp.array(dtype=wp.vec3),
        scratch: wp.array(dtype=wp.float32),
    ):
        """By group: origin, rotation into its frame, and in `ranges` the first active transducer and one past the last,
        and the first active drive and one past the last. By transducer: x, y, 0, z.

        drives: by drive and transducer; the first `count` are computed
        shapes: directivity and slope, an array because a GPU would reload the numbers of a struct for each transducer
        fall: p0 [Pa m] times the coefficients of the decay, one vector; adds: whether to add to result and rows
        result, rows: pressure [Pa] and gradient [Pa/m] as pairs, shapes (drives, points) and (drives, points, 3)
        weights_re, weights_im: share of the sound of each transducer at each point, used by the form `shaded`, shape
            (points / BLOCK, elements, BLOCK)
        normals: unit outward normals of opaque surfaces at the points, used by the form `faced`
        scratch: SCRATCH numbers on the CPU, where threads of a launch run in sequence
        """
        own, block = wp.tid()
        first = block * width
        low = wp.int32(0)
        high = count[0]
        if gpu:
            low = own
            high = wp.min(high, own + 1)
        stop = wp.min(first + width, points.shape[0])
        if not adds:
            for k in range(low, high):
                for at in range(first, stop):
                    result[k, at] = wp.vec2()
                    for j in range(3):
                        rows[k, at, j] = wp.vec2()
        strength = fall[0]
        if gpu:
            in_directivity = shapes[0]
            in_slope = shapes[1]
        else:
            in_directivity = sound.directivity
            in_slope = sound.slope
        x = places()
        y = places()
        z = places()  # its square in the flat form
        n_x = lanes()
        n_y = lanes()
        n_z = lanes()  # times z in the flat form
        for group in range(ranges.shape[0]):
            span = ranges[group]
            begin = wp.max(low, span[2])
            end = wp.min(high, span[3])
            if begin >= end:
                continue
            if faced:
                # Back to a rotation, times the steepness
                turn = wp.mat33(turns[group])
                turn *= STEEPNESS / wp.length(turn[0])
            for i in range(width):
                local = turns[group] * (points[wp.min(first + i, stop - 1)] - origins[group])
                x[i] = local[0]
                y[i] = local[1]
                z[i] = local[2]
                if flat:
                    z[i] = local[2] * local[2] + real(NEAREST_M2)
                if faced:
                    normal = turn * normals[wp.min(first + i, stop - 1)]
                    n_x[i] = normal[0]
                    n_y[i] = normal[1]
                    n_z[i] = normal[2] * wp.float32(local[2]) if flat else normal[2]
            sums = parts()
            if not gpu:
                clear(scratch, begin, end)
            slot = wp.int32(0)
            for e in range(span[0], span[1]):
                element = row(elements, e)
                for i in range(width):
                    dx = x[i] - element[0]
                    dy = y[i] - element[1]
                    dz = z[i]
                    z2 = z[i]
                    if not flat:
                        dz -= element[3]
                        z2 = dz * dz + real(NEAREST_M2)
                    square = dx * dx + (dy * dy + z2)
                    distance = root(square)
                    d = distance[0]
                    inverse = distance[1]
                    wave = angle(sound, square, d, inverse, real(0.0))
                    if shaded:
                        w_re = weights_re[first // BLOCK, e, first % BLOCK + i]
                        w_im = weights_im[first // BLOCK, e, first % BLOCK + i]
                        wave = times(wave, wp.vec2(w_re, w_im))
                    if gpu:
                        wave = times(wave, drives[own, e])
                    gain = fall_of(sound, strength, d, inverse)
                    r_x = wp.float32(dx)
                    r_y = wp.float32(dy)
                    r_z = wp.float32(1.0)  # add the terms that the flat form omits to the sum
                    if not flat:
                        r_z = wp.float32(dz)
                        gain = wp.where(dz > real(0.0), gain, wp.float32(0.0))
                    if faced:
                        gain *= from_front(-(r_x * n_x[i] + r_y * n_y[i] + r_z * n_z[i]) * inverse)
                    q = wp.float32(z2) * (inverse * inverse)
                    direct = gain * directivity(in_directivity, q)
                    bend = gain * (inverse * inverse) * slope(in_slope, q)
                    swing = direct * inverse
                    decay = (inverse + sound.absorption_Np_m) * swing + q * bend
                    along_re = decay * wave[0] + swing * wave[1]
                    along_im = decay * wave[1] - swing * wave[0]
                    found = vec8(
                        direct * wave[0],
                        direct * wave[1],
                        along_re * r_x,
                        along_im * r_x,
                        along_re * r_y,
                        along_im * r_y,
                        r_z * (along_re - bend * wave[0]),
                        r_z * (along_im - bend * wave[1]),
                    )
                    if gpu:
                        for j in range(8):
                            sums[j, i] += found[j]
                    else:
                        keep(scratch, slot, i, found)
                if not gpu:
                    slot += 1
                    # In a fixed order, so that silent transducers do not change the rounding
                    if (e + 1) % TILE == 0 or e == span[1] - 1:
                        add_tile(scratch, slot, drives, e + 1 - slot, begin, end)
                        slot = wp.int32(0)
            back = wp.mat33(wp.transpose(turns[group]))
            for i in range(width):
                if first + i < stop:
                    local = turns[group] * (points[first + i] - origins[group])
                    height = wp.float32(local[2]) if flat else wp.float32(1.0)
                    if height > 0.0:
                        for k in range(begin, end):
                            found = vec8()
                            for j in range(8):
                                if gpu:
                                    found[j] = sums[j, i]
                                else:
                                    found[j] = scratch[(TILE + k) * NUMBERS + j * width + i]
                            cosine = -wp.vec3(found[2], found[4], height * found[6])
                            sine = -wp.vec3(found[3], found[5], height * found[7])
                            result[k, first + i] = result[k, first + i] + wp.vec2(found[0], found[1])
                            for j in range(3):
                                axis = wp.vec3(back[j, 0], back[j, 1], back[j, 2])
                                grown = wp.vec2(wp.dot(axis, cosine), wp.dot(axis, sine))
                                rows[k, first + i, j] = rows[k, first + i, j] + grown

    return kernel
