"""Sums in numba on one thread: with functions of the C library, and in blocks with polynomials that LLVM vectorises."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]
BLOCK = 64
TURN = np.float32(2.0 * math.pi)
HALF = np.float32(0.5)
ONE = np.float32(1.0)
NONE = np.float32(0.0)


@numba.njit(fastmath=True, inline="always")
def quintic(c: Single, x: np.float32) -> np.float32:
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))


@numba.njit(fastmath=True, error_model="numpy")
def libm(
    points: Single, elements: Single, turns_per_m: np.float32, absorption_Np_m: np.float32, directivity: Single
) -> NDArray[np.complex64]:
    """Sum with functions of the C library.

    elements: position [m], normal, strength [Pa m], phase [turns], shape (t, 8).
    """
    result = np.empty(len(points), np.complex64)
    for i in range(len(points)):
        re = im = NONE
        for e in range(len(elements)):
            x = points[i, 0] - elements[e, 0]
            y = points[i, 1] - elements[e, 1]
            z = points[i, 2] - elements[e, 2]
            d = math.sqrt(x * x + y * y + z * z)
            cosine = (x * elements[e, 3] + y * elements[e, 4] + z * elements[e, 5]) / d
            turns = d * turns_per_m + elements[e, 7]
            angle = TURN * (turns - np.floor(turns + HALF))
            gain = elements[e, 6] / d * math.exp(-absorption_Np_m * d) * quintic(directivity, ONE - cosine * cosine)
            if cosine > NONE:
                re += gain * math.cos(angle)
                im += gain * math.sin(angle)
        result[i] = re + 1j * im
    return result


@numba.njit(fastmath=True, error_model="numpy")
def polynomials(
    points: Single,
    elements: Single,
    turns_per_m: np.float32,
    directivity: Single,
    attenuation: Single,
    sine: Single,
    cosine: Single,
) -> NDArray[np.complex64]:
    """Sum as `libm` with polynomials: attenuation in the distance, sine and cosine in the square of the turns.

    The polynomials are those of `palmfield.studies.bench.problem`.
    """
    # Coefficients in plain variables: as arrays they might overlap what the loop writes, and it would stay scalar
    a0, a1, a2, a3 = attenuation[0], attenuation[1], attenuation[2], attenuation[3]
    d0, d1, d2, d3, d4, d5 = (
        directivity[0],
        directivity[1],
        directivity[2],
        directivity[3],
        directivity[4],
        directivity[5],
    )
    s0, s1, s2, s3, s4, s5 = sine[0], sine[1], sine[2], sine[3], sine[4], sine[5]
    c0, c1, c2, c3, c4, c5 = cosine[0], cosine[1], cosine[2], cosine[3], cosine[4], cosine[5]
    result = np.empty(len(points), np.complex64)
    x = np.empty(BLOCK, np.float32)
    y = np.empty(BLOCK, np.float32)
    z = np.empty(BLOCK, np.float32)
    re = np.empty(BLOCK, np.float32)
    im = np.empty(BLOCK, np.float32)
    for start in range(0, len(points), BLOCK):
        count = min(BLOCK, len(points) - start)
        for i in range(BLOCK):
            j = start + min(i, count - 1)
            x[i], y[i], z[i] = points[j, 0], points[j, 1], points[j, 2]
            re[i] = im[i] = NONE
        for e in range(len(elements)):
            ox, oy, oz = elements[e, 0], elements[e, 1], elements[e, 2]
            nx, ny, nz = elements[e, 3], elements[e, 4], elements[e, 5]
            strength, phase = elements[e, 6], elements[e, 7]
            for i in range(BLOCK):
                dx, dy, dz = x[i] - ox, y[i] - oy, z[i] - oz
                d = math.sqrt(dx * dx + dy * dy + dz * dz)
                inverse = ONE / d
                along = (dx * nx + dy * ny + dz * nz) * inverse
                turns = d * turns_per_m + phase
                f = turns - np.floor(turns + HALF)
                gain = strength * inverse * (a0 + d * (a1 + d * (a2 + d * a3)))
                q = ONE - along * along
                gain *= d0 + q * (d1 + q * (d2 + q * (d3 + q * (d4 + q * d5))))
                gain = gain if along > NONE else NONE
                q = f * f
                re[i] += gain * (c0 + q * (c1 + q * (c2 + q * (c3 + q * (c4 + q * c5)))))
                im[i] += gain * f * (s0 + q * (s1 + q * (s2 + q * (s3 + q * (s4 + q * s5)))))
        for i in range(count):
            result[start + i] = re[i] + 1j * im[i]
    return result
