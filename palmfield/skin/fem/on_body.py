"""The part of a traction that lies on a body, given by points of the face of the body."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palmfield.skin.approximation.load_scales import distance_to_sides
from palmfield.skin.fem.load import face_points, halvings_for
from palmfield.skin.fem.probe import closest_on_triangles
from palmfield.skin.fem.traction import field_at, seen_from_above
from palmfield.skin.problem import Body, Layer, Load, Slab, Spot, Traction, normals_on_face
from palmfield.types import Float

ROUND_OFF = 1e-6
"""Largest overhang of a point or its area over the side of a slab, as a share of the spacing of points."""
SLACK = 0.05
"""The same for the rim of a layer, whose triangles lie slightly off the surface that they represent."""
PARTS = 3
"""Number of places along a cell of the face over which its pressure is averaged."""


def on_body(body: Body, load: Load) -> Load:
    """Return a load without the part off the body; the same load if all of it is on the body.

    A spot is returned unchanged. If areas of the points of a traction cross the side of a slab or the rim of a layer,
    the pressure is sampled again. The new points cover the whole pressed face. Single points, and points on a line,
    that lie on the body press with their whole area.
    """
    if isinstance(load, Spot) or len(load.points) == 0:
        return load
    if isinstance(body, Slab):
        load = replace(load, points=load.points * [1.0, 1.0, 0.0])
    spacing = np.sqrt(load.weights_m2)
    net = seen_from_above(load)
    if net is None:
        on = off_face(body, load.points) <= (SLACK if isinstance(body, Layer) else ROUND_OFF) * spacing
        return load if on.all() else _part(load, on)
    slack = SLACK if isinstance(body, Layer) else ROUND_OFF
    if np.all(off_face(body, net.points) <= slack * spacing[net.owner]):
        return load
    places, weights, parts = _face(body, float(np.median(spacing)))
    shares = field_at(load, normals_on_face(body, load.points), places, normals_on_face(body, places), None)
    pressure = (shares @ load.pressure_Pa.T).T.reshape(len(load.times_s), -1, parts).mean(axis=2)
    pressed = shares.getnnz(axis=1).reshape(-1, parts).any(axis=1)
    points = places.reshape(-1, parts, 3).mean(axis=1)
    return Traction(points[pressed], weights[pressed], load.times_s, pressure[:, pressed], load.law)


def _part(load: Traction, chosen: NDArray[np.bool_]) -> Traction:
    return replace(
        load, points=load.points[chosen], weights_m2=load.weights_m2[chosen], pressure_Pa=load.pressure_Pa[:, chosen]
    )


def off_face(body: Body, points: Float) -> Float:
    """Return the distance of points, (n, 3), from a face, measured along the face [m], shape (n,); 0 on the face."""
    if isinstance(body, Slab):
        return np.maximum(-distance_to_sides(body, points[:, :2]), 0.0)
    away = points - closest_on_triangles(body.patch.vertices[body.patch.faces], points)[1]
    normal = normals_on_face(body, points)
    return np.asarray(np.linalg.norm(away - np.einsum("nc,nc->n", away, normal)[:, None] * normal, axis=1))


def _face(body: Body, spacing_m: float) -> tuple[Float, Float, int]:
    """Return places on a whole face, about `spacing_m` [m] apart, the area of each cell [m2], and places per cell."""
    if isinstance(body, Layer):
        halvings = halvings_for(body.patch.vertices[body.patch.faces], np.array([spacing_m**2]))
        return *face_points(body.patch, halvings), 1
    inner = (np.arange(PARTS) + 0.5) / PARTS
    if body.size_m is not None and body.shape == "box":
        counts = [math.ceil(length / spacing_m - ROUND_OFF) for length in body.size_m]
        lines = [((np.arange(n)[:, None] + inner) / n - 0.5) * a for n, a in zip(counts, body.size_m, strict=True)]
        x, y = np.broadcast_arrays(lines[0][:, None, :, None], lines[1][None, :, None, :])
        area = np.full(counts[0] * counts[1], float(np.prod(body.size_m)) / (counts[0] * counts[1]))
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), area, PARTS**2
    radius = body.radius_m or 0.0
    rings = max(1, math.ceil(radius / spacing_m - ROUND_OFF))
    places, areas = [], []
    for ring in range(rings):
        # With six cells in the first ring, length and width of cells are about equal
        count = round(2.0 * math.pi * (ring + 0.5)) if ring else 6
        r = radius * np.sqrt((1.0 - inner) * (ring / rings) ** 2 + inner * ((ring + 1.0) / rings) ** 2)
        angle = 2.0 * math.pi * (np.arange(count)[:, None] + inner) / count
        x, y = (r[None, :, None] * part[:, None, :] for part in (np.cos(angle), np.sin(angle)))
        places.append(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
        areas.append(np.full(count, math.pi * radius**2 * ((ring + 1.0) ** 2 - ring**2) / rings**2 / count))
    return np.concatenate(places), np.concatenate(areas), PARTS**2
