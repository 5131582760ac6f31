"""Points of the face in the coordinates of the cells of the surface."""

import numpy as np
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.skin.problem import in_space
from palmfield.skin.solvers.spectral_elements.gll import lagrange, rule
from palmfield.skin.solvers.spectral_elements.solid import Solid
from palmfield.types import Float, Int

CANDIDATES = 12
"""Number of nearest cells in which a point is searched."""


def find(solid: Solid, at: Float) -> tuple[Int, Float]:
    """Return the surface nodes of the cell that contains each point, and their shares, both (p, n^2).

    at: points [m], shape (p, 3), or (p, 2) on a plane face; each is replaced by the nearest place of the surface.
    Raises SceneError for another shape, numbers that are not finite, and points farther off than the width of a cell.
    """
    points = in_space(at)
    cells = solid.quads.cells
    n = solid.order + 1
    x = solid.nodes[: solid.surface_nodes][cells]
    centres = x.reshape(len(cells), -1, 3).mean(axis=1)
    count = min(CANDIDATES, len(cells))
    near = cKDTree(centres).query(points, k=count)[1].reshape(len(points), count)
    best = np.full(len(points), np.inf)
    chosen, where = near[:, 0].copy(), np.zeros((len(points), 2))
    width = np.linalg.norm(x[:, 0, 0] - x[:, -1, -1], axis=1)
    for column in near.T:
        unresolved = np.flatnonzero(best > 1e-9 * width[chosen])
        if len(unresolved) == 0:
            break
        tried = column[unresolved]
        places = _invert(x[tried], points[unresolved], solid.order)
        off = np.linalg.norm(_place(x[tried], *_lines(places, solid.order)) - points[unresolved], axis=1)
        better = off < best[unresolved] - 1e-12
        improved = unresolved[better]
        best[improved], chosen[improved], where[improved] = off[better], tried[better], places[better]
    far = best / width[chosen]
    worst = int(np.argmax(far))
    if far[worst] > 1.0:
        raise SceneError(
            f"skin point {worst}, ({', '.join(f'{c:.4g}' for c in points[worst])}) m, is {best[worst]:.3g} m from "
            "the face: move it onto the face"
        )
    a, b = _lines(where, solid.order)
    return cells[chosen].reshape(len(points), n * n), (a[:, :, None] * b[:, None, :]).reshape(len(points), n * n)


def _lines(local: Float, order: int) -> tuple[Float, Float]:
    return lagrange(order, local[:, 0]), lagrange(order, local[:, 1])


def _place(x: Float, a: Float, b: Float) -> Float:
    return np.einsum("pj,pjc->pc", b, np.einsum("pi,pijc->pjc", a, x))


def _invert(x: Float, points: Float, order: int) -> Float:
    """Return the reference coordinates in [-1, 1]^2 of the places nearest to points, by Gauss-Newton."""
    local = np.zeros((len(points), 2))
    derivative = rule(order).derivative
    for _ in range(8):
        a, b = _lines(local, order)
        slope = np.stack([_place(x, a @ derivative, b), _place(x, a, b @ derivative)], axis=2)
        square = np.einsum("pca,pcb->pab", slope, slope)
        away = np.einsum("pca,pc->pa", slope, points - _place(x, a, b))
        step = np.linalg.solve(square, away[..., None])[..., 0]
        local = np.clip(local + step, -1.0, 1.0)
        if np.abs(step).max() < 1e-12:
            break
    return local
