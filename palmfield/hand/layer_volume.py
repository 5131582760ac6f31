"""Volume of a skin layer: that of its wedges, and the exact one from thickness and curvature."""

import numpy as np

from palmfield.hand.triangles import corner_angles, directed_edges, face_normals, numbered_edges
from palmfield.types import Float, Int


def layer_volume(vertices: Float, faces: Int, inward: Float, depth: Float) -> float:
    """Return the volume of the wedges [m3], each of three tetrahedra; folded parts are negative."""
    order = np.argsort(faces, axis=1)
    odd = (order[:, [0, 1]] > order[:, [1, 2]]).sum(axis=1) + (order[:, 0] > order[:, 2])
    ordered = np.take_along_axis(faces, order, axis=1)
    bottom = vertices + depth[:, None] * inward
    a, b, c = (vertices[ordered[:, i]] for i in range(3))
    d, e, f = (bottom[ordered[:, i]] for i in range(3))
    six = sum(
        np.einsum("ij,ij->i", q - p, np.cross(r - p, p - s))
        for p, q, r, s in ((a, b, c, f), (a, b, f, e), (a, e, f, d))
    )
    return float((np.where(odd % 2 == 0, 1.0, -1.0) * six).sum()) / 6.0


def curvature_integrals(vertices: Float, faces: Int) -> tuple[Float, Float]:
    """Return the integrals of mean curvature H [m] and Gaussian curvature K [1] over each face, shape (m,) each.

    H is half the sum of the principal curvatures, positive on a ball. An edge of length l and turning angle a
    contributes l a / 2 to H, half to each face. A vertex contributes its angle deficit to K, shared by corner angle.
    Edges and vertices of a rim contribute nothing (Steiner's formula for polyhedra; Cohen-Steiner & Morvan 2003, doi
    10.1145/777792.777839).
    """
    unit, _ = face_normals(vertices, faces)
    directed = directed_edges(faces)
    edges, inverse, count = numbered_edges(faces)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.argsort(inverse, kind="stable")
    inner = (count == 2)[inverse[order]]
    first, second = order[inner].reshape(-1, 2).T
    start, end = vertices[directed[first, 0]], vertices[directed[first, 1]]
    n, m = unit[owner[first]], unit[owner[second]]
    length = np.linalg.norm(end - start, axis=1)
    along = (end - start) / np.where(length > 0.0, length, 1.0)[:, None]
    turn = np.arctan2(np.einsum("ij,ij->i", np.cross(n, m), along), np.einsum("ij,ij->i", n, m))
    mean = np.zeros(len(faces))
    for face in (owner[first], owner[second]):
        mean += np.bincount(face, 0.25 * length * turn, len(faces))
    angles = corner_angles(vertices, faces)
    total = np.bincount(faces.ravel(), angles.ravel(), len(vertices))
    missing = 2.0 * np.pi - total
    missing[edges[count != 2]] = 0.0
    share = angles / np.where(total > 0.0, total, 1.0)[faces]
    return mean, np.asarray((missing[faces] * share).sum(axis=1))


def thickness_integral(vertices: Float, faces: Int, depth: Float, chosen: Int | None = None) -> float:
    """Return the exact volume of a layer of thickness `depth` along the inward normals [m3].

    At depth s an area dA becomes (1 - 2 s H + s^2 K) dA, so a layer of thickness t has the volume
    dV = (t - t^2 H + t^3 K / 3) dA, with the curvatures of `curvature_integrals`.

    chosen: numbers of the faces that carry the layer, default all
    """
    mean, gauss = curvature_integrals(vertices, faces)
    area = face_normals(vertices, faces)[1]
    use = slice(None) if chosen is None else chosen
    t = depth[faces[use]]
    # Means of t, t^2 and t^3 over a triangle with linear t
    s1, s2, s3 = t.sum(axis=1), (t**2).sum(axis=1), (t**3).sum(axis=1)
    one, two, three = s1 / 3.0, (s1**2 + s2) / 12.0, (s1**3 + 3.0 * s1 * s2 + 2.0 * s3) / 60.0
    return float((area[use] * one - mean[use] * two + gauss[use] * three / 3.0).sum())
