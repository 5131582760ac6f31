"""Patches and rows of elements of a slab or layer, for a given element size."""

import math
from dataclasses import dataclass, replace

import numpy as np

from palmfield.skin.mesh.disc import disc_patch, flat_patch
from palmfield.skin.problem import Slab
from palmfield.types import Float, Patch

GROWTH = 1.6
"""Ratio of the heights of neighbouring rows of elements, growing with depth."""
STEEPEST = 0.4
"""Growth of the edges of a box with distance from its fine part."""


@dataclass(frozen=True)
class Sizes:
    """Sizes of the elements of a mesh.

    fine_m, coarse_m: edges within fine_radius_m of `centre_m`, and farthest from it [m].
    row_m, deepest_row_m: height of the first row, and largest height of a row [m].
    refinements: number of quarterings of the triangles of a layer.
    reach_m: distance from the centre to the end of the undamped part of an infinite slab [m].
    ring_m: width of the damped ring round an infinite or absorbing slab [m]. match_Hz: frequency of its damping [Hz].
    remesh: whether triangles of these sizes replace the triangles of a layer.
    """

    centre_m: tuple[float, float]
    fine_radius_m: float
    fine_m: float
    coarse_m: float
    row_m: float
    deepest_row_m: float
    refinements: int
    reach_m: float
    ring_m: float
    match_Hz: float
    remesh: bool = False

    def scaled(self, factor: float) -> "Sizes":
        """Return sizes times `factor`; triangles of a layer change by whole quarterings."""
        return replace(
            self, fine_m=factor * self.fine_m, coarse_m=factor * self.coarse_m, row_m=factor * self.row_m,
            deepest_row_m=factor * self.deepest_row_m, refinements=max(0, self.refinements - round(math.log2(factor))),
        )  # fmt: skip


def graded_fractions(depth_m: float, row_m: float, deepest_row_m: float) -> Float:
    """Return depth fractions of L >= 2 rows of elements, (L+1,), growing by GROWTH from row_m to deepest_row_m [m]."""
    heights = [min(row_m, 0.5 * depth_m)]
    while sum(heights) < depth_m * (1.0 - 1e-9):
        heights.append(min(GROWTH * heights[-1], max(deepest_row_m, row_m)))
    if sum(heights) - depth_m > 0.5 * heights[-1] and len(heights) > 2:
        heights.pop()
    return np.concatenate([[0.0], np.cumsum(heights)]) / sum(heights)


def slab_patch(slab: Slab, sizes: Sizes) -> tuple[Patch, Float]:
    """Return the face of the slab, with a ring if its sides absorb, and the distance of vertices into the ring [m]."""
    ring = sizes.ring_m if slab.shape == "infinite" or slab.side == "absorbing" else 0.0
    if slab.shape == "box":
        assert slab.size_m is not None
        half = 0.5 * np.array(slab.size_m)
        patch = box_patch(half + ring, slab.thickness_m, sizes)
        return patch, (np.abs(patch.vertices[:, :2]) - half).max(axis=1)
    radius = sizes.reach_m if slab.shape == "infinite" else slab.radius_m
    centre = np.array(sizes.centre_m) if slab.shape == "infinite" else np.zeros(2)
    assert radius is not None
    outer = radius + ring
    fine_radius = min(sizes.fine_radius_m + float(np.hypot(*(np.array(sizes.centre_m) - centre))), outer)
    coarse = min(sizes.coarse_m, 0.5 * outer)
    fine = min(sizes.fine_m, coarse)
    patch = disc_patch(outer, slab.thickness_m, fine, coarse, fine_radius)
    in_ring = np.linalg.norm(patch.vertices[:, :2], axis=1) - radius
    return replace(patch, vertices=patch.vertices + np.append(centre, 0.0)), in_ring


def box_patch(half_m: Float, thickness_m: float, sizes: Sizes) -> Patch:
    """Return a rectangle of half widths half_m (2,) on grid lines by `sizes`; diagonals of its cells alternate."""
    x, y = (_lines(float(half), centre, sizes) for half, centre in zip(half_m, sizes.centre_m, strict=True))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(len(x) - 1), np.arange(len(y) - 1), indexing="ij"))
    a = i * len(y) + j
    b, c, d = a + len(y), a + len(y) + 1, a + 1
    turned = ((i + j) % 2 == 1)[:, None]
    first = np.where(turned, np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    second = np.where(turned, np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    rim = np.asarray((np.abs(grid) > half_m * (1.0 - 1e-9)).any(axis=1))
    return flat_patch(grid, np.concatenate([first, second]), thickness_m, rim)


def _lines(half: float, centre: float, sizes: Sizes) -> Float:
    """Return the grid lines from -half to half; their distance grows outwards from the fine part."""
    x = np.linspace(-half, half, 2001)
    outside = np.maximum(np.abs(x - centre) - sizes.fine_radius_m, 0.0)
    density = 1.0 / np.minimum(sizes.fine_m + STEEPEST * outside, max(sizes.coarse_m, sizes.fine_m))
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(x))])
    return np.interp(np.linspace(0.0, count[-1], max(2, math.ceil(count[-1])) + 1), count, x)


def quartered(patch: Patch) -> Patch:
    """Cut each triangle into four at the middles of its edges; depths and inward directions are means of the ends."""
    faces = np.asarray(patch.faces)
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, of, uses = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    middle = len(patch.vertices) + of.reshape(-1, 3)
    a, b, c = faces.T
    d, e, f = middle.T
    inward = np.concatenate([patch.inward, patch.inward[edges].mean(axis=1)])
    return replace(
        patch,
        vertices=np.concatenate([patch.vertices, patch.vertices[edges].mean(axis=1)]),
        faces=np.concatenate([np.column_stack(t) for t in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))]).astype(
            np.int32
        ),
        inward=inward / np.linalg.norm(inward, axis=1, keepdims=True),
        depth=np.concatenate([patch.depth, patch.depth[edges].mean(axis=1)]),
        rim=np.concatenate([patch.rim, (uses == 1) & patch.rim[edges].all(axis=1)]),
    )
