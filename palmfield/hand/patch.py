"""Cut the simulated patch of skin out of a closed surface, remesh it to given edge lengths, and fit its thickness."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from palmfield import cache
from palmfield.errors import SceneError
from palmfield.hand.grading import graded_size, triangulate
from palmfield.hand.layer import depth_by_vertex, fit_thickness, inward_directions, mesh_report, wedge_quality
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces, exit_distances, over_plane
from palmfield.hand.region import Region, Shape, facing_region, trace_shape
from palmfield.hand.triangles import face_normals, on_rim
from palmfield.types import Float, Int, Patch, Surface

CENTRE_TOLERANCE_m = 0.005
Lengths = tuple[float, float, float, float, float, float]
Sizes = tuple[float, float, float, float, float, float, float]
MADE = ("vertices", "faces", "inward", "depth", "rim")
"""Arrays of a patch in the cache."""
STEPS, SPIKE, WIDEST_SPIKE_m = 60, 0.08, 8e-3
"""Steps of the traced outline to the radius of a patch, and half of the least width of its necks: a share of this
radius, at most the length. They and GAUGE do not depend on the edges, so meshes of different edges have one geometry:
the outline and depth of each mesh for itself changed the motion of a palm at 200 Hz by 5 % (rms over foci)."""
NARROWEST = 0.75
"""Least distance of the rim from the middle of a patch, in coarse edges."""
FLAT = 0.1
"""Quality of a triangle below which no depth is fitted to it."""
GAUGE, LEAST_GAUGE_m, WIDEST_GAUGE_m = 0.05, 8e-4, 4e-3
"""Edge of the triangles for the depth of a layer, as a share of the radius, and its limits. Below fingertips of meshes
columns meet: edges of 0.4 mm gave half of a depth of 6 mm, 0.8 mm gives 0.7 to 0.9 of it."""


def surface_patch(
    surface: Surface,
    depth: ArrayLike | float,
    centre: ArrayLike,
    radius_m: float,
    fine_m: float,
    coarse_m: float,
    fine_radius_m: float,
    *,
    max_depth_m: float,
    axis: ArrayLike | None = None,
    facing: ArrayLike | None = None,
    max_fraction: float = 0.45,
    fine_at: ArrayLike | None = None,
) -> Patch:
    """Return the patch of a closed surface around `centre`, with a new graded triangulation and a layer under it.

    The patch is a height field over the plane normal to `facing`. It contains the faces that are connected to the
    centre, within `radius_m` in that plane, and inclined by at most 75 degrees to it. If they end before the radius,
    the rim is their boundary, without spikes and narrow necks (SPIKE). Vertices are on the surface. Outline
    and depth do not depend on the edge lengths, except where an element would fold.

    surface: closed mesh [m]; depth: skin thickness at its vertices [m], shape (n,), or one number
    centre: [m], shape (3,), at most 5 mm off the surface; moved to the nearest point of the surface
    fine_m, coarse_m: edge lengths within `fine_radius_m` and at the radius [m]; linear between
    fine_at: centre of the fine edges [m], shape (3,), projected along `facing`; default the centre
    max_depth_m: largest thickness [m]
    axis: stored in the patch; facing: outward direction, shape (3,), default the normal at the centre
    max_fraction: largest thickness as a share of the distance through the body along the inward direction. Use 0.45 to
        leave room for a layer on the far side, and 1 if the far side is the rigid base.

    Patch.report: vertices, triangles, area_m2, angle_min_deg, edge_mean_m, quality_min (scaled Jacobian of the wedges),
    depth_asked_min_m and depth_got_min_m. The following are of even triangles of the same patch: share_thinned (share
    of vertices thinned by more than 0.1 %), depth_asked_{p10,mean}_m, depth_got_{p10,mean}_m and through_m (median
    distance through the body along the inward directions).

    Raises SceneError for numbers out of range, a centre off the surface or facing away, and a layer that folds.
    """
    middle = np.asarray(centre, dtype=np.float64)
    thickness = depth_by_vertex(depth, len(surface.vertices))
    lengths = radius_m, fine_m, coarse_m, fine_radius_m, max_depth_m, max_fraction
    _check_numbers(middle, lengths)
    direction = None if facing is None else _unit_vector(facing, "facing")
    fine_middle = None if fine_at is None else np.asarray(fine_at, dtype=np.float64)
    symmetry = None if axis is None else _unit_vector(axis, "axis")
    # A depth by vertex ends at bones, where no columns meet
    least_m = LEAST_GAUGE_m if np.ndim(depth) == 0 else 0.0
    gauge_m = min(max(GAUGE * radius_m, least_m), WIDEST_GAUGE_m)
    of = surface, thickness, middle, (gauge_m, *lengths), direction, fine_middle
    return patch_of(cache.kept("patch", of, lambda: _made(*of)), symmetry)


def patch_of(made: cache.Arrays, axis: Float | None = None) -> Patch:
    """Return the patch of the arrays of `layer_in`."""
    report = dict(zip(made["report_names"].tolist(), made["report"].tolist(), strict=True))
    return Patch(**{name: made[name] for name in MADE}, axis=axis, report=report)


def _made(
    surface: Surface, thickness: Float, middle: Float, sizes: Sizes, facing: Float | None, fine_at: Float | None
) -> cache.Arrays:
    """Return the arrays of `surface_patch` by the names MADE, and the report."""
    gauge_m, lengths = sizes[0], sizes[1:]
    radius_m, _, coarse_m, *_ = lengths
    origin, seed = nearest_face(surface, middle)
    outward = _outward(surface, seed, origin) if facing is None else facing
    region = facing_region(surface, origin, seed, outward, radius_m)
    shape = trace_shape(region, radius_m / STEPS, min(SPIKE * radius_m, WIDEST_SPIKE_m), NARROWEST * coarse_m)
    return layer_in(surface, thickness, region, shape, gauge_m, lengths, fine_at)


def layer_in(
    surface: Surface, thickness: Float, region: Region, shape: Shape, gauge_m: float, lengths: Lengths, at: Float | None
) -> cache.Arrays:
    """Return the arrays MADE and the report of a layer in a shape; gauge_m: edges on which depths are fitted [m]."""
    radius_m, fine_m, coarse_m, fine_radius_m, max_depth_m, max_fraction = lengths
    x, y = (0.0, 0.0) if at is None else (region.frame[:2] @ (at - region.origin)).tolist()
    size = graded_size(fine_m, coarse_m, fine_radius_m, radius_m, (x, y))
    plane, faces = triangulate(shape, size, radius_m, (x, y))
    vertices, requested = _lift(region, plane, thickness)
    requested = np.minimum(requested, max_depth_m)
    fitted, way = _depth_field(surface, thickness, region, shape, (gauge_m, max_depth_m, max_fraction))
    corners, weights = over_plane(fitted.plane, fitted.faces, plane)
    depth = np.einsum("ij,ij->i", weights, fitted.depth[corners])
    inward = inward_directions(vertices, faces)
    depths, quality = fit_thickness(vertices, faces, inward, depth, np.full(len(depth), np.inf))
    report = mesh_report(vertices, faces, face_normals(vertices, faces)[1], quality)
    report["share_thinned"] = float(np.mean(fitted.depth < 0.999 * fitted.requested))
    for name, value, least in (("asked", fitted.requested, requested), ("got", fitted.depth, depths)):
        report[f"depth_{name}_min_m"] = float(least.min())
        report[f"depth_{name}_p10_m"] = float(np.percentile(value, 10.0))
        report[f"depth_{name}_mean_m"] = float(value.mean())
    report["through_m"] = float(np.median(way))
    made: cache.Arrays = dict(zip(MADE, (vertices, faces, inward, depths, on_rim(faces, len(vertices))), strict=True))
    return made | {"report_names": np.array(list(report)), "report": np.array(list(report.values()), dtype=np.float64)}


class DepthField(NamedTuple):
    """Depth of a layer at the vertices of a triangulation of the plane under it.

    plane: [m], shape (n, 2); faces: shape (m, 3)
    requested, depth: depth of the layer before and after it was fitted into the body [m], shape (n,)
    """

    plane: Float
    faces: Int
    requested: Float
    depth: Float


def _depth_field(
    surface: Surface, thickness: Float, region: Region, shape: Shape, limits: tuple[float, float, float]
) -> tuple[DepthField, Float]:
    """Return the depth of the layer on even triangles, and the distance through the body at their vertices [m]."""
    edge, max_depth_m, max_fraction = limits
    plane, faces = triangulate(shape, graded_size(edge, edge, 0.0, region.radius_m), region.radius_m)
    vertices, requested = _lift(region, plane, thickness)
    inward = inward_directions(vertices, faces)
    # Flat triangles between points of the rim have no depth of their own
    faces = faces[wedge_quality(vertices, faces, inward, np.zeros(len(vertices))) > FLAT]
    span = float(np.ptp(surface.vertices, axis=0).sum())
    way = exit_distances(surface.vertices, surface.faces, vertices, inward, span)
    requested = np.minimum(requested, max_depth_m)
    depth, _ = fit_thickness(vertices, faces, inward, requested, max_fraction * way)
    return DepthField(plane, faces, requested, depth), way


def _check_numbers(centre: Float, lengths: Lengths) -> None:
    radius_m, fine_m, coarse_m, fine_radius_m, max_depth_m, max_fraction = lengths
    if centre.shape != (3,) or not np.isfinite(centre).all():
        raise SceneError(f"patch centre {centre.tolist()} must be three finite numbers [m]")
    positive = {"radius_m": radius_m, "fine_m": fine_m, "coarse_m": coarse_m, "max_depth_m": max_depth_m}
    for name, value in positive.items():
        if not (np.isfinite(value) and value > 0.0):
            raise SceneError(f"patch {name} {value:g} must be a positive length in metres")
    if not (np.isfinite(fine_radius_m) and fine_radius_m >= 0.0):
        raise SceneError(f"patch fine_radius_m {fine_radius_m:g} must not be negative")
    if coarse_m < fine_m:
        raise SceneError(f"patch coarse_m {coarse_m:g} is below fine_m {fine_m:g}; give coarse_m >= fine_m")
    if radius_m < 2.0 * fine_m:
        raise SceneError(f"patch radius {radius_m:g} m is below two fine edges of {fine_m:g} m; enlarge it or refine")
    if not 0.0 < max_fraction <= 1.0:
        raise SceneError(f"patch max_fraction is {max_fraction:g}; allowed: above 0, at most 1")


def nearest_face(surface: Surface, centre: Float) -> tuple[Float, int]:
    """Return the nearest point of the surface [m] and its face. Raises SceneError if it is far away."""
    mesh = build_mesh(surface.vertices, surface.faces)
    reach = float(np.linalg.norm(surface.vertices - centre, axis=1).min()) * 1.01 + 1e-6
    face = int(closest_faces(mesh, centre[None], reach)[0])
    corners = surface.vertices[surface.faces[face]][None]
    origin = (barycentric(corners, centre[None])[0, :, None] * corners[0]).sum(axis=0)
    gap = float(np.linalg.norm(origin - centre))
    if gap > CENTRE_TOLERANCE_m:
        place = ", ".join(f"{1e3 * c:.1f}" for c in centre)
        raise SceneError(
            f"patch centre ({place}) mm is {1e3 * gap:.1f} mm from the surface; allowed: at most "
            f"{1e3 * CENTRE_TOLERANCE_m:g} mm: move it onto the skin"
        )
    return origin, face


def _outward(surface: Surface, seed: int, origin: Float) -> Float:
    corners = surface.faces[seed]
    weights = barycentric(surface.vertices[corners][None], origin[None])[0]
    return _unit_vector(weights @ surface.normals[corners], "facing")


def _unit_vector(vector: ArrayLike, name: str) -> Float:
    value = np.asarray(vector, dtype=np.float64)
    if value.shape != (3,) or not np.isfinite(value).all() or np.linalg.norm(value) == 0.0:
        raise SceneError(f"patch {name} {value.tolist()} must be three finite numbers that are not all zero")
    return value / np.linalg.norm(value)


def _lift(region: Region, plane: Float, thickness: Float) -> tuple[Float, Float]:
    """Return positions on the surface under points of the plane, and the depths there."""
    corners, weights = over_plane(region.shadow, region.faces, plane)
    lifted = np.einsum("ij,ijk->ik", weights, region.vertices[corners])
    return lifted, np.einsum("ij,ij->i", weights, thickness[region.index][corners])
