"""Pressure of transducers and its gradient; see pressure.py, whose parts it shares.

All lengths are in units of 1/k here: rotations into the groups' frames are k times as long, and so are elements' x, y
and z; absorption is per radian. Then the spreading and the phase of a wave need no factor.
"""

import functools
from typing import Any

import warp as wp

from warp_kernels.point_sound import BLOCK
from warp_kernels.pressure import (
    CPU,
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


@functools.cache
def gradient(form: Form) -> Any:
    """Kernel of the pressure and its gradient; WIDTH points a thread.

    With r from transducer to point, d = |r|, q = z^2/d^2, D the directivity and S = 2 dD/dq, the gradient of
    exp(id - bd) D/d over exp(id - bd)/d is [(i - b - 1/d) D/d - q S/d^2] r + S z/d^2 along the axis.
    """
    vec3, vec4, mat33 = form.vectors
    width = WIDTH["gpu" if form.gpu else "cpu"]
    real = wp.float64 if form.accurate else wp.float32
    places = wp.types.vector(length=width, dtype=real)
    lanes = wp.types.vector(length=width, dtype=wp.float32)
    row = row64 if form.accurate else row32
    root = root64 if form.accurate else root32
    angle = form.angle
    gpu, flat, shaded, faced = form.gpu, form.flat, form.shaded, form.faced
    fall = form.fall_of
    directivity = quartic if form.smooth else quintic
    slope = cubic if form.smooth else quartic

    @wp.kernel(module="unique", module_options=GPU if form.gpu else CPU, enable_backward=False)
    def kernel(
        points: wp.array(dtype=vec3),
        origins: wp.array(dtype=vec3),
        turns: wp.array(dtype=mat33),
        ranges: wp.array(dtype=wp.vec2i),
        elements: wp.array(dtype=vec4),
        strengths: wp.array(dtype=wp.vec4),
        sound: Sound,
        shapes: wp.array(dtype=vec6),
        result: wp.array(dtype=wp.vec2),
        rows: wp.array2d(dtype=wp.vec2),
        weights_re: wp.array3d(dtype=wp.float32),
        weights_im: wp.array3d(dtype=wp.float32),
        normals: wp.array(dtype=wp.vec3),
    ):
        """As `pressure`, and in `rows` the gradient [Pa/m], shape (points, 3); both must hold zeros.

        weights_re, weights_im: what is left of each transducer's sound at each point, which the form `shaded` reads,
        shape (points / BLOCK, elements, BLOCK)
        normals: unit, outward, of opaque surfaces at the points, which the form `faced` reads
        shapes: the sound's directivity and slope; from an array a GPU keeps them in registers, but it loads a struct's
        numbers again for each transducer
        """
        first = wp.tid() * width
        count = points.shape[0]
        loss = sound.absorption_Np_m
        if gpu:
            in_directivity = shapes[0]
            in_slope = shapes[1]
        else:
            in_directivity = sound.directivity
            in_slope = sound.slope
        x = places()
        y = places()
        z = places()  # its square in the flat form
        near = lanes()
        n_x = lanes()
        n_y = lanes()
        n_z = lanes()  # times z in the flat form
        for group in range(ranges.shape[0]):
            if faced:
                # Back to a rotation, times the steepness
                turn = wp.mat33(turns[group])
                turn *= STEEPNESS / wp.length(turn[0])
            for i in range(width):
                local = turns[group] * (points[wp.min(first + i, count - 1)] - origins[group])
                x[i] = local[0]
                y[i] = local[1]
                if flat:
                    z[i] = local[2] * local[2] + real(NEAREST_M2)
                    near[i] = wp.float32(z[i])
                else:
                    z[i] = local[2]
                if faced:
                    normal = turn * normals[wp.min(first + i, count - 1)]
                    n_x[i] = normal[0]
                    n_y[i] = normal[1]
                    n_z[i] = normal[2] * wp.float32(local[2]) if flat else normal[2]
            re = lanes()
            im = lanes()
            x_re = lanes()
            x_im = lanes()
            y_re = lanes()
            y_im = lanes()
            z_re = lanes()
            z_im = lanes()
            for e in range(ranges[group][0], ranges[group][1]):
                element = row(elements, e)
                strength = row32(strengths, e)
                for i in range(width):
                    dx = x[i] - element[0]
                    dy = y[i] - element[1]
                    if flat:
                        z2 = z[i]
                    else:
                        dz = z[i] - element[3]
                        z2 = dz * dz + real(NEAREST_M2)
                    square = dx * dx + (dy * dy + z2)
                    distance = root(square)
                    d = distance[0]
                    inverse = distance[1]
                    wave = angle(sound, square, d, inverse, element[2])
                    if shaded:
                        w_re = weights_re[first // BLOCK, e, first % BLOCK + i]
                        w_im = weights_im[first // BLOCK, e, first % BLOCK + i]
                        wave = wp.vec2(wave[0] * w_re - wave[1] * w_im, wave[0] * w_im + wave[1] * w_re)
                    gain = fall(sound, strength, d, inverse)
                    if flat:
                        rise2 = near[i]
                    else:
                        rise2 = wp.float32(z2)
                        gain = wp.where(dz > real(0.0), gain, wp.float32(0.0))
                    if faced:
                        above = wp.float32(dx) * n_x[i] + wp.float32(dy) * n_y[i]
                        if flat:
                            above += n_z[i]
                        else:
                            above += wp.float32(dz) * n_z[i]
                        gain *= from_front(-above * inverse)
                    q = rise2 * (inverse * inverse)
                    direct = gain * directivity(in_directivity, q)
                    bend = gain * (inverse * inverse) * slope(in_slope, q)
                    swing = direct * inverse
                    decay = (inverse + loss) * swing + q * bend
                    along_re = decay * wave[0] + swing * wave[1]
                    along_im = decay * wave[1] - swing * wave[0]
                    re[i] += direct * wave[0]
                    im[i] += direct * wave[1]
                    x_re[i] += along_re * wp.float32(dx)
                    x_im[i] += along_im * wp.float32(dx)
                    y_re[i] += along_re * wp.float32(dy)
                    y_im[i] += along_im * wp.float32(dy)
                    if flat:
                        z_re[i] += along_re - bend * wave[0]
                        z_im[i] += along_im - bend * wave[1]
                    else:
                        z_re[i] += wp.float32(dz) * (along_re - bend * wave[0])
                        z_im[i] += wp.float32(dz) * (along_im - bend * wave[1])
            back = wp.transpose(turns[group])
            for i in range(width):
                if first + i < count:
                    local = turns[group] * (points[first + i] - origins[group])
                    height = wp.float32(local[2]) if flat else wp.float32(1.0)
                    if height > 0.0:
                        cosine = -wp.vec3(x_re[i], y_re[i], height * z_re[i])
                        sine = -wp.vec3(x_im[i], y_im[i], height * z_im[i])
                        result[first + i] = result[first + i] + wp.vec2(re[i], im[i])
                        for j in range(3):
                            axis = wp.vec3(wp.float32(back[j, 0]), wp.float32(back[j, 1]), wp.float32(back[j, 2]))
                            rows[first + i, j] = rows[first + i, j] + wp.vec2(wp.dot(axis, cosine), wp.dot(axis, sine))

    return kernel
