"""Sound on and around a rigid body by boundary elements: mesh, operator, solution, and pressure of the total field."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, gmres

from palmfield.acoustics.arp import wall_pressure
from palmfield.acoustics.polynomials import sine_cosine
from palmfield.device import resolve, run_kernel
from palmfield.errors import PalmfieldError
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.triangles import directed_edges, face_normals, vertex_normals
from palmfield.threads import cores, pool
from palmfield.types import Air, Complex, Float, Int
from warp_kernels import bem as kernels

LEAST_ELEMENTS_PER_WAVELENGTH = 6.0
DEPTH_PER_WAVELENGTH = 0.125
DEPTH_PER_THICKNESS = 0.25
Incident = Callable[[Float], Complex]
"""Complex peak pressure [Pa], shape (n,), of the sound without the body at points [m], shape (n, 3)."""
RESTART = 60
LARGEST_ITERATIONS = 300
CHUNK = 4096
POWERS = [(a, total - a) for total in range(4) for a in range(total + 1)]
"""Exponents of the ten terms of the cubic; (0, 1) and (1, 0) have the numbers 1 and 2."""
NEARNESS = 0.15
LEAST_COSINE = 0.5
"""Faces rotated by 60 deg or more are not used, because the gradient is not continuous across a sharp edge."""
RIDGE = 1e-9
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


def checked(vertices: ArrayLike, faces: ArrayLike) -> tuple[Float, Int]:
    """Return vertices [m], shape (v, 3), and faces, shape (m, 3), of a closed mesh with outward faces.

    Raises PalmfieldError for other shapes, numbers that are not finite, invalid vertex numbers, faces without area, an
    open mesh, and faces that point inwards.
    """
    points = np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(faces, dtype=np.int32)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise PalmfieldError(f"mesh vertices have shape {points.shape}: give finite numbers of shape (v, 3), in metres")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise PalmfieldError(f"mesh faces have shape {triangles.shape}: give (m, 3), m > 0")
    if triangles.min() < 0 or triangles.max() >= len(points):
        worst = triangles.max() if triangles.max() >= len(points) else triangles.min()
        raise PalmfieldError(f"a mesh face names vertex {worst}; allowed: 0 to {len(points) - 1}")
    areas = face_normals(points, triangles)[1]
    if not areas.min() > 0.0:
        raise PalmfieldError(f"mesh face {int(areas.argmin())} has no area: remove it or merge its vertices")
    directed = directed_edges(triangles).astype(np.int64)
    keys, counts = np.unique(directed[:, 0] * len(points) + directed[:, 1], return_counts=True)
    turned = keys % len(points) * len(points) + keys // len(points)
    alone = int(np.count_nonzero(~np.isin(turned, keys)))
    if alone or counts.max() > 1:
        raise PalmfieldError(
            f"mesh is open or wound inconsistently ({alone} edges without an opposite one): scattering needs a closed "
            "surface; close a patch with palmfield.acoustics.scattering.closed"
        )
    volume = float(trimesh.Trimesh(points, triangles, process=False).volume)
    if volume <= 0.0:
        raise PalmfieldError(f"mesh has the volume {volume:.3g} m3, so its faces point inwards: reverse their corners")
    return points, triangles


def mean_edge_m(vertices: Float, faces: Int) -> float:
    """Return the mean length of the edges [m]."""
    ends = vertices[directed_edges(faces)]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())


def elements_per_wavelength(vertices: Float, faces: Int, wavenumber: float) -> float:
    """Return wavelength over mean edge; warn (UserWarning) if it is below LEAST_ELEMENTS_PER_WAVELENGTH."""
    elements = 2.0 * np.pi / wavenumber / mean_edge_m(vertices, faces)
    if elements < LEAST_ELEMENTS_PER_WAVELENGTH:
        warnings.warn(
            f"mesh has {elements:.1f} elements per wavelength; allowed: {LEAST_ELEMENTS_PER_WAVELENGTH:g} or more: "
            f"use edges shorter than {2e3 * np.pi / wavenumber / LEAST_ELEMENTS_PER_WAVELENGTH:.2g} mm",
            stacklevel=3,
        )
    return elements


def inner_points(vertices: Float, faces: Int, wavenumber: float) -> Float:
    """Return a point under the centroid of each face [m], shape (m, 3), a wavelength/8 deep, less in thin parts."""
    normals, _ = face_normals(vertices, faces)
    centroids = vertices[faces].mean(axis=1)
    depth = DEPTH_PER_WAVELENGTH * 2.0 * np.pi / wavenumber
    thickness = exit_distances(vertices, faces, centroids, -normals, depth / DEPTH_PER_THICKNESS)
    return centroids - np.minimum(depth, DEPTH_PER_THICKNESS * thickness)[:, None] * normals


def closed(vertices: Float, faces: Int, thickness_m: float) -> tuple[Float, Int, NDArray[np.bool_]]:
    """Close an open patch to a plate, by a copy `thickness_m` behind it along the inward normals, and rim walls.

    vertices: [m], shape (v, 3). faces: shape (m, 3), counter-clockwise seen from outside.
    Returns vertices, faces (those of the patch first), and True on the faces of the patch.
    Raises PalmfieldError for a thickness that is not positive, and for a patch without a rim.
    """
    if not thickness_m > 0.0:
        raise PalmfieldError(f"thickness_m = {thickness_m} must be positive: give the depth of the plate [m]")
    directed = directed_edges(faces).astype(np.int64)
    keys = directed[:, 0] * len(vertices) + directed[:, 1]
    rim = directed[~np.isin(directed[:, 1] * len(vertices) + directed[:, 0], keys)]
    if len(rim) == 0:
        raise PalmfieldError("the mesh has no rim, so it is already closed: use it unchanged")
    count = len(vertices)
    layers = max(1, round(thickness_m / mean_edge_m(vertices, faces)))
    inward = -vertex_normals(vertices, faces)
    rim_vertices = np.unique(rim)
    place = np.full(count, -1)
    place[rim_vertices] = np.arange(len(rim_vertices))
    rings = [rim_vertices]
    points = [vertices, vertices + thickness_m * inward]
    for layer in range(1, layers):
        points.append(vertices[rim_vertices] + (thickness_m * layer / layers) * inward[rim_vertices])
        rings.append(2 * count + (layer - 1) * len(rim_vertices) + np.arange(len(rim_vertices)))
    rings.append(rim_vertices + count)
    walls = []
    for upper, lower in pairwise(rings):
        a, b = place[rim[:, 0]], place[rim[:, 1]]
        walls += [np.stack([upper[b], upper[a], lower[a]], axis=1), np.stack([upper[b], lower[a], lower[b]], axis=1)]
    whole = np.concatenate([faces, faces[:, ::-1] + count, *walls]).astype(np.int32)
    return np.concatenate(points), whole, np.arange(len(whole)) < len(faces)


@dataclass(frozen=True)
class Scattering:
    """Total sound on a rigid body, one value per face, with e^{-i w t}.

    vertices: [m], shape (v, 3). faces: shape (m, 3). wavenumber: [rad/m].
    centroids: [m], shape (m, 3). normals: unit, outward, shape (m, 3). areas: [m2], shape (m,).
    pressure: complex peak pressure at the centroids [Pa], shape (m,).
    gradient: gradient along the surface [Pa/m], shape (m, 3); the normal component is 0.
    iterations: number of GMRES iterations. residual: relative residual of the linear system.
    elements_per_wavelength: wavelength over mean edge.
    """

    vertices: Float
    faces: Int
    wavenumber: float
    centroids: Float
    normals: Float
    areas: Float
    pressure: Complex
    gradient: Complex
    iterations: int
    residual: float
    elements_per_wavelength: float


def scatter(
    mesh_vertices: ArrayLike,
    faces: ArrayLike,
    incident: Incident,
    wavenumber: float,
    *,
    device: str = "auto",
    tolerance: float = 1e-4,
) -> Scattering:
    """Return the total sound on a closed rigid body, by matrix-free collocation with one value per face, and GMRES.

    The Helmholtz integral p_i + K p is p/2 on the surface and 0 inside. The equation of a face is the first condition
    at its centroid minus i times the second condition an eighth of a wavelength below. (Yaghjian and co-workers use
    this dual-surface equation for radio waves.) It is Burton & Miller's equation with the normal derivative as a
    difference over that depth, so it has no hypersingular kernel. On a sphere of inner radius b its eigenvalues are
    proportional to j_n(ka) - i j_n(kb). They never vanish, so there are no irregular frequencies. For other bodies this
    is not proved; check momentum and reciprocity. The equation is of the second kind and needs no preconditioner.

    mesh_vertices: [m], shape (v, 3). faces: shape (m, 3), counter-clockwise seen from outside.
    incident: pressure without the body, which must satisfy the wave equation inside the body too.
    wavenumber: [rad/m].
    device: "auto", "cpu" or "cuda:N". tolerance: relative residual at which GMRES stops, >= 1e-6 (float32 sums).
    Raises PalmfieldError for an open or inverted mesh, for a bad wavenumber or tolerance, for incident sound that is
    not finite, and if GMRES does not converge. Warns (UserWarning) below 6 elements per wavelength.
    """
    vertices, triangles = checked(mesh_vertices, faces)
    if not 0.0 < wavenumber < np.inf:
        raise PalmfieldError(f"wavenumber = {wavenumber} must be positive and finite: give 2 pi f/c [rad/m]")
    if not 1e-6 <= tolerance < 1.0:
        raise PalmfieldError(
            f"tolerance = {tolerance} must be between 1e-6 and 1, because sums are in float32: use for example 1e-4"
        )
    resolution = elements_per_wavelength(vertices, triangles, wavenumber)
    normals, areas = face_normals(vertices, triangles)
    centroids = vertices[triangles].mean(axis=1)
    count = len(triangles)
    points = np.concatenate([centroids, inner_points(vertices, triangles, wavenumber)])
    sound = np.asarray(incident(points), dtype=np.complex128)
    if sound.shape != (2 * count,) or not np.isfinite(sound).all():
        raise PalmfieldError(
            f"incident sound of shape {sound.shape} at {2 * count} points on and inside the body must be finite "
            f"and have shape ({2 * count},): correct the function, or move the body away from the sources"
        )
    own = np.concatenate([np.arange(count), np.full(count, -1)])
    layer = DoubleLayer(points, vertices, triangles, wavenumber, resolve(device), own)

    def equation(pressure: Complex) -> Complex:
        doubled = layer.apply(pressure)
        return 0.5 * pressure - doubled[:count] + 1j * doubled[count:]

    right_side = sound[:count] - 1j * sound[count:]
    steps: list[float] = []
    pressure, failed = gmres(
        LinearOperator((count, count), matvec=equation, dtype=np.complex128),
        right_side,
        rtol=tolerance,
        atol=0.0,
        restart=RESTART,
        maxiter=LARGEST_ITERATIONS // RESTART,
        callback=steps.append,
        callback_type="pr_norm",
    )
    scale = float(np.linalg.norm(right_side))
    residual = float(np.linalg.norm(right_side - equation(pressure))) / scale if scale > 0.0 else 0.0
    if failed:
        raise PalmfieldError(
            f"scattering did not converge: residual {residual:.2g} after {len(steps)} iterations, tolerance "
            f"{tolerance:g}; check the mesh for faces that intersect, or raise tolerance"
        )
    gradient = surface_gradient(vertices, triangles, pressure)
    return Scattering(
        vertices, triangles, wavenumber, centroids, normals, areas, pressure, gradient, len(steps), residual, resolution
    )


def wall_arp(scattering: Scattering, air: Air) -> Float:
    """Return the radiation pressure on the rigid wall [Pa], shape (m,), positive inwards.

    The law is `palmfield.acoustics.arp.TOTAL_FIELD`.
    """
    return wall_pressure(scattering.pressure, scattering.gradient, scattering.wavenumber, air)


def surface_gradient(vertices: Float, faces: Int, values: Complex) -> Complex:
    """Return the tangential gradient at the centroids [per m], shape (m, 3), of values at the centroids, shape (m,).

    A cubic in the plane of the face is fitted by least squares to two rings of neighbours, where neighbours share a
    vertex. Near faces have larger weights, rotated faces smaller ones. For a wave along the surface with eight
    triangles per wavelength the error is 1 %; a quadratic over one ring would have 6 %.
    """
    count = len(faces)
    ones = np.ones(3 * count, np.float32)
    corner = sparse.csr_array((ones, (np.repeat(np.arange(count), 3), faces.ravel())), shape=(count, len(vertices)))
    ring = sparse.csr_array(corner @ corner.T)
    around = sparse.csr_array(ring @ ring)
    centroids = vertices[faces].mean(axis=1)
    normals, _ = face_normals(vertices, faces)
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    right = np.cross(normals, helper)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(normals, right)
    result = np.empty((count, 3), np.complex128)
    for first in range(0, count, CHUNK):
        rows = np.arange(first, min(first + CHUNK, count))
        size = np.diff(around.indptr)[rows]
        slot = np.arange(size.max())
        valid = slot < size[:, None]
        neighbours = around.indices[np.where(valid, around.indptr[rows][:, None] + slot, around.indptr[rows][:, None])]
        offset = centroids[neighbours] - centroids[rows, None]
        x, y = (np.einsum("nsk,nk->ns", offset, axis[rows]) for axis in (right, up))
        scale = np.sqrt(np.where(valid, x**2 + y**2, 0.0).max(axis=1))
        x, y = x / scale[:, None], y / scale[:, None]
        facing = np.einsum("nsk,nk->ns", normals[neighbours], normals[rows])
        weight = np.where(valid, np.maximum(facing - LEAST_COSINE, 0.0) / (NEARNESS + x**2 + y**2) ** 2, 0.0)
        terms = np.stack([x**a * y**b for a, b in POWERS], axis=2)
        weighted = terms * weight[..., None]
        gram = weighted.transpose(0, 2, 1) @ terms
        gram += RIDGE * np.einsum("naa->n", gram)[:, None, None] * np.eye(len(POWERS))
        moments = weighted.transpose(0, 2, 1) @ np.stack([values[neighbours].real, values[neighbours].imag], axis=2)
        fitted = (np.linalg.solve(gram, moments) @ np.array([1.0, 1j])) / scale[:, None]
        result[rows] = fitted[:, 2, None] * right[rows] + fitted[:, 1, None] * up[rows]
    return result


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
