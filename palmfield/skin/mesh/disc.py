"""A flat round layer, the phantom on which solvers are compared."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from palmfield.errors import SceneError
from palmfield.hand.grading import graded_size, triangulate
from palmfield.hand.region import Shape
from palmfield.hand.triangles import signed_areas
from palmfield.types import Float, Int, Patch

STEEPEST = 0.4
"""Largest growth of the edge with distance from the centre; steeper growth makes triangles that are too thin."""


OUTLINE, GRID = 720, 257
"""Number of points on the outline of a circle, and of grid points along each side of its square."""


def disc_patch(
    radius_m: float,
    thickness_m: float,
    fine_m: float,
    coarse_m: float,
    fine_radius_m: float,
    fine_at: tuple[float, float] = (0.0, 0.0),
) -> Patch:
    """Return a disc of concentric rings of vertices, joined by Delaunay triangles.

    radius_m, thickness_m: radius and thickness of the disc [m]. fine_m: edge length within fine_radius_m of the centre
    [m]. coarse_m: edge length at the rim [m]; edges grow linearly with distance from the centre, at most by STEEPEST.
    fine_at: centre of the fine edges [m] instead of the centre of the disc; then there are rings only near it.
    Returns a Patch with face at z = 0, outward normal +z, `inward` along -z and `axis` +z.
    Raises SceneError unless all lengths are > 0, fine_m <= coarse_m <= radius_m and fine_radius_m <= radius_m.
    """
    if not 0.0 < fine_m <= coarse_m <= radius_m or not 0.0 < fine_radius_m <= radius_m or not thickness_m > 0.0:
        raise SceneError(
            f"disc of radius {radius_m} m, thickness {thickness_m} m, edges {fine_m} to {coarse_m} m, fine radius "
            f"{fine_radius_m} m: need 0 < fine <= coarse <= radius, 0 < fine radius <= radius and thickness > 0"
        )

    sizes = radius_m, fine_m, coarse_m, fine_radius_m
    points, faces = _round(*sizes, fine_at) if any(fine_at) else _ringed(*sizes)
    clockwise = signed_areas(points, faces) < 0.0
    faces[clockwise] = faces[clockwise][:, ::-1]
    return flat_patch(points, faces, thickness_m, np.linalg.norm(points, axis=1) > radius_m * (1.0 - 1e-9))


def flat_patch(points: Float, faces: Int, thickness_m: float, rim: NDArray[np.bool_]) -> Patch:
    """Return a flat face at z = 0, outward normal +z, with vertices (n, 2) [m], over a layer of constant thickness."""
    count = len(points)
    return Patch(
        vertices=np.column_stack([points, np.zeros(count)]),
        faces=faces.astype(np.int32),
        inward=np.tile([0.0, 0.0, -1.0], (count, 1)),
        depth=np.full(count, thickness_m),
        rim=rim,
        axis=np.array([0.0, 0.0, 1.0]),
    )


def _ringed(radius_m: float, fine_m: float, coarse_m: float, fine_radius_m: float) -> tuple[Float, Int]:
    def edge(r: float) -> float:
        if r <= fine_radius_m:
            return fine_m
        target = (coarse_m - fine_m) / (radius_m - fine_radius_m)
        return fine_m + min(target, STEEPEST) * (r - fine_radius_m)

    # A ring of equilateral triangles is sqrt(3)/2 edges wide; all rings are scaled so that the last one is the rim.
    radii = [0.0]
    while radii[-1] < radius_m:
        radii.append(radii[-1] + math.sqrt(0.75) * edge(radii[-1]))
    radii = [min(r * radius_m / radii[-1], radius_m) for r in radii]
    rings = [np.zeros((1, 2))]
    for number, r in enumerate(radii[1:]):
        count = max(6, round(2.0 * math.pi * r / edge(r)))
        angle = 2.0 * math.pi * (np.arange(count) + 0.5 * (number % 2)) / count
        rings.append(r * np.column_stack([np.cos(angle), np.sin(angle)]))
    points = np.concatenate(rings)
    return points, Delaunay(points).simplices


def _round(
    radius_m: float, fine_m: float, coarse_m: float, fine_radius_m: float, fine_at: tuple[float, float]
) -> tuple[Float, Int]:
    """Return vertices and faces of a disc with fine edges round a place that is not its centre."""
    away = math.hypot(*fine_at)
    grown = min(coarse_m, fine_m + STEEPEST * max(radius_m + away - fine_radius_m, 0.0))
    size = graded_size(fine_m, grown, fine_radius_m, radius_m, fine_at)
    turn = 2.0 * math.pi * np.arange(OUTLINE) / OUTLINE
    outline = radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
    x = 1.05 * radius_m * np.linspace(-1.0, 1.0, GRID)
    shape = Shape(x, np.hypot(x[None, :], x[:, None]) - radius_m, [outline])
    points, faces = triangulate(shape, size, radius_m, fine_at)
    rim = np.linalg.norm(points, axis=1) > radius_m * (1.0 - 1e-3)
    points[rim] *= radius_m / np.linalg.norm(points[rim], axis=1)[:, None]
    return points, faces
