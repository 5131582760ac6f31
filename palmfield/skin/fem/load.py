"""Quadrature points of the pressure on the skin, and the consistent nodal forces of a pressure."""

import math

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.hand.triangles import face_normals
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.mesh.element import triangle_rule, triangle_shape
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int, Patch

MOST_HALVINGS = 4
"""Largest number of quarterings of a triangle under the points of a traction."""


class SurfaceQuadrature:
    """Points of the pressure on the skin, and the operator from pressure to nodal forces.

    halvings: number of quarterings of each triangle. only: numbers of the covered triangles, by default all.
    points: positions [m], shape (q, 3); six in each quartered triangle (Dunavant, degree 4), triangle by triangle.
    normals: unit outward normals, shape (q, 3). weights: areas [m^2], shape (q,), which sum to the surface area.
    operator: csr, shape (n free degrees of freedom, q) [m^2]: force = operator @ inward normal pressure.
    """

    def __init__(self, mesh: WedgeMesh, system: SkinSystem, halvings: int = 0, only: Int | None = None) -> None:
        rule, rule_weights = quartered_rule(halvings)
        faces = mesh.surface_triangles6 if only is None else mesh.surface_triangles6[only]
        a, b, c = (mesh.nodes[faces[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)
        twice = np.linalg.norm(area, axis=1)
        x, y = rule[:, :1], rule[:, 1:]
        triangles = len(twice)
        self.points = (a[:, None] * (1 - x - y) + b[:, None] * x + c[:, None] * y).reshape(-1, 3)
        self.normals = np.repeat(area / twice[:, None], len(rule), axis=0)
        self.weights = np.outer(twice, rule_weights).ravel()
        shape = np.tile(triangle_shape(rule), (triangles, 1))
        nodes = np.repeat(faces, len(rule), axis=0)
        forces = -(shape * self.weights[:, None])[..., None] * self.normals[:, None, :]
        rows = 3 * nodes[..., None] + np.arange(3)
        columns = np.broadcast_to(np.arange(len(nodes))[:, None, None], rows.shape)
        nodal = sparse.coo_matrix(
            (forces.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * len(mesh.nodes), len(nodes))
        )
        self.operator = sparse.csr_matrix(system.dof_map.T @ nodal.tocsr())

    def assemble(self, traction_normal: Float) -> Float:
        """Return the consistent nodal forces [N] over free degrees of freedom, (n,), of inward pressures [Pa], (q,).

        Raises SceneError unless there is one pressure per point.
        """
        pressure = np.asarray(traction_normal, dtype=float)
        if pressure.shape != self.weights.shape:
            raise SceneError(
                f"pressure has shape {pressure.shape}; give one value at each of {len(self.weights)} points"
            )
        return self.operator @ pressure


def halvings_for(corners: Float, weights_m2: Float) -> int:
    """Return how often to quarter triangles, (t, 3, 3) [m], for a rule about as dense as points of these areas."""
    edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
    spacing = math.sqrt(float(np.median(weights_m2)))
    return int(np.clip(math.ceil(math.log2(max(0.5 * edge / spacing, 1.0))), 0, MOST_HALVINGS))


def quartered_rule(halvings: int) -> tuple[Float, Float]:
    """Return points (q, 2) and weights (q,) of the triangle rule in each of 4^halvings parts of the unit triangle."""
    points, weights = triangle_rule()
    for _ in range(halvings):
        parts = [0.5 * points + corner for corner in np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])]
        points, weights = np.concatenate([*parts, 0.5 - 0.5 * points]), np.tile(0.25 * weights, 4)
    return points, weights


def face_points(patch: Patch, halvings: int = 1) -> tuple[Float, Float]:
    """Return points of a patch and their areas, for a Traction on it: shapes (q, 3) [m] and (q,) [m2].

    They are the quadrature points of the triangles of the patch, each cut into 4^halvings. If the elements are these
    triangles, forces at the points are exactly the load. On other elements the pressure is linear between the points
    (`traction.sampled`).
    halvings: number of quarterings; wedges quarter the triangles once or twice.
    """
    points, weights = quartered_rule(halvings)
    corners = patch.vertices[patch.faces]
    shares = np.column_stack([1.0 - points.sum(axis=1), points])
    places = np.einsum("qc,fcd->fqd", shares, corners).reshape(-1, 3)
    areas = face_normals(patch.vertices, patch.faces)[1]
    return places, np.outer(areas, weights / weights.sum()).ravel()
