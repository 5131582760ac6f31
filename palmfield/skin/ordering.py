"""Elimination order of a layer: nested dissection of its surface."""

import numpy as np
from scipy import sparse

from palmfield.skin.assembly import SkinSystem
from palmfield.types import Float, Int


def dissection_order(system: SkinSystem, leaf: int = 12) -> Int:
    """Permutation of the free degrees of freedom, shape (n,): old index by new place.

    The layer is thin, so its surface alone is dissected (George 1973), all degrees of freedom under one surface node
    staying together. Separators are cut at the median along the longer principal direction of the nodes' positions.
    """
    mesh = system.mesh
    triangles = mesh.surface_triangles6
    rows, columns = np.repeat(triangles, 6, axis=1).ravel(), np.tile(triangles, (1, 6)).ravel()
    size = mesh.surface_nodes
    graph = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    order = _dissect(graph, mesh.nodes[:size], np.arange(size, dtype=np.int32), leaf)
    place = np.empty(size, dtype=np.int64)
    place[order] = np.arange(size)
    return np.argsort(place[system.surface_node], kind="stable").astype(np.int32)


def _dissect(graph: sparse.csr_matrix, points: Float, nodes: Int, leaf: int) -> Int:
    if len(nodes) <= leaf:
        return nodes
    centred = points[nodes] - points[nodes].mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    along = centred @ axes[:, -1]
    far = along > np.median(along)
    touches = np.zeros(graph.shape[0])
    touches[nodes[far]] = 1.0
    separator = ~far & (graph[nodes] @ touches > 0.0)
    near = ~far & ~separator
    if not near.any() or not far.any():
        return nodes
    parts = [_dissect(graph, points, nodes[part], leaf) for part in (near, far)]
    return np.concatenate([*parts, nodes[separator]])
