"""Sound of several drives at points of a surface, on a device: partial fields, then the ARP with shadows.

One thread computes one point, a few drives and a run of the transducers. Partial results are stored separately and
summed in a fixed order, so few points fill a GPU, and equal input gives equal bits.
"""

import functools
from typing import Any

import warp as wp

from warp_kernels import FUSED
from warp_kernels.arp import radiation_pressure, times
from warp_kernels.pressure import (
    BLOCK,
    GPU,
    NEAREST_M2,
    STEEPNESS,
    TURN,
    from_front,
    inverse_root,
    quartic,
    quintic,
    row32,
    vec6,
)

wp.set_module_options(GPU)

PARTS = 8
"""Numbers of a field: real and imaginary pressure, then those of its gradient over k along x, y and z."""
GRAZING = 1.0e-6


@wp.struct
class Waves:
    """Constants of all pairs of transducer and point.

    turns_per_m: one over the wavelength [1/m]; absorption_Np_m: amplitude absorption [Np/m]
    per_wavenumber: 1/k [m]
    """

    turns_per_m: wp.float32
    absorption_Np_m: wp.float32
    per_wavenumber: wp.float32


@functools.cache
def fields(rows: int, gpu: bool, shaded: bool = False) -> Any:
    """Return the kernel of pressure and gradient of `rows` drives per thread; dim: (w drives / rows, runs, points).

    shaded: whether each pair of transducer and point has a weight
    """
    lanes = wp.types.vector(length=rows, dtype=wp.float32)

    @wp.kernel(module="unique", module_options=GPU if gpu else FUSED)
    def kernel(
        points: wp.array2d(dtype=wp.vec3),
        normals: wp.array2d(dtype=wp.vec3),
        places: wp.array(dtype=wp.vec4),
        facing: wp.array(dtype=wp.vec4),
        shapes: wp.array(dtype=vec6),
        waves: Waves,
        first: wp.int32,
        stop: wp.int32,
        size: wp.int32,
        run: wp.int32,
        counts: wp.array2d(dtype=wp.int32),
        drives: wp.array2d(dtype=wp.vec2),
        weights_re: wp.array3d(dtype=wp.float32),
        weights_im: wp.array3d(dtype=wp.float32),
        result: wp.array4d(dtype=wp.float32),
    ):
        """Sum over transducers [first, stop) in runs of `size`; results of the runs begin at result[:, run].

        points, normals: of each world, (w, n); normals: unit outward normals of opaque surfaces, see
            `pressure.from_front`
        places, facing: position [m] and unit direction of each transducer, the fourth number is unused
        shapes: directivity and slope, see `pressure.Sound`
        counts: number of drives in each world; drives: complex amplitude of each transducer [Pa m], shape (w drives, n)
        weights_re, weights_im: as `gradient.gradient`, read if `shaded`
        result: the numbers of a field, shape (w drives, runs, PARTS, points)
        """
        block, j, i = wp.tid()
        row = block * rows
        capacity = drives.shape[0] // counts.shape[0]
        world = row // capacity
        if row - world * capacity < counts[world, 0]:
            point = points[world, i]
            normal = STEEPNESS * normals[world, i]
            in_directivity = shapes[0]
            in_slope = shapes[1]
            # Local copies, because numbers in a struct would be reloaded for each transducer
            turns_per_m = waves.turns_per_m
            loss = waves.absorption_Np_m
            per_wavenumber = waves.per_wavenumber
            a_re = lanes()
            a_im = lanes()
            p_re = lanes()
            p_im = lanes()
            x_re = lanes()
            x_im = lanes()
            y_re = lanes()
            y_im = lanes()
            z_re = lanes()
            z_im = lanes()
            for e in range(first + j * size, wp.min(first + (j + 1) * size, stop)):
                # A single drive is often zero here, as it is of another array; several drives are read for lit points
                sounds = True
                if rows == 1:
                    a = drives[row, e]
                    a_re[0] = a[0]
                    a_im[0] = a[1]
                    sounds = wp.abs(a[0]) + wp.abs(a[1]) > 0.0
                if sounds:
                    place = row32(places, e)
                    axis = row32(facing, e)
                    x = point[0] - place[0]
                    y = point[1] - place[1]
                    z = point[2] - place[2]
                    square = x * x + y * y + z * z + wp.float32(NEAREST_M2)
                    inverse = inverse_root(square)
                    d = square * inverse
                    cosine = (x * axis[0] + y * axis[1] + z * axis[2]) * inverse
                    share = from_front(-(x * normal[0] + y * normal[1] + z * normal[2]) * inverse)
                    if cosine > 0.0 and share > 0.0:
                        turns = d * turns_per_m
                        angle = TURN * (turns - wp.floor(turns + 0.5))
                        gain = share * inverse * wp.exp(-loss * d)
                        wave_re = gain * wp.cos(angle)
                        wave_im = gain * wp.sin(angle)
                        if shaded:
                            w_re = weights_re[i // BLOCK, e, i % BLOCK]
                            w_im = weights_im[i // BLOCK, e, i % BLOCK]
                            straight = wave_re
                            wave_re = straight * w_re - wave_im * w_im
                            wave_im = straight * w_im + wave_im * w_re
                        q = cosine * cosine
                        direct = quintic(in_directivity, q)
                        bend = quartic(in_slope, q) * inverse
                        swing = direct * inverse
                        decay = -(loss + inverse) * per_wavenumber * swing - q * bend * inverse
                        along_re = decay * wave_re - swing * wave_im
                        along_im = decay * wave_im + swing * wave_re
                        axial_re = cosine * bend * wave_re
                        axial_im = cosine * bend * wave_im
                        p = wp.vec2(direct * wave_re, direct * wave_im)
                        gx = wp.vec2(along_re * x + axial_re * axis[0], along_im * x + axial_im * axis[0])
                        gy = wp.vec2(along_re * y + axial_re * axis[1], along_im * y + axial_im * axis[1])
                        gz = wp.vec2(along_re * z + axial_re * axis[2], along_im * z + axial_im * axis[2])
                        # Separate sums, each of which is a fused multiply-add
                        for r in range(rows):
                            if rows > 1:
                                a = drives[row + r, e]
                                a_re[r] = a[0]
                                a_im[r] = a[1]
                            p_re[r] += a_re[r] * p[0]
                            p_re[r] -= a_im[r] * p[1]
                            p_im[r] += a_re[r] * p[1]
                            p_im[r] += a_im[r] * p[0]
                            x_re[r] += a_re[r] * gx[0]
                            x_re[r] -= a_im[r] * gx[1]
                            x_im[r] += a_re[r] * gx[1]
                            x_im[r] += a_im[r] * gx[0]
                            y_re[r] += a_re[r] * gy[0]
                            y_re[r] -= a_im[r] * gy[1]
                            y_im[r] += a_re[r] * gy[1]
                            y_im[r] += a_im[r] * gy[0]
                            z_re[r] += a_re[r] * gz[0]
                            z_re[r] -= a_im[r] * gz[1]
                            z_im[r] += a_re[r] * gz[1]
                            z_im[r] += a_im[r] * gz[0]
            for r in range(rows):
                result[row + r, run + j, 0, i] = p_re[r]
                result[row + r, run + j, 1, i] = p_im[r]
                result[row + r, run + j, 2, i] = x_re[r]
                result[row + r, run + j, 3, i] = x_im[r]
                result[row + r, run + j, 4, i] = y_re[r]
                result[row + r, run + j, 5, i] = y_im[r]
                result[row + r, run + j, 6, i] = z_re[r]
                result[row + r, run + j, 7, i] = z_im[r]

    return kernel


@wp.func
def reach_to_boards(point: wp.vec3, along: wp.vec3, boards: wp.array(dtype=wp.vec4), farthest_m: wp.float32):
    """Return the length of the ray back along the sound up to the farthest board [m].

    boards: mean direction of each board and height of its centre along it [m]
    """
    reach = wp.float32(0.0)
    for b in range(boards.shape[0]):
        facing = wp.vec3(boards[b][0], boards[b][1], boards[b][2])
        leaving = wp.dot(facing, along)
        way = farthest_m
        if leaving > GRAZING:
            way = (wp.dot(facing, point) - boards[b][3]) / leaving
        reach = wp.max(reach, way)
    return wp.min(reach, farthest_m)


@wp.kernel
def arp_of_sums(
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    counts: wp.array2d(dtype=wp.int32),
    levels: wp.array2d(dtype=wp.vec2),
    fields: wp.array4d(dtype=wp.float32),
    weights: wp.vec3,
    mesh: wp.uint64,
    boards: wp.array(dtype=wp.vec4),
    clearance_m: wp.float32,
    farthest_m: wp.float32,
    result: wp.array2d(dtype=wp.float32),
):
    """Compute the ARP [Pa] of sums of drives, levels (w m, k), at points with unit outward normals; dim: (w m, n).

    counts: numbers of drives and sums in each world, (w, 2); fields: of `fields`
    weights: as for `arp.radiation_pressure`
    mesh: mesh that casts shadows, 0 for none; a point is dark if the ray back along the sound hits it before the
        boards, see `reach_to_boards`; clearance_m: height above the surface at which a ray starts
    """
    m, i = wp.tid()
    worlds = counts.shape[0]
    sums = levels.shape[0] // worlds
    w = m // sums
    if m - w * sums < counts[w, 1]:
        first = w * (fields.shape[0] // worlds)
        p = wp.vec2()
        gx = wp.vec2()
        gy = wp.vec2()
        gz = wp.vec2()
        for k in range(counts[w, 0]):
            level = levels[m, k]
            if level[0] != 0.0 or level[1] != 0.0:
                q = wp.vec2()
                hx = wp.vec2()
                hy = wp.vec2()
                hz = wp.vec2()
                for j in range(fields.shape[1]):
                    q += wp.vec2(fields[first + k, j, 0, i], fields[first + k, j, 1, i])
                    hx += wp.vec2(fields[first + k, j, 2, i], fields[first + k, j, 3, i])
                    hy += wp.vec2(fields[first + k, j, 4, i], fields[first + k, j, 5, i])
                    hz += wp.vec2(fields[first + k, j, 6, i], fields[first + k, j, 7, i])
                p += times(level, q)
                gx += times(level, hx)
                gy += times(level, hy)
                gz += times(level, hz)
        n = normals[w, i]
        s_re = wp.vec3(gx[0], gy[0], gz[0])
        s_im = wp.vec3(gx[1], gy[1], gz[1])
        n_re = wp.dot(s_re, n)
        n_im = wp.dot(s_im, n)
        t_re = s_re - n_re * n
        t_im = s_im - n_im * n
        arp = radiation_pressure(p[0], p[1], n_re, n_im, wp.dot(t_re, t_re) + wp.dot(t_im, t_im), weights)
        if mesh != wp.uint64(0) and arp != 0.0:
            flux = p[0] * s_im - p[1] * s_re
            # Divided by its largest part first: the squares of faint sound would underflow
            largest = wp.max(wp.max(wp.abs(flux[0]), wp.abs(flux[1])), wp.abs(flux[2]))
            along = wp.vec3()
            if largest > 0.0:
                along = wp.normalize(flux / largest)
            start = points[w, i] - clearance_m * along
            reach = reach_to_boards(points[w, i], along, boards, farthest_m)
            if largest == 0.0 or wp.mesh_query_ray_anyhit(mesh, start, -along, reach):
                arp = wp.float32(0.0)
        result[m, i] = arp
