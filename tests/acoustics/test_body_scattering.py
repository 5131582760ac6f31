"""Shadows by rays against plane geometry while the bodies move, and the scattered field on a rigid sphere."""

import numpy as np
import pytest
from rigid_sphere import geodesic
from shadow_rays import lit

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.body_scattering import RigidScatteredField, boundary_mesh
from palmfield.acoustics.occlusion import Occlusion
from palmfield.acoustics.scattering import wall_arp
from palmfield.acoustics.shadow import shadow_mesh
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Surface

RADIUS = 0.02
UP = np.array([[0.0, 0.0, 3.0]])


def plane_points(count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-0.05, 0.05, (count, 2)), np.zeros(count)])


def in_shadow_of(centre: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether points lie in a ball's shadow of sound along z, and where that is clear of the facets' rim."""
    radius = np.hypot(*(points - centre)[:, :2].T)
    return radius < RADIUS, np.abs(radius - RADIUS) > 3e-4


def test_the_shadow_moves_with_the_body() -> None:
    vertices, faces = geodesic(RADIUS, 20)
    points = plane_points()
    occlusion = Occlusion(vertices - [0.0, 0.0, 0.06], faces, "cpu")
    flux = np.repeat(UP, len(points), axis=0)
    for x in (0.0, 0.02, -0.03):
        centre = np.array([x, 0.01, -0.06])
        occlusion.move(vertices + centre)
        dark, clear = in_shadow_of(centre, points)
        np.testing.assert_array_equal(~occlusion.lit(points, flux)[clear], dark[clear])


def test_reach_ends_before_the_body_and_no_flux_is_dark() -> None:
    vertices, faces = geodesic(RADIUS, 8)
    occlusion = Occlusion(vertices - [0.0, 0.0, 0.06], faces, "cpu")
    points = np.zeros((3, 3))
    flux = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    lit = occlusion.lit(points, flux, np.array([0.03, 0.05, 0.03]))
    np.testing.assert_array_equal(lit, [True, False, False])


def test_bodies_that_begin_in_one_place_and_go_apart() -> None:
    vertices, faces = geodesic(RADIUS, 20)
    both = np.concatenate([vertices, vertices])
    occlusion = Occlusion(both, np.concatenate([faces, faces + len(vertices)]), "cpu", [len(vertices)] * 2)
    points = plane_points()
    flux = np.repeat(UP, len(points), axis=0)
    first, second = np.array([-0.03, 0.0, -0.06]), np.array([0.025, 0.0, -0.09])
    occlusion.move(np.concatenate([vertices + first, vertices + second]))
    dark, clear = (
        np.array(pair) for pair in zip(in_shadow_of(first, points), in_shadow_of(second, points), strict=True)
    )
    clear = clear.all(axis=0)
    np.testing.assert_array_equal(~occlusion.lit(points, flux)[clear], dark.any(axis=0)[clear])


def test_equals_the_rays_of_shadow_whatever_the_threads() -> None:
    vertices, faces = geodesic(RADIUS, 20)
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.03, 0.03, (3000, 3))
    flux = rng.normal(size=(3000, 3)) * 10.0 ** rng.uniform(-20, 9, (3000, 1))
    reach = rng.uniform(0.0, 0.05, 3000)
    expected = lit(points, flux, shadow_mesh(Surface(vertices, faces, vertices), "cpu"), reach_m=reach)
    assert 0.1 < expected.mean() < 0.9
    for threads in (1, 3):
        occlusion = Occlusion(vertices, faces, "cpu", threads=threads)
        for _ in range(2):
            got = occlusion.lit(points, flux, reach)
            assert got.dtype == np.bool_ and (got != expected).sum() <= 2  # rays along an edge
        assert (occlusion.lit(points[:400], flux[:400], reach[:400]) == got[:400]).all()


def test_bad_rays_are_named() -> None:
    occlusion = Occlusion(*geodesic(RADIUS, 2), "cpu")
    points, flux = np.zeros((4, 3)), np.ones((4, 3))
    with pytest.raises(PalmfieldError, match=r"points \(4, 3\) and flux \(3, 3\)"):
        occlusion.lit(points, flux[:3])
    flux[2, 1] = np.nan
    with pytest.raises(PalmfieldError, match=r"flux\[2\] is not finite"):
        occlusion.lit(points, flux)
    assert occlusion.lit(points[:0], flux[:0]).shape == (0,)


def test_a_device_that_is_not_there() -> None:
    with pytest.raises(PalmfieldError, match="cuda:99"):
        Occlusion(*geodesic(RADIUS, 2), "cuda:99")


def test_boundary_mesh_has_short_edges_and_no_double_vertices() -> None:
    vertices, faces = boundary_mesh(*geodesic(RADIUS, 2), 8.6e-3)
    corners = vertices[faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 8.6e-3 / 6.0 + 1e-12
    assert len(np.unique(vertices, axis=0)) == len(vertices) == len(faces) // 2 + 2


def test_the_scattered_field_is_read_at_the_nearest_face() -> None:
    air = Air()
    wavenumber = 2.0 * np.pi * 40e3 / sound_speed(air)
    mesh = geodesic(0.004, 4)
    field = RigidScatteredField.of(mesh, lambda x: 100.0 * np.exp(1j * wavenumber * x[:, 2]), wavenumber, air, "cpu")
    solution = field.solution
    sound = field.at(solution.centroids)
    np.testing.assert_allclose(sound.arp, wall_arp(solution, air), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(sound.amplitude, np.abs(solution.pressure), rtol=1e-6)
    assert sound.flux is None
    # Between centroids the pressure goes on along the face
    step = 1e-5 * np.cross(solution.normals, [1.0, 0.0, 0.0])
    near = field.at(solution.centroids + step).amplitude
    expected = np.abs(solution.pressure + np.einsum("ij,ij->i", step, solution.gradient))
    np.testing.assert_allclose(near, expected, rtol=1e-5)
