"""Elimination order of a layer, and its cells: nested dissection of its surface."""

import numpy as np
from scipy import sparse

from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int


def surface_graph(mesh: WedgeMesh) -> sparse.csr_matrix:
    """Which surface nodes share a triangle, shape (S, S)."""
    triangles = mesh.surface_triangles6
    rows, columns = np.repeat(triangles, 6, axis=1).ravel(), np.tile(triangles, (1, 6)).ravel()
    size = mesh.surface_nodes
    return sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size))


def dissection_order(system: SkinSystem, leaf: int = 12) -> Int:
    """Permutation of the free degrees of freedom, shape (n,): old index by new place.

    The layer is thin, so its surface alone is dissected (George 1973), all degrees of freedom under one surface node
    staying together. Separators are cut at the median along the longer principal direction of the nodes' positions.
    """
    mesh = system.mesh
    size = mesh.surface_nodes
    order = _dissect(surface_graph(mesh), mesh.nodes[:size], np.arange(size, dtype=np.int32), leaf)
    place = np.empty(size, dtype=np.int64)
    place[order] = np.arange(size)
    return np.argsort(place[system.surface_node], kind="stable").astype(np.int32)


def surface_cells(mesh: WedgeMesh, largest: int, overlap: int) -> list[Int]:
    """Cells of at most `largest` surface nodes that cover the surface, each grown by `overlap` rings of neighbours."""
    graph = surface_graph(mesh)
    points = mesh.nodes[: mesh.surface_nodes]
    pending, cells = [np.arange(mesh.surface_nodes, dtype=np.int32)], []
    while pending:
        nodes = pending.pop()
        if len(nodes) <= largest:
            inside = np.zeros(mesh.surface_nodes)
            inside[nodes] = 1.0
            for _ in range(overlap):
                inside = (graph @ inside > 0.0).astype(float)
            cells.append(np.flatnonzero(inside).astype(np.int32))
            continue
        order = np.argsort(_along(points[nodes]), kind="stable")
        half = len(nodes) // 2
        pending += [nodes[order[half:]], nodes[order[:half]]]
    return cells


def _along(points: Float) -> Float:
    """Place of each point along their longer principal direction."""
    centred = points - points.mean(axis=0)
    return centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]


def _dissect(graph: sparse.csr_matrix, points: Float, nodes: Int, leaf: int) -> Int:
    if len(nodes) <= leaf:
        return nodes
    along = _along(points[nodes])
    far = along > np.median(along)
    touches = np.zeros(graph.shape[0])
    touches[nodes[far]] = 1.0
    separator = ~far & (graph[nodes] @ touches > 0.0)
    near = ~far & ~separator
    if not near.any() or not far.any():
        return nodes
    parts = [_dissect(graph, points, nodes[part], leaf) for part in (near, far)]
    return np.concatenate([*parts, nodes[separator]])
