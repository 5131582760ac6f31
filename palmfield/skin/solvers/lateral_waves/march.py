"""Run the oscillators of a wave set, on the CPU or a GPU, and sum the waves at points."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from palmfield.device import run_kernel
from palmfield.skin.problem import Load
from palmfield.skin.solvers.lateral_waves.drive import Timeline, drive
from palmfield.skin.solvers.lateral_waves.waves import WaveSet
from palmfield.threads import cores
from palmfield.types import Complex, Float
from warp_kernels import oscillators as kernels

CHUNK_NUMBERS = 4_000_000
"""Approximate largest number of doubles of the drive or the result of one chunk of waves."""
LEAST_CHUNKS = 8
"""Least number of parts of the work; the same on all machines, because the order of the sums depends on it."""


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
