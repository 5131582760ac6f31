"""Closest points of triangles against trimesh, which gives the same bits but takes long to import."""

import numpy as np
from trimesh.triangles import closest_point, points_to_barycentric

from palmfield.hand.triangles import closest_on_each, in_triangles


def test_closest_points_and_their_weights_have_the_bits_of_trimesh():
    rng = np.random.default_rng(3)
    triangles = rng.normal(size=(4000, 3, 3))
    points = rng.normal(size=(4000, 3)) * rng.choice([0.1, 1.0, 5.0], size=(4000, 1))
    points[:400], points[400:800] = triangles[:400, 1], triangles[400:800, 1:].mean(axis=1)  # on corners and edges
    points[800:1200] = triangles[800:1200].mean(axis=1)
    closest = closest_on_each(triangles, points)
    np.testing.assert_array_equal(closest, closest_point(triangles, points))
    weights = in_triangles(triangles, closest)
    np.testing.assert_array_equal(weights, points_to_barycentric(triangles, closest)[:, 1:])
    inside = (weights.min(axis=1) > 1e-6) & (weights.sum(axis=1) < 1.0 - 1e-6)
    assert 500 < inside.sum() < 3000  # all cases are there
