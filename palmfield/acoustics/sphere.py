"""Rigid sphere in a plane wave: the exact solution against which scattering is held, and meshes of a sphere."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.special import eval_legendre, spherical_jn, spherical_yn

from palmfield.types import Complex, Float, Int


def _terms(ka: float) -> tuple[Int, Complex]:
    """Orders n and (2n + 1) i^n i/((ka)^2 h_n'(ka))."""
    n = np.arange(int(ka + 4.0 * ka ** (1.0 / 3.0) + 12.0), dtype=np.int32)
    slope = spherical_jn(n, ka, derivative=True) + 1j * spherical_yn(n, ka, derivative=True)
    return n, (2 * n + 1) * 1j**n * 1j / (ka**2 * slope)


def surface_pressure(ka: float, cosine: ArrayLike) -> Complex:
    """Total pressure on a rigid fixed sphere in the wave exp(ikz), e^{-iwt}; cosine: of the angle from +z.

    p = sum (2n+1) i^n P_n [j_n - j_n'/h_n' h_n](ka), by the Wronskian (2n+1) i^n P_n i/((ka)^2 h_n') (Morse & Ingard,
    Theoretical Acoustics, section 8.2).
    """
    n, terms = _terms(ka)
    return np.stack([eval_legendre(i, np.asarray(cosine, dtype=float)) for i in n], axis=-1) @ terms


def force_over_energy(ka: float) -> float:
    """Force along the wave over pi a^2 E, E = |p_i|^2/(2 rho c^2), |p_i| peak: wall pressure integrated exactly.

    The wall feels |p|^2/(4 rho c^2) - rho |u_t|^2/4; Gauss-Legendre points integrate the product of series.
    """
    n, terms = _terms(ka)
    cosine, weight = np.polynomial.legendre.leggauss(2 * len(n) + 2)
    legendre = np.stack([eval_legendre(i, cosine) for i in n], axis=-1)
    before = np.concatenate([np.zeros((len(cosine), 1)), legendre[:, :-1]], axis=1)
    # (1 - x^2) P_n' = n (P_{n-1} - x P_n), and |dp/dtheta|^2 = (1 - x^2) |dp/dx|^2
    slope = (n * (before - cosine[:, None] * legendre)) @ terms
    square = np.abs(legendre @ terms) ** 2 - np.abs(slope) ** 2 / (1.0 - cosine**2) / ka**2
    return float(-(weight * square * cosine).sum())


def geodesic(radius_m: float, divisions: int) -> tuple[Float, Int]:
    """Sphere of 20 divisions^2 triangles with the volume of the true one; vertices [m], shape (v, 3), and faces."""
    corners = trimesh.creation.icosahedron()
    ij = np.array([(i, j) for i in range(divisions + 1) for j in range(divisions + 1 - i)])
    number = {(int(i), int(j)): n for n, (i, j) in enumerate(ij)}
    small = []
    for i, j in number:
        if i + j < divisions:
            small.append((number[i, j], number[i + 1, j], number[i, j + 1]))
        if i + j < divisions - 1:
            small.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    share = np.column_stack([divisions - ij.sum(axis=1), ij]) / divisions
    points = np.concatenate([share @ corners.vertices[face] for face in corners.faces])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = np.concatenate([np.array(small) + k * len(ij) for k in range(len(corners.faces))])
    mesh = trimesh.Trimesh(points, faces, process=False)
    mesh.merge_vertices(digits_vertex=8)
    scale = radius_m * (4.0 / 3.0 * np.pi / mesh.volume) ** (1.0 / 3.0)
    return scale * np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)
