"""What the face is pressed with at every step."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from palmfield.skin.problem import GAUSSIAN, Load, Spot
from palmfield.skin.solvers.spectral_elements.places import find
from palmfield.skin.solvers.spectral_elements.solid import Solid, face_areas
from palmfield.types import Float, Int


@dataclass(frozen=True)
class Table:
    """The load by step: a spot (moving) or pressures at the surface nodes by frame.

    steps: how many; spot: peak [Pa] and centre [m], shape (steps, 3); spread: 4 ln 2 / fwhm^2 [1/m^2]
    frames: [Pa], shape (f, surface nodes); frame, share: by step, frame and share of the next, shape (steps,)
    """

    moving: bool
    steps: int
    spot: Float
    spread: float
    frames: Float
    frame: Int
    share: Float


def no_load(steps: int, surface_nodes: int) -> Table:
    return Table(True, steps, np.zeros((steps, 3)), 0.0, np.zeros((1, 1)), np.zeros(1, np.int64), np.zeros(1))


def rows_at(load: Load, times: Any, step_s: float) -> tuple[Any, Any]:
    """Row of [0, first, ..., last, last] and share of the next row at times that begin with the load's first.

    Where the load jumps, a step takes the mean over half a step to each side, so that the scheme stays of second order.
    """
    given = np.asarray(load.times_s, dtype=float)
    if load.law == "linear":
        row = np.searchsorted(given, times, side="right")
        after = np.minimum(row, len(given) - 1)
        before = np.maximum(row - 1, 0)
        gap = np.maximum(given[after] - given[before], np.finfo(float).tiny)
        share = np.where(row >= len(given), 0.0, (times - given[before]) / gap)
    else:
        row = np.searchsorted(given, times - 0.5 * step_s, side="right")
        jump = given[np.minimum(row, len(given) - 1)]
        share = np.clip((times + 0.5 * step_s - jump) / step_s, 0.0, 1.0) * (row < len(given))
    row[0], share[0] = 0, 0.5
    return row, share


def table_of(load: Load, solid: Solid, step_s: float, steps: int) -> Table:
    """The load at `steps` times from its first on."""
    times = float(load.times_s[0]) + step_s * np.arange(steps)
    row, share = rows_at(load, times, step_s)
    if isinstance(load, Spot):
        peak = np.concatenate([[0.0], load.peak_Pa, load.peak_Pa[-1:]])
        centre = np.concatenate([load.centres()[:1], load.centres(), load.centres()[-1:]])
        spot = np.empty((steps, 3))
        spot[:, 0] = (1.0 - share) * peak[row] + share * peak[row + 1]
        spot[:, 1:] = (1.0 - share)[:, None] * centre[row] + share[:, None] * centre[row + 1]
        return Table(True, steps, spot, GAUSSIAN / load.fwhm_m**2, np.zeros((1, 1)), np.zeros(1, int), np.zeros(1))
    # The given points are a quadrature: consistent forces at the nodes, as pressures over the nodes' own areas
    nodes, shares = find(solid, load.points)
    owner = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    gather = sparse.csr_matrix((shares.ravel(), (nodes.ravel(), owner)), shape=(solid.surface_nodes, len(nodes)))
    area = np.linalg.norm(face_areas(solid), axis=1)
    pressure = (gather @ (np.asarray(load.weights_m2)[:, None] * np.asarray(load.pressure_Pa).T)).T / area
    frames = np.concatenate([np.zeros((1, len(area))), pressure, pressure[-1:]])
    return Table(False, steps, np.zeros((1, 3)), 0.0, frames, row, share)
