"""Pressure of baffled pistons, one point per thread: the form for GPUs, and for any range on the CPU.

Phasors go with e^{-i w t}. The phase is counted in turns, so that its reduction is exact in float32.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": True})

vec6 = wp.types.vector(length=6, dtype=wp.float32)

TURN = wp.constant(6.283185307179586)
NEAREST_M2 = wp.constant(1.0e-18)  # keeps 1/d finite at an element's own position


@wp.struct
class Sound:
    """Numbers shared by every pair of transducer and point.

    turns_per_m: one over the wavelength [1/m]
    absorption_Np_m: amplitude lost on the way [Np/m]
    directivity, slope: polynomials in sin^2 of the angle off the axis, lowest power first: the piston's directivity
        and its derivative
    """

    turns_per_m: wp.float32
    absorption_Np_m: wp.float32
    directivity: vec6
    slope: vec6


@wp.func
def polynomial(c: vec6, x: wp.float32):
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
    i = wp.tid()
    point = points[i]
    total = wp.vec2()
    for e in range(positions.shape[0]):
        r = point - positions[e]
        d = wp.sqrt(wp.dot(r, r) + NEAREST_M2)
        cosine = wp.dot(r, normals[e]) / d
        if cosine > 0.0:
            turns = d * sound.turns_per_m + drive[e][1]
            angle = TURN * (turns - wp.floor(turns + 0.5))
            gain = drive[e][0] / d * wp.exp(-sound.absorption_Np_m * d)
            gain *= polynomial(sound.directivity, 1.0 - cosine * cosine)
            total += gain * wp.vec2(wp.cos(angle), wp.sin(angle))
    result[i] = total


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
    """As `pressure`, and the gradient [Pa/m], shape (points, 3).

    With q = cos(angle off the axis) and D a function of s = 1 - q^2, the gradient of exp(ikd - beta d) D/d is
    exp(ikd - beta d)/d times ((ik - beta - 1/d) D + 2 q^2 D'/d) along the ray and -2 q D'/d along the axis.
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
        if cosine > 0.0:
            s = 1.0 - cosine * cosine
            directivity = polynomial(sound.directivity, s)
            bend = 2.0 * cosine * inverse * polynomial(sound.slope, s)
            turns = d * sound.turns_per_m + drive[e][1]
            angle = TURN * (turns - wp.floor(turns + 0.5))
            gain = drive[e][0] * inverse * wp.exp(-sound.absorption_Np_m * d)
            wave_re = gain * wp.cos(angle)
            wave_im = gain * wp.sin(angle)
            decay = cosine * bend - directivity * (sound.absorption_Np_m + inverse)
            swing = directivity * TURN * sound.turns_per_m
            along_re = (decay * wave_re - swing * wave_im) * inverse
            along_im = (decay * wave_im + swing * wave_re) * inverse
            total += directivity * wp.vec2(wave_re, wave_im)
            real += along_re * r - bend * wave_re * normals[e]
            imag += along_im * r - bend * wave_im * normals[e]
    result[i] = total
    for axis in range(3):
        gradient[i, axis] = wp.vec2(real[axis], imag[axis])
