"""Sides that absorb waves: dashpots on the side faces, and a ring of graded damping outside the body.

The dashpots (Lysmer & Kuhlemeyer 1969) give a traction -rho c v in every direction. c is the shear speed at the given
frequency. The compression speed is usual along the normal of a side. But skin is nearly incompressible, and the waves
that leave a layer are guided waves near the shear speed. Error of the motion under the spot for c, 2 c and 4 c along
the normal: 1.9, 2.9, 7.8 % (palm preset, depth 12 mm, sides at 35 mm, 200 Hz; fixed sides: 21 %) and 2.4, 3.2, 6.3 %
(Ecoflex, 20 mm, 40 mm, 70 Hz; 13 %). The ring adds a force -rho sigma v. sigma grows as the square of the distance.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material, complex_shear
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int

SPONGE_DECAY = 14.0
"""sigma_max x width / c_s: a shear wave that crosses the ring and back falls by exp(-SPONGE_DECAY / 3) = 0.009."""


def match_speed(material: Material, f_Hz: float) -> float:
    """Return Re sqrt(G*(f) / rho) [m/s]: the resistance of a face to a plane shear wave over the density.

    Raises SceneError unless f_Hz > 0.
    """
    if not (math.isfinite(f_Hz) and f_Hz > 0.0):
        raise SceneError(f"absorbing sides: frequency is {f_Hz} Hz; give one above 0")
    return float(np.sqrt(complex_shear(material, f_Hz) / material.density_kg_m3).real)


def side_springs(mesh: WedgeMesh, material: Material, f_Hz: float) -> float:
    """Return the stiffness by damping of side faces held by the tissue around them [1/s]: G_r / R by area.

    R: mean distance of the rim from its middle. The traction of a point load on a half space, by its displacement, is
    about G / R at that distance; f_Hz: see side_dashpots
    """
    rim = mesh.nodes[np.unique(rim_edges(mesh))]
    radius = float(np.linalg.norm(rim - rim.mean(axis=0), axis=1).mean())
    return material.shear_relaxed_Pa / radius / (material.density_kg_m3 * match_speed(material, f_Hz))


def side_dashpots(mesh: WedgeMesh, rows: Sequence[Material], f_Hz: float) -> sparse.csr_matrix:
    """Return the damping [N s/m] of the side faces over all nodal components, csr, shape (3 nodes, 3 nodes).

    rows: material of each row of elements, from the surface down; f_Hz: frequency that the dashpots match [Hz], > 0
    """
    edges = rim_edges(mesh)
    line, rule = np.polynomial.legendre.leggauss(3)
    shape = np.column_stack([line * (line - 1) / 2, 1 - line**2, line * (line + 1) / 2])
    pair = np.column_stack([(1 - line) / 2, (1 + line) / 2])
    size = 3 * len(mesh.nodes)
    total = sparse.csr_matrix((size, size))
    for row, material in enumerate(rows):
        levels = (2 * row + np.arange(3)) * mesh.surface_nodes
        nodes = (levels[:, None] + edges[:, None, :]).reshape(len(edges), 9)
        near, far = mesh.nodes[nodes[:, [0, 2]]], mesh.nodes[nodes[:, [6, 8]]]
        # Bilinear faces: tangents at the quadrature points (depth p, edge q)
        along = 0.5 * (
            np.einsum("p,ec->epc", pair[:, 0], near[:, 1] - near[:, 0])
            + np.einsum("p,ec->epc", pair[:, 1], far[:, 1] - far[:, 0])
        )
        down = 0.5 * np.einsum("qs,esc->eqc", pair, far - near)
        area = np.cross(along[:, :, None], down[:, None, :])
        values = np.einsum("pi,qj->pqij", shape, shape).reshape(3, 3, 9)
        resistance = material.density_kg_m3 * match_speed(material, f_Hz)
        weights = resistance * np.linalg.norm(area, axis=3) * np.outer(rule, rule)
        blocks = np.einsum("epq,pqm,pqn,ab->emanb", weights, values, values, np.eye(3))
        total = total + scatter(nodes, blocks, size)
    return total


def rim_edges(mesh: WedgeMesh) -> Int:
    """Return the edges of the lateral boundary as surface nodes (start, middle, end), shape (e, 3)."""
    triangles = mesh.surface_triangles6
    edges = triangles[:, [[0, 3, 1], [1, 4, 2], [2, 5, 0]]].reshape(-1, 3)
    _, index, uses = np.unique(edges[:, 1], return_index=True, return_counts=True)
    return edges[index[uses == 1]]


def scatter(nodes: Int, blocks: Float, size: int) -> sparse.csr_matrix:
    """Return the sum of blocks (m, n, 3, n, 3) over the nodes (m, n) as a csr matrix of shape (size, size)."""
    width = 3 * nodes.shape[1]
    dofs = (3 * nodes[..., None] + np.arange(3)).reshape(len(nodes), width)
    rows, columns = np.repeat(dofs, width, axis=1).ravel(), np.tile(dofs, (1, width)).ravel()
    return sparse.coo_matrix((blocks.ravel(), (rows, columns)), shape=(size, size)).tocsr()


def sponge(mesh: WedgeMesh, depth_in_ring: Float, width_m: float, speed_m_s: float) -> Float:
    """Return the damping per mass of each column of elements [1/s], shape (triangles,), for a ring outside the body.

    depth_in_ring: distance of each surface vertex into the ring [m], 0 or below inside the body, shape (S,)
    width_m: width of the ring [m], > 0; speed_m_s: shear speed [m/s]
    """
    share = np.clip(depth_in_ring[mesh.surface_triangles6[:, :3]].mean(axis=1) / width_m, 0.0, 1.0)
    return SPONGE_DECAY * speed_m_s / width_m * share**2
