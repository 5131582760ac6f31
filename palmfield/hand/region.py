"""The part of a surface around a point that is visible from one side, as a shape in the plane."""

from dataclasses import dataclass

import numpy as np
import scipy  # which loads its parts when they are used
from numpy.typing import NDArray

from palmfield.errors import SceneError
from palmfield.hand.triangles import face_components, face_normals, unique_edges
from palmfield.types import Float, Int, Surface

FACING_COSINE = float(np.cos(np.deg2rad(75.0)))
LEAST_COSINE = 0.05
BLOCK = 256
"""Number of points whose distances to an outline are computed together."""


@dataclass(frozen=True)
class Region:
    """Faces visible along `facing`, with their projection to the plane through `origin`.

    frame: rows are the two axes of the plane and the facing direction, shape (3, 3)
    vertices, faces: the whole faces; index: numbers of the vertices in the surface
    shadow: projected vertices [m], shape (n, 2)
    outline: boundary of the facing part, segments in the plane [m], shape (s, 2, 2)
    """

    origin: Float
    frame: Float
    vertices: Float
    faces: Int
    index: Int
    shadow: Float
    outline: Float
    radius_m: float


@dataclass(frozen=True)
class Shape:
    """Signed distance to the boundary on a square grid [m], negative inside, and the boundary loops on it."""

    x: Float
    distance: Float
    loops: list[Float]

    def at(self, points: Float) -> Float:
        """Return the linearly interpolated distance [m], shape (n,)."""
        step = self.x[1] - self.x[0]
        where = (points - self.x[0]) / step
        return scipy.ndimage.map_coordinates(self.distance, where.T[::-1], order=1, mode="nearest")


def facing_region(surface: Surface, origin: Float, seed: int, facing: Float, radius_m: float) -> Region:
    """Return the faces within `radius_m` of `origin` (across `facing`), connected to `seed`, up to 75 degrees steep.

    Raises SceneError if the seed face is steeper.
    """
    helper = np.eye(3)[np.argmin(np.abs(facing))]
    right = np.cross(helper, facing)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(facing, right), facing])
    plane = (surface.vertices - origin) @ frame[:2].T
    visible = surface.normals @ facing - FACING_COSINE

    unit, _ = face_normals(surface.vertices, surface.faces)
    corners = plane[surface.faces]
    reach = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    near = np.linalg.norm(corners.mean(axis=1), axis=1) < radius_m + reach
    keep = near & (unit @ facing > LEAST_COSINE) & (visible[surface.faces].max(axis=1) > 0.0)
    if not keep[seed]:
        raise SceneError(
            "the skin at the patch centre is tilted by more than 75 degrees from `facing`; change "
            "`facing`, or move the centre"
        )
    chosen = np.flatnonzero(keep)
    labels = face_components(surface.faces[chosen])
    chosen = chosen[labels == labels[np.searchsorted(chosen, seed)]]
    index, local = np.unique(surface.faces[chosen], return_inverse=True)
    faces = local.reshape(-1, 3).astype(np.int32)
    outline = _outline(plane[index], faces, visible[index])
    return Region(origin, frame, surface.vertices[index], faces, index, plane[index], outline, radius_m)


def _outline(plane: Float, faces: Int, value: Float) -> Float:
    """Return the boundary of the part where `value`, linear over each face, is positive; segments, shape (s, 2, 2)."""
    segments = []
    signs = value[faces] > 0.0
    for face in faces[signs.any(axis=1) & ~signs.all(axis=1)]:
        crossing = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            va, vb = value[face[a]], value[face[b]]
            if (va > 0.0) != (vb > 0.0):
                crossing.append(plane[face[a]] + va / (va - vb) * (plane[face[b]] - plane[face[a]]))
        segments.append(crossing)
    edges, count = unique_edges(faces)
    for a, b in edges[count == 1]:
        va, vb = value[a], value[b]
        if va <= 0.0 and vb <= 0.0:
            continue
        ends = [plane[a], plane[b]]
        if (va > 0.0) != (vb > 0.0):
            ends[0 if va <= 0.0 else 1] = plane[a] + va / (va - vb) * (plane[b] - plane[a])
        segments.append(ends)
    return np.array(segments, dtype=np.float64).reshape(-1, 2, 2)


def region_distance(region: Region, points: Float) -> Float:
    """Return the signed distance to the boundary of the region in the plane [m], shape (n,); negative inside."""
    circle = np.linalg.norm(points, axis=1) - region.radius_m
    return np.maximum(_outline_distance(region.outline, points), circle)


def _outline_distance(outline: Float, points: Float) -> Float:
    a, b = outline[:, 0], outline[:, 1]
    along = b - a
    squared = np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
    slope = along[:, 0] / np.where(along[:, 1] == 0.0, np.inf, along[:, 1])
    out = np.empty(len(points))
    # By coordinate and in blocks that fit the cache of a core
    for start in range(0, len(points), BLOCK):
        block = points[start : start + BLOCK]
        right, up = block[:, :1] - a[:, 0], block[:, 1:] - a[:, 1]
        t = np.clip((right * along[:, 0] + up * along[:, 1]) / squared, 0.0, 1.0)
        nearest = ((right - t * along[:, 0]) ** 2 + (up - t * along[:, 1]) ** 2).min(axis=1)
        crosses = (a[:, 1] > block[:, 1:]) != (b[:, 1] > block[:, 1:])
        left = block[:, :1] < a[:, 0] + up * slope
        inside = (crosses & left).sum(axis=1) % 2 == 1
        distance = np.sqrt(nearest)
        out[start : start + BLOCK] = np.where(inside, -distance, distance)
    return out


def trace_shape(region: Region, step_m: float, spike_m: float, least_m: float = 0.0) -> Shape:
    """Return the boundary loops of the region without spikes and necks narrower than 2 `spike_m`.

    The first loop is the outer one, around the origin; the others are holes. Loop points are on the boundary within
    rounding, except where a spike was cut.

    Raises SceneError if the part around the centre is narrower than 2 `spike_m` or 2 `least_m`.
    """
    margin = 4.0 * step_m
    half = int(np.ceil((region.radius_m + margin) / step_m))
    x = np.asarray(step_m * np.arange(-half, half + 1), dtype=np.float64)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    distance = region_distance(region, grid).reshape(len(x), len(x))
    core, _ = scipy.ndimage.label(distance < -spike_m)
    home = core[half, half]
    if home == 0 or distance[half, half] > -least_m:
        narrow_mm = 2e3 * max(spike_m, least_m)
        raise SceneError(
            f"the facing part of the surface around the patch centre is narrower than {narrow_mm:.1f} mm; move "
            "the centre inward, use a smaller coarse_m, or change `facing`"
        )
    # Morphological opening (erode, then dilate) by spike_m; the slack of the grid keeps smooth boundaries unchanged
    opened = step_m * scipy.ndimage.distance_transform_edt(core != home) - spike_m - step_m
    opened[core == home] = -region.radius_m  # deep inside, the boundary itself is what limits the distance
    distance = np.maximum(distance, opened)
    from contourpy import contour_generator

    loops = [
        _snap(region, Shape(x, opened, []), np.asarray(line)[:-1])
        for line in contour_generator(x, x, distance).lines(0.0)
        if len(line) > 3
    ]
    around = [loop for loop in loops if contains(loop, np.zeros((1, 2)))]
    outer = min(around, key=lambda loop: abs(loop_area(loop)))
    holes = [loop for loop in loops if loop is not outer and contains(outer, loop[:1])]
    return Shape(x, distance, [outer, *(hole for hole in holes if abs(loop_area(hole)) > (2.0 * spike_m) ** 2)])


def _snap(region: Region, opened: Shape, points: Float) -> Float:
    """Move points onto the zero level by Newton steps along the gradient."""
    tiny = 1e-7

    def level(at: Float) -> Float:
        return np.maximum(region_distance(region, at), opened.at(at))

    for _ in range(4):
        value = level(points)
        slope = np.stack([level(points + d) - level(points - d) for d in tiny * np.eye(2)], axis=1) / (2.0 * tiny)
        points = points - (value / np.maximum((slope**2).sum(axis=1), 0.25))[:, None] * slope
    return points


def loop_area(loop: Float) -> float:
    """Return the signed area of a closed polygon [m2]."""
    nxt = np.roll(loop, -1, axis=0)
    return 0.5 * float((loop[:, 0] * nxt[:, 1] - loop[:, 1] * nxt[:, 0]).sum())


def contains(loop: Float, points: Float) -> NDArray[np.bool_]:
    """Return whether points, shape (n, 2), are in a closed polygon, shape (k, 2)."""
    return _outline_distance(np.stack([loop, np.roll(loop, -1, axis=0)], axis=1), points) < 0.0
