"""Inward directions and thickness of a skin layer, so that its wedges are not inverted."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.hand.triangles import (
    adjacency,
    corner_angles,
    edge_lengths,
    face_normals,
    neighbour_mean,
    vertex_normals,
)
from palmfield.types import Float, Int

LEAST_QUALITY = 0.05
LEAST_RATIO = 0.05
# Scaled Jacobian of a triangle with a smallest angle of 12.5 degrees.
SOUND_TRIANGLE = 0.25
# Largest rise of thickness per distance along the surface: the base then rises at 35 degrees.
STEEPEST_RISE = 0.7
KEPT_COSINE = 0.9
# Smallest cosine between direction and face normal: a wedge slanted by 84 degrees is still valid.
LEAST_VISIBLE = 0.1
MOST_MOVES = 20
# Share of the median edge below which all distances count equally when directions are smoothed.
LEAST_DISTANCE = 1e-3
# Full height of an equilateral corner gives 1.
CORNER_SCALE = 2.0 / np.sqrt(3.0)


def depth_by_vertex(depth: ArrayLike | float, count: int) -> Float:
    """Return the thickness [m], shape (count,). Raises SceneError for another shape and for values not above 0."""
    value = np.asarray(depth, dtype=np.float64)
    if value.ndim == 0:
        value = np.full(count, float(value))
    if value.shape != (count,):
        raise SceneError(f"skin depth has shape {value.shape}; give one number, or one per vertex ({count})")
    wrong = ~(np.isfinite(value) & (value > 0.0))
    if wrong.any():
        raise SceneError(f"skin depth is {value[wrong][0]:g} m at vertex {np.argmax(wrong)}; allowed: above 0")
    return value


def most_visible_normals(vertices: Float, faces: Int) -> tuple[Float, Float]:
    """Return unit normals that maximise their smallest cosine to the faces around, and that cosine; (n, 3), (n,).

    The angle-weighted mean is moved step by step towards the worst face (Aubry & Lohner 2008, "On the most normal
    normal", doi 10.1002/cnm.1056). If the cosine is 0 or less, no direction is outside of all faces.
    """
    unit, _ = face_normals(vertices, faces)
    normal = vertex_normals(vertices, faces)
    best = _least_cosine(normal, faces, unit)
    for step in (0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02):
        at_worst = np.einsum("ijk,ik->ij", normal[faces], unit) <= best[faces] + 1e-9
        push = np.zeros_like(normal)
        for i in range(3):
            np.add.at(push, faces[at_worst[:, i], i], unit[at_worst[:, i]])
        trial = _unit(normal + step * push)
        cosine = _least_cosine(trial, faces, unit)
        better = cosine > best
        normal[better], best[better] = trial[better], cosine[better]
    return normal, best


def inward_directions(vertices: Float, faces: Int, smoothing_rounds: int = 5) -> Float:
    """Return unit directions into the body, shape (n, 3): the negative most visible normals, smoothed.

    Smoothing keeps at least KEPT_COSINE of the smallest cosine to the faces. It takes `smoothing_rounds` rounds with
    the mean of the neighbours, which makes directions on creases and facets radial. Twice as many rounds follow with
    weights of inverse squared distance: vertices that nearly coincide, as after marching cubes, then have nearly equal
    directions, and their wedges are not twisted.
    """
    unit, _ = face_normals(vertices, faces)
    normal, best = most_visible_normals(vertices, faces)
    floor = KEPT_COSINE * best
    edges, length = edge_lengths(vertices, faces)
    typical = float(np.median(length))
    for power, rounds in ((0.0, smoothing_rounds), (-2.0, 2 * smoothing_rounds)):
        weights = np.maximum(length / typical, LEAST_DISTANCE) ** power
        half = sparse.coo_array((weights, (edges[:, 0], edges[:, 1])), shape=(len(vertices), len(vertices)))
        links = sparse.csr_array(half + half.T)
        for _ in range(rounds):
            trial = _unit(normal + _unit(links @ normal))
            accepted = _least_cosine(trial, faces, unit) >= floor
            normal[accepted] = trial[accepted]
    return -normal


def unfolded(vertices: Float, faces: Int) -> Float:
    """Return positions [m], shape (n, 3), at which every vertex has a direction that is outside of all its faces.

    If the best cosine of a vertex is below LEAST_VISIBLE, as at folds of a coarse mesh in finger webs, the vertex and
    its neighbours move half way to the mean of their neighbours, at most MOST_MOVES times. Others are fixed.
    """
    links = adjacency(faces, len(vertices))
    points = vertices.copy()
    for _ in range(MOST_MOVES):
        folded = most_visible_normals(points, faces)[1] < LEAST_VISIBLE
        if not folded.any():
            break
        around = np.unique(faces[folded[faces].any(axis=1)])
        points[around] = 0.5 * (points + neighbour_mean(points, links))[around]
    return points


def wedge_quality(vertices: Float, faces: Int, inward: Float, depth: Float) -> Float:
    """Return the smallest scaled Jacobian of each extruded wedge, shape (m,): 1 is best, above 0 there is no fold.

    Along the edge at a corner the Jacobian is quadratic and bounded by its three Bernstein coefficients (top, mixed,
    bottom; Johnen et al. 2013, doi 10.1016/j.jcp.2012.08.051). Top and bottom alone do not detect a wedge that has
    passed through a point: its bottom is rotated by 180 degrees, and its area is positive again.
    """
    bottom = vertices + depth[:, None] * inward
    quality = np.full(len(faces), np.inf)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        up = -inward[faces[:, i]]
        side = [
            (level[faces[:, j]] - level[faces[:, i]], level[faces[:, k]] - level[faces[:, i]])
            for level in (vertices, bottom)
        ]
        volume = [[np.einsum("ij,ij->i", np.cross(e1, e2), up) for _, e2 in side] for e1, _ in side]
        size = [[np.linalg.norm(e1, axis=1) * np.linalg.norm(e2, axis=1) for _, e2 in side] for e1, _ in side]
        for value, scale in (
            (volume[0][0], size[0][0]),
            (volume[0][1] + volume[1][0], size[0][1] + size[1][0]),
            (volume[1][1], size[1][1]),
        ):
            quality = np.minimum(quality, CORNER_SCALE * value / np.maximum(scale, 1e-30))
    return quality


def mesh_report(vertices: Float, faces: Int, area: Float, quality: Float) -> dict[str, float]:
    """Return the report entries on the triangles and wedges of a patch; area: areas of its faces [m2]."""
    return {
        "vertices": float(len(vertices)),
        "triangles": float(len(faces)),
        "area_m2": float(area.sum()),
        "angle_min_deg": float(np.rad2deg(corner_angles(vertices, faces).min())),
        "edge_mean_m": float(edge_lengths(vertices, faces)[1].mean()),
        "quality_min": float(quality.min()),
    }


def fit_thickness(vertices: Float, faces: Int, inward: Float, requested: Float, limit: Float) -> tuple[Float, Float]:
    """Return the thickness [m], shape (n,), at most `requested` and `limit`, and the wedge quality, shape (m,).

    The ratio of limit to request is min-filtered over neighbours. At an inverted or poor wedge the thickness is
    multiplied by 0.9, repeatedly, and around it the thickness rises by at most STEEPEST_RISE of the distance along the
    surface. A wedge is poor below LEAST_QUALITY; this limit is proportionally lower for triangles with a quality below
    SOUND_TRIANGLE.

    Raises SceneError with the position if wedges are poor even at 5 % of the requested thickness.
    """
    edges, length = edge_lengths(vertices, faces)
    flat = wedge_quality(vertices, faces, inward, np.zeros(len(vertices)))
    floor = LEAST_QUALITY * np.minimum(1.0, flat / SOUND_TRIANGLE)
    thickness = requested * _neighbour_min(np.minimum(1.0, limit / requested), faces)
    while True:
        thickness = _rising_gently(thickness, edges, STEEPEST_RISE * length)
        quality = wedge_quality(vertices, faces, inward, thickness)
        poor = (quality < floor) | (quality <= 0.0)
        if not poor.any():
            return thickness, quality
        touched = np.unique(faces[poor])
        thickness[touched] *= 0.9
        if (thickness[touched] / requested[touched]).min() < LEAST_RATIO:
            worst = int(np.argmin(np.where(poor, quality - floor, np.inf)))
            place = vertices[faces[worst]].mean(axis=0) * 1e3
            raise SceneError(
                f"the skin layer folds at ({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) mm (element quality "
                f"{quality[worst]:.2g}, least allowed {floor[worst]:.2g}); use a thinner layer or, in a patch, a "
                "smaller radius, or smooth the mesh there"
            )


def _least_cosine(direction: Float, faces: Int, unit: Float) -> Float:
    """Return the smallest cosine of the direction of each vertex to the normals of the faces around it, shape (n,)."""
    worst = np.full(len(direction), np.inf)
    np.minimum.at(worst, faces.ravel(), np.einsum("ijk,ik->ij", direction[faces], unit).ravel())
    return worst


def _neighbour_min(values: Float, faces: Int) -> Float:
    out = values.copy()
    np.minimum.at(out, faces.ravel(), np.repeat(values[faces].min(axis=1), 3))
    return out


def _rising_gently(values: Float, edges: Int, rise: Float) -> Float:
    """Return the largest values that are at most `values` and differ by at most `rise` along each edge."""
    while True:
        out = values.copy()
        np.minimum.at(out, edges[:, 0], values[edges[:, 1]] + rise)
        np.minimum.at(out, edges[:, 1], values[edges[:, 0]] + rise)
        if (out >= values - 1e-12).all():
            return out
        values = out


def _unit(vectors: Float) -> Float:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
