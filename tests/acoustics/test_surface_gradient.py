"""Gradient along surfaces against polynomials, which it must hit exactly, and waves."""

import numpy as np
from rigid_sphere import geodesic
from scipy.spatial import Delaunay

from palmfield.acoustics.scattering import surface_gradient
from palmfield.hand.triangles import face_normals


def test_cubic_on_a_tilted_uneven_plane_is_exact() -> None:
    flat = np.random.default_rng(4).uniform(-1.0, 1.0, (300, 2))
    faces = Delaunay(flat).simplices.astype(np.int32)
    tilt = np.linalg.qr(np.array([[1.0, 0.3, 0.1], [0.2, 1.0, -0.4], [0.5, 0.1, 1.0]]))[0]
    vertices = 1e-2 * np.column_stack([flat, np.zeros(300)]) @ tilt
    x, y = flat[faces].mean(axis=1).T
    values = (1 + 2j) + x - 3j * y + 2 * x * y - 1j * x**2 + 0.5 * x**3 - y**2 * x
    slope = np.stack([1 + 2 * y - 2j * x + 1.5 * x**2 - y**2, -3j + 2 * x - 2 * x * y, 0 * x], axis=1)
    got = surface_gradient(vertices, faces, values)
    np.testing.assert_allclose(got, 100 * slope @ tilt, atol=1e-3 * 100 * np.abs(slope).max())


def test_wave_over_a_sphere_at_eight_triangles_a_wavelength() -> None:
    vertices, faces = geodesic(1.0, 20)
    k = 2 * np.pi / (8 * 0.057)
    normals, areas = face_normals(vertices, faces)
    along = np.array([0.6, 0.0, 0.8])
    values = np.exp(1j * k * vertices[faces].mean(axis=1) @ along)
    slope = 1j * k * values[:, None] * (along - (normals @ along)[:, None] * normals)
    off = (np.abs(surface_gradient(vertices, faces, values) - slope) ** 2).sum(axis=1)
    assert np.sqrt(areas @ off / (areas @ (np.abs(slope) ** 2).sum(axis=1))) < 0.015
    assert np.abs(np.einsum("ij,ij->i", surface_gradient(vertices, faces, values), normals)).max() < 1e-9 * k
