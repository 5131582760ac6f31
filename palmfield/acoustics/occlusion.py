"""Shadows by rays: all obstacles in one hierarchy that moves with them, and the ray lengths back along the sound."""

import math
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from palmfield.acoustics import check
from palmfield.acoustics.knife_edge import OutlineMesh
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.shadow import CLEARANCE_m, REACH_m
from palmfield.device import SharedArray, filled, recorded, resolve
from palmfield.errors import PalmfieldError
from palmfield.threads import Calls, cores, share
from palmfield.types import Float, Float32, Int
from warp_kernels import shadow as kernels

GRAZING = 1e-6
"""Smallest cosine between a ray and the normal of a board; other rays are parallel and do not meet it."""
RAYS_PER_THREAD = 300
"""Smallest number of rays per thread: 0.2 ms of work, and 0.02 ms to start a thread."""
SIZES_STORED = 8
"""Largest number of buffer sizes stored by an `Occlusion`."""


def distance_to_arrays(points: Float, flux: Float | Float32, phased_array: PhasedArray) -> Float:
    """Return the length of the ray from each point back along the sound to the board of an array [m], shape (n,).

    points: [m], array frame, shape (n, 3). flux: direction of the sound there, any length, shape (n, 3).
    A board is the plane through the centre of an array normal to its mean direction; the farthest board is used.
    """
    along = flux.T.astype(np.float64, order="C")
    along /= np.maximum(np.sqrt(np.add.reduce(along * along, axis=0)), 1e-30)
    farthest: Float = np.zeros(len(points))
    for facing, height in zip(phased_array.facing.T, phased_array.heights.tolist(), strict=True):
        leaving = facing @ along  # decrease of the distance to the board per length
        above = points @ facing
        above -= height
        way = np.empty(len(points))
        way.fill(REACH_m)
        np.divide(above, leaving, out=way, where=leaving > GRAZING)
        np.maximum(farthest, way, out=farthest)
    return np.minimum(farthest, REACH_m, out=farthest)


class Occlusion:
    """All obstacles as a bounding volume hierarchy that is refitted to moving vertices.

    Refitting takes 0.4 ms for two hands of 11,448 faces each, building 9 ms; rays are equally fast in both.
    It is part of the state of one simulation and not thread-safe; on the CPU it starts threads itself.

    vertices: [m], shape (v, 3). faces: shape (m, 3): all obstacles in one mesh.
    device: "auto", "cpu" or "cuda:N".
    counts: number of vertices of each body in the mesh, in order, if there are several.
    threads: number of threads on the CPU, 1 or more; None is all cores of this process.
    """

    def __init__(
        self, vertices: Float, faces: Int, device: str = "auto", counts: Sequence[int] = (), threads: int | None = None
    ):
        """Raises PalmfieldError for a device that is not on this machine."""
        self.device = resolve(device)
        self._threads = cores() if threads is None else threads
        self._vertices = SharedArray(len(vertices), wp.vec3, self.device)
        corners: wp.array = wp.array(np.asarray(faces, np.int32).ravel(), dtype=wp.int32, device=self.device)
        # Built with the bodies far from each other, so that no branch has faces of two bodies: such a branch would
        # grow when the bodies move
        extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
        body = np.repeat(np.arange(len(counts)), counts) if len(counts) else np.zeros(len(vertices), int)
        self._vertices.put(vertices + np.outer(2.0 * extent * body, [1.0, 0.0, 0.0]))
        self.mesh = wp.Mesh(self._vertices.array, corners)
        self._rays: dict[int, _Rays] = {}
        self._shape = vertices, faces
        self._outline: tuple[OutlineMesh, Calls] | None = None
        self.move(vertices)

    @property
    def outline(self) -> OutlineMesh:
        """Edges of the same bodies for knife-edge diffraction; after the first use they move with the bodies."""
        if self._outline is None:
            made = OutlineMesh(self.mesh, *self._shape)
            self._outline = made, made.calls()
            for call in self._outline[1]:
                call()
        return self._outline[0]

    def move(self, vertices: Float) -> None:
        """Set new positions of the vertices [m], shape (v, 3)."""
        self._vertices.put(vertices)
        self.mesh.refit()
        if self._outline is not None:
            for call in self._outline[1]:
                call()

    def lit(
        self, points: Float, flux: Float | Float32, reach_m: Float | Float32 | float = REACH_m
    ) -> NDArray[np.bool_]:
        """Return whether no body blocks the ray from each point back along the sound, shape (n,).

        A point of a closed body is dark where sound leaves the surface, because the ray enters the body; so is a point
        without sound. The result is a view of a buffer that the next call with as many points overwrites.

        points: [m], shape (n, 3). flux: direction of the sound there, any length, shape (n, 3).
        reach_m: length of the ray [m], a number or shape (n,).
        Raises PalmfieldError for other shapes and numbers that are not finite.
        """
        count = len(points)
        if points.shape != (count, 3) or flux.shape != (count, 3):
            raise PalmfieldError(f"points {points.shape} and flux {flux.shape}: give (n, 3) for both")
        rays = self._rays.get(count)
        if rays is None:
            if len(self._rays) >= SIZES_STORED:
                self._rays.clear()
            rays = self._rays[count] = _Rays(self.mesh, count, self.device, self._threads)
        rays.points.host[...] = points
        rays.flux.host[...] = flux
        rays.reach.host[...] = reach_m
        for name, values in (("points", points), ("flux", flux)):
            if not math.isfinite(np.add.reduce(values, axis=None)):
                raise PalmfieldError(
                    f"{name}[{check.first_bad(values)}] is not finite: correct the source of the {name}"
                )
        if self.device != "cpu":
            rays.points.upload()
            rays.flux.upload()
            rays.reach.upload()
        if rays.threads > 1:
            share(rays.blocks, rays.threads)
        else:
            for calls in rays.blocks:
                for call in calls:
                    call()
        if self.device != "cpu":
            rays.lit.download()
            wp.synchronize_stream(self.device)
        return rays.result


class _Rays:
    """Buffers and recorded launches for `count` rays, in blocks for threads."""

    def __init__(self, mesh: wp.Mesh, count: int, device: str, threads: int):
        self.points, self.flux = SharedArray(count, wp.vec3, device), SharedArray(count, wp.vec3, device)
        self.reach, self.lit = SharedArray(count, wp.float32, device), SharedArray(count, wp.uint8, device)
        self.result = self.lit.host.view(np.bool_)
        self.threads = 1 if device != "cpu" else max(1, min(threads, count // RAYS_PER_THREAD))
        blocks = min(4 * self.threads, count // RAYS_PER_THREAD) if self.threads > 1 else 1
        size = -(-count // blocks)
        self.blocks: list[Calls] = []
        for start in range(0, count, size or 1):
            own = slice(start, min(start + size, count))
            rays = filled(
                kernels.Rays(),
                mesh=mesh.id,
                points=self.points.array[own],
                flux=self.flux.array[own],
                reach=self.reach.array[own],
                clearance=CLEARANCE_m,
                lit=self.lit.array[own],
            )
            self.blocks.append((recorded(kernels.lit_by_flux, own.stop - own.start, [rays], device),))
