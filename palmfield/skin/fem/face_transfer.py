"""Transfer between the wedges of a layer and the same face on another mesh: pressure to that mesh, and motion back."""

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.mesh.element import triangle_rule, triangle_shape
from palmfield.skin.stepper import Reader, checked_operator
from palmfield.types import Float


class FaceTransfer:
    """Data on the wedges, which define loads and operators, for a stepper on its own mesh.

    system: system of the wedges. points: nodes of the other face [m], shape (f, 3).
    weights: motion of the wedges' surface nodes by that of the nodes of the other face, csr, shape (S, f).
    pressure: pressure at the nodes of the other face [Pa] by pressure at the quadrature points of the layer, csr, shape
        (f, q): the quadratic polynomial through the six points of each triangle.
    motion: unknowns of the wedges by displacement of the nodes of the other face, csr, shape (ndof, 3 f); 0 below the
    face.
    """

    def __init__(self, system: SkinSystem, points: Float, weights: sparse.csr_matrix) -> None:
        mesh, nodes = system.mesh, 3 * system.mesh.surface_nodes
        place = SurfaceProbe(mesh, points, system)
        rule, _ = triangle_rule()
        values = triangle_shape(place.local) @ np.linalg.inv(triangle_shape(rule))
        rows = np.repeat(np.arange(len(points)), len(rule))
        columns = (len(rule) * place.triangles[:, None] + np.arange(len(rule))).ravel()
        count = len(rule) * len(mesh.surface_triangles6)
        self.pressure = sparse.csr_matrix((values.ravel(), (rows, columns)), shape=(len(points), count))
        # The columns of the map are orthonormal, so its transpose gives the unknowns of nodal displacements
        unknowns = sparse.csr_matrix(system.dof_map.T)
        self.motion = sparse.csr_matrix(unknowns[:, :nodes] @ sparse.kron(weights, sparse.identity(3), format="csr"))
        self._below = unknowns[:, nodes:]

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """Read displacement and velocity of the nodes of the other face as an operator (m, ndof) on the wedges would.

        Raises SceneError for another number of columns and for an operator that reads below the surface.
        """
        matrix = checked_operator(operator, len(self.motion.indptr) - 1)
        below = np.abs((matrix @ self._below).data).max(initial=0.0)
        if below > 1e-9 * np.abs(matrix.data).max(initial=0.0):
            raise SceneError(
                f"skin reader: the operator reads below the surface of the skin, with weights up to {below:.3g}; a "
                "solver with its own mesh gives only the motion of the surface: use solver 'wedges'"
            )
        return Reader(matrix.shape[0], sparse.csr_matrix(matrix @ self.motion))


def read(motion: Float, reader: Reader) -> Float:
    """Displacement and velocity, shape (s, 2, m), by those of the nodes of the other face, shape (s, 2, f, 3)."""
    flat = motion.reshape(2 * len(motion), -1)
    return np.ascontiguousarray((reader.matrix @ flat.T).T).reshape(len(motion), 2, reader.count)


def ends_of_substeps(pressure: sparse.csr_matrix, patterns: Float, first: Float, last: Float) -> Float:
    """Return the pressure at the nodes of a face at both ends of each substep, shape (2 s, f), start and end in turn.

    pressure: pressure of FaceTransfer, (f, q); patterns: patterns at the quadrature points [Pa], (k, q); first, last:
    weights, (s, k)
    """
    weights = np.stack([first, last], axis=1).reshape(2 * len(first), -1)
    there = np.ascontiguousarray((pressure @ np.asarray(patterns, dtype=np.float64).T).T)
    return weights @ there
