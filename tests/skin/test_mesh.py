import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.element import corner_slopes, displacement_shape, prism_rule
from palmfield.skin.mesh.wedges import extrude


def volume(mesh):
    points, rule = prism_rule()
    corners = mesh.nodes[mesh.elements[:, [0, 1, 2, 12, 13, 14]]]
    return np.linalg.det(np.einsum("mai,qaj->mqij", corners, corner_slopes(points))) @ rule


def dome(patch, radius):
    """The disc bent into a cap of a sphere, pressed from all sides: inward directions meet at its centre."""
    flat = patch.vertices
    z = np.sqrt(radius**2 - (flat[:, :2] ** 2).sum(axis=1))
    vertices = np.column_stack([flat[:, :2], z - radius])
    outward = np.column_stack([flat[:, :2], z]) / radius
    return dataclasses.replace(patch, vertices=vertices, inward=-outward)


@settings(max_examples=25, deadline=None)
@given(radius=st.floats(0.01, 0.1), fine=st.floats(0.05, 0.2), growth=st.floats(1.0, 3.0), share=st.floats(0.1, 1.0))
def test_disc_is_sound(radius, fine, growth, share):
    edge = fine * radius
    patch = disc_patch(radius, 0.01, edge, growth * edge, share * radius)
    a, b, c = (patch.vertices[patch.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    assert np.all(normal[:, 2] > 0.0)
    area = 0.5 * normal[:, 2].sum()
    rim = int(patch.rim.sum())
    assert area == pytest.approx(0.5 * rim * radius**2 * np.sin(2 * np.pi / rim), rel=1e-9)
    longest = np.maximum.reduce([np.linalg.norm(x, axis=1) for x in (b - a, c - b, a - c)])
    assert np.min(normal[:, 2] / longest**2) > 0.2


def test_disc_edges_follow_the_request():
    patch = disc_patch(0.06, 0.02, 0.003, 0.009, 0.012)
    middle = patch.vertices[patch.faces].mean(axis=1)
    a, b, c = (patch.vertices[patch.faces[:, i]] for i in range(3))
    edge = np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1) * 2 / np.sqrt(3))
    r = np.linalg.norm(middle, axis=1)
    assert np.mean(edge[r < 0.010]) == pytest.approx(0.003, rel=0.1)
    assert np.mean(edge[r > 0.052]) == pytest.approx(0.0085, rel=0.15)


def test_shape_functions():
    points = np.random.default_rng(1).uniform(0.0, 0.5, (20, 3))
    values, slopes = displacement_shape(points)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-14)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        difference = (displacement_shape(points + step)[0] - displacement_shape(points - step)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, :, axis], difference, atol=1e-8)


def test_node_numbers_go_by_level():
    patch = disc_patch(0.02, 0.01, 0.01, 0.01, 0.01)
    mesh = extrude(patch, np.array([0.0, 0.3, 1.0]))
    assert mesh.levels == 5
    assert len(mesh.nodes) == 5 * mesh.surface_nodes
    depths = mesh.nodes[:, 2].reshape(5, -1)
    np.testing.assert_allclose(depths, np.broadcast_to([[0], [-0.0015], [-0.003], [-0.0065], [-0.01]], depths.shape))
    np.testing.assert_array_equal(mesh.nodes[: len(patch.vertices)], patch.vertices)
    a, b, c = (patch.vertices[patch.faces[:, i]] for i in range(3))
    area = 0.5 * np.cross(b - a, c - a)[:, 2].sum()
    assert volume(mesh).sum() == pytest.approx(0.01 * area)
    # Edge nodes lie in the middle of their ends, and a side node's normal points away from the axis.
    corner, edge = mesh.surface_triangles6[:, :3], mesh.surface_triangles6[:, 3:]
    ends = mesh.nodes[corner[:, [[0, 1], [1, 2], [2, 0]]]].mean(axis=2)
    np.testing.assert_allclose(mesh.nodes[edge], ends, atol=1e-15)
    outward = mesh.nodes[mesh.side] * [1, 1, 0]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh.side_normals, outward, atol=1e-12)


def test_volume_of_a_curved_shell_of_varying_depth():
    """A cap of a sphere between two radii, against its exact volume, with the error falling with the square of h."""
    radius, depth, rim = 0.05, 0.01, 0.03
    height = radius - np.sqrt(radius**2 - rim**2)
    share = height / (2 * radius)
    exact = share * 4 / 3 * np.pi * (radius**3 - (radius - depth) ** 3)
    errors = []
    for h in (0.008, 0.004, 0.002):
        mesh = extrude(dome(disc_patch(rim, depth, h, h, rim), radius), np.array([0.0, 0.4, 1.0]))
        errors.append(abs(volume(mesh).sum() / exact - 1))
    assert errors[2] < 0.005
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(2.0, abs=0.4)


def test_depth_varies_by_vertex():
    patch = disc_patch(0.02, 0.01, 0.005, 0.005, 0.02)
    patch = dataclasses.replace(patch, depth=0.01 + 0.2 * patch.vertices[:, 0])
    mesh = extrude(patch, np.array([0.0, 0.5, 1.0]))
    base = mesh.nodes[mesh.base]
    np.testing.assert_allclose(base[:, 2], -(0.01 + 0.2 * base[:, 0]), atol=1e-15)


@pytest.mark.parametrize("fractions", [[0.0], [0.0, 0.5], [0.1, 1.0], [0.0, 0.6, 0.6, 1.0], [0.0, np.nan, 1.0]])
def test_bad_fractions(fractions):
    with pytest.raises(SceneError, match="rise from 0 to 1"):
        extrude(disc_patch(0.02, 0.01, 0.01, 0.01, 0.01), np.array(fractions))


def test_inverted_element_is_an_error_with_its_place():
    patch = dome(disc_patch(0.03, 0.04, 0.01, 0.01, 0.03), 0.035)
    with pytest.raises(SceneError, match=r"near \(.*\) m is flat or inverted"):
        extrude(patch, np.array([0.0, 0.5, 1.0]))


def test_turned_faces_and_zero_depth_are_errors():
    patch = disc_patch(0.02, 0.01, 0.01, 0.01, 0.01)
    for bad in (
        dataclasses.replace(patch, faces=patch.faces[:, ::-1]),
        dataclasses.replace(patch, depth=np.zeros_like(patch.depth)),
    ):
        with pytest.raises(SceneError, match="flat or inverted"):
            extrude(bad, np.array([0.0, 1.0]))


def test_bad_disc():
    with pytest.raises(SceneError, match="fine <= coarse"):
        disc_patch(0.06, 0.02, 0.01, 0.005, 0.01)


def test_a_disc_is_fine_round_a_place_beside_its_centre():
    """Edges near the place are as asked, at the rim coarser; the rim is a circle, and the area is the disc's."""
    fine, place = 0.004, np.array([0.025, -0.01])
    patch = disc_patch(0.06, 0.02, fine, 0.012, 0.01, (0.025, -0.01))
    corners = patch.vertices[patch.faces][:, :, :2]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    away = np.linalg.norm(corners.mean(axis=1) - place, axis=1)
    assert edges[away < 0.008].mean() == pytest.approx(fine, rel=0.25)
    assert edges[away > 0.05].mean() > 2.0 * fine
    assert np.allclose(np.linalg.norm(patch.vertices[patch.rim], axis=1), 0.06)
    (ax, ay), (bx, by) = ((corners[:, i] - corners[:, 0]).T for i in (1, 2))
    twice = ax * by - ay * bx
    assert twice.min() > 0.0 and 0.5 * twice.sum() == pytest.approx(np.pi * 0.06**2, rel=0.02)
    # Fewer than as many as a disc that is fine all the way out there
    assert len(patch.faces) < 0.7 * len(disc_patch(0.06, 0.02, fine, 0.012, 0.01 + 0.027).faces)
