"""Pressure on the face at every step."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from palmfield.skin.fem.traction import face_pressure
from palmfield.skin.problem import GAUSSIAN, Load, Spot
from palmfield.skin.solvers.spectral_elements.gll import lagrange, rule
from palmfield.skin.solvers.spectral_elements.solid import Solid
from palmfield.types import Float, Int

MOST_ACROSS = 24
"""Largest number of places across a cell at which pressures at points are sampled."""


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
