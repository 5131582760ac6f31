"""Share of the sound of each transducer behind bodies: Kirchhoff's integral over a screen, along its outline.

The sound removed by a screen between two points is an integral over the screen. By Maggi and Rubinowicz it is an
integral along the outline; for a straight edge it is Fresnel's. The source is shared by CPU and GPUs.
"""

import functools
from typing import Any

import warp as wp

from warp_kernels import FUSED
from warp_kernels.outline import LANES, Pieces
from warp_kernels.pressure import BLOCK, GPU, inverse_root, quintic, vec6

WIDTH = {"cpu": 16, "gpu": 1}
"""Number of transducers that one thread computes together."""
NEIGHBOURS = 6
"""Number of nodes in the interpolation at a point."""
LEAST_SQUARE = wp.constant(1.0e-9)
BLUR_M2 = wp.constant(9.0e-6)
FULL_TURN = wp.constant(6.283185307179586)


@wp.struct
class Nodes:
    """Points at which weights are computed.

    points: points of the surface [m]; numbers: point numbers of the nodes; groups: view group of each node
    """

    points: wp.array(dtype=wp.vec3)
    numbers: wp.array(dtype=wp.int32)
    groups: wp.array(dtype=wp.int32)


@wp.struct
class Emitters:
    """Transducers by board, each board padded to a multiple of WIDTH of the CPU.

    x, y, z: [m]; rows: rows of their weights, -1 for padding; boards: board of each block of WIDTH
    """

    x: wp.array(dtype=wp.float32)
    y: wp.array(dtype=wp.float32)
    z: wp.array(dtype=wp.float32)
    rows: wp.array(dtype=wp.int32)
    boards: wp.array(dtype=wp.int32)


@wp.struct
class Waves:
    """Constants of the waves. turns_per_m: one over the wavelength [1/m]; sine, cosine: as in `pressure.Sound`

    fades: detour in wavelengths at which diffracted sound is zero; it is faded out over the last wavelength
    """

    turns_per_m: wp.float32
    fades: wp.float32
    sine: vec6
    cosine: vec6


@functools.cache
def node_weights(gpu: bool) -> Any:
    """Return the kernel of weights at nodes; dim: (nodes, transducers / WIDTH)."""
    width = WIDTH["gpu" if gpu else "cpu"]
    lanes = wp.types.vector(length=width, dtype=wp.float32)
    of_block = WIDTH["cpu"] // width

    @wp.kernel(module="unique", module_options=GPU if gpu else FUSED)
    def kernel(
        nodes: Nodes,
        emitters: Emitters,
        waves: Waves,
        across: wp.array2d(dtype=wp.vec2),
        pieces: Pieces,
        real: wp.array2d(dtype=wp.float32),
        imag: wp.array2d(dtype=wp.float32),
        boards: wp.int32,
        first: wp.int32,
    ):
        """across: from `outline.look_across`; pieces: output of `outline.list_pieces`
        real, imag: result, shape (nodes, rows); first: number of the first node

        With a from the node to a piece of length and direction t, u from the node to the transducer, and d the distance
        of the piece from the line between them, a piece removes u . (t x a) / (2 pi d^2) times 1 - (1 + cos psi)/2
        exp(ik detour), psi the diffraction angle. The 1 is split into g(d) and 1 - g(d). The sum of 1 - g over pieces
        is the number of layers on the path, blurred over 3 mm and limited to one; g is for pieces with diffraction.
        """
        n, block = wp.tid()
        node = first + n
        board = emitters.boards[block // of_block]
        view = nodes.groups[node] * boards + board
        near = wp.float32(0.0)
        around = wp.float32(0.0)
        for lane in range(LANES):
            near += across[node * boards + board, lane][0]
            around += across[node * boards + board, lane][1]
        re = lanes()
        im = lanes()
        layers = lanes()
        blur_m2 = wp.float32(BLUR_M2)
        if near > 0.0:
            point = nodes.points[nodes.numbers[node]]
            ux = lanes()
            uy = lanes()
            uz = lanes()
            far = lanes()
            fades = waves.fades
            half_turns = wp.float32(0.5) * wp.float32(FULL_TURN) * waves.turns_per_m
            turns_per_m = waves.turns_per_m
            cosine = waves.cosine
            sine = waves.sine
            for i in range(width):
                e = block * width + i
                x = emitters.x[e] - point[0]
                y = emitters.y[e] - point[1]
                z = emitters.z[e] - point[2]
                square = x * x + y * y + z * z + wp.float32(LEAST_SQUARE)
                inverse = inverse_root(square)
                ux[i] = x * inverse
                uy[i] = y * inverse
                uz[i] = z * inverse
                far[i] = square * inverse
            totals = pieces.totals[view]
            for j in range(totals[1]):
                slot = pieces.listed[view, pieces.listed.shape[1] - 1 - j]
                piece = pieces.middles[view, slot]
                a = wp.vec3(piece[0], piece[1], piece[2]) - point
                swept = wp.cross(pieces.ways[view, slot], a)
                square = wp.dot(a, a)
                for i in range(width):
                    along = a[0] * ux[i] + a[1] * uy[i] + a[2] * uz[i]
                    aside = wp.max(square - along * along, wp.float32(LEAST_SQUARE))
                    # angle times (1 - blur), with one division
                    whole = wp.float32(1.0) / (blur_m2 + aside)
                    swept_by = ux[i] * swept[0] + uy[i] * swept[1] + uz[i] * swept[2]
                    layers[i] += swept_by * whole * (wp.float32(1.0) + blur_m2 * whole)
            for j in range(totals[0]):
                slot = pieces.listed[view, j]
                piece = pieces.middles[view, slot]
                a = wp.vec3(piece[0], piece[1], piece[2]) - point
                t = pieces.ways[view, slot]
                swept = wp.cross(t, a)
                square = wp.dot(a, a)
                near_side = wp.sqrt(square)
                slope = wp.dot(t, a)
                rising = slope / near_side
                for i in range(width):
                    along = a[0] * ux[i] + a[1] * uy[i] + a[2] * uz[i]
                    aside = wp.max(square - along * along, wp.float32(LEAST_SQUARE))
                    left = far[i] - along
                    inverse = inverse_root(left * left + aside)
                    far_side = (left * left + aside) * inverse
                    detour = aside / (near_side + along) + aside / (far_side + left)
                    bend = wp.float32(0.5) + wp.float32(0.5) * (along * left - aside) * inverse / near_side
                    ahead = t[0] * ux[i] + t[1] * uy[i] + t[2] * uz[i]
                    phase = half_turns * (rising + (slope - far[i] * ahead) * inverse)
                    phase = phase * phase
                    # sin(x)/x without its zeros: the mean over a piece with varying phase
                    mean = bend / (wp.float32(1.0) + phase * (wp.float32(0.16666667) + phase * wp.float32(0.019444444)))
                    turns = detour * turns_per_m
                    mean = mean * wp.clamp(fades - turns, wp.float32(0.0), wp.float32(1.0))
                    f = turns - wp.floor(turns + wp.float32(0.5))
                    q = f * f
                    angle = (ux[i] * swept[0] + uy[i] * swept[1] + uz[i] * swept[2]) / aside
                    blur = blur_m2 / (blur_m2 + aside)
                    blur = blur * blur
                    layers[i] += angle * (wp.float32(1.0) - blur)
                    re[i] += angle * (blur - mean * quintic(cosine, q))
                    im[i] -= angle * mean * (f * quintic(sine, q))
            for i in range(width):
                behind = wp.clamp(layers[i] / wp.float32(FULL_TURN), wp.float32(0.0), wp.float32(1.0))
                re[i] = wp.float32(1.0) - behind - re[i] / wp.float32(FULL_TURN)
                im[i] = -im[i] / wp.float32(FULL_TURN)
        else:
            for i in range(width):
                re[i] = wp.where(around > 0.5, wp.float32(0.0), wp.float32(1.0))
        for i in range(width):
            row = emitters.rows[block * width + i]
            if row >= 0:
                real[node, row] = re[i]
                imag[node, row] = im[i]

    return kernel


@wp.kernel
def find_clear(across: wp.array2d(dtype=wp.vec2), boards: wp.int32, clear: wp.array(dtype=wp.float32)):
    """Set 1 for each node without obstacles towards any board, else 0; dim: nodes. across: `outline.look_across`"""
    node = wp.tid()
    result = wp.float32(1.0)
    for board in range(boards):
        around = wp.float32(0.0)
        for lane in range(LANES):
            if across[node * boards + board, lane][0] > 0.0:
                result = wp.float32(0.0)
            around += across[node * boards + board, lane][1]
        if around > 0.5:
            result = wp.float32(0.0)
    clear[node] = result


@functools.cache
def spread(gpu: bool) -> Any:
    """Return the kernel that interpolates weights from nodes to points; dim: points / BLOCK, GPU: (rows, points)."""
    lanes = wp.types.vector(length=BLOCK, dtype=wp.float32)

    @wp.kernel(module="unique", module_options=GPU if gpu else FUSED)
    def kernel(
        neighbours: wp.array2d(dtype=wp.int32),
        shares: wp.array2d(dtype=wp.float32),
        node_real: wp.array2d(dtype=wp.float32),
        node_imag: wp.array2d(dtype=wp.float32),
        real: wp.array3d(dtype=wp.float32),
        imag: wp.array3d(dtype=wp.float32),
        clear: wp.array(dtype=wp.float32),
        first: wp.int32,
    ):
        """neighbours, shares: (NEIGHBOURS, points), with a multiple of BLOCK points
        node_real, node_imag: (nodes, rows), with a multiple of BLOCK rows
        real, imag: result, shape (points / BLOCK, rows, BLOCK)
        clear: 1 for each node without obstacles; first: number of the first block of points
        """
        if gpu:
            row, point = wp.tid()
            w_re = wp.float32(0.0)
            w_im = wp.float32(0.0)
            for k in range(NEIGHBOURS):
                w_re += shares[k, point] * node_real[neighbours[k, point], row]
                w_im += shares[k, point] * node_imag[neighbours[k, point], row]
            real[point // BLOCK, row, point % BLOCK] = w_re
            imag[point // BLOCK, row, point % BLOCK] = w_im
        else:
            block = first + wp.tid()
            ways = wp.float32(0.0)
            for i in range(BLOCK):
                for k in range(NEIGHBOURS):
                    ways += clear[neighbours[k, block * BLOCK + i]]
            if ways == wp.float32(BLOCK * NEIGHBOURS):
                for e in range(node_real.shape[1]):
                    for i in range(BLOCK):
                        real[block, e, i] = wp.float32(1.0)
                        imag[block, e, i] = wp.float32(0.0)
                return
            for e in range(0, node_real.shape[1], BLOCK):
                for i in range(BLOCK):
                    re = lanes()
                    im = lanes()
                    for k in range(NEIGHBOURS):
                        c = shares[k, block * BLOCK + i]
                        n = neighbours[k, block * BLOCK + i]
                        for j in range(BLOCK):
                            re[j] += c * node_real[n, e + j]
                            im[j] += c * node_imag[n, e + j]
                    for j in range(BLOCK):
                        real[block, e + j, i] = re[j]
                        imag[block, e + j, i] = im[j]

    return kernel
