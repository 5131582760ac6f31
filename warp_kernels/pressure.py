"""Pressure of planar transducers, with one source for CPU and GPUs. The gradient is in gradient.py.

Phasors are e^{-i w t}. Transducers are in groups with a common plane and axis. In the group frame (x, y in the plane, z
along the axis) they differ only in x, y, strength and phase, so that z^2, cos^2 of the angle off the axis and the test
for "behind the plane" cost little per pair. If only the axis is common, each transducer also has a z.

One thread computes several points. On the CPU, where Warp runs scalar code per thread, LLVM vectorises the loop over
the points; 16 fill one AVX-512 register. On a GPU 4 points share the loads of a transducer.

Options are chosen when the kernels are built (`Form`), for example the functions `angle_*` and `fall_*`.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from warp_kernels import EXACT, FUSED

vec6 = wp.types.vector(length=6, dtype=wp.float32)

NEAREST_M2 = wp.constant(1.0e-18)  # keeps 1/d finite at an element's own position
TURN = wp.constant(6.283185307179586)
STEEPNESS = wp.constant(5.0)  # slope of `from_front` over the cosine: from 0 to 1 between -0.1 and 0.1

GPU = EXACT | {"fast_math": True}
BLOCK = 16
"""Number of points whose weights are adjacent in memory, by transducer."""


@wp.struct
class Sound:
    """Constants of all pairs of transducer and point; polynomials have the lowest power first.

    turns_per_m, turns32_per_m, wavenumber_rad_m: one over the wavelength [1/m], in both precisions, and 2 pi times that
    absorption_Np_m: amplitude absorption [Np/m]; directivity: polynomial in q = cos^2 of the angle off the axis
    slope: twice the derivative of the directivity by q, over k
    sine, cosine: sin(2 pi f)/f and cos(2 pi f) in f^2, for f within half a turn
    """

    turns_per_m: wp.float64
    turns32_per_m: wp.float32
    wavenumber_rad_m: wp.float32
    absorption_Np_m: wp.float32
    directivity: vec6
    slope: vec6
    sine: vec6
    cosine: vec6


@wp.func
def quintic(c: vec6, x: wp.float32):
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))


@wp.func
def cubic(c: vec6, x: wp.float32):
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@wp.func
def quartic(c: vec6, x: wp.float32):
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return rsqrtf(x);
#else
    return 1.0f / sqrtf(x);
#endif
"""
)
def inverse_root(x: wp.float32) -> wp.float32: ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    const float4 v = __ldg(reinterpret_cast<const float4*>(rows.data) + i);
    return wp::vec_t<4, wp::float32>(v.x, v.y, v.z, v.w);
#else
    return rows.data[i];
#endif
"""
)
def row32(rows: wp.array(dtype=wp.vec4), i: wp.int32) -> wp.vec4:
    """Load four numbers at once, for which Warp's indexing needs four loads."""
    ...


@wp.func
def row64(rows: wp.array(dtype=wp.vec4d), i: wp.int32):
    return rows[i]


@wp.func
def from_front(height: wp.float32):
    """Return the share of sound that reaches the front of an opaque surface: continuous, 1/2 at grazing incidence.

    height: STEEPNESS times the cosine between the outward normal and the direction to the transducer
    """
    return wp.min(wp.max(height + 0.5, 0.0), 1.0)


@wp.func
def root32(square: wp.float32):
    """Return the distance [m] and its inverse [1/m] from a squared distance."""
    inverse = inverse_root(square)
    return wp.vec2(square * inverse, inverse)


@wp.func
def root64(square: wp.float64):
    inverse = inverse_root(wp.float32(square))
    return wp.vec2(wp.float32(square) * inverse, inverse)


@wp.func
def polynomial_wave(sound: Sound, f: wp.float32):
    q = f * f
    return wp.vec2(quintic(sound.cosine, q), f * quintic(sound.sine, q))


# Cosine and sine of the phase after distance d; phase: at the transducer [turns]
@wp.func
def angle_cpu32(sound: Sound, square: wp.float32, d: wp.float32, inverse: wp.float32, phase: wp.float32):
    turns = d * sound.turns32_per_m + phase
    return polynomial_wave(sound, turns - wp.floor(turns + 0.5))


@wp.func
def angle_gpu32(sound: Sound, square: wp.float32, d: wp.float32, inverse: wp.float32, phase: wp.float32):
    # The phase is in radians and not reduced, because the sine of the hardware reduces it
    angle = d * sound.wavenumber_rad_m + phase
    return wp.vec2(wp.cos(angle), wp.sin(angle))


@wp.func
def turns64(sound: Sound, square: wp.float64, d: wp.float32, inverse: wp.float32, phase: wp.float64):
    """Return the phase within half a turn, from a distance corrected to float64 by one Newton step."""
    rough = wp.float64(d)
    exact = rough + wp.float64(0.5) * wp.float64(inverse) * (square - rough * rough)
    turns = exact * sound.turns_per_m + phase
    return wp.float32(turns - wp.floor(turns + wp.float64(0.5)))


@wp.func
def angle_cpu64(sound: Sound, square: wp.float64, d: wp.float32, inverse: wp.float32, phase: wp.float64):
    return polynomial_wave(sound, turns64(sound, square, d, inverse, phase))


@wp.func
def angle_gpu64(sound: Sound, square: wp.float64, d: wp.float32, inverse: wp.float32, phase: wp.float64):
    angle = TURN * turns64(sound, square, d, inverse, phase)
    return wp.vec2(wp.cos(angle), wp.sin(angle))


@wp.func
def fall_cubic(sound: Sound, strength: wp.vec4, d: wp.float32, inverse: wp.float32):
    """Return strength times exp(-absorption d)/d, with the exponential as a cubic with coefficients in `strength`."""
    return strength[0] * inverse + (strength[1] + d * (strength[2] + d * strength[3]))


@wp.func
def fall_quadratic(sound: Sound, strength: wp.vec4, d: wp.float32, inverse: wp.float32):
    return strength[0] * inverse + (strength[1] + d * strength[2])


@wp.func
def fall_exponential(sound: Sound, strength: wp.vec4, d: wp.float32, inverse: wp.float32):
    return strength[0] * inverse * wp.exp(-sound.absorption_Np_m * d)


FALLS = {"quadratic": fall_quadratic, "cubic": fall_cubic, "exponential": fall_exponential}


@dataclass(frozen=True)
class Form:
    """Options with which kernels are built.

    gpu: for a GPU instead of the CPU; accurate: geometry and phase in float64, all else in float32
    fall: method for the decay of the amplitude with distance, a key of FALLS
    smooth: directivity as a quartic and its slope as a cubic, instead of a quintic and a quartic
    flat: transducers of a group are in a plane; otherwise the fourth number of an element is its height over the plane
    shaded: each pair of transducer and point has a weight (kernels with gradient)
    faced: points are on opaque surfaces, which sound from behind does not reach (kernels with gradient)
    """

    gpu: bool
    accurate: bool
    fall: str
    smooth: bool
    flat: bool
    shaded: bool = False
    faced: bool = False

    @property
    def fall_of(self) -> Any:
        return FALLS[self.fall]

    @property
    def angle(self) -> Any:
        if self.gpu:
            return angle_gpu64 if self.accurate else angle_gpu32
        return angle_cpu64 if self.accurate else angle_cpu32

    @property
    def vectors(self) -> tuple[Any, Any, Any]:
        """Warp types of a position, of four numbers and of a rotation."""
        return (wp.vec3d, wp.vec4d, wp.mat33d) if self.accurate else (wp.vec3, wp.vec4, wp.mat33)


WIDTH = {"cpu": 16, "gpu": 4}


@functools.cache
def pressure(form: Form) -> Any:
    """Return the kernel of the pressure without gradient; WIDTH points per thread."""
    vec3, vec4, mat33 = form.vectors
    width = WIDTH["gpu" if form.gpu else "cpu"]
    real = wp.float64 if form.accurate else wp.float32
    places = wp.types.vector(length=width, dtype=real)
    lanes = wp.types.vector(length=width, dtype=wp.float32)
    row = row64 if form.accurate else row32
    root = root64 if form.accurate else root32
    angle = form.angle
    flat = form.flat
    fall = form.fall_of
    directivity = quartic if form.smooth else quintic

    @wp.kernel(module="unique", module_options=GPU if form.gpu else FUSED)
    def kernel(
        points: wp.array(dtype=vec3),
        origins: wp.array(dtype=vec3),
        turns: wp.array(dtype=mat33),
        ranges: wp.array2d(dtype=wp.vec2i),
        elements: wp.array(dtype=vec4),
        strengths: wp.array(dtype=wp.vec4),
        sound: Sound,
        result: wp.array2d(dtype=wp.vec2),
    ):
        """By group: origin, rotation into its frame. By part and group: range of transducers. By transducer: x, y,
        phase, z; strength [Pa m] times the coefficients of the decay. result: real and imaginary pressure [Pa] by part
        of the transducers and point.
        """
        part, thread = wp.tid()
        first = thread * width
        count = points.shape[0]
        x = places()
        y = places()
        z = places()  # its square in the flat form
        near = lanes()
        re = lanes()
        im = lanes()
        for group in range(ranges.shape[1]):
            front = lanes()
            for i in range(width):
                local = turns[group] * (points[wp.min(first + i, count - 1)] - origins[group])
                x[i] = local[0]
                y[i] = local[1]
                if flat:
                    z[i] = local[2] * local[2] + real(NEAREST_M2)
                    near[i] = wp.float32(z[i])
                    front[i] = wp.where(local[2] > real(0.0), wp.float32(1.0), wp.float32(0.0))
                else:
                    z[i] = local[2]
                    front[i] = wp.float32(1.0)
            part_re = lanes()
            part_im = lanes()
            for e in range(ranges[part, group][0], ranges[part, group][1]):
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
                    gain = fall(sound, strength, d, inverse)
                    if flat:
                        rise2 = near[i]
                    else:
                        rise2 = wp.float32(z2)
                        gain = wp.where(dz > real(0.0), gain, wp.float32(0.0))
                    gain *= directivity(sound.directivity, rise2 * (inverse * inverse))
                    part_re[i] += gain * wave[0]
                    part_im[i] += gain * wave[1]
            for i in range(width):
                re[i] += front[i] * part_re[i]
                im[i] += front[i] * part_im[i]
        for i in range(width):
            if first + i < count:
                result[part, first + i] = wp.vec2(re[i], im[i])

    return kernel


@wp.kernel(module="unique", module_options=EXACT)
def sum_of_parts(parts: wp.array2d(dtype=wp.vec2), result: wp.array(dtype=wp.vec2)):
    """Compute the pressure [Pa] by point, from that of each part of the transducers."""
    i = wp.tid()
    total = parts[0, i]
    for part in range(1, parts.shape[0]):
        total += parts[part, i]
    result[i] = total


@functools.cache
def emitted(accurate: bool) -> Any:
    """Return the kernel that converts a drive for the kernels of the field, in mode accurate or fast."""
    vec4 = wp.vec4d if accurate else wp.vec4
    real = wp.float64 if accurate else wp.float32

    @wp.kernel(module="unique", module_options=EXACT)
    def kernel(
        drive: wp.array(dtype=wp.vec2d),
        fall: wp.array(dtype=wp.vec4d),
        per_radian: wp.float64,
        elements: wp.array(dtype=vec4),
        strengths: wp.array(dtype=wp.vec4),
    ):
        """drive: complex amplitudes by transducer; fall: p0 [Pa m] times the coefficients of the decay, one vector.
        elements, strengths: filled with phases and amplitudes, see `pressure`
        """
        e = wp.tid()
        element = elements[e]
        element[2] = real(wp.atan2(drive[e][1], drive[e][0]) * per_radian)
        elements[e] = element
        strengths[e] = wp.vec4(wp.length(drive[e]) * fall[0])

    return kernel
