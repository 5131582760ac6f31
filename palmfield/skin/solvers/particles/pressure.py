"""Pressure on the particles of the face: means over each step."""

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.device import run_kernel
from palmfield.skin.fem.load import halvings_for, quartered_rule
from palmfield.skin.fem.traction import face_pressure
from palmfield.skin.problem import GAUSSIAN, Law, Load, Spot, Traction, between
from palmfield.skin.solvers.particles.cloud import Cloud
from palmfield.types import Float
from warp_kernels import particles as kernels


def integral(times_s: Float, values: Float, law: Law, to_s: Float) -> Float:
    """Return the integral of a held or piecewise-linear history from its first time to to_s, shape (n, ...).

    times_s: shape (f,); values: shape (f, ...), 0 before the first time and constant after the last; to_s: shape (n,)
    """
    times, values = np.asarray(times_s, dtype=float), np.asarray(values, dtype=float)
    gaps = np.diff(times).reshape(-1, *[1] * (values.ndim - 1))
    slopes = np.zeros_like(values)
    if law == "linear":
        slopes[:-1] = np.diff(values, axis=0) / gaps
    pieces = gaps * (values[:-1] + 0.5 * gaps * slopes[:-1])
    before = np.concatenate([np.zeros_like(values[:1]), np.cumsum(pieces, axis=0)])
    piece = np.clip(np.searchsorted(times, to_s, side="right") - 1, 0, len(times) - 1)
    since = np.maximum(to_s - times[piece], 0.0).reshape(-1, *[1] * (values.ndim - 1))
    return before[piece] + since * (values[piece] + 0.5 * since * slopes[piece])


def means(times_s: Float, values: Float, law: Law, at_s: Float, step_s: float) -> Float:
    """Return the means over a step centred at each time, shape (n, ...): the load of a leapfrog step."""
    ends = [integral(times_s, values, law, at_s + half) for half in (-0.5 * step_s, 0.5 * step_s)]
    return (ends[1] - ends[0]) / step_s


class Pressure:
    """Fills a table (steps, particles of the face) of pressures [Pa] on the device for one block of steps at a time."""

    def __init__(self, cloud: Cloud, load: Load, device: str) -> None:
        self.load = load
        self.device = device
        if isinstance(load, Spot):
            self.places: wp.array = wp.array(cloud.columns.face[:, :2].astype(np.float32), dtype=wp.vec2, device=device)
        else:
            self.spread = _spread(cloud, load)

    def fill(self, table: wp.array, times_s: Float, step_s: float) -> None:
        """Write the pressures at times [s] into the first rows of a table; each is the mean over its step."""
        load = self.load
        if isinstance(load, Traction):
            frames = means(load.times_s, load.pressure_Pa, load.law, times_s, step_s)
            rows = np.zeros(table.shape, dtype=np.float32)
            rows[: len(times_s)] = (self.spread @ frames.T).T
            table.assign(rows)
            return
        peak = means(load.times_s, load.peak_Pa, load.law, times_s, step_s)
        centre = between(load, load.centres(), times_s)
        run_kernel(
            kernels.spot_pressure,
            dim=(len(times_s), table.shape[1]),
            inputs=[
                self.places,
                wp.array(peak.astype(np.float32), dtype=wp.float32, device=self.device),
                wp.array(centre.astype(np.float32), dtype=wp.vec2, device=self.device),
                GAUSSIAN / load.fwhm_m**2,
            ],
            outputs=[table],
            device=self.device,
        )


def _spread(cloud: Cloud, load: Traction) -> sparse.csr_matrix:
    """Return the matrix from pressure at the points of the load to pressure at the particles of the face, (f, n)."""
    columns = cloud.columns
    squares = columns.squares
    # A square is the mean of its two cuts into triangles, so each corner has a quarter of the area
    cuts = [squares[:, cut] for cut in ([0, 1, 2], [0, 2, 3], [1, 2, 3], [1, 3, 0])]
    triangles = np.concatenate([columns.triangles, *cuts])
    corners = columns.face[triangles]
    rule, parts = quartered_rule(halvings_for(corners, load.weights_m2))
    shares = np.column_stack([1.0 - rule.sum(axis=1), rule])
    places = np.einsum("qk,tkc->tqc", shares, corners).reshape(-1, 3)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area[len(columns.triangles) :] *= 0.5
    nodes = np.repeat(triangles, len(rule), axis=0)
    areas = np.einsum("tc,q->tqc", area, parts).reshape(-1, 3)
    return face_pressure(load, nodes, np.tile(shares, (len(triangles), 1)), places, areas)
