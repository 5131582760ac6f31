"""A layer's surface and its whole boundary as flat triangles."""

import numpy as np

from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int


def output_triangles(mesh: WedgeMesh) -> Int:
    """Four flat triangles for each quadratic one, over the S surface nodes, counter-clockwise, (4 t, 3), int32."""
    pieces = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
    return mesh.surface_triangles6[:, pieces].reshape(-1, 3)


def closed_boundary(mesh: WedgeMesh) -> tuple[Float, Int]:
    """Skin surface, base and cut side of a layer as one closed triangle mesh.

    Returns vertices [m], shape (2 S, 3), of which the first S are the skin's surface nodes, and faces, shape (m, 3).
    """
    count, top = mesh.surface_nodes, output_triangles(mesh)
    vertices = np.concatenate([mesh.nodes[:count], mesh.nodes[-count:]])
    edges = np.concatenate([top[:, [0, 1]], top[:, [1, 2]], top[:, [2, 0]]])
    _, index, uses = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    rim = edges[index[uses == 1]]
    a, b = rim[:, 0], rim[:, 1]
    side = np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])
    return vertices, np.concatenate([top, top[:, ::-1] + count, side]).astype(np.int32)
