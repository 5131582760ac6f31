"""Elimination order of a layer: nested dissection of its surface (George 1973).

The table has stored values in both factors and ms per solve of SuperLU, on one core of the 2-core machine. Layers:
follow_fingertip, two_hands, hover_explore, phantom_am200, palm_am200. MMD and COLAMD are orders of SuperLU; "median"
cuts at the median node. "This" order is used for every layer: if another has less fill, it saves a few per cent of a
small factor.

| unknowns | median | MMD_AT_PLUS_A | COLAMD | this |
|---|---|---|---|---|
| 1,512 | 0.53 M, 0.37 ms | 0.36 M, 0.24 ms | 0.35 M, 0.18 ms | 0.36 M, 0.29 ms |
| 2,760 | 1.43 M, 0.78 ms | 1.18 M, 0.72 ms | 1.05 M, 0.59 ms | 0.89 M, 0.49 ms |
| 7,272 | 5.4 M, 5.0 ms | 5.3 M, 7.4 ms | 4.4 M, 4.6 ms | 3.2 M, 3.3 ms |
| 13,404 | 12.6 M, 15 ms | 10.0 M, 10 ms | 13.3 M, 13 ms | 6.9 M, 8.0 ms |
| 28,272 | 44.8 M, 49 ms | 39.9 M, 55 ms | - | 28 M, 34 ms |
"""

import numpy as np

from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int

DIRECTIONS = 4
"""Number of trial directions of the cut through a piece."""
PLACES = (0.42, 0.46, 0.5, 0.54, 0.58)
"""Trial shares of the triangles of a piece on the first side of the cut."""
SMALLEST = 3
"""Largest number of nodes of a piece that is not cut further."""


def dissection_order(mesh: WedgeMesh, surface_node: Int) -> Int:
    """Return the permutation of unknowns, shape (n,): old index at each new place.

    surface_node: surface node above each unknown, shape (n,)
    The layer is thin, so only its surface is dissected; all unknowns under one surface node stay together. A piece is
    a set of triangles. Several cuts through a piece are tried. The cut with the fewest nodes that belong to both sides
    is used, because these nodes separate the two halves. Nodes without unknowns do not count.
    """
    free = np.zeros(mesh.surface_nodes, dtype=bool)
    free[surface_node] = True
    triangles = mesh.surface_triangles6
    middles = mesh.nodes[triangles[:, :3]].mean(axis=1)
    pieces = _dissect(triangles, middles, np.arange(len(triangles), dtype=np.int32), free)
    place = np.zeros(mesh.surface_nodes, dtype=np.int64)
    order = np.concatenate(pieces)
    place[order] = np.arange(len(order))
    return np.argsort(place[surface_node], kind="stable").astype(np.int32)


def _dissect(triangles: Int, middles: Float, piece: Int, pending: np.ndarray) -> list[Int]:
    """Return the nodes of a piece in order of elimination, its separator last, and remove them from `pending` (S,)."""
    nodes = np.unique(triangles[piece])
    nodes = nodes[pending[nodes]]
    if len(piece) == 1 or len(nodes) <= SMALLEST:
        pending[nodes] = False
        return [nodes]
    centred = middles[piece] - middles[piece].mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1][:, :0:-1]
    least, parts, separator = np.inf, (piece, piece), nodes
    for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        along = np.argsort(centred @ (axes @ [np.cos(angle), np.sin(angle)]), kind="stable")
        for share in PLACES:
            count = min(max(1, round(share * len(piece))), len(piece) - 1)
            near, far = piece[along[:count]], piece[along[count:]]
            offset = np.zeros(len(pending), dtype=bool)
            offset[triangles[near]] = True
            common = np.unique(triangles[far])
            common = common[offset[common] & pending[common]]
            # Unequal halves have a penalty.
            if len(common) * (1.0 + abs(share - 0.5)) < least:
                least, parts, separator = len(common) * (1.0 + abs(share - 0.5)), (near, far), common
    pending[separator] = False
    near, far = parts
    return [*_dissect(triangles, middles, near, pending), *_dissect(triangles, middles, far, pending), separator]
