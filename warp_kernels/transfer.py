"""Fields of single transducers at fixed points, and radiation pressure from products with them."""

import warp as wp

from warp_kernels import FUSED
from warp_kernels.arp import FORMULA, radiation_pressure
from warp_kernels.pressure import (
    NEAREST_M2,
    STEEPNESS,
    Sound,
    fall_cubic,
    from_front,
    inverse_root,
    polynomial_wave,
    quartic,
    quintic,
)

wp.set_module_options(FUSED)

WIDTH = 16
lanes = wp.types.vector(length=WIDTH, dtype=wp.float32)


@wp.kernel
def matrix(
    points: wp.array(dtype=wp.vec3),
    axes: wp.array(dtype=wp.mat33),
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    strength: wp.vec4,
    sound: Sound,
    result: wp.array(dtype=wp.float32, ndim=3),
):
    """Compute the fields of single transducers; WIDTH points per thread.

    result[e, 0 and 4, i]: real and imaginary pressure [Pa] at point i for unit drive of transducer e; [e, 1..3 and
    5..7, i]: its gradient over k along the rows of axes[i] [Pa]; the last row is the outward normal of an opaque
    surface. The formula is that of `gradient.gradient` with the form `faced`.
    """
    block, e = wp.tid()
    first = block * WIDTH
    count = points.shape[0]
    position = positions[e]
    normal = normals[e]
    x = lanes()
    y = lanes()
    z = lanes()
    for i in range(WIDTH):
        point = points[wp.min(first + i, count - 1)]
        x[i] = point[0] - position[0]
        y[i] = point[1] - position[1]
        z[i] = point[2] - position[2]
    re = lanes()
    im = lanes()
    along_re = lanes()
    along_im = lanes()
    axial_re = lanes()
    axial_im = lanes()
    for i in range(WIDTH):
        square = x[i] * x[i] + y[i] * y[i] + z[i] * z[i] + wp.float32(NEAREST_M2)
        inverse = inverse_root(square)
        d = square * inverse
        cosine = (x[i] * normal[0] + y[i] * normal[1] + z[i] * normal[2]) * inverse
        turns = d * sound.turns32_per_m
        wave = polynomial_wave(sound, turns - wp.floor(turns + 0.5))
        gain = wp.where(cosine > 0.0, fall_cubic(sound, strength, d, inverse), 0.0)
        wave_re = gain * wave[0]
        wave_im = gain * wave[1]
        q = cosine * cosine
        direct = quintic(sound.directivity, q)
        bend = quartic(sound.slope, q) * inverse
        swing = direct * inverse
        decay = -(sound.absorption_Np_m + inverse) / sound.wavenumber_rad_m * swing - q * bend * inverse
        re[i] = direct * wave_re
        im[i] = direct * wave_im
        along_re[i] = decay * wave_re - swing * wave_im
        along_im[i] = decay * wave_im + swing * wave_re
        axial_re[i] = cosine * bend * wave_re
        axial_im[i] = cosine * bend * wave_im
    for i in range(WIDTH):
        k = first + i
        if k < count:
            ray = axes[k] * wp.vec3(x[i], y[i], z[i])
            axis = axes[k] * normal
            share = from_front(-STEEPNESS * ray[2] * inverse_root(wp.dot(ray, ray) + wp.float32(NEAREST_M2)))
            result[e, 0, k] = share * re[i]
            result[e, 4, k] = share * im[i]
            for j in range(3):
                result[e, 1 + j, k] = share * (along_re[i] * ray[j] + axial_re[i] * axis[j])
                result[e, 5 + j, k] = share * (along_im[i] * ray[j] + axial_im[i] * axis[j])


@wp.func_native(
    snippet=f"""
    const auto row = [&](int j, int r) {{
        return reinterpret_cast<const float*>(reinterpret_cast<const char*>(parts.data)
            + j * size_t(parts.strides[0]) + r * size_t(parts.strides[1]));
    }};
    const int re = frame, im = frames + frame;
    const float *rr0 = row(0, re), *rr1 = row(1, re), *rr2 = row(2, re), *rr3 = row(3, re);
    const float *ri0 = row(4, re), *ri1 = row(5, re), *ri2 = row(6, re), *ri3 = row(7, re);
    const float *ir0 = row(0, im), *ir1 = row(1, im), *ir2 = row(2, im), *ir3 = row(3, im);
    const float *ii0 = row(4, im), *ii1 = row(5, im), *ii2 = row(6, im), *ii3 = row(7, im);
    float* __restrict to = reinterpret_cast<float*>(reinterpret_cast<char*>(result.data)
        + size_t(first_frame + frame) * result.strides[0]) + first;
    for (int k = 0; k < width; ++k) {{
        const float p_re = rr0[k] - ii0[k], s_re = rr1[k] - ii1[k], t_re = rr2[k] - ii2[k], n_re = rr3[k] - ii3[k];
        const float p_im = ri0[k] + ir0[k], s_im = ri1[k] + ir1[k], t_im = ri2[k] + ir2[k], n_im = ri3[k] + ir3[k];
        const float along2 = s_re * s_re + s_im * s_im + t_re * t_re + t_im * t_im;
        to[k] = {FORMULA};
    }}
"""
)
def arp_row(
    parts: wp.array(dtype=wp.float32, ndim=3),
    frames: wp.int32,
    width: wp.int32,
    weights: wp.vec3,
    frame: wp.int32,
    first_frame: wp.int32,
    first: wp.int32,
    result: wp.array(dtype=wp.float32, ndim=2),
):
    """Compute a row in C, because LLVM cannot vectorise Warp's strided indexing, which is ten times slower."""
    ...


@wp.kernel
def arp_rows(
    parts: wp.array(dtype=wp.float32, ndim=3),
    frames: wp.int32,
    width: wp.int32,
    weights: wp.vec3,
    first_frame: wp.int32,
    first: wp.int32,
    result: wp.array(dtype=wp.float32, ndim=2),
):
    """Compute the ARP [Pa] from products with the blocks of `matrix`, one frame per thread, on the CPU.

    parts: by block, row and point; the first `frames` rows are those of the real parts of the drives, the next those of
        the imaginary parts, so that the real part of a product is parts[j, f] - parts[4 + j, frames + f]
    """
    frame = wp.tid()
    arp_row(parts, frames, width, weights, frame, first_frame, first, result)


@wp.kernel
def arp_in_span(
    fields: wp.array3d(dtype=lanes),
    shares: wp.array2d(dtype=wp.vec2),
    weights: wp.vec3,
    result: wp.array2d(dtype=lanes),
):
    """Compute the ARP [Pa] of sums of a few fields, WIDTH points per thread.

    fields: numbers of `matrix` for each field, shape (blocks, r, 8); shares: amplitudes of the fields, shape (m, r)
    result: shape (m, blocks)
    """
    block = wp.tid()
    for frame in range(shares.shape[0]):
        p_re = lanes()
        s_re = lanes()
        t_re = lanes()
        n_re = lanes()
        p_im = lanes()
        s_im = lanes()
        t_im = lanes()
        n_im = lanes()
        for j in range(shares.shape[1]):
            share = shares[frame, j]
            re = share[0]
            im = share[1]
            p_re = p_re + (re * fields[block, j, 0] - im * fields[block, j, 4])
            p_im = p_im + (re * fields[block, j, 4] + im * fields[block, j, 0])
            s_re = s_re + (re * fields[block, j, 1] - im * fields[block, j, 5])
            s_im = s_im + (re * fields[block, j, 5] + im * fields[block, j, 1])
            t_re = t_re + (re * fields[block, j, 2] - im * fields[block, j, 6])
            t_im = t_im + (re * fields[block, j, 6] + im * fields[block, j, 2])
            n_re = n_re + (re * fields[block, j, 3] - im * fields[block, j, 7])
            n_im = n_im + (re * fields[block, j, 7] + im * fields[block, j, 3])
        along2 = wp.cw_mul(s_re, s_re) + wp.cw_mul(s_im, s_im) + wp.cw_mul(t_re, t_re) + wp.cw_mul(t_im, t_im)
        arp = lanes()
        for i in range(WIDTH):
            arp[i] = radiation_pressure(p_re[i], p_im[i], n_re[i], n_im[i], along2[i], weights)
        result[frame, block] = arp


@wp.kernel
def arp_columns(
    parts: wp.array(dtype=wp.float32, ndim=2),
    weights: wp.vec3,
    first: int,
    result: wp.array(dtype=wp.float32, ndim=2),
    peaks: wp.array(dtype=wp.float32, ndim=2),
):
    """Compute the ARP [Pa] from a row of eight blocks, see `matrix`, one point and frame per thread, on a GPU.

    peaks: amplitudes of the pressures [Pa], of the shape of the result, or None
    """
    frame, k = wp.tid()
    count = parts.shape[1] / 8
    s_re = parts[frame, count + k]
    t_re = parts[frame, 2 * count + k]
    s_im = parts[frame, 5 * count + k]
    t_im = parts[frame, 6 * count + k]
    along2 = s_re * s_re + s_im * s_im + t_re * t_re + t_im * t_im
    result[first + frame, k] = radiation_pressure(
        parts[frame, k], parts[frame, 4 * count + k], parts[frame, 3 * count + k], parts[frame, 7 * count + k],
        along2, weights,
    )  # fmt: skip
    if peaks:
        peaks[first + frame, k] = wp.length(wp.vec2(parts[frame, k], parts[frame, 4 * count + k]))
