"""Halve long edges of a mesh without gaps: each face is divided according to its halved edges."""

import numpy as np
from scipy import sparse

from palmfield.hand.triangles import numbered_edges
from palmfield.types import Float, Int

MOST_ROUNDS = 6


def split_long_edges(vertices: Float, faces: Int, longest_m: float) -> tuple[sparse.csr_array, Int]:
    """Halve edges longer than longest_m repeatedly; return the matrix from old to new vertices, (n_new, n), and faces.

    The matrix also interpolates values at vertices. New vertices are on the old triangles, so the shape is unchanged.
    """
    carry = sparse.csr_array(sparse.eye_array(len(vertices)))
    for _ in range(MOST_ROUNDS):
        points = carry @ vertices
        edges, inverse, _ = numbered_edges(faces)
        # Edge i of a face goes from corner i to the next.
        of_face = inverse.reshape(3, len(faces)).T
        long = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) > longest_m
        if not long.any():
            break
        middle = np.full(len(edges), -1)
        middle[long] = len(points) + np.arange(int(long.sum()))
        pairs = edges[long]
        rows = np.repeat(np.arange(len(pairs)), 2)
        halves = sparse.csr_array(
            (np.full(2 * len(pairs), 0.5), (rows, pairs.ravel())), shape=(len(pairs), len(points))
        )
        faces = _cut(faces, middle[of_face], points)
        carry = sparse.csr_array(sparse.vstack([carry, halves @ carry]))
    return carry, faces


def _cut(faces: Int, middle: Int, points: Float) -> Int:
    """Cut faces at the midpoints of their edges; middle: shape (m, 3), -1 for an uncut edge."""
    count = (middle >= 0).sum(axis=1)
    out = [faces[count == 0]]
    # Each face is rotated so that its only cut edge comes first, or its only uncut edge last.
    turn = np.where(count == 1, np.argmax(middle >= 0, axis=1), np.where(count == 2, np.argmin(middle, axis=1) + 1, 0))
    order = (np.arange(3) + turn[:, None]) % 3
    corner, mid = np.take_along_axis(faces, order, axis=1), np.take_along_axis(middle, order, axis=1)
    (a, b, c), (ab, _, _) = corner[count == 1].T, mid[count == 1].T
    out += [np.stack([a, ab, c], axis=1), np.stack([ab, b, c], axis=1)]
    (a, b, c), (ab, bc, _) = corner[count == 2].T, mid[count == 2].T
    out.append(np.stack([ab, b, bc], axis=1))
    # The rest is four-sided; its shorter diagonal gives the better triangles.
    to_c = np.linalg.norm(0.5 * (points[a] + points[b]) - points[c], axis=1)
    to_a = np.linalg.norm(0.5 * (points[b] + points[c]) - points[a], axis=1)
    short = to_c < to_a
    out.append(np.where(short[:, None], np.stack([a, ab, c], axis=1), np.stack([a, ab, bc], axis=1)))
    out.append(np.where(short[:, None], np.stack([ab, bc, c], axis=1), np.stack([a, bc, c], axis=1)))
    (a, b, c), (ab, bc, ca) = corner[count == 3].T, mid[count == 3].T
    out += [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (bc, c, ca), (ab, bc, ca))]
    return np.concatenate(out).astype(np.int32)
