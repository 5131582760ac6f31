"""Matrix-free double-layer operator from triangles with constant values to points, on the CPU or a GPU."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from palmfield.acoustics.polynomials import sine_cosine
from palmfield.device import run_kernel
from palmfield.hand.triangles import face_normals
from palmfield.threads import cores, pool
from palmfield.types import Complex, Float, Int
from warp_kernels import bem as kernels

NEAR_EDGES = 3.0
"""Distance from a triangle, in edge lengths, within which its integral is computed exactly."""

SOFTENING_EDGES = 0.01
"""Distance below which the one-point sum is clipped: the error is 1e-5, and values that are subtracted later stay
small."""

CPU_WIDTH = 16
GPU_THREADS = 500_000
"""Number of threads that fills a large GPU; for fewer points, several threads share the triangles."""

RULE = np.array(
    [(1 / 3, 1 / 3, 1 / 3, 0.225)]
    + [
        (*np.roll([1.0 - 2.0 * b, b, b], shift), weight)
        for b, weight in ((0.470142064105115, 0.132394152788506), (0.101286507323456, 0.125939180544827))
        for shift in range(3)
    ]
)
"""Quadrature of degree 5 with seven points (Radon 1948; Dunavant 1985, doi 10.1002/nme.1620210612): barycentric
coordinates and weight."""


class DoubleLayer:
    """p -> integral of p dG/dn over a triangle mesh, at fixed points; G = exp(ikr)/(4 pi r), p constant by triangle.

    The operator jumps at the wall. At the centroid of triangle `own` the result is the principal value, the mean of the
    limits from both sides; other points must be off the wall. Sums are in float32, error 1e-6 of the largest result.

    points: [m], shape (n, 3). vertices: [m], shape (v, 3). faces: shape (m, 3), outward counter-clockwise.
    wavenumber: [rad/m]. device: a name from `palmfield.device.resolve`.
    own: triangle whose centroid is the point, -1 for points off the wall, shape (n,); None is -1 for all.
    """

    def __init__(
        self, points: Float, vertices: Float, faces: Int, wavenumber: float, device: str, own: Int | None = None
    ) -> None:
        per_m = wavenumber / (2.0 * np.pi)
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        corners = (vertices[faces] - middle) * per_m
        normals, areas = face_normals(vertices, faces)
        centroids = corners.mean(axis=1)
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
        self.softening = float((SOFTENING_EDGES * edge.mean()) ** 2)
        self.per_m = per_m
        self.device = device
        self.count = len(points)
        self.sine, self.cosine = (kernels.vec6(*c) for c in sine_cosine())
        self.points = self._vectors((points - middle) * per_m)
        self.centroids = self._vectors(centroids)
        self.moments = self._vectors(normals * (areas * per_m**2 / (4.0 * np.pi))[:, None])
        self._correct(self._vectors(corners), NEAR_EDGES * edge, np.full(self.count, -1) if own is None else own)

    def _vectors(self, values: Float) -> wp.array:
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device=self.device)

    def _correct(self, corners: wp.array, reach_in_wavelengths: Float, own: NDArray[np.integer]) -> None:
        """Compute the sparse corrections of pairs for which the one-point sum is inaccurate."""
        largest = float(reach_in_wavelengths.max())
        reach: wp.array = wp.array(reach_in_wavelengths.astype(np.float32), dtype=float, device=self.device)
        grid = wp.HashGrid(128, 128, 128, device=self.device)
        grid.build(self.centroids, radius=largest)
        count = wp.zeros(self.count, dtype=int, device=self.device)
        inputs = [grid.id, self.points, self.centroids, reach, largest, count]
        run_kernel(kernels.near_count, dim=self.count, inputs=inputs, device=self.device)
        start = np.zeros(self.count + 1, np.int32)
        np.cumsum(count.numpy(), out=start[1:])
        self.start: wp.array = wp.array(start, dtype=int, device=self.device)
        self.column = wp.empty(int(start[-1]), dtype=int, device=self.device)
        self.value = wp.empty(int(start[-1]), dtype=wp.vec2, device=self.device)
        rule: wp.array = wp.array(RULE.astype(np.float32), dtype=wp.vec4, device=self.device)
        inputs = [grid.id, self.points, self.centroids, self.moments, corners, reach, largest, rule, self.softening]
        inputs += [wp.array(own.astype(np.int32), dtype=int, device=self.device), self.start, self.column, self.value]
        run_kernel(kernels.near_fill, dim=self.count, inputs=inputs, device=self.device)

    def apply(self, density: Complex) -> Complex:
        """Return the values at the points, shape (n,), of a density by triangle, shape (m,)."""
        result = wp.zeros(self.count, dtype=wp.vec2, device=self.device)
        if self.count == 0:
            return np.zeros(0, np.complex128)
        values = self.pairs(density)
        if self.device == "cpu":
            self._far_on_cpu(values, result)
        else:
            parts = max(1, GPU_THREADS // self.count)
            run_kernel(
                kernels.far(1),
                (self.count, parts),
                [*self.summands(self.points, values, parts), result],
                device=self.device,
            )
        inputs = [self.start, self.column, self.value, values, result]
        run_kernel(kernels.near_apply, dim=self.count, inputs=inputs, device=self.device)
        return result.numpy().view(np.complex64)[:, 0].astype(np.complex128)

    def pairs(self, density: Complex) -> wp.array:
        """Return real and imaginary parts by triangle, on the device."""
        pairs = np.ascontiguousarray(density, np.complex64).view(np.float32).reshape(-1, 2)
        return wp.array(pairs, dtype=wp.vec2, device=self.device)

    def summands(self, points: wp.array, density: wp.array, parts: int) -> list:
        """Return the arguments of kernel `far`, except its result."""
        return [points, self.centroids, self.moments, density, self.sine, self.cosine, self.softening, parts]

    def _far_on_cpu(self, density: wp.array, result: wp.array) -> None:
        """Compute one slice of the points per thread; Warp releases the GIL while a kernel runs."""
        kernel = kernels.far(CPU_WIDTH)
        threads = cores()
        size = -(-self.count // (threads * CPU_WIDTH)) * CPU_WIDTH

        def run(first: int) -> None:
            part = slice(first, min(first + size, self.count))
            blocks = -(-(part.stop - part.start) // CPU_WIDTH)
            run_kernel(kernel, (blocks, 1), [*self.summands(self.points[part], density, 1), result[part]], device="cpu")

        for job in [pool().submit(run, first) for first in range(0, self.count, size)]:
            job.result()
