"""Finer triangles where they are wanted, by longest-edge bisection (Rivara 1984): no hanging nodes."""

import numpy as np


def bisected(vertices, faces, longest_m):
    """Vertices and faces with no edge longer than `longest_m(middles)` [m], (k, 3) -> (k,), of the same shape."""
    while True:
        directed = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, of_face = np.unique(directed, axis=0, return_inverse=True)
        of_face = of_face.reshape(-1, 3)
        length = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
        cut = length > longest_m(vertices[edges].mean(axis=1))
        if not cut.any():
            return vertices, faces
        # Of edges of equal length both sides take the same one
        rank = np.empty(len(edges), dtype=int)
        rank[np.lexsort((np.arange(len(edges)), length))] = np.arange(len(edges))
        first = rank[of_face].argmax(axis=1)
        turned = (first[:, None] + np.arange(3)) % 3
        (a, b, c), halved = np.take_along_axis(faces, turned, axis=1).T, np.take_along_axis(of_face, turned, axis=1)
        while not cut[follow := halved[cut[halved].any(axis=1), 0]].all():
            cut[follow] = True
        middle = np.full(len(edges), -1)
        middle[cut] = len(vertices) + np.arange(cut.sum())
        vertices = np.concatenate([vertices, vertices[edges[cut]].mean(axis=1)])
        ab, bc, ca = middle[halved].T
        parts = [faces[ab < 0]]
        for start, end, half in ((b, c, bc), (c, a, ca)):
            plain, both = (ab >= 0) & (half < 0), half >= 0
            parts += [np.stack([start, end, ab], axis=1)[plain], np.stack([start, half, ab], axis=1)[both]]
            parts += [np.stack([half, end, ab], axis=1)[both]]
        faces = np.concatenate(parts).astype(np.int32)
