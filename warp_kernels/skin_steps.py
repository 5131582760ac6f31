"""Substeps of the reduced model of a skin on a device, with pressures from other kernels.

Partial sums are stored separately and added in a fixed order, so that equal input gives equal bits.
"""

import functools
from typing import Any

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

ROWS = 4
"""Number of pressure patterns per thread, which share the numbers read from the matrix."""
LANES = 32
"""Number of parts of a sum of squares."""


@wp.kernel
def pressure_products(
    counts: wp.array2d(dtype=wp.int32),
    pressure: wp.array2d(dtype=wp.float32),
    points: wp.array(dtype=wp.int32),
    matrix: wp.array2d(dtype=wp.float32),
    size: wp.int32,
    result: wp.array3d(dtype=wp.float32),
):
    """Multiply pressure patterns at some points by a matrix (p, c), in chunks of `size` points, (chunks, w rows, c).

    counts[w, 1]: number of patterns; pressure: [Pa], shape (w m, q); points: numbers of the used points, (p,)
    dim: (w rows / ROWS, chunks, c)
    """
    block, chunk, column = wp.tid()
    worlds = counts.shape[0]
    blocks = result.shape[1] // ROWS // worlds
    world = block // blocks
    patterns = pressure.shape[0] // worlds
    first = (block - world * blocks) * ROWS
    if first < counts[world, 1]:
        totals = wp.vec4()
        for i in range(chunk * size, wp.min((chunk + 1) * size, matrix.shape[0])):
            factor = matrix[i, column]
            for r in range(ROWS):
                totals[r] += factor * pressure[world * patterns + wp.min(first + r, patterns - 1), points[i]]
        for r in range(ROWS):
            result[chunk, block * ROWS + r, column] = totals[r]


@wp.kernel
def mixed_products(
    counts: wp.array2d(dtype=wp.int32),
    weights: wp.array3d(dtype=wp.float64),
    parts: wp.array3d(dtype=wp.float32),
    result: wp.array3d(dtype=wp.float64),
):
    """Compute weighted sums, weights (w, s, m), of the patterns in `pressure_products`, (w, s, c); dim: (w, s, c)."""
    world, substep, column = wp.tid()
    first = world * (parts.shape[1] // counts.shape[0])
    total = wp.float64(0.0)
    for k in range(counts[world, 1]):
        weight = weights[world, substep, k]
        if weight != wp.float64(0.0):
            own = wp.float64(0.0)
            for chunk in range(parts.shape[0]):
                own += wp.float64(parts[chunk, first + k, column])
            total += weight * own
    result[world, substep, column] = total


@functools.cache
def of_rows(rows: int) -> tuple[Any, Any]:
    """Return the types of the state of a mode with `rows` numbers, and of its matrices."""
    return wp.types.vector(length=rows, dtype=wp.float64), wp.types.matrix(shape=(rows, rows), dtype=wp.float64)


@functools.cache
def lone_modes(rows: int) -> Any:
    """Return the kernel of all substeps of modes whose states have `rows` numbers; dim: (worlds, modes)."""
    numbers, square = of_rows(rows)

    @wp.kernel(module="unique", module_options=EXACT)
    def kernel(
        advance: wp.array(dtype=square),
        inputs: wp.array(dtype=numbers),
        forces: wp.array3d(dtype=wp.float64),
        first: wp.int32,
        last: wp.int32,
        before: wp.array3d(dtype=wp.float64),
        after: wp.array3d(dtype=wp.float64),
    ):
        """Replace the state of a mode by advance @ state + inputs * force in substeps from the first, before the last.

        forces: of each substep, (w, s, at least r); before, after: states, (w, rows, r)
        """
        world, mode = wp.tid()
        state = numbers()
        for i in range(rows):
            state[i] = before[world, i, mode]
        own_advance = advance[mode]
        own_inputs = inputs[mode]
        for substep in range(first, last):
            state = own_advance * state + forces[world, substep, mode] * own_inputs
        for i in range(rows):
            after[world, i, mode] = state[i]

    return kernel


@functools.cache
def modes_of_worlds(rows: int) -> Any:
    """Return the kernel of all substeps of modes with `rows` numbers in several worlds; dim: (worlds, modes)."""
    numbers, square = of_rows(rows)

    @wp.kernel(module="unique", module_options=EXACT)
    def kernel(
        advance: wp.array(dtype=square),
        inputs: wp.array(dtype=numbers),
        pushes: wp.array2d(dtype=wp.float32),
        mixed: wp.array2d(dtype=wp.float32),
        states: wp.array3d(dtype=wp.float64),
        seen: wp.array2d(dtype=wp.float32),
    ):
        """Replace the state of a mode by advance @ state + inputs * force in each substep, in place, (worlds, rows, r).

        pushes: forces of the pressure of each world on the modes, (worlds, r); mixed: their factors, (worlds, s)
        seen: filled with displacement and velocity after each substep, (worlds * s * 2, r); unused if empty
        """
        world, mode = wp.tid()
        state = numbers()
        for i in range(rows):
            state[i] = states[world, i, mode]
        own_advance = advance[mode]
        own_inputs = inputs[mode]
        push = pushes[world, mode]
        substeps = mixed.shape[1]
        for substep in range(substeps):
            state = own_advance * state + wp.float64(mixed[world, substep] * push) * own_inputs
            if seen.shape[0] > 0:
                row = 2 * (world * substeps + substep)
                seen[row, mode] = wp.float32(state[0])
                seen[row + 1, mode] = wp.float32(state[1])
        for i in range(rows):
            states[world, i, mode] = state[i]

    return kernel


@wp.kernel
def mixed_rows(
    weights: wp.array2d(dtype=wp.float64),
    rows: wp.array3d(dtype=wp.float64),
    result: wp.array2d(dtype=wp.float64),
):
    """Compute weighted sums of rows (w, k, n), weights (c, k), in sequence, (w, c * n); dim: (w, c, n)."""
    world, matrix, column = wp.tid()
    total = wp.float64(0.0)
    for i in range(weights.shape[1]):
        total += weights[matrix, i] * rows[world, i, column]
    result[world, matrix * rows.shape[2] + column] = total


@wp.kernel
def add_chunks(parts: wp.array3d(dtype=wp.float64), row: wp.int32, result: wp.array3d(dtype=wp.float64)):
    """Add parts (w, chunks, n) to the first n numbers of a row of the result, (w, s, at least n); dim: (w, n)."""
    world, column = wp.tid()
    total = wp.float64(0.0)
    for chunk in range(parts.shape[1]):
        total += parts[world, chunk, column]
    result[world, row, column] += total


@wp.kernel
def squares(
    values: wp.array3d(dtype=wp.float64),
    starts: wp.array(dtype=wp.int32),
    result: wp.array4d(dtype=wp.float64),
):
    """Compute partial sums of squares of column groups, starts[i] to starts[i + 1]; dim: (w, groups, s, LANES)."""
    world, group, substep, lane = wp.tid()
    total = wp.float64(0.0)
    for column in range(starts[group] + lane, starts[group + 1], LANES):
        value = values[world, substep, column]
        total += value * value
    result[world, group, substep, lane] = total


@wp.kernel
def state_products(
    matrix: wp.array2d(dtype=wp.float64),
    before: wp.array2d(dtype=wp.float64),
    forces: wp.array2d(dtype=wp.float64),
    size: wp.int32,
    result: wp.array3d(dtype=wp.float64),
):
    """Multiply state (w, n) and forces (w, f), joined, by a matrix (n + f, n), in chunks of `size`.

    dim: that of the result, (w, chunks, n)
    """
    world, chunk, column = wp.tid()
    count = before.shape[1]
    total = wp.float64(0.0)
    for i in range(chunk * size, wp.min((chunk + 1) * size, matrix.shape[0])):
        if i < count:
            total += matrix[i, column] * before[world, i]
        else:
            total += matrix[i, column] * forces[world, i - count]
    result[world, chunk, column] = total


@wp.kernel
def sums_of_chunks(parts: wp.array3d(dtype=wp.float64), result: wp.array2d(dtype=wp.float64)):
    """Sum the parts (w, chunks, n) to (w, n); dim: (w, n)."""
    world, column = wp.tid()
    total = wp.float64(0.0)
    for chunk in range(parts.shape[1]):
        total += parts[world, chunk, column]
    result[world, column] = total
