"""Resultants against plain sums and pressure on closed bodies; distances to boards against plane geometry."""

import numpy as np
import pytest
from rigid_sphere import geodesic

from palmfield.acoustics.arrays import from_poses, layout
from palmfield.acoustics.occlusion import distance_to_arrays
from palmfield.acoustics.phased_array import HOUSING_M, ArrayInstance, BoardOutline, PhasedArray
from palmfield.acoustics.shadow import REACH_m
from palmfield.acoustics.surface_load import CLEARANCE_M, Parts, pushes, resultants
from palmfield.config import ArrayConfig
from palmfield.hand.triangles import face_normals
from palmfield.transforms import IDENTITY, Placement, Transform

HERE = Placement.of(IDENTITY)


def test_resultants_are_the_sums_over_each_bodys_faces() -> None:
    rng = np.random.default_rng(0)
    count, bodies = 3000, 7
    arp, areas = rng.normal(size=count).astype(np.float32), rng.uniform(0.0, 1e-5, count)
    normals, points = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    origins, owners = rng.normal(size=(bodies, 3)), rng.integers(0, bodies - 1, count).astype(np.int32)
    forces, torques = resultants(arp, pushes(areas, normals, points), origins, Parts(owners, len(origins)))
    push = -(arp * areas)[:, None] * normals
    for body in range(bodies):
        own = owners == body
        np.testing.assert_allclose(forces[body], push[own].sum(axis=0), atol=1e-15)
        arms = points[own] - origins[body]
        np.testing.assert_allclose(torques[body], np.cross(arms, push[own]).sum(axis=0), atol=1e-15)
    assert not forces[-1].any() and not torques[-1].any()  # no face belongs to the last one
    again = resultants(arp, pushes(areas, normals, points), origins, Parts(owners, len(origins)))
    assert forces.tobytes() == again[0].tobytes() and torques.tobytes() == again[1].tobytes()


def test_no_faces_push_nothing() -> None:
    none = np.zeros((0, 3))
    forces, torques = resultants(
        np.zeros(0), pushes(np.zeros(0), none, none), np.ones((2, 3)), Parts(np.zeros(0, np.int32), 2)
    )
    np.testing.assert_array_equal(forces, np.zeros((2, 3)))
    np.testing.assert_array_equal(torques, np.zeros((2, 3)))


def test_even_pressure_on_a_closed_body_moves_nothing() -> None:
    vertices, faces = geodesic(0.02, 8)
    normals, areas = face_normals(vertices, faces)
    centroids = vertices[faces].mean(axis=1)
    one, origin = Parts(np.zeros(len(faces), np.int32), 1), np.array([[0.1, 0.0, 0.0]])
    forces, torques = resultants(np.ones(len(faces)), pushes(areas, normals, centroids), origin, one)
    assert np.abs(forces).max() < 1e-15 and np.abs(torques).max() < 1e-15
    half = (centroids[:, 2] < 0.0).astype(float)
    forces, _ = resultants(half, pushes(areas, normals, centroids), np.zeros((1, 3)), one)
    np.testing.assert_allclose(forces[0], [0.0, 0.0, np.pi * 0.02**2], rtol=0.02, atol=1e-12)


def test_distance_to_arrays_goes_back_along_the_sound() -> None:
    side = Placement.of(Transform(np.array([0.3, 0.0, 0.1]), np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])))
    instance = ArrayInstance(ArrayConfig(), HERE)
    one = PhasedArray([instance], [HERE], "cpu")
    both = PhasedArray([instance, instance], [HERE, side], "cpu")
    up, tilted = [0.0, 0.0, 5.0], [3.0, 0.0, 4.0]
    points = np.array([[0.0, 0.0, 0.2], [0.05, 0.0, 0.2], [0.0, 0.0, 0.2]])
    flux = np.array([up, tilted, [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(distance_to_arrays(points, flux, one), [0.2, 0.25, REACH_m], rtol=1e-12)
    # Sound along the second array's plane never meets it; sound from it meets the plane x = 0.3
    flux = np.array([[-1.0, 0.0, 0.0], [-3.0, 0.0, 4.0], [0.0, 0.0, 0.0]])
    expected = [REACH_m, max(0.25, 0.25 / 0.6), REACH_m]
    np.testing.assert_allclose(distance_to_arrays(points, flux, both), expected, rtol=1e-12)


def test_clearance() -> None:
    array = layout("uhev1")
    points = np.array([[0.0, 0.0, 0.03], [1.0, 0.0, -0.5]])
    assert BoardOutline.of(array).clearance(points) == pytest.approx(0.03 - array.positions[:, 2].mean())
    assert BoardOutline.of(array).clearance(points[1:]) == np.inf
    assert BoardOutline.of(array).clearance(points - [0.0, 0.0, 0.1]) < 0.0
    bowl = layout("two_bow_corrected")
    nearest = np.linalg.norm(bowl.positions - points[0], axis=1).min()
    assert BoardOutline.of(bowl).clearance(points[:1]) == pytest.approx(nearest - HOUSING_M)


def test_clearance_is_measured_from_the_board_wherever_it_lies() -> None:
    board = layout("uhev1")
    half = board.positions[:, 0].max() + HOUSING_M
    for offset in np.array([[0.0, 0.0, 0.0], [0.3, -0.1, 0.05]]):
        moved = from_poses("moved", board.positions + offset, board.normals)
        over, low, outside = offset + np.array([[0, 0, 0.03], [half - 1e-4, 0, -0.01], [half + 1e-4, 0, -0.01]])
        assert BoardOutline.of(moved).clearance(over[None]) == pytest.approx(0.03)
        assert BoardOutline.of(moved).clearance(low[None]) == pytest.approx(-0.01)
        assert BoardOutline.of(moved).clearance(outside[None]) == np.inf


def test_clearance_of_an_array_without_a_board_is_that_of_its_faces() -> None:
    # On edge: all transducers lie in one plane of constant z and look along x
    positions = np.array([[0.0, y, 0.0] for y in np.linspace(-0.05, 0.05, 11)])
    upright = from_poses("upright", positions, np.tile([1.0, 0.0, 0.0], (11, 1)))
    assert BoardOutline.of(upright).clearance(np.array([[0.03, 0.0, 0.0]])) == pytest.approx(0.03 - HOUSING_M)
    assert BoardOutline.of(upright).clearance(np.array([[0.006, 0.0, 0.0]])) < CLEARANCE_M
