"""Faces that cross, against shapes whose crossings are known."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.hand.selfcross import crossings


def joined(*meshes):
    whole = trimesh.util.concatenate(meshes)
    return np.array(whole.vertices), np.array(whole.faces)


def test_a_ball_and_two_balls_apart_do_not_cross():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    assert len(crossings(np.array(ball.vertices), np.array(ball.faces))) == 0
    other = ball.copy()
    other.apply_translation([0.1001, 0.0, 0.0])
    assert len(crossings(*joined(ball, other))) == 0


@settings(max_examples=15, deadline=None)
@given(st.floats(0.01, 0.09), st.integers(0, 99))
def test_two_balls_cross_along_their_circle(apart, seed):
    """Every pair lies on the circle where the two meet, and the circle has no gap longer than two edges."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    other = ball.copy()
    other.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)))
    other.apply_translation([apart, 0.0, 0.0])
    vertices, faces = joined(ball, other)
    pairs = crossings(vertices, faces)
    assert ((pairs[:, 0] < len(ball.faces)) & (pairs[:, 1] >= len(ball.faces))).all()
    places = vertices[faces[pairs]].mean(axis=(1, 2))
    edge = ball.edges_unique_length.max()
    assert np.abs(places[:, 0] - 0.5 * apart).max() < edge
    radius = np.sqrt(0.05**2 - 0.25 * apart**2)
    angles = np.sort(np.arctan2(places[:, 2], places[:, 1]))
    assert radius * np.diff(np.append(angles, angles[0] + 2.0 * np.pi)).max() < 2.0 * edge


def test_two_faces_by_hand():
    flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    through = [[0.2, 0.2, -0.5], [0.2, 0.2, 0.5], [2.0, 2.0, 0.5]]
    beside = [[0.8, 0.8, -0.5], [0.8, 0.8, 0.5], [2.0, 2.0, 0.5]]
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert crossings(np.array(flat + through), faces).tolist() == [[0, 1]]
    assert len(crossings(np.array(flat + beside), faces)) == 0


def test_a_shared_corner_counts_only_where_the_faces_go_through_each_other():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, -0.5], [1.0, 1.0, 0.5]])
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    assert crossings(points, faces).tolist() == [[0, 1]]
    assert len(crossings(points * [1.0, 1.0, 1.0] + np.where(np.arange(5) >= 3, 1.0, 0.0)[:, None], faces)) == 0


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_finger_pushed_through_the_palm_is_found_at_any_size_and_place(scale):
    palm = trimesh.creation.box([0.08, 0.09, 0.02])
    finger = trimesh.creation.capsule(height=0.05, radius=0.008)
    vertices, faces = joined(palm.subdivide().subdivide(), finger)
    assert len(crossings(scale * (vertices + 5.0), faces)) > 10


def test_more_crossings_than_there_is_room_for_at_first():
    rng = np.random.default_rng(1)
    vertices = rng.random((3 * 300, 3))
    faces = np.arange(900).reshape(-1, 3)
    pairs = crossings(vertices, faces)
    assert len(pairs) > 1024
    assert len(np.unique(pairs, axis=0)) == len(pairs)
