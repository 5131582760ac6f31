"""Motion at points below the skin surface, from the unknowns of a layer."""

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.mesh.element import CORNERS, barycentric, corner_slopes, displacement_shape, triangle_shape
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int


def below_surface(
    mesh: WedgeMesh, system: SkinSystem, triangles: Int, local: Float, depth_m: float
) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Return the operators to displacement inwards and compression, along the normal at points below the surface.

    triangles: triangles of the surface above the points, (n,); local: xi and eta there, (n, 2). depth_m: depth below
    the surface along its normal [m]. Both operators are csr, shape (n, free degrees of freedom).
    Raises SceneError for a layer that is not deeper than this at one of the points.
    """
    columns = mesh.nodes.reshape(mesh.levels, mesh.surface_nodes, 3)[::2, mesh.surface_triangles6[triangles, :3]]
    line = np.einsum("pi,lpic->plc", barycentric(local), columns)
    normals = np.einsum("pi,pic->pc", triangle_shape(local), mesh.surface_normals()[mesh.surface_triangles6[triangles]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    depths = np.einsum("plc,pc->pl", line[:, :1] - line, normals)
    if not (thinnest := float(depths[:, -1].min(initial=np.inf))) > depth_m:
        raise SceneError(
            f"a point {1e3 * depth_m:g} mm below the skin lies outside the layer, which is {1e3 * thinnest:.3g} mm deep"
        )
    row = (depths[:, 1:] <= depth_m).sum(axis=1)
    above, below = (np.take_along_axis(depths, (row + n)[:, None], axis=1)[:, 0] for n in (0, 1))
    points = np.column_stack([local, 1.0 - 2.0 * (depth_m - above) / (below - above)])
    elements = mesh.elements[row * len(mesh.surface_triangles6) + triangles]
    values, slopes = displacement_shape(points)
    jacobian = np.einsum("pai,paj->pij", mesh.nodes[elements[:, CORNERS]], corner_slopes(points))
    gradients = np.einsum("pad,pdi->pai", slopes, np.linalg.inv(jacobian))
    along = np.einsum("pai,pi->pa", gradients, normals)
    columns_of = (3 * elements[..., None] + np.arange(3)).ravel()
    rows = np.repeat(np.arange(len(points)), 54)
    operators = []
    for factors in (values, along):
        entries = -(factors[..., None] * normals[:, None]).ravel()
        nodal = sparse.coo_matrix((entries, (rows, columns_of)), shape=(len(points), 3 * len(mesh.nodes)))
        operators.append(sparse.csr_matrix(nodal.tocsr() @ system.dof_map))
    return operators[0], operators[1]
