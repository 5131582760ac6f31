"""Well-shaped, graded triangulation of a plane shape."""

from collections.abc import Callable

import numpy as np
import scipy  # which loads its parts when they are used

from palmfield.hand.region import Shape
from palmfield.hand.triangles import signed_areas
from palmfield.types import Float, Int

SMOOTHING_ROUNDS = 12
Size = Callable[[Float], Float]


MIDDLE = (0.0, 0.0)


def graded_size(
    fine_m: float, coarse_m: float, fine_radius_m: float, radius_m: float, centre_m: tuple[float, float] = MIDDLE
) -> Size:
    """Return the target edge length as a function of the position in the plane.

    Edges are fine around `centre_m` and grow linearly to coarse at the radius about the origin.
    """
    centre = np.array(centre_m)
    radius_m += float(np.linalg.norm(centre))

    def size(points: Float) -> Float:
        r = np.linalg.norm(points - centre, axis=1)
        grown = np.clip((r - fine_radius_m) / max(radius_m - fine_radius_m, 1e-9), 0.0, 1.0)
        return fine_m + (coarse_m - fine_m) * grown

    return size


def triangulate(shape: Shape, size: Size, radius_m: float, centre_m: tuple[float, float] = MIDDLE) -> tuple[Float, Int]:
    """Return points in the plane [m], shape (n, 2), and counter-clockwise faces, shape (m, 3).

    radius_m: largest distance of the shape from the origin; centre_m: centre of the initial rings of points
    Points on the boundary loops are fixed. The others move to the density-weighted centroid of their triangles (Chen &
    Holst 2011, doi 10.1016/j.cma.2010.11.007), with a new Delaunay triangulation in each round.
    """
    boundary = np.concatenate([_resample(loop, size) for loop in shape.loops])
    inner = _rings(size, radius_m, centre_m)
    inner = inner[shape.at(inner) < -0.6 * size(inner)]
    fixed = len(boundary)
    points = np.concatenate([boundary, inner])
    for _ in range(SMOOTHING_ROUNDS):
        faces = _inside(points, shape)
        centroid = points[faces].mean(axis=1)
        weight = signed_areas(points, faces) / size(centroid) ** 3
        total = np.bincount(faces.ravel(), np.repeat(weight, 3), len(points))
        moved = np.stack(
            [np.bincount(faces.ravel(), np.repeat(weight * centroid[:, k], 3), len(points)) for k in (0, 1)], axis=1
        )
        free = np.flatnonzero(total > 0.0)
        free = free[free >= fixed]
        points[free] = moved[free] / total[free, None]
    used, local = np.unique(_inside(points, shape), return_inverse=True)
    return points[used], local.reshape(-1, 3).astype(np.int32)


def _rings(size: Size, radius_m: float, centre_m: tuple[float, float]) -> Float:
    """Return points on concentric rings with the target spacing, a whole number of rings up to the radius."""
    centre = np.array(centre_m)
    r = np.linspace(0.0, radius_m + float(np.linalg.norm(centre)), 2000)
    step = size(centre + np.column_stack([r, np.zeros_like(r)]))
    count = np.concatenate([[0.0], np.cumsum(np.diff(r) / (0.5 * np.sqrt(0.75) * (step[1:] + step[:-1])))])
    rings = max(2, round(count[-1]))
    points = [centre[None]]
    for k in range(1, rings):
        radius = float(np.interp(count[-1] * k / rings, count, r))
        number = max(6, round(2.0 * np.pi * radius / float(np.interp(radius, r, step))))
        angle = 2.0 * np.pi * (np.arange(number) + 0.5 * k) / number
        points.append(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(points)


def _resample(loop: Float, size: Size) -> Float:
    """Return points along a closed polygon at the target spacing, from its first point on."""
    closed = np.concatenate([loop, loop[:1]])
    length = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    count = np.concatenate([[0.0], np.cumsum(length / size(0.5 * (closed[1:] + closed[:-1])))])
    number = max(8, round(count[-1]))
    along = count[-1] * np.arange(number) / number
    return np.stack([np.interp(along, count, closed[:, k]) for k in (0, 1)], axis=1)


def _inside(points: Float, shape: Shape) -> Int:
    faces = scipy.spatial.Delaunay(points).simplices.astype(np.int32)
    area = signed_areas(points, faces)
    faces[area < 0.0] = faces[area < 0.0][:, ::-1]
    flat = np.abs(area) < 1e-6 * np.abs(area).mean()
    return faces[~flat & (shape.at(points[faces].mean(axis=1)) < 0.0)]
