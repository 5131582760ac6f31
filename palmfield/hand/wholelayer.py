"""Skin layer under a whole closed surface or some of its faces, on the triangles of the surface."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import SceneError
from palmfield.hand.layer import (
    depth_by_vertex,
    fit_thickness,
    inward_directions,
    mesh_report,
    unfolded,
    wedge_quality,
)
from palmfield.hand.layer_volume import layer_volume, thickness_integral
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.split_edges import split_long_edges
from palmfield.hand.triangles import face_normals, largest_part, on_rim, unique_edges, vertex_areas, vertex_normals
from palmfield.types import Float, Int, Patch, Surface

THINNED = 0.999
"""A vertex is thinned if it has less than this share of the requested thickness."""
LEAST_UPRIGHT = 0.5
"""Smallest cosine in the length correction of a slanted column: 60 degrees."""
PALMAR = (0.0, 0.0, -1.0)
"""Direction of the palmar skin of a hand, in the hand frame."""


def hand_layer(
    surface: Surface,
    depth: ArrayLike | float,
    faces: ArrayLike | None = None,
    *,
    sheets: ArrayLike | None = None,
    max_fraction: float = 0.45,
    inward: Float | None = None,
) -> Patch:
    """Return the layer of wedges under a closed surface or some of its faces, one column of wedges per triangle.

    surface: closed mesh [m]; depth: thickness normal to the skin at its vertices [m], shape (n,), or one number; a
        slanted column, as at creases, is longer by the inverse of its mean cosine to the faces
    faces: numbers of the faces with a layer, shape (k,), for example by `facing_faces`; None is all faces, without rim
    sheets: relative thicknesses of sub-layers in any unit, the first at the skin, for the report only; the solvers use
        the same numbers as sheets of a `palmfield.skin.problem.Layer`
    max_fraction: largest thickness as a share of the distance through the body along the inward direction. At 0.5
        layers of both sides meet; 0.45 leaves a tenth of the distance between them

    inward: unit directions into the body, shape (n, 3). None computes `layer.inward_directions` of the whole surface,
        so that columns at a rim are like those inside; if a coarse mesh folds over, as at some finger webs, a few
        vertices are moved first (`layer.unfolded`)

    Patch.report (percentiles, means and shares are weighted by area):
    vertices, triangles, area_m2, angle_min_deg, edge_mean_m; quality_min (lower bound of the wedges' scaled Jacobian)
    depth_asked_{min,p10,mean}_m (requested), depth_got_{min,p10,mean}_m, p10_share (10th percentile of their ratio)
    area_thinned (share with less than 0.999 of the requested thickness), area_limited (share of these where
    max_fraction alone is the reason)
    volume_m3, thickness_integral_m3 (see `layer_volume.thickness_integral`), volume_share (their ratio)
    vertices_moved, moved_most_m
    sheet_1_p10_m, sheet_1_volume_m3, sheet_1_quality_min, and so on for each of `sheets`

    Raises SceneError for numbers out of range, a surface that is not closed, and a layer that folds, with its place.
    """
    vertices = np.asarray(surface.vertices, dtype=np.float64)
    everything = np.asarray(surface.faces, dtype=np.int32)
    requested = depth_by_vertex(depth, len(vertices))
    chosen = _face_numbers(faces, len(everything))
    shares = _shares(sheets)
    if inward is not None and np.shape(inward) != vertices.shape:
        raise SceneError(f"skin layer: inward has shape {np.shape(inward)}; give one direction for each vertex")
    if not 0.0 < max_fraction <= 1.0:
        raise SceneError(f"skin layer: max_fraction is {max_fraction:g}; give more than 0 and at most 1")
    _, uses = unique_edges(everything)
    if (uses != 2).any():
        raise SceneError(
            f"skin layer: {int((uses != 2).sum())} edges of the surface do not have two faces; close it, as "
            "palmfield.hand.meshfile.load_mesh does"
        )
    moved = np.zeros(len(vertices))
    if inward is None:
        original, vertices = vertices, unfolded(vertices, everything)
        moved = np.linalg.norm(vertices - original, axis=1)
        inward = inward_directions(vertices, everything)
    used, local = np.unique(everything[chosen], return_inverse=True)
    points, corners, down = vertices[used], local.reshape(-1, 3).astype(np.int32), inward[used]
    way = exit_distances(vertices, everything, points, down, float(np.ptp(vertices, axis=0).sum()))
    upright = upright_cosine(points, corners, down)
    along = requested[used] / upright
    thickness, quality = fit_thickness(points, corners, down, along, max_fraction * way)

    full = np.zeros(len(vertices))
    full[used] = thickness * upright
    integral = thickness_integral(vertices, everything, full, chosen)
    patch = Patch(points, corners, down, thickness, on_rim(corners, len(used)))
    report = _report(patch, requested[used], max_fraction * way, quality, integral)
    report |= _sheet_report(patch, shares)
    report |= {"vertices_moved": float((moved > 0.0).sum()), "moved_most_m": float(moved.max())}
    return replace(patch, report=report)


def whole_layer(surface: Surface, depth: ArrayLike | float, most_m: float, longest_m: float) -> Patch:
    """Return `hand_layer` of a whole surface whose edges longer than `longest_m` are halved [m].

    depth: at its vertices [m], shape (n,), or one number; most_m: largest depth [m]
    """
    carry, faces = split_long_edges(surface.vertices, surface.faces, longest_m)
    vertices, depths = carry @ surface.vertices, carry @ depth_by_vertex(depth, len(surface.vertices))
    return hand_layer(Surface(vertices, faces, vertex_normals(vertices, faces)), np.minimum(depths, most_m))


def facing_faces(surface: Surface, direction: ArrayLike = PALMAR, least_cosine: float = 0.3) -> Int:
    """Return the largest connected part of the faces on one side of a surface, with holes filled, shape (k,).

    direction: unit direction of the side, default palmar in the hand frame
    least_cosine: smallest cosine of vertex normals to it; vertex normals give a smoother rim than face normals
    Raises SceneError if there is no such face.
    """
    cosine = surface.normals @ np.asarray(direction, dtype=np.float64)
    visible = cosine[surface.faces].mean(axis=1) > least_cosine
    if not visible.any():
        raise SceneError(
            f"no face has a normal along {np.asarray(direction).tolist()} with a cosine of {least_cosine:g} or "
            "more; lower least_cosine"
        )
    area = face_normals(surface.vertices, surface.faces)[1]
    for facing in (True, False):
        numbers = np.flatnonzero(visible == facing)
        if len(numbers):
            visible[numbers[~largest_part(surface.faces[numbers], area[numbers])]] = not facing
    return np.flatnonzero(visible).astype(np.int32)


def _face_numbers(faces: ArrayLike | None, count: int) -> Int:
    if faces is None:
        return np.arange(count, dtype=np.int32)
    numbers = np.asarray(faces)
    if numbers.ndim != 1 or len(numbers) == 0 or numbers.dtype.kind not in "iu":
        raise SceneError(
            f"skin layer: faces of shape {numbers.shape} and type {numbers.dtype}; give numbers of faces, shape (k,)"
        )
    if numbers.min() < 0 or numbers.max() >= count:
        raise SceneError(f"skin layer: faces name {numbers.min()} to {numbers.max()}; the surface has {count}")
    return np.unique(numbers).astype(np.int32)


def _shares(sheets: ArrayLike | None) -> Float:
    """Return the boundaries of the sheets as shares of the depth, from 0 to 1; empty without sheets."""
    if sheets is None:
        return np.zeros(0)
    parts = np.asarray(sheets, dtype=np.float64)
    if parts.ndim != 1 or len(parts) == 0 or not (np.isfinite(parts) & (parts > 0.0)).all():
        raise SceneError(f"skin layer: sheets are {parts.tolist()}; give shares of the depth above 0, skin first")
    return np.concatenate([[0.0], np.cumsum(parts) / parts.sum()])


def upright_cosine(vertices: Float, faces: Int, inward: Float) -> Float:
    """Return the mean cosine between the direction of each vertex and its face normals, shape (n,).

    The mean is weighted by area; values are at least LEAST_UPRIGHT.
    """
    unit, area = face_normals(vertices, faces)
    cosine = -np.einsum("ijk,ik->ij", inward[faces], unit) * area[:, None]
    total = np.bincount(faces.ravel(), cosine.ravel(), len(vertices))
    return np.maximum(total / (3.0 * vertex_areas(vertices, faces)), LEAST_UPRIGHT)


def percentile(values: Float, weights: Float, percent: float) -> float:
    """Return the weighted percentile: the smallest value with at least `percent` of the weight at or below it."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, 0.01 * percent * cumulative[-1])])


def _report(patch: Patch, requested: Float, limit: Float, quality: Float, integral: float) -> dict[str, float]:
    points, upright = patch.vertices, upright_cosine(patch.vertices, patch.faces, patch.inward)
    thickness, limit = patch.depth * upright, limit * upright
    area = vertex_areas(points, patch.faces)
    share = area / area.sum()
    volume = layer_volume(points, patch.faces, patch.inward, patch.depth)
    report = mesh_report(points, patch.faces, area, quality) | {
        "p10_share": percentile(thickness / requested, area, 10.0),
        "area_thinned": float(share[thickness < THINNED * requested].sum()),
        "area_limited": float(share[limit < THINNED * requested].sum()),
        "volume_m3": volume,
        "thickness_integral_m3": integral,
        "volume_share": volume / integral,
    }
    for name, value in (("asked", requested), ("got", thickness)):
        report[f"depth_{name}_min_m"] = float(value.min())
        report[f"depth_{name}_p10_m"] = percentile(value, area, 10.0)
        report[f"depth_{name}_mean_m"] = float(share @ value)
    return report


def _sheet_report(patch: Patch, shares: Float) -> dict[str, float]:
    report = {}
    area, upright = vertex_areas(patch.vertices, patch.faces), upright_cosine(patch.vertices, patch.faces, patch.inward)
    for number, (above, below) in enumerate(pairwise(shares), start=1):
        top, thick = patch.vertices + (above * patch.depth)[:, None] * patch.inward, (below - above) * patch.depth
        report[f"sheet_{number}_p10_m"] = percentile(thick * upright, area, 10.0)
        report[f"sheet_{number}_volume_m3"] = layer_volume(top, patch.faces, patch.inward, thick)
        report[f"sheet_{number}_quality_min"] = float(wedge_quality(top, patch.faces, patch.inward, thick).min())
    return report
