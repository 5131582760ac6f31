"""Motion of the skin surface, at its nodes and at given points, from the unknowns of a layer."""

import numpy as np
import scipy  # loads its parts at first use
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.hand.triangles import closest_on_each, in_triangles
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.mesh.element import triangle_shape
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int


class SurfaceProbe:
    """Reader of the displacement at points of the skin.

    points: positions [m], shape (n, 3); each is replaced by the closest point of the surface.
    closest: these closest points [m], (n, 3). triangles: their triangles, (n,). local: their xi and eta, (n, 2).
    distance: from point to closest point [m], (n,). normals: outward normals at the closest points, (n, 3).
    operator: csr, (n, free degrees of freedom); operator @ u is the displacement along the outward normal.
    vectors: csr, (3 n, free degrees of freedom); vectors @ u is the displacement, three components per point.
    Raises SceneError unless points is (n, 3) and finite.
    """

    def __init__(self, mesh: WedgeMesh, points: Float, system: SkinSystem) -> None:
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise SceneError(f"skin points have shape {points.shape}; give finite positions of shape (n, 3)")
        self.closest, self.normals, self.triangles, self.local = nearest_on_surface(mesh, points)
        self.distance = np.linalg.norm(points - self.closest, axis=1)
        nodes = mesh.surface_triangles6[self.triangles]
        shape = triangle_shape(self.local)
        rows = np.broadcast_to(np.arange(len(points))[:, None, None], (len(points), 6, 3))
        values = shape[..., None] * self.normals[:, None, :]
        nodal = sparse.coo_matrix(
            (values.ravel(), (rows.ravel(), (3 * nodes[..., None] + np.arange(3)).ravel())),
            shape=(len(points), 3 * len(mesh.nodes)),
        )
        self.operator = sparse.csr_matrix(nodal.tocsr() @ system.dof_map)
        shares = sparse.coo_matrix(
            (shape.ravel(), (np.repeat(np.arange(len(points)), 6), nodes.ravel())), shape=(len(points), len(mesh.nodes))
        )
        self.vectors = sparse.csr_matrix(sparse.kron(shares, sparse.identity(3)) @ system.dof_map)


def nearest_on_surface(mesh: WedgeMesh, points: Float) -> tuple[Float, Float, Int, Float]:
    """Return the closest points [m] on the surface of a mesh, (n, 3), and the outward normals there, (n, 3).

    Also returns their triangles, (n,), and their xi and eta, (n, 2). points: [m], shape (n, 3)
    """
    corners = mesh.nodes[mesh.surface_triangles6[:, :3]]
    triangles, closest = closest_on_triangles(corners, points)
    local = in_triangles(corners[triangles], closest)
    normals = np.einsum("pi,pic->pc", triangle_shape(local), mesh.surface_normals()[mesh.surface_triangles6[triangles]])
    return closest, normals / np.linalg.norm(normals, axis=1, keepdims=True), triangles, local


def closest_on_triangles(corners: Float, points: Float) -> tuple[Int, Float]:
    """Return the index of the closest triangle, (n,), and the closest point on this triangle, (n, 3)."""
    centroids = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centroids[:, None], axis=2).max()
    tree = scipy.spatial.cKDTree(centroids)
    nearest, _ = tree.query(points)
    # The nearest centroid is on the surface, so the centroid of the closest triangle is farther by at most `reach`.
    lists = tree.query_ball_point(points, nearest + reach)
    counts = np.array([len(result) for result in lists])
    candidates = np.concatenate([np.asarray(result, dtype=np.int64) for result in lists])
    owner = np.repeat(np.arange(len(points)), counts)
    spots = 1e-3 * closest_on_each(1e3 * corners[candidates], 1e3 * points[owner])
    order = np.lexsort((np.linalg.norm(spots - points[owner], axis=1), owner))
    first = order[np.concatenate(([0], np.cumsum(counts)[:-1]))]
    return candidates[first].astype(np.int32), spots[first]


def surface_motion(mesh: WedgeMesh, system: SkinSystem) -> sparse.csr_matrix:
    """Return the operator (S, free degrees of freedom) for the outward normal displacement at all S surface nodes."""
    count = mesh.surface_nodes
    rows = np.repeat(np.arange(count), 3)
    nodal = sparse.coo_matrix(
        (mesh.surface_normals().ravel(), (rows, np.arange(3 * count))), shape=(count, 3 * len(mesh.nodes))
    )
    return sparse.csr_matrix(nodal.tocsr() @ system.dof_map)


def surface_vectors(mesh: WedgeMesh, system: SkinSystem) -> sparse.csr_matrix:
    """Return the operator (3 S, free degrees of freedom) for the displacement (x, y, z) of all S surface nodes."""
    count = 3 * mesh.surface_nodes
    nodal = sparse.eye_array(count, 3 * len(mesh.nodes), format="csr")
    return sparse.csr_matrix(nodal @ system.dof_map)
