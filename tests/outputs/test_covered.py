"""A body that is drawn under its skin: nothing of it shows, nothing of it is missing."""

import numpy as np
import pytest
import trimesh

from palmfield.outputs.covered import SUNK_M, under


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(4, radius=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_a_covered_body_lies_below_its_skin_and_meets_it_at_the_rim(ball: trimesh.Trimesh, seed: int) -> None:
    turned = trimesh.creation.icosphere(3, radius=0.03)
    turned.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)))
    cap = turned.submesh([np.flatnonzero(turned.triangles_center[:, 2] > 0.01)], append=True)
    found = under(np.asarray(ball.vertices), [(cap.vertices, cap.faces, cap.vertex_normals)])
    moved = ball.vertices.copy()
    moved[found.vertex] -= found.depth_m[:, None] * cap.vertex_normals[found.node]
    # A ray from the middle meets the body before the skin, wherever both are
    directions = ball.vertices[found.vertex] / 0.03
    to_skin = _radius(cap, directions)
    over = np.isfinite(to_skin)
    assert over.mean() > 0.95
    assert (to_skin - np.linalg.norm(moved[found.vertex], axis=1))[over].min() > 0.0
    assert found.depth_m.max() < 1.3 * SUNK_M
    # Far inside it is as deep as the skin's largest push; beside the skin nothing has moved
    middle = ball.vertices[found.vertex, 2] > 0.028
    np.testing.assert_array_less(0.9 * SUNK_M, found.depth_m[middle])
    beside = np.setdiff1d(np.arange(len(ball.vertices)), found.vertex)
    assert (ball.vertices[beside, 2] < 0.016).all()
    assert trimesh.Trimesh(moved, ball.faces).is_watertight


def test_skins_share_what_they_both_cover(ball: trimesh.Trimesh) -> None:
    half = ball.submesh([np.flatnonzero(ball.triangles_center[:, 2] > 0.0)], append=True)
    shape = half.vertices, half.faces, half.vertex_normals
    found = under(np.asarray(ball.vertices), [shape, shape])
    assert (found.skin == 0).all() and len(np.unique(found.vertex)) == len(found.vertex) > 0
    assert len(under(np.asarray(ball.vertices), []).vertex) == 0


def _radius(mesh: trimesh.Trimesh, directions: np.ndarray) -> np.ndarray:
    """How far from the origin unit directions, (n, 3), meet a mesh; inf where they don't."""
    # A direction is a sum of a triangle's corners with weights that are none below 0; their sum is 1 over the distance
    weights = np.linalg.solve(mesh.triangles.transpose(0, 2, 1)[None], directions[:, None, :, None])[..., 0]
    inside = (weights >= -1e-9).all(axis=2)
    return np.where(inside, 1.0 / np.where(inside, weights.sum(axis=2), 1.0), np.inf).min(axis=1)
