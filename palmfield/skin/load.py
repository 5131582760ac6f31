"""Normal pressure on the skin, as consistent nodal forces."""

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.assembly import SkinSystem
from palmfield.skin.element import triangle_rule, triangle_shape
from palmfield.skin.wedges import WedgeMesh
from palmfield.types import Float


class SurfaceQuadrature:
    """Points at which the pressure on the skin is wanted, and the operator that makes nodal forces of it.

    points: positions [m], shape (q, 3); six a triangle (Dunavant, degree 4), triangle by triangle
    normals: unit outward normals, shape (q, 3); weights: areas [m^2], shape (q,), which sum to the surface's area
    operator: csr, shape (n free degrees of freedom, q) [m^2]: force = operator @ inward normal pressure
    """

    def __init__(self, mesh: WedgeMesh, system: SkinSystem) -> None:
        rule, rule_weights = triangle_rule()
        a, b, c = (mesh.nodes[mesh.surface_triangles6[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)
        twice = np.linalg.norm(area, axis=1)
        x, y = rule[:, :1], rule[:, 1:]
        triangles = len(twice)
        self.points = (a[:, None] * (1 - x - y) + b[:, None] * x + c[:, None] * y).reshape(-1, 3)
        self.normals = np.repeat(area / twice[:, None], len(rule), axis=0)
        self.weights = np.outer(twice, rule_weights).ravel()
        shape = np.tile(triangle_shape(rule), (triangles, 1))
        nodes = np.repeat(mesh.surface_triangles6, len(rule), axis=0)
        forces = -(shape * self.weights[:, None])[..., None] * self.normals[:, None, :]
        rows = 3 * nodes[..., None] + np.arange(3)
        columns = np.broadcast_to(np.arange(len(nodes))[:, None, None], rows.shape)
        nodal = sparse.coo_matrix(
            (forces.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * len(mesh.nodes), len(nodes))
        )
        self.operator = sparse.csr_matrix(system.dof_map.T @ nodal.tocsr())

    def assemble(self, traction_normal: Float) -> Float:
        """Consistent nodal forces [N] over the free degrees of freedom, shape (n,), of an inward pressure [Pa], (q,).

        Raises SceneError unless there is one pressure a point.
        """
        pressure = np.asarray(traction_normal, dtype=float)
        if pressure.shape != self.weights.shape:
            raise SceneError(
                f"pressure has shape {pressure.shape}; give one value at each of {len(self.weights)} points"
            )
        return self.operator @ pressure
