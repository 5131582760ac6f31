"""Points of the face in the coordinates of the cells of the surface, and the pressure there at every step."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.skin.fem.traction import face_pressure
from palmfield.skin.problem import GAUSSIAN, Load, Spot, in_space
from palmfield.skin.solvers.spectral_elements.solid import Solid, lagrange, rule
from palmfield.types import Float, Int

CANDIDATES = 12
"""Number of nearest cells in which a point is searched."""
MOST_ACROSS = 24
"""Largest number of places across a cell at which pressures at points are sampled."""


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


@dataclass(frozen=True)
class Table:
    """The load at each step: a spot, or pressures at the surface nodes by frame.

    steps: number of steps; spot: peak [Pa] and centre [m], shape (steps, 3); spread: 4 ln 2 / fwhm^2 [1/m^2]
    frames: [Pa], shape (f, surface nodes); frame, share: frame of each step, and share of the next frame, (steps,)
    """

    moving: bool
    steps: int
    spot: Float
    spread: float
    frames: Float
    frame: Int
    share: Float


def rows_at(load: Load, times: Any, step_s: float) -> tuple[Any, Any]:
    """Return the row of [0, first, ..., last, last] and the share of the next row, at times from the start of the load.

    Near a jump of the load, a step uses the mean over half a step on each side, so that the scheme stays second order.
    """
    load_times = np.asarray(load.times_s, dtype=float)
    if load.law == "linear":
        row = np.searchsorted(load_times, times, side="right")
        after = np.minimum(row, len(load_times) - 1)
        before = np.maximum(row - 1, 0)
        gap = np.maximum(load_times[after] - load_times[before], np.finfo(float).tiny)
        share = np.where(row >= len(load_times), 0.0, (times - load_times[before]) / gap)
    else:
        row = np.searchsorted(load_times, times - 0.5 * step_s, side="right")
        jump = load_times[np.minimum(row, len(load_times) - 1)]
        share = np.clip((times + 0.5 * step_s - jump) / step_s, 0.0, 1.0) * (row < len(load_times))
    row[0], share[0] = 0, 0.5
    return row, share


def table_of(load: Load, solid: Solid, step_s: float, steps: int) -> Table:
    """Return the load at `steps` times from its first time on."""
    times = float(load.times_s[0]) + step_s * np.arange(steps)
    row, share = rows_at(load, times, step_s)
    if isinstance(load, Spot):
        peak = np.concatenate([[0.0], load.peak_Pa, load.peak_Pa[-1:]])
        centre = np.concatenate([load.centres()[:1], load.centres(), load.centres()[-1:]])
        spot = np.empty((steps, 3))
        spot[:, 0] = (1.0 - share) * peak[row] + share * peak[row + 1]
        spot[:, 1:] = (1.0 - share)[:, None] * centre[row] + share[:, None] * centre[row + 1]
        return Table(True, steps, spot, GAUSSIAN / load.fwhm_m**2, np.zeros((1, 1)), np.zeros(1, int), np.zeros(1))
    pressure = (
        face_pressure(load, *face_rule(solid, math.sqrt(float(np.median(load.weights_m2))))) @ load.pressure_Pa.T
    ).T
    frames = np.concatenate([np.zeros((1, solid.surface_nodes)), pressure, pressure[-1:]])
    return Table(False, steps, np.zeros((1, 3)), 0.0, frames, row, share)


def face_rule(solid: Solid, spacing_m: float) -> tuple[Int, Float, Float, Float]:
    """Return Gauss points on all cells of the face, about `spacing_m` [m] apart or closer, for `face_pressure`.

    Returns the surface nodes of the cell of each point and their shares, both (q, n^2), then the points [m] and their
    outward area vectors [m2], both (q, 3).
    """
    cells, order = solid.quads.cells, solid.order
    x = solid.nodes[cells]
    width = float(np.linalg.norm(x[:, 0, 0] - x[:, -1, -1], axis=1).mean()) / math.sqrt(2.0)
    across, weights = leggauss(int(np.clip(math.ceil(width / spacing_m), order + 1, MOST_ACROSS)))
    line = lagrange(order, across)
    slope = line @ rule(order).derivative
    places = np.einsum("ai,bj,eijc->eabc", line, line, x, optimize=True)
    along = (np.einsum("ai,bj,eijc->eabc", one, two, x, optimize=True) for one, two in ((slope, line), (line, slope)))
    area = np.cross(*along) * np.outer(weights, weights)[..., None]
    shares = np.einsum("ai,bj->abij", line, line).reshape(-1, line.shape[1] ** 2)
    nodes = np.repeat(cells.reshape(len(cells), -1), len(shares), axis=0)
    return nodes, np.tile(shares, (len(cells), 1)), places.reshape(-1, 3), area.reshape(-1, 3)
