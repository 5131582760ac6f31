"""The load on each wave in segments of time, and the oscillators of a wave set, on the CPU or a GPU."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from palmfield.device import run_kernel
from palmfield.skin.problem import Load, Spot, spread
from palmfield.skin.solvers.lateral_waves.waves import WaveSet, transform
from palmfield.threads import cores
from palmfield.types import Complex, Float, Int
from warp_kernels import oscillators as kernels

SAME = 1e-9
"""Largest difference of two equal moments, as a share of the whole time."""
CHUNK_NUMBERS = 4_000_000
"""Approximate largest number of doubles of the drive or the result of one chunk of waves."""
LEAST_CHUNKS = 8
"""Least number of parts of the work; the same on all machines, because the order of the sums depends on it."""


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


def tables(waves: WaveSet, line: Timeline) -> list[tuple[Any, Any]]:
    """Return poles, residues and e^{s h}, padded to one width, with their Warp types, in the order of the kernel."""
    counts = np.array([len(m.poles) for m in waves.modes], dtype=np.int32)
    width = int(counts.max())
    groups = len(counts)
    poles, residues = np.zeros((groups, 2, width)), np.zeros((groups, 4, width))
    decay = np.zeros((len(line.durations), groups, 2, width))
    for number, (modes, count) in enumerate(zip(waves.modes, counts, strict=True)):
        poles[number, :, :count] = modes.poles.real, modes.poles.imag
        residues[number, :, :count] = modes.normal.real, modes.normal.imag, modes.lateral.real, modes.lateral.imag
        turned = np.exp(np.outer(line.durations, modes.poles))
        decay[:, number, 0, :count], decay[:, number, 1, :count] = turned.real, turned.imag
    return [
        (counts, wp.int32),
        (poles, wp.float64),
        (residues, wp.float64),
        (line.kind, wp.int32),
        (line.durations, wp.float64),
        (decay, wp.float64),
    ]


def march(
    load: Load,
    line: Timeline,
    waves: WaveSet,
    rows: int,
    to_points: Callable[[slice, Complex], Float],
    device: str,
    threads: int | None,
    force_on: Callable[[slice], Float] | None = None,
) -> Float:
    """Return the sum over all waves of to_points(part, amplitude), see `waves.at_points`, in chunks of waves.

    force_on: returns the force on a part of the waves, as `drive`; None if the waves are plane or axial.
    Chunks run in parallel on the CPU and are added in a fixed order, so that the sum is always the same.
    """
    shared = tables(waves, line)
    width = shared[1][0].shape[2]
    fixed: list[Any] = [wp.array(values.ravel(), dtype=kind, device=device) for values, kind in shared]
    after: Any = wp.array(line.rows, dtype=wp.int32, device=device)
    segments = len(line.kind)

    def run(part: slice) -> Float:
        group = waves.group[part]
        count = len(group)
        force = drive(load, line, waves, part) if force_on is None else force_on(part)
        result: Any = wp.zeros(rows * count * 8, dtype=wp.float64, device=device)
        inputs = [
            count,
            len(waves.modes),
            width,
            segments,
            wp.array(group, dtype=wp.int32, device=device),
            *fixed,
            wp.array(force.ravel(), dtype=wp.float64, device=device),
            after,
            wp.zeros(count * 2 * width, dtype=wp.float64, device=device),
            result,
        ]
        run_kernel(kernels.march, dim=count, inputs=inputs, device=device)
        return to_points(part, result.numpy().view(complex).reshape(rows, count, 4))

    size = max(1, min(CHUNK_NUMBERS // (7 * segments + 8 * rows), -(-len(waves) // LEAST_CHUNKS)))
    parts = [slice(start, min(start + size, len(waves))) for start in range(0, len(waves), size)]
    workers = min((threads or cores()) if device == "cpu" else 1, len(parts))
    if workers == 1:
        return sum((run(part) for part in parts[1:]), start=run(parts[0]))
    with ThreadPoolExecutor(workers) as pool:
        results = pool.map(run, parts)
        return sum(results, start=next(results))
