"""Pressure of baffled pistons on the CPU: 16 points per Warp thread, so that LLVM vectorises the loop over them.

Warp's CPU back end runs scalar code per thread, and library sine, cosine and exponential keep a loop scalar. Here they
are short polynomials whose coefficients the caller fits (`palmfield.acoustics.polynomials`). Sixteen lanes are one
AVX-512 register: they stay in registers, where 32 went through the stack and ran at 0.7 of the speed whenever the
stack happened not to start at a cache line.
"""

import warp as wp

wp.set_module_options(
    {
        "enable_backward": False,
        "max_unroll": 1,  # LLVM vectorises loops, not what Warp has unrolled
        # Contraction lets LLVM fuse multiply and add across Warp's function calls: a fifth faster, no less accurate
        "cpu_compiler_flags": "-march=native -ffp-contract=fast",
    }
)

WIDTH = 16
lanes = wp.types.vector(length=WIDTH, dtype=wp.float32)
vec4 = wp.types.vector(length=4, dtype=wp.float32)
vec5 = wp.types.vector(length=5, dtype=wp.float32)
vec6 = wp.types.vector(length=6, dtype=wp.float32)

NEAREST_M2 = wp.constant(1.0e-18)  # keeps 1/d finite at an element's own position


@wp.struct
class Sound:
    """Numbers shared by every pair of transducer and point; polynomials have the lowest power first.

    turns_per_m, wavenumber_rad_m: one over the wavelength [1/m], and 2 pi times that
    absorption_Np_m: amplitude lost on the way [Np/m]
    attenuation: exp(-absorption d) in d [m]
    directivity, slope: the piston's directivity in sin^2 of the angle off the axis, and its derivative
    sine, cosine: sin(2 pi f)/f and cos(2 pi f) in f^2, for f within half a turn
    """

    turns_per_m: wp.float32
    wavenumber_rad_m: wp.float32
    absorption_Np_m: wp.float32
    attenuation: vec4
    directivity: vec6
    slope: vec5
    sine: vec6
    cosine: vec6


@wp.func
def cubic(c: vec4, x: wp.float32):
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@wp.func
def quartic(c: vec5, x: wp.float32):
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))


@wp.func
def quintic(c: vec6, x: wp.float32):
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))


@wp.kernel
def pressure(
    points: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    drive: wp.array(dtype=wp.vec2),
    sound: Sound,
    result: wp.array(dtype=wp.vec2),
):
    """drive: strength [Pa m] and phase [turns] by transducer; result: real and imaginary pressure [Pa] by point."""
    first = wp.tid() * WIDTH
    count = points.shape[0]
    x = lanes()
    y = lanes()
    z = lanes()
    re = lanes()
    im = lanes()
    for i in range(WIDTH):
        point = points[wp.min(first + i, count - 1)]
        x[i] = point[0]
        y[i] = point[1]
        z[i] = point[2]
    for e in range(positions.shape[0]):
        o = positions[e]
        n = normals[e]
        strength = drive[e][0]
        phase = drive[e][1]
        for i in range(WIDTH):
            dx = x[i] - o[0]
            dy = y[i] - o[1]
            dz = z[i] - o[2]
            # 1/square does not wait for the square root, as 1/d would
            square = dx * dx + dy * dy + dz * dz + NEAREST_M2
            d = wp.sqrt(square)
            inverse = d * (1.0 / square)
            cosine = (dx * n[0] + dy * n[1] + dz * n[2]) * inverse
            turns = d * sound.turns_per_m + phase
            f = turns - wp.floor(turns + 0.5)
            directivity = quintic(sound.directivity, 1.0 - cosine * cosine)
            gain = strength * inverse * cubic(sound.attenuation, d) * directivity
            gain = wp.where(cosine > 0.0, gain, 0.0)
            re[i] += gain * quintic(sound.cosine, f * f)
            im[i] += gain * f * quintic(sound.sine, f * f)
    for i in range(WIDTH):
        if first + i < count:
            result[first + i] = wp.vec2(re[i], im[i])


@wp.kernel
def pressure_gradient(
    points: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    drive: wp.array(dtype=wp.vec2),
    sound: Sound,
    result: wp.array(dtype=wp.vec2),
    gradient: wp.array2d(dtype=wp.vec2),
):
    """As `pressure`, and the gradient [Pa/m], shape (points, 3); the formula stands in `field.pressure_gradient`."""
    first = wp.tid() * WIDTH
    count = points.shape[0]
    x = lanes()
    y = lanes()
    z = lanes()
    re = lanes()
    im = lanes()
    x_re = lanes()
    x_im = lanes()
    y_re = lanes()
    y_im = lanes()
    z_re = lanes()
    z_im = lanes()
    for i in range(WIDTH):
        point = points[wp.min(first + i, count - 1)]
        x[i] = point[0]
        y[i] = point[1]
        z[i] = point[2]
    for e in range(positions.shape[0]):
        o = positions[e]
        n = normals[e]
        strength = drive[e][0]
        phase = drive[e][1]
        for i in range(WIDTH):
            dx = x[i] - o[0]
            dy = y[i] - o[1]
            dz = z[i] - o[2]
            square = dx * dx + dy * dy + dz * dz + NEAREST_M2
            d = wp.sqrt(square)
            inverse = d * (1.0 / square)
            cosine = (dx * n[0] + dy * n[1] + dz * n[2]) * inverse
            s = 1.0 - cosine * cosine
            turns = d * sound.turns_per_m + phase
            f = turns - wp.floor(turns + 0.5)
            directivity = quintic(sound.directivity, s)
            bend = 2.0 * cosine * inverse * quartic(sound.slope, s)
            gain = strength * inverse * cubic(sound.attenuation, d)
            gain = wp.where(cosine > 0.0, gain, 0.0)
            wave_re = gain * quintic(sound.cosine, f * f)
            wave_im = gain * f * quintic(sound.sine, f * f)
            decay = (cosine * bend - directivity * (sound.absorption_Np_m + inverse)) * inverse
            swing = directivity * sound.wavenumber_rad_m * inverse
            along_re = decay * wave_re - swing * wave_im
            along_im = decay * wave_im + swing * wave_re
            axial_re = bend * wave_re
            axial_im = bend * wave_im
            re[i] += directivity * wave_re
            im[i] += directivity * wave_im
            x_re[i] += along_re * dx - axial_re * n[0]
            x_im[i] += along_im * dx - axial_im * n[0]
            y_re[i] += along_re * dy - axial_re * n[1]
            y_im[i] += along_im * dy - axial_im * n[1]
            z_re[i] += along_re * dz - axial_re * n[2]
            z_im[i] += along_im * dz - axial_im * n[2]
    for i in range(WIDTH):
        if first + i < count:
            result[first + i] = wp.vec2(re[i], im[i])
            gradient[first + i, 0] = wp.vec2(x_re[i], x_im[i])
            gradient[first + i, 1] = wp.vec2(y_re[i], y_im[i])
            gradient[first + i, 2] = wp.vec2(z_re[i], z_im[i])
