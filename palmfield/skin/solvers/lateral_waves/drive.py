"""The load on each wave, in segments of time that end where the load bends or a result is requested."""

from dataclasses import dataclass

import numpy as np

from palmfield.skin.problem import Load, Spot, spread
from palmfield.skin.solvers.lateral_waves.waves import WaveSet, transform
from palmfield.types import Complex, Float, Int

SAME = 1e-9
"""Largest difference of two equal moments, as a share of the whole time."""


@dataclass(frozen=True)
class Timeline:
    """Segments of time. edges: ends [s], shape (s + 1,); kind: number of the duration of each segment, shape (s,);
    rows: number of the requested time at the end of each segment, or -1, shape (s,)
    """

    edges: Float
    kind: Int
    durations: Float
    rows: Int


def timeline(load: Load, requested: Float) -> Timeline | None:
    """Return the segments from the start of the load to the last requested time; None if no requested time is later."""
    start = float(load.times_s[0])
    span = float(requested[-1]) - start
    if span <= 0.0:
        return None
    bends = load.times_s[load.times_s < requested[-1]]
    ticks = np.round((np.concatenate([bends, requested[requested > start]]) - start) / (SAME * span)).astype(np.int64)
    different, place = np.unique(ticks, return_inverse=True)
    edges = np.empty(len(different))
    # Bends are written last, so that common edges have exactly the time of the load
    edges[place[::-1]] = np.concatenate([bends, requested[requested > start]])[::-1]
    rows = np.full(len(edges), -1, dtype=np.int32)
    rows[place[len(bends) :]] = np.flatnonzero(requested > start)
    lengths = np.round(np.diff(edges) / (SAME * span)).astype(np.int64)
    _, first, kind = np.unique(lengths, return_index=True, return_inverse=True)
    return Timeline(edges, kind.astype(np.int32), np.diff(edges)[first], rows[1:])


def spot_transform(fwhm_m: float, k: Float) -> Float:
    """Return the integral of exp(-4 ln 2 r^2 / fwhm^2) e^{-ik.x} over the plane [m^2]."""
    s = spread(fwhm_m)
    return 2.0 * np.pi * s**2 * np.exp(-0.5 * (k * s) ** 2)


def drive(load: Load, line: Timeline, waves: WaveSet, part: slice) -> Float:
    """Return the force on each wave in the form of `warp_kernels.oscillators.march`: shape (n, s, 7).

    The transform of the shape of a spot is part of the weight of the wave. This force has its amplitude and phase.
    """
    if not isinstance(load, Spot):
        forces = transform(waves.vectors[part], load.pressure_Pa * load.weights_m2, load.points[:, :2])
        return on_timeline(load.law, load.times_s, forces, line)
    if waves.centre is not None:
        still = np.ones((len(waves.group[part]), 1)) * load.peak_Pa
        return on_timeline(load.law, load.times_s, still.astype(complex), line)
    centres = load.centres()
    if load.law == "held":
        return on_timeline("held", load.times_s, np.exp(-1j * (waves.vectors[part] @ centres.T)) * load.peak_Pa, line)
    path = np.stack([np.interp(line.edges, load.times_s, centres[:, axis]) for axis in range(2)])
    size = np.interp(line.edges, load.times_s, load.peak_Pa)
    turned = waves.vectors[part] @ path
    phase = np.exp(-1j * turned)
    before = phase[:, :-1]
    result = np.empty((*before.shape, 7))
    _split(result, before * size[:-1], before * np.diff(size), phase[:, 1:] * before.conj())
    result[:, :, 6] = np.diff(turned, axis=1) / line.durations[line.kind]
    return result


def on_timeline(law: str, times: Float, values: Complex, line: Timeline) -> Float:
    """Return forces at given times, (n, f), in the form of `drive`; they are constant or linear between the times."""
    last = len(times) - 1
    result = np.empty((len(values), len(line.kind), 7))
    place = np.clip(np.searchsorted(times, 0.5 * (line.edges[:-1] + line.edges[1:]), side="right") - 1, 0, last)
    if law == "held" or last == 0:
        _split(result, values[:, place], np.zeros(1), np.ones(1))
    else:
        following = np.minimum(place + 1, last)
        gap = np.where(following > place, times[following] - times[place], 1.0)
        slope = (values[:, following] - values[:, place]) / gap
        before = values[:, place] + slope * (line.edges[:-1] - times[place])
        _split(result, before, slope * np.diff(line.edges), np.ones(1))
    result[:, :, 6] = 0.0
    return result


def _split(result: Float, first: Complex, change: Complex | Float, turn: Complex | Float) -> None:
    for place, values in ((0, first), (2, change), (4, turn)):
        result[:, :, place], result[:, :, place + 1] = np.real(values), np.imag(values)
