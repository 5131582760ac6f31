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
    """Matrices between the wedges, which define loads and operators, and the face of a stepper with its own mesh.

    system: system of the wedges. points: nodes of the other face [m], shape (f, 3).
    weights: from motion at the nodes of the other face to motion at the surface nodes of the wedges, csr, (S, f).
    pressure: from pressure at the quadrature points of the layer to pressure at the nodes of the other face, csr,
        (f, q); it evaluates the quadratic polynomial through the six points of each triangle.
    motion: from displacement of the nodes of the other face to unknowns of the wedges, csr, (ndof, 3 f); 0 below it.
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
        """Convert an operator (m, ndof) on the wedges to a Reader of the nodes of the other face.

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
    """Return displacement and velocity, (s, 2, m), from the motion of the nodes of the other face, (s, 2, f, 3)."""
    flat = motion.reshape(2 * len(motion), -1)
    return np.ascontiguousarray((reader.matrix @ flat.T).T).reshape(len(motion), 2, reader.count)


def ends_of_substeps(pressure: sparse.csr_matrix, patterns: Float, first: Float, last: Float) -> Float:
    """Return the pressure at the nodes of a face at start and end of each substep, alternating, shape (2 s, f).

    pressure: as in FaceTransfer; patterns: at the quadrature points [Pa], (k, q); first, last: weights, (s, k)
    """
    weights = np.stack([first, last], axis=1).reshape(2 * len(first), -1)
    there = np.ascontiguousarray((pressure @ np.asarray(patterns, dtype=np.float64).T).T)
    return weights @ there
