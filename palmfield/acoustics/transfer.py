"""ARP of many drive frames at the same points: fields of all transducers once, then one matrix product per frame."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr

from palmfield.acoustics import check
from palmfield.acoustics.arp import ArpLaw, arp, law_named, law_weights, unit_normals
from palmfield.acoustics.field import CUBIC_REACH_Np, FieldEvaluator, distances, polynomial_fall
from palmfield.acoustics.groups import axes
from palmfield.blas import one_blas_thread
from palmfield.device import SharedArray, available_bytes, launch, matrix_product, recorded, run_kernel
from palmfield.errors import PalmfieldError
from palmfield.threads import pool, share
from palmfield.types import Complex, Float, Float32
from warp_kernels import products
from warp_kernels import transfer as kernels

DROPPED = 1e-5
"""Largest share of the norm of each frame that is lost by a reduction to fewer dimensions."""
SPAN_FROM = 0.7
"""Share of the number of transducers above which a reduction saves no work."""
FIRST_SAMPLE = 64

# Sixteen rows of points for a block of frames are 1 MB, so they stay in the cache between product and ARP
POINTS_A_BLOCK = 256
FRAMES_A_BLOCK = 64
GPU_SCRATCH_BYTES = 2**31
BYTES_LIMIT = 2**32
"""Largest size of a matrix [bytes] on any machine."""
GPU_SHARE = 8
"""Free GPU memory over largest matrix: a GPU stores the matrix twice, its reduced form, blocks of products, and ARP."""
MATRIX_FROM = 16
"""Number of frames from which the matrix is faster; it takes as long as 10 to 15 frames (docs/bench/frames.md)."""


Weights = tuple[float, float, float]
"""Weights of an ARP law, see `palmfield.acoustics.arp.law_weights`."""


class Transfer:
    """Transfer matrix from all transducers to fixed points: pressure, and gradient along the surface and its normal.

    evaluator: gives array, air, absorption and device. Its mode must be "fast", since the matrix is in float32.
    points: [m], array frame, shape (n, 3). normals: unit outward, shape (n, 3), of opaque surfaces, see `arp_frames`.
    It takes 32 bytes per transducer and point. Raises PalmfieldError for an evaluator of mode "accurate", for bad
    points or normals, for points too far apart (see CUBIC_REACH_Np), and for more than `memory_limit`.
    """

    def __init__(self, evaluator: FieldEvaluator, points: ArrayLike, normals: ArrayLike):
        self.evaluator = evaluator
        if evaluator.mode != "fast":
            raise PalmfieldError(
                f"a transfer matrix is in float32, but the evaluator has mode '{evaluator.mode}': use mode 'fast', "
                "or arp_frames, which then computes frame by frame"
            )
        where = check.points(points, np.float32)
        outward = unit_normals(normals, len(where))
        self.where, self.normals = where, outward
        self.points = len(where)
        elements = len(evaluator.array)
        self.nbytes = matrix_bytes(elements, self.points)
        limit = memory_limit(evaluator.device)
        if self.nbytes > limit:
            raise PalmfieldError(
                f"a transfer matrix of {elements} transducers and {self.points} points takes "
                f"{self.nbytes / 2**30:.2g} GiB; available: {limit / 2**30:.2g} GiB: pass the points in parts"
            )
        self._matrix = self._compute(where, outward)
        self._on_gpu: Any = None
        self._rooms: list[_Room] = []

    def _compute(self, points: Float32, normals: Float32) -> Float32:
        """Return pressure and gradient over k, real parts first, shape (transducers, 8, points)."""
        evaluator, array = self.evaluator, self.evaluator.array
        result = np.zeros((len(array), 8, len(points)), np.float32)
        if result.size == 0:
            return result
        low, high = distances(points, array.positions)
        if too_steep(evaluator, points):
            raise PalmfieldError(
                f"points at {low:.2f} to {high:.2f} m from the transducers span too large a range for an "
                f"absorption of {evaluator.absorption_Np_m:.3g} Np/m: pass near and far points in separate calls"
            )
        strength = array.p0_Pa_m * polynomial_fall(evaluator.absorption_Np_m, low, high)
        place: Any = wp.array(points, dtype=wp.vec3, device="cpu", copy=False)
        turn: Any = wp.array(axes(normals.astype(float)).astype(np.float32), dtype=wp.mat33, device="cpu")

        def run(first: int, stop: int) -> None:
            inputs = [
                place,
                turn,
                wp.array(array.positions[first:stop].astype(np.float32), dtype=wp.vec3, device="cpu"),
                wp.array(array.normals[first:stop].astype(np.float32), dtype=wp.vec3, device="cpu"),
                wp.vec4(*strength),
                evaluator.sound,
                wp.array(result[first:stop], dtype=wp.float32, device="cpu", copy=False),
            ]
            dim = (-(-len(points) // kernels.WIDTH), stop - first)
            run_kernel(kernels.matrix, dim=dim, inputs=inputs, device="cpu")

        bounds = np.linspace(0, len(array), evaluator.threads + 1).astype(int)
        list(pool().map(run, bounds[:-1], bounds[1:]))
        return result

    def pressure(self, drives: ArrayLike) -> NDArray[np.complex64]:
        """Return complex peak pressures [Pa], shape (frames, points), for drives of shape (frames, transducers)."""
        left, basis = self.reduced(drives)
        right = self._matrix[:, 0] + 1j * self._matrix[:, 4]
        return np.asarray(left @ (right if basis is None else basis.conj().T @ right), np.complex64)

    def arp(self, drives: ArrayLike, law: str | ArpLaw = "default", out: Float32 | None = None) -> Float32:
        """Return the ARP [Pa], (frames, points), for drives (frames, transducers); see `palmfield.acoustics.arp`.

        out: array to fill and return, float32; reuse is faster, because the system need not clear new pages.
        Raises SceneError for an unknown law, PalmfieldError for drives that are not finite or of another shape, and for
        an `out` of another shape or type.
        """
        weights = law_weights(law, self.evaluator.air)
        # One BLAS thread per thread, because more would split products that fit the cache of a core. With other
        # programs running, waiting BLAS threads made the reduction up to twenty times slower
        with one_blas_thread:
            left, basis = self.reduced(drives)
            result = np.empty((len(left), self.points), np.float32) if out is None else out
            if result.shape != (len(left), self.points) or result.dtype != np.float32 or not result.flags.c_contiguous:
                raise PalmfieldError(
                    f"out is {result.dtype} of shape {result.shape}: give contiguous float32 of shape "
                    f"({len(left)}, {self.points})"
                )
            if result.size > 0:
                self._fill(result, left, basis, weights)
        return result

    def _fill(
        self, result: Float32, left: NDArray[np.complex64], basis: NDArray[np.complex64] | None, weights: Weights
    ) -> None:
        """Write the ARP of frames with coordinates `left` in `basis`, with blocks of points divided among threads.

        weights: weights of the law, see `palmfield.acoustics.arp.law_weights`
        """
        chunks: list[tuple[slice, Float32]] = []
        for start in range(0, len(left), FRAMES_A_BLOCK):
            chunk = slice(start, min(start + FRAMES_A_BLOCK, len(left)))
            chunks.append((chunk, np.concatenate((left[chunk].real, left[chunk].imag))))
        self._make_rooms(len(left), weights)

        def fill(first: int) -> None:
            matrix = self._matrix[:, :, first : first + POINTS_A_BLOCK]
            if basis is not None:
                matrix = in_basis(matrix, basis)
            width = matrix.shape[2]
            try:
                room = self._rooms.pop()
            except IndexError:
                room = _Room()
            for chunk, rows in chunks:
                for k in range(8):
                    # BLAS accepts rows with a stride, so no copy is made
                    np.matmul(rows, matrix[:, k], out=room.products.host[k, : len(rows), :width])
                count = len(rows) // 2
                launch = room.launches.get((count, width, weights)) or room.record(count, width, weights)
                launch()
                result[chunk, first : first + width] = room.arp.host[:count, :width]
            self._rooms.append(room)

        blocks = [(functools.partial(fill, first),) for first in range(0, self.points, POINTS_A_BLOCK)]
        share(blocks, self.evaluator.threads)

    def _make_rooms(self, frames: int, weights: Weights) -> None:
        """Make work arrays and launches for all threads beforehand."""
        blocks = -(-self.points // POINTS_A_BLOCK)
        while len(self._rooms) < min(self.evaluator.threads, blocks):
            self._rooms.append(_Room())
        for room in self._rooms:
            for count in (min(frames, FRAMES_A_BLOCK), frames % FRAMES_A_BLOCK):
                for width in (min(self.points, POINTS_A_BLOCK), self.points % POINTS_A_BLOCK):
                    if count > 0 and width > 0 and (count, width, weights) not in room.launches:
                        room.record(count, width, weights)

    def arp_on_gpu(self, drives: ArrayLike, law: str | ArpLaw = "default", peaks: Any = None) -> Any:
        """Return the result of `arp` on the GPU of the evaluator, as a Warp array of shape (frames, points).

        peaks: Warp array of this shape for the amplitudes of the pressures [Pa], or None
        """
        weights = wp.vec3(*law_weights(law, self.evaluator.air))
        left, basis = self.reduced(drives)
        device = self.evaluator.device
        right = self._gpu_matrix(basis)
        result = wp.empty((len(left), self.points), dtype=wp.float32, device=device)
        if result.size == 0:
            return result
        stacked: Any = wp.array(np.concatenate([left.real, left.imag], axis=1), dtype=wp.float32, device=device)
        step = max(products.ROWS, GPU_SCRATCH_BYTES // (32 * self.points))
        parts = wp.empty((min(step, len(left)), 8 * self.points), dtype=wp.float32, device=device)
        for first in range(0, len(left), step):
            rows = stacked[first : min(first + step, len(left))]
            matrix_product(rows, right, parts[: rows.shape[0]], device)()
            inputs = [parts, weights, first, result, peaks]
            launch(kernels.arp_columns, (rows.shape[0], self.points), inputs, device)()
        return result

    def _gpu_matrix(self, basis: NDArray[np.complex64] | None) -> Any:
        """Return the real form of the matrix, see `real_form`, in `basis` if it is not None, on the GPU."""
        device = self.evaluator.device
        if self._on_gpu is None:
            self._on_gpu = wp.array(real_form(self._matrix), dtype=wp.float32, device=device)
        if basis is None:
            return self._on_gpu
        back = basis.conj().T
        rows: Any = wp.array(np.block([[back.real, back.imag], [-back.imag, back.real]]), wp.float32, device=device)
        reduced = wp.empty((len(rows), 8 * self.points), dtype=wp.float32, device=device)
        matrix_product(rows, self._on_gpu, reduced, device)()
        return reduced

    def reduced(self, drives: ArrayLike) -> tuple[NDArray[np.complex64], NDArray[np.complex64] | None]:
        """Return the frames and None, or their coordinates in an orthonormal basis, and the basis, (transducers, r).

        A basis is used if it saves work: foci along a path span few dimensions, since neighbouring frames are similar.
        drives: shape (frames, transducers), as for `arp`.
        """
        frames = check.frames(drives, self.evaluator.array)
        if self.evaluator.array.gain is not None:
            frames = frames * self.evaluator.array.gain
        spanned = span(frames) if len(frames) > 2 * frames.shape[1] else None
        if spanned is None:
            return frames.astype(np.complex64), None
        coordinates, basis = spanned
        return coordinates.astype(np.complex64), basis.astype(np.complex64)


class _Room:
    """Work arrays of one thread: products of a block, and their ARP.

    launches: by numbers of frames and points, and weights of the law
    """

    def __init__(self) -> None:
        self.products = SharedArray((8, 2 * FRAMES_A_BLOCK, POINTS_A_BLOCK), wp.float32, "cpu")
        self.arp = SharedArray((FRAMES_A_BLOCK, POINTS_A_BLOCK), wp.float32, "cpu")
        self.launches: dict[tuple[int, int, Weights], Callable[[], object]] = {}

    def record(self, count: int, width: int, weights: Weights) -> Callable[[], object]:
        """Return the launch that computes the ARP from the products of a block."""
        inputs = [self.products.array, count, width, wp.vec3(*weights), 0, 0, self.arp.array]
        launch = self.launches[count, width, weights] = recorded(kernels.arp_rows, count, inputs, "cpu")
        return launch


def span(frames: Complex) -> tuple[Complex, Complex] | None:
    """Return coordinates C and an orthonormal basis V, shape (transducers, r), with frames = C V^H.

    Every frame, also a quiet one, loses at most the share DROPPED of its norm. The result is None if r is not well
    below the number of transducers. The basis is computed from few normalised frames: some are random, and others are
    those with the largest error in the present basis.
    """
    elements = frames.shape[1]
    energy = squares(frames)
    if not energy.any():
        return None
    norm = np.sqrt(np.where(energy > 0.0, energy, 1.0))
    sample = np.random.default_rng(0).permutation(len(frames))[:FIRST_SAMPLE]
    while len(sample) < elements:
        columns, triangle, _ = qr((frames[sample] / norm[sample, None]).T, mode="economic", pivoting=True)
        weight = np.abs(np.diag(triangle))
        rank = int(np.count_nonzero(weight > 0.1 * DROPPED))
        if rank >= SPAN_FROM * elements:
            return None
        basis = columns[:, :rank].conj()
        if rank < len(sample):
            inside = frames @ basis
            lost = (energy - squares(inside)) / norm**2
            if lost.max() <= DROPPED**2:
                return inside, basis
            worst = np.argsort(lost)[-len(sample) :]
        else:
            worst = np.arange(len(frames))
        fresh = np.setdiff1d(worst, sample)
        sample = np.append(sample, np.random.default_rng(1).permutation(fresh)[: len(sample)])
    return None


def squares(frames: Complex) -> Float:
    """Return the sum of |a|^2 of each row; the rows must be contiguous."""
    parts = frames.view(float)
    return np.einsum("ij,ij->i", parts, parts)


def in_basis(matrix: Float32, basis: NDArray[np.complex64]) -> Float32:
    """Return V^H times the matrix, in the form of the matrix, shape (r, 8, n); basis: V, see Transfer.reduced."""
    back = basis.conj().T
    real, imag = (matrix[:, half].reshape(len(matrix), -1) for half in (slice(0, 4), slice(4, 8)))
    parts = [back.real @ real - back.imag @ imag, back.real @ imag + back.imag @ real]
    return np.concatenate([part.reshape(len(back), 4, -1) for part in parts], axis=1)


def real_form(matrix: Float32) -> Float32:
    """Return the matrix from (real, imaginary) parts of a drive to eight blocks of points, (2 transducers, 8 n).

    matrix: as in Transfer, shape (transducers, 8, n)
    """
    real, imag = (matrix[:, half].reshape(len(matrix), -1) for half in (slice(0, 4), slice(4, 8)))
    return np.block([[real, imag], [-imag, real]])


def matrix_bytes(elements: int, points: int) -> int:
    """Return the memory of a transfer matrix [bytes]."""
    return 32 * elements * points


def memory_limit(device: str) -> int:
    """Return the memory limit of a matrix [bytes]: half the free memory (GPU: 1/GPU_SHARE), at most BYTES_LIMIT."""
    limit = min(BYTES_LIMIT, available_bytes() // 2)
    return limit if device == "cpu" else min(limit, wp.get_device(device).free_memory // GPU_SHARE)


def too_steep(evaluator: FieldEvaluator, points: NDArray[np.floating]) -> bool:
    """Return whether absorption over the range of distances is too large for the cubic of the matrix."""
    low, high = distances(points, evaluator.array.positions)
    return evaluator.absorption_Np_m * (high - low) > CUBIC_REACH_Np


def arp_frames(
    evaluator: FieldEvaluator, points: ArrayLike, normals: ArrayLike, drives: ArrayLike, law: str | ArpLaw = "default"
) -> Float32:
    """Return the ARP [Pa] of many drive frames at the same points, shape (frames, points), by the faster method.

    From MATRIX_FROM frames on, the method is a transfer matrix, in blocks of points limited by `memory_limit`. Fewer
    frames, mode "accurate" and points too far apart for the matrix are computed frame by frame.

    evaluator: array, air, absorption, mode, and device of the products.
    points: [m], array frame, shape (n, 3); normals: unit outward normals of opaque surfaces, shape (n, 3); sound from
        behind the surface is omitted; drives: complex amplitudes, shape (frames, transducers).
    Raises the errors of `palmfield.acoustics.arp.arp` and FieldEvaluator.
    """
    law = law_named(law)
    array = evaluator.array
    frames = check.frames(drives, array)
    where = check.points(points, np.float64)
    outward = unit_normals(normals, len(where))
    result = np.zeros((len(frames), len(where)), np.float32)
    if result.size == 0 or len(array) == 0:
        return result
    if len(frames) < MATRIX_FROM or evaluator.mode == "accurate" or too_steep(evaluator, where):
        for row, drive in zip(result, frames, strict=True):
            field = evaluator.pressure(where, drive, normals=outward)
            row[:] = arp(field, outward, evaluator.air, array.frequency_Hz, law=law, device=evaluator.device)
        return result
    size = max(POINTS_A_BLOCK, memory_limit(evaluator.device) // (matrix_bytes(len(array), 1) + 4 * len(frames)))
    for first in range(0, len(where), size):
        part = slice(first, first + size)
        transfer = Transfer(evaluator, where[part], outward[part])
        if evaluator.device != "cpu":
            result[:, part] = transfer.arp_on_gpu(frames, law).numpy()
        elif size >= len(where):
            transfer.arp(frames, law, out=result)
        else:
            result[:, part] = transfer.arp(frames, law)
    return result
