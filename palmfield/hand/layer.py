"""Inward directions and thickness of a skin layer, so that its wedges are not inverted."""

import numpy as np
from numpy.typing import NDArray

from palmfield.errors import SceneError
from palmfield.hand.triangles import adjacency, face_normals, neighbour_mean, vertex_normals
from palmfield.types import Float, Int

LEAST_QUALITY = 0.05
LEAST_RATIO = 0.05
# Full height of an equilateral corner gives 1.
CORNER_SCALE = 2.0 / np.sqrt(3.0)


def inward_directions(vertices: Float, faces: Int, smoothing_rounds: int = 3) -> Float:
    """Unit directions into the body, shape (n, 3): minus the most visible normals, smoothed where that stays visible.

    The most visible normal of a vertex maximises its smallest cosine to the faces there (Aubry & Lohner 2008,
    "On the most normal normal"); smoothing may cost at most half of that cosine.
    """
    unit, _ = face_normals(vertices, faces)

    def least_cosine(direction: Float) -> Float:
        worst = np.full(len(vertices), np.inf)
        np.minimum.at(worst, faces.ravel(), np.einsum("ijk,ik->ij", direction[faces], unit).ravel())
        return worst

    normal = vertex_normals(vertices, faces)
    best = least_cosine(normal)
    for step in (0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02):
        cosine = np.einsum("ijk,ik->ij", normal[faces], unit)
        push = np.zeros_like(normal)
        at_worst = cosine <= best[faces] + 1e-9
        for i in range(3):
            np.add.at(push, faces[at_worst[:, i], i], unit[at_worst[:, i]])
        trial = _unit(normal + step * push)
        cost = least_cosine(trial)
        better = cost > best
        normal[better], best[better] = trial[better], cost[better]
    links = adjacency(faces, len(vertices))
    floor = 0.5 * best
    for _ in range(smoothing_rounds):
        trial = _unit(normal + neighbour_mean(normal, links))
        keep = least_cosine(trial) >= floor
        normal[keep] = trial[keep]
    return -normal


def wedge_quality(vertices: Float, faces: Int, inward: Float, depth: Float) -> Float:
    """Smallest scaled Jacobian of each extruded wedge, shape (m,): 1 is best, above 0 nothing is folded.

    Down the edge at a corner the Jacobian is quadratic; its three Bernstein coefficients (top, mixed, bottom) bound it
    (Johnen et al. 2013, doi 10.1016/j.jcp.2012.08.051). Top and bottom alone miss a wedge that has passed through a
    point: there the bottom is turned by 180 degrees and its area is positive again.
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


def fit_thickness(vertices: Float, faces: Int, inward: Float, asked: Float, limit: Float) -> tuple[Float, Float]:
    """Thickness [m], shape (n,), no more than `asked` and `limit`, and the wedges' quality, shape (m,).

    The share of the asked thickness is min-filtered over neighbours and smoothed downwards; where a wedge is inverted
    or poor it is cut by 0.85 again and again.

    Raises SceneError with the place where no thickness above 5 % of the asked one gives sound wedges.
    """
    links = adjacency(faces, len(vertices))
    ratio = _lower_smooth(_neighbour_min(np.minimum(1.0, limit / asked), faces), links, rounds=3)
    while True:
        quality = wedge_quality(vertices, faces, inward, ratio * asked)
        poor = quality < LEAST_QUALITY
        if not poor.any():
            return ratio * asked, quality
        touched = np.unique(faces[poor])
        ratio[touched] *= 0.85
        ratio = _lower_smooth(ratio, links, rounds=1)
        if ratio[touched].min() < LEAST_RATIO:
            place = vertices[faces[np.argmin(quality)]].mean(axis=0) * 1e3
            raise SceneError(
                f"skin layer folds at ({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) mm (quality "
                f"{quality.min():.2g}, least {LEAST_QUALITY}); use a smaller radius or max_depth, or "
                "smooth the mesh there"
            )


def _neighbour_min(values: Float, faces: Int) -> Float:
    out = values.copy()
    np.minimum.at(out, faces.ravel(), np.repeat(values[faces].min(axis=1), 3))
    return out


def _lower_smooth(values: Float, links: NDArray, rounds: int) -> Float:
    for _ in range(rounds):
        values = np.minimum(values, neighbour_mean(values, links))
    return values


def _unit(vectors: Float) -> Float:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
