"""Substeps of a layer whose factorised matrix is kept as dense blocks of supernodes, in float64 on the CPU.

A supernode is a run of unknowns that are eliminated together. Its block holds, of a matrix L D L^T, the inverse of its
own part, S^-1, and B = L_below L_own^-1, so that a solve is two passes of products with dense blocks:

    forward  u_k = S_k^-1 b_k,  b_below -= B_k b_k,    backward  x_k = u_k - B_k^T x_below.

Blocks are stored WIDTH rows by WIDTH rows, in the order in which both passes read them.
"""

import warp as wp

wp.set_module_options(
    {"enable_backward": False, "max_unroll": 1, "cpu_compiler_flags": "-march=native -ffp-contract=fast"}
)

WIDTH = 16
lanes = wp.types.vector(length=WIDTH, dtype=wp.float64)
ROWS = 8
rows_of_group = wp.types.vector(length=ROWS, dtype=wp.float64)


@wp.struct
class Supernodes:
    """column: first unknown; size: unknowns; below: groups of WIDTH rows below; value: where its block begins in
    `values`; row: where its rows below begin in `rows`, whose padding is the unknown after the last."""

    column: wp.array(dtype=wp.int32)
    size: wp.array(dtype=wp.int32)
    below: wp.array(dtype=wp.int32)
    value: wp.array(dtype=wp.int32)
    row: wp.array(dtype=wp.int32)
    rows: wp.array(dtype=wp.int32)
    values: wp.array(dtype=lanes)


@wp.kernel
def forward(
    nodes: Supernodes,
    first: wp.int32,
    last: wp.int32,
    right: wp.array(dtype=wp.float64),
    solved: wp.array(dtype=wp.float64),
):
    """Supernodes first..last - 1 of the forward pass: takes from `right` of what lies below, and fills `solved`."""
    for k in range(first, last):
        size = nodes.size[k]
        begin = nodes.column[k]
        at = nodes.value[k]
        for group in range((size + WIDTH - 1) // WIDTH):
            total = lanes()
            for j in range(size):
                total += nodes.values[at + j] * right[begin + j]
            at += size
            for i in range(WIDTH):
                if group * WIDTH + i < size:
                    solved[begin + group * WIDTH + i] = total[i]
        row = nodes.row[k]
        for _group in range(nodes.below[k]):
            total = lanes()
            for j in range(size):
                total += nodes.values[at + j] * right[begin + j]
            at += size
            for i in range(WIDTH):
                where = nodes.rows[row + i]
                right[where] = right[where] - total[i]
            row += WIDTH


@wp.kernel
def backward(
    nodes: Supernodes,
    first: wp.int32,
    last: wp.int32,
    solved: wp.array(dtype=wp.float64),
    sums: wp.array(dtype=lanes),
    solution: wp.array(dtype=wp.float64),
):
    """Supernodes last - 1..first of the backward pass, whose rows below are in `solution`; sums: work array."""
    for back in range(last - first):
        k = last - 1 - back
        size = nodes.size[k]
        begin = nodes.column[k]
        at = nodes.value[k] + size * ((size + WIDTH - 1) // WIDTH)
        row = nodes.row[k]
        for j in range(size):
            sums[j] = lanes()
        for _group in range(nodes.below[k]):
            moved = lanes()
            for i in range(WIDTH):
                moved[i] = solution[nodes.rows[row + i]]
            for j in range(size):
                sums[j] = sums[j] + wp.cw_mul(nodes.values[at + j], moved)
            at += size
            row += WIDTH
        for j in range(size):
            parts = sums[j]
            total = wp.float64(0.0)
            for i in range(WIDTH):
                total += parts[i]
            solution[begin + j] = solved[begin + j] - total


@wp.struct
class GroupedRows:
    """A sparse matrix by groups of ROWS rows, each with the columns in which one of them holds a number. rows: their
    numbers, padded by the place after the last; start: where each group's columns begin in `columns` and `values`."""

    rows: wp.array(dtype=wp.int32)
    start: wp.array(dtype=wp.int32)
    columns: wp.array(dtype=wp.int32)
    values: wp.array(dtype=rows_of_group)


@wp.kernel
def weigh(
    first: wp.int32,
    last: wp.int32,
    weights: wp.array(dtype=wp.float64),
    forces: wp.array2d(dtype=wp.float64),
    right: wp.array(dtype=wp.float64),
):
    """Rows first..last - 1 of weights @ forces."""
    for row in range(first, last):
        right[row] = wp.float64(0.0)
    for k in range(weights.shape[0]):
        weight = weights[k]
        if weight != wp.float64(0.0):
            for row in range(first, last):
                right[row] = right[row] + weight * forces[k, row]


@wp.kernel
def multiply(
    matrix: GroupedRows,
    first: wp.int32,
    last: wp.int32,
    sums: wp.array(dtype=wp.float64),
    right: wp.array(dtype=wp.float64),
):
    """Add groups first..last - 1 of matrix @ sums to `right`."""
    for group in range(first, last):
        begin = matrix.start[group]
        end = matrix.start[group + 1]
        # Two sums, so that one product need not wait for the other
        even = rows_of_group()
        odd = rows_of_group()
        for pair in range((end - begin) // 2):
            j = begin + 2 * pair
            even += matrix.values[j] * sums[matrix.columns[j]]
            odd += matrix.values[j + 1] * sums[matrix.columns[j + 1]]
        if (end - begin) % 2 == 1:
            even += matrix.values[end - 1] * sums[matrix.columns[end - 1]]
        even += odd
        for i in range(ROWS):
            row = matrix.rows[group * ROWS + i]
            right[row] = right[row] + even[i]


@wp.kernel
def add_up(into_sums: wp.array2d(dtype=wp.float64), rows: wp.array2d(dtype=lanes), sums: wp.array2d(dtype=lanes)):
    """sums = into_sums @ rows."""
    for i in range(sums.shape[0]):
        for group in range(rows.shape[1]):
            total = lanes()
            for b in range(rows.shape[0]):
                total += rows[b, group] * into_sums[i, b]
            sums[i, group] = total


@wp.kernel
def advance(
    first: wp.int32,
    last: wp.int32,
    solution: wp.array(dtype=lanes),
    carry: wp.array2d(dtype=wp.float64),
    follow: wp.array(dtype=wp.float64),
    into_sums: wp.array2d(dtype=wp.float64),
    old: wp.array(dtype=lanes),
    rows: wp.array2d(dtype=lanes),
    sums: wp.array2d(dtype=lanes),
):
    """Groups first..last - 1 of unknowns: rows of the state become carry @ rows + follow (solution + last of `sums`),
    and sums = into_sums @ rows. old: work array, as long as a state has rows."""
    count = rows.shape[0]
    offset = sums.shape[0] - 1
    for group in range(first, last):
        moved = solution[group] + sums[offset, group]
        for a in range(count):
            old[a] = rows[a, group]
        for a in range(count):
            total = moved * follow[a]
            for b in range(count):
                total += old[b] * carry[a, b]
            rows[a, group] = total
        for i in range(offset + 1):
            total = lanes()
            for b in range(count):
                total += rows[b, group] * into_sums[i, b]
            sums[i, group] = total


@wp.kernel
def collect(first: wp.int32, last: wp.int32, parts: wp.array(dtype=wp.float64), total: wp.array(dtype=wp.float64)):
    """Add rows first..last - 1 of `parts` to `total`, and leave 0 there."""
    for row in range(first, last):
        total[row] = total[row] + parts[row]
        parts[row] = wp.float64(0.0)
