"""A rigid sphere in a plane wave: the force on it, and meshes of it."""

import numpy as np
import trimesh
from scipy.special import eval_legendre

from palmfield.instruments.microphone import series_terms
from palmfield.types import Float, Int


def force_over_energy(ka: float) -> float:
    """Force along the wave over pi a^2 E, E = |p_i|^2/(2 rho c^2), |p_i| peak: wall pressure integrated exactly.

    The wall feels |p|^2/(4 rho c^2) - rho |u_t|^2/4; Gauss-Legendre points integrate the product of series.
    """
    n, terms = series_terms(ka)
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
