"""Finer triangles where they are wanted, by longest-edge bisection: no hanging nodes, bounded angles, same shape."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.hand.triangles import directed_edges, face_normals, vertex_normals
from palmfield.types import Float, Int, Surface

MOST_VERTICES = 2_000_000
ACOUSTIC_m = 0.0086
"""Wavelength of 40 kHz in air at 20 C."""
EdgeLength = ArrayLike | Callable[[Float], Float]


def refine(surface: Surface, target_edge_m: EdgeLength) -> Surface:
    """The same surface with no edge longer than its target there, and no triangle cut where none was too long nearby.

    target_edge_m: longest edge [m], one number or by vertex, shape (n,), linear on the triangles; or a function of
        points, (k, 3) -> (k,). It is taken at the middle of each edge, so it should not fall faster than one to one
    No angle gets below half of the smallest of the given triangles (Rivara 1984, doi 10.1002/nme.1620200412).
    `bisected` gives the matrix that carries values at the vertices over as well.

    Raises SceneError for target lengths that are not finite and above 0, or so small that the mesh would have more than
    MOST_VERTICES vertices.
    """
    carry, faces = bisected(surface.vertices, surface.faces, target_edge_m)
    vertices = carry @ surface.vertices
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def bisected(vertices: Float, faces: Int, target_edge_m: EdgeLength) -> tuple[sparse.csr_array, Int]:
    """As `refine`: matrix that makes the new vertices, and any value at them, from the old, shape (n_new, n); faces."""
    carry = sparse.csr_array(sparse.eye_array(len(vertices)))
    given = None if callable(target_edge_m) else _by_vertex(target_edge_m, len(vertices))
    while True:
        points = carry @ vertices
        edges, inverse = np.unique(np.sort(directed_edges(faces), axis=1), axis=0, return_inverse=True)
        # Edge i of a face runs from its corner i to the next
        of_face = inverse.reshape(3, len(faces)).T.astype(np.int32)
        length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        if callable(target_edge_m):
            target = np.asarray(target_edge_m(points[edges].mean(axis=1)), dtype=np.float64)
            _check(target, len(edges))
        else:
            target = (carry @ given)[edges].mean(axis=1)
        cut = length > target
        if not cut.any():
            return carry, faces
        # A triangle whose edges are not longer than w is not larger than sqrt(3) / 4 w^2
        least = (face_normals(points, faces)[1] / (0.433 * target[of_face].max(axis=1) ** 2)).sum()
        if 0.5 * least > MOST_VERTICES:
            raise SceneError(
                f"edges of {1e3 * target.min():.2g} mm are wanted: the mesh would have more than {MOST_VERTICES} "
                "vertices; ask for longer ones"
            )
        longest = _longest(of_face, length)
        _close(cut, of_face, longest)
        middle = np.full(len(edges), -1)
        middle[cut] = len(points) + np.arange(int(cut.sum()))
        rows = np.repeat(np.arange(int(cut.sum())), 2)
        halves = sparse.csr_array(
            (np.full(len(rows), 0.5), (rows, edges[cut].ravel())), shape=(rows[-1] + 1, len(points))
        )
        faces = _split(faces, middle[of_face], longest)
        carry = sparse.csr_array(sparse.vstack([carry, halves @ carry]))


def target_edges(
    distance_m: Float,
    shear_wavelength_m: float,
    *,
    acoustic_wavelength_m: float = ACOUSTIC_m,
    per_acoustic: float = 4.0,
    per_shear: float = 4.0,
    near_m: float = ACOUSTIC_m,
    growth: float = 0.3,
) -> Float:
    """Longest edges [m] at distances from the stimulus [m]; same shape.

    Within near_m the shorter of acoustic_wavelength_m / per_acoustic and shear_wavelength_m / per_shear, so that spot
    and waves are resolved; from there on growing by `growth` of the distance, until the waves alone set the edge. On
    quadratic elements there are twice as many nodes as edges a wavelength.
    shear_wavelength_m: wave speed over frequency, as of `palmfield.skin.materials.material.shear_wave`
    Raises SceneError for lengths and numbers that are not finite and above 0, a growth below 0, and distances below 0.
    """
    for name, value in (
        ("shear_wavelength_m", shear_wavelength_m),
        ("acoustic_wavelength_m", acoustic_wavelength_m),
        ("per_acoustic", per_acoustic),
        ("per_shear", per_shear),
        ("near_m", near_m),
    ):
        if not (np.isfinite(value) and value > 0.0):
            raise SceneError(f"wanted edges: {name} is {value:g}; give a finite number above 0")
    if not (np.isfinite(growth) and growth >= 0.0):
        raise SceneError(f"wanted edges: growth is {growth:g}; give 0 or more")
    distance = np.asarray(distance_m, dtype=np.float64)
    if not (distance >= 0.0).all():
        raise SceneError(f"wanted edges: a distance is {distance.min():g} m; give 0 or more")
    wave = shear_wavelength_m / per_shear
    fine = min(acoustic_wavelength_m / per_acoustic, wave)
    return np.minimum(fine + growth * np.maximum(distance - near_m, 0.0), wave)


def _by_vertex(target: ArrayLike, count: int) -> Float:
    value = np.asarray(target, dtype=np.float64)
    if value.ndim == 0:
        value = np.full(count, float(value))
    _check(value, count)
    return value


def _check(target: Float, count: int) -> None:
    if target.shape != (count,):
        raise SceneError(f"wanted edges have shape {target.shape}; give one length for each of {count} places")
    wrong = ~(np.isfinite(target) & (target > 0.0))
    if wrong.any():
        raise SceneError(f"wanted edge {target[wrong][0]:g} m must be finite and above 0")


def _longest(of_face: Int, length: Float) -> Int:
    """Which edge of each face is its longest, shape (m,); of equal ones that with the lowest number, on both sides."""
    order = np.lexsort((-np.arange(len(length)), length))
    rank = np.empty(len(length), dtype=np.int64)
    rank[order] = np.arange(len(length))
    return np.argmax(rank[of_face], axis=1).astype(np.int32)


def _close(cut: np.ndarray, of_face: Int, longest: Int) -> None:
    """Mark, in place, the longest edge of every face that has a marked edge, until that marks no more."""
    top = np.take_along_axis(of_face, longest[:, None], axis=1)[:, 0]
    while True:
        follow = top[cut[of_face].any(axis=1)]
        if cut[follow].all():
            return
        cut[follow] = True


def _split(faces: Int, middle: Int, longest: Int) -> Int:
    """Faces cut at their longest edge, then each half at the other marked edge that it holds; middle (m, 3), or -1."""
    order = (np.arange(3) + longest[:, None]) % 3
    (a, b, c), (ab, bc, ca) = np.take_along_axis(faces, order, axis=1).T, np.take_along_axis(middle, order, axis=1).T
    whole = ab < 0
    out = [faces[whole]]
    for start, end, half in ((b, c, bc), (c, a, ca)):
        plain, both = ~whole & (half < 0), ~whole & (half >= 0)
        out.append(np.stack([start, end, ab], axis=1)[plain])
        out.append(np.stack([start, half, ab], axis=1)[both])
        out.append(np.stack([half, end, ab], axis=1)[both])
    return np.concatenate(out).astype(np.int32)
