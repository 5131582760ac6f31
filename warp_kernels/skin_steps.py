"""Substeps of a skin's small model on a device, under pressure that other kernels have left there.

Sums are taken in parts, each in a place of its own, and added up in a fixed order: equal input gives equal bits.
"""

import functools
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

ROWS = 4
"""Patterns of pressure that a thread takes: what it reads of the matrix is shared."""
LANES = 32
"""Parts of a sum of squares."""


@wp.kernel
def pressure_products(
    counts: wp.array(dtype=wp.int32),
    pressure: wp.array2d(dtype=wp.float32),
    points: wp.array(dtype=wp.int32),
    matrix: wp.array2d(dtype=wp.float32),
    size: wp.int32,
    result: wp.array3d(dtype=wp.float32),
):
    """Patterns of pressure at some points times a matrix (p, c), in chunks of `size` points, (chunks, rows, c).

    counts[1]: how many patterns there are; pressure: [Pa], shape (m, q); points: numbers of those that count, (p,)
    dim: (rows / ROWS, chunks, c)
    """
    block, chunk, column = wp.tid()
    first = block * ROWS
    if first < counts[1]:
        totals = wp.vec4()
        for i in range(chunk * size, wp.min((chunk + 1) * size, matrix.shape[0])):
            factor = matrix[i, column]
            for r in range(ROWS):
                totals[r] += factor * pressure[wp.min(first + r, pressure.shape[0] - 1), points[i]]
        for r in range(ROWS):
            result[chunk, first + r, column] = totals[r]


@wp.kernel
def mixed_products(
    counts: wp.array(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.float64),
    parts: wp.array3d(dtype=wp.float32),
    result: wp.array2d(dtype=wp.float64),
):
    """Weighted sums of patterns, weights (s, m), of what `pressure_products` found, shape (s, c); dim: (s, c)."""
    substep, column = wp.tid()
    total = wp.float64(0.0)
    for k in range(counts[1]):
        weight = weights[substep, k]
        if weight != wp.float64(0.0):
            own = wp.float64(0.0)
            for chunk in range(parts.shape[0]):
                own += wp.float64(parts[chunk, k, column])
            total += weight * own
    result[substep, column] = total


@functools.cache
def of_rows(rows: int) -> tuple[Any, Any]:
    """Types of a mode's state of `rows` numbers, and of what carries it on."""
    return wp.types.vector(length=rows, dtype=wp.float64), wp.types.matrix(shape=(rows, rows), dtype=wp.float64)


@functools.cache
def lone_modes(rows: int) -> Any:
    """Kernel of all substeps of modes whose states have `rows` numbers; dim: modes."""
    numbers, square = of_rows(rows)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        advance: wp.array(dtype=square),
        inputs: wp.array(dtype=numbers),
        forces: wp.array2d(dtype=wp.float64),
        first: wp.int32,
        last: wp.int32,
        before: wp.array2d(dtype=wp.float64),
        after: wp.array2d(dtype=wp.float64),
    ):
        """A mode's state becomes advance @ state + inputs * force in each substep from the first, before the last.

        forces: of each substep, (s, at least r); before, after: states, (rows, r)
        """
        mode = wp.tid()
        state = numbers()
        for i in range(rows):
            state[i] = before[i, mode]
        own_advance = advance[mode]
        own_inputs = inputs[mode]
        for substep in range(first, last):
            state = own_advance * state + forces[substep, mode] * own_inputs
        for i in range(rows):
            after[i, mode] = state[i]

    return kernel


@functools.cache
def modes_of_worlds(rows: int) -> Any:
    """Kernel of all substeps of modes, whose states have `rows` numbers, in several worlds; dim: (worlds, modes)."""
    numbers, square = of_rows(rows)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        advance: wp.array(dtype=square),
        inputs: wp.array(dtype=numbers),
        pushes: wp.array2d(dtype=wp.float32),
        mixed: wp.array2d(dtype=wp.float32),
        states: wp.array3d(dtype=wp.float64),
        seen: wp.array2d(dtype=wp.float32),
    ):
        """A mode's state becomes advance @ state + inputs * force in each substep, in place, (worlds, rows, r).

        pushes: of each world's pressure on the modes, (worlds, r); mixed: how much of it there is, (worlds, s)
        seen: takes displacement and velocity after each substep, (worlds * s * 2, r); without rows, nothing
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
    rows: wp.array2d(dtype=wp.float64),
    result: wp.array(dtype=wp.float64),
):
    """Weighted sums of rows (k, n), weights (c, k), one after the other, (c * n,); dim: (c, n)."""
    matrix, column = wp.tid()
    total = wp.float64(0.0)
    for i in range(weights.shape[1]):
        total += weights[matrix, i] * rows[i, column]
    result[matrix * rows.shape[1] + column] = total


@wp.kernel
def add_chunks(parts: wp.array2d(dtype=wp.float64), row: wp.int32, result: wp.array2d(dtype=wp.float64)):
    """Parts (chunks, n) added to the first n numbers of a row of the result; dim: n."""
    column = wp.tid()
    total = wp.float64(0.0)
    for chunk in range(parts.shape[0]):
        total += parts[chunk, column]
    result[row, column] += total


@wp.kernel
def squares(
    values: wp.array2d(dtype=wp.float64),
    starts: wp.array(dtype=wp.int32),
    result: wp.array3d(dtype=wp.float64),
):
    """Parts of the sums of squares of groups of columns, starts[i] to starts[i + 1]; dim: (groups, s, LANES)."""
    group, substep, lane = wp.tid()
    total = wp.float64(0.0)
    for column in range(starts[group] + lane, starts[group + 1], LANES):
        value = values[substep, column]
        total += value * value
    result[group, substep, lane] = total


@wp.kernel
def state_products(
    matrix: wp.array2d(dtype=wp.float64),
    before: wp.array(dtype=wp.float64),
    forces: wp.array(dtype=wp.float64),
    size: wp.int32,
    result: wp.array2d(dtype=wp.float64),
):
    """State (n,) and forces (f,), side by side, times a matrix (n + f, n), in chunks of `size` rows; (chunks, n).

    dim: (chunks, n)
    """
    chunk, column = wp.tid()
    count = before.shape[0]
    total = wp.float64(0.0)
    for i in range(chunk * size, wp.min((chunk + 1) * size, matrix.shape[0])):
        if i < count:
            total += matrix[i, column] * before[i]
        else:
            total += matrix[i, column] * forces[i - count]
    result[chunk, column] = total


@wp.kernel
def sums_of_chunks(parts: wp.array2d(dtype=wp.float64), result: wp.array(dtype=wp.float64)):
    """Parts (chunks, n) added up, (n,); dim: n."""
    column = wp.tid()
    total = wp.float64(0.0)
    for chunk in range(parts.shape[0]):
        total += parts[chunk, column]
    result[column] = total
