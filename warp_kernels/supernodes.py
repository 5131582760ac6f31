"""Substeps of a layer with a factorised matrix stored as dense blocks of supernodes, in float64 on the CPU.

A supernode is a run of unknowns that are eliminated together. For a matrix L D L^T its block contains the inverse of
the diagonal block, S^-1, and B = L_below L_own^-1, so that a solution is two passes of products with dense blocks:

    forward  u_k = S_k^-1 b_k,  b_below -= B_k b_k,    backward  x_k = u_k - B_k^T x_below.

Blocks are stored in groups of WIDTH rows, in the order in which both passes read them.
"""

import warp as wp

from warp_kernels import FUSED

wp.set_module_options(FUSED)

WIDTH = 16
lanes = wp.types.vector(length=WIDTH, dtype=wp.float64)
ROWS = 12
rows_of_group = wp.types.vector(length=ROWS, dtype=wp.float64)


@wp.struct
class Supernodes:
    """Supernodes. column: first unknown; size: number of unknowns; below: groups of WIDTH rows below; value: start of
    the block in `values`; row: start of the rows below in `rows`, which is padded by the unknown after the last."""

    column: wp.array(dtype=wp.int32)
    size: wp.array(dtype=wp.int32)
    below: wp.array(dtype=wp.int32)
    value: wp.array(dtype=wp.int32)
    row: wp.array(dtype=wp.int32)
    rows: wp.array(dtype=wp.int32)
    values: wp.array(dtype=lanes)


@wp.struct
class GroupedRows:
    """Sparse matrix in groups of ROWS rows, each with the union of the columns of its rows. rows: row numbers, padded
    by the number after the last; start: start of the columns of each group in `columns` and `values`."""

    rows: wp.array(dtype=wp.int32)
    start: wp.array(dtype=wp.int32)
    columns: wp.array(dtype=wp.int32)
    values: wp.array(dtype=rows_of_group)


@wp.struct
class Substep:
    """Common data of all parts of a layer in a substep. Unknowns are numbered as in the factor.

    weights, forces: of load patterns, (k,) and (k, n); matrix @ sums: contribution of the old state to the right side
    solved: result of the forward pass, (n,); solution, in_lanes: result of the backward pass, two views of one memory
    rows: state; it becomes carry @ rows + follow (solution + the last of the sums)
    into_sums: sums are into_sums @ rows; sums, flat_sums: two views of one memory
    """

    weights: wp.array(dtype=wp.float64)
    forces: wp.array2d(dtype=wp.float64)
    matrix: GroupedRows
    nodes: Supernodes
    solved: wp.array(dtype=wp.float64)
    solution: wp.array(dtype=wp.float64)
    in_lanes: wp.array(dtype=lanes)
    rows: wp.array2d(dtype=lanes)
    carry: wp.array2d(dtype=wp.float64)
    follow: wp.array(dtype=wp.float64)
    into_sums: wp.array2d(dtype=wp.float64)
    sums: wp.array2d(dtype=lanes)
    flat_sums: wp.array(dtype=wp.float64)


@wp.struct
class Part:
    """Unknowns, supernodes and row groups of a part, each from the first to the one after the last.

    right: right side of the part, and its contribution to that of the trunk, (n + 1,)
    work, old: work arrays with one entry per unknown of the widest supernode, and per row of a state
    """

    first: wp.int32
    last: wp.int32
    first_node: wp.int32
    last_node: wp.int32
    first_group: wp.int32
    last_group: wp.int32
    right: wp.array(dtype=wp.float64)
    work: wp.array(dtype=lanes)
    old: wp.array(dtype=lanes)


@wp.func
def weigh(part: Part, step: Substep):
    """Set the right side to the forces of the load, weights @ forces."""
    for row in range(part.first, part.last):
        part.right[row] = wp.float64(0.0)
    for k in range(step.weights.shape[0]):
        weight = step.weights[k]
        if weight != wp.float64(0.0):
            for row in range(part.first, part.last):
                part.right[row] = part.right[row] + weight * step.forces[k, row]


@wp.func
def multiply(part: Part, step: Substep):
    """Add matrix @ sums to the right side."""
    for group in range(part.first_group, part.last_group):
        begin = step.matrix.start[group]
        end = step.matrix.start[group + 1]
        # Two sums, so that products do not wait for each other
        even = rows_of_group()
        odd = rows_of_group()
        for pair in range((end - begin) // 2):
            j = begin + 2 * pair
            even += step.matrix.values[j] * step.flat_sums[step.matrix.columns[j]]
            odd += step.matrix.values[j + 1] * step.flat_sums[step.matrix.columns[j + 1]]
        if (end - begin) % 2 == 1:
            even += step.matrix.values[end - 1] * step.flat_sums[step.matrix.columns[end - 1]]
        even += odd
        for i in range(ROWS):
            row = step.matrix.rows[group * ROWS + i]
            part.right[row] = part.right[row] + even[i]


@wp.func
def forward(part: Part, step: Substep):
    """Run the forward pass, which subtracts from the right side below and fills `solved`."""
    for k in range(part.first_node, part.last_node):
        size = step.nodes.size[k]
        begin = step.nodes.column[k]
        at = step.nodes.value[k]
        for group in range((size + WIDTH - 1) // WIDTH):
            total = lanes()
            for j in range(size):
                total += step.nodes.values[at + j] * part.right[begin + j]
            at += size
            for i in range(WIDTH):
                if group * WIDTH + i < size:
                    step.solved[begin + group * WIDTH + i] = total[i]
        row = step.nodes.row[k]
        for _group in range(step.nodes.below[k]):
            total = lanes()
            for j in range(size):
                total += step.nodes.values[at + j] * part.right[begin + j]
            at += size
            for i in range(WIDTH):
                where = step.nodes.rows[row + i]
                part.right[where] = part.right[where] - total[i]
            row += WIDTH


@wp.func
def collect(parts: wp.array(dtype=wp.float64), part: Part):
    """Add the contribution of another part to the right side, and set the contribution to 0."""
    for row in range(part.first, part.last):
        part.right[row] = part.right[row] + parts[row]
        parts[row] = wp.float64(0.0)


@wp.func
def backward(part: Part, step: Substep):
    """Run the backward pass, after the solution below is computed."""
    for back in range(part.last_node - part.first_node):
        k = part.last_node - 1 - back
        size = step.nodes.size[k]
        begin = step.nodes.column[k]
        at = step.nodes.value[k] + size * ((size + WIDTH - 1) // WIDTH)
        row = step.nodes.row[k]
        for j in range(size):
            part.work[j] = lanes()
        for _group in range(step.nodes.below[k]):
            moved = lanes()
            for i in range(WIDTH):
                moved[i] = step.solution[step.nodes.rows[row + i]]
            for j in range(size):
                part.work[j] = part.work[j] + wp.cw_mul(step.nodes.values[at + j], moved)
            at += size
            row += WIDTH
        for j in range(size):
            parts = part.work[j]
            total = wp.float64(0.0)
            for i in range(WIDTH):
                total += parts[i]
            step.solution[begin + j] = step.solved[begin + j] - total


@wp.func
def add_up(first: wp.int32, last: wp.int32, step: Substep):
    """Compute the sums of the state in groups first..last - 1 of unknowns."""
    for group in range(first, last):
        for i in range(step.sums.shape[0]):
            total = lanes()
            for b in range(step.rows.shape[0]):
                total += step.rows[b, group] * step.into_sums[i, b]
            step.sums[i, group] = total


@wp.func
def advance(part: Part, step: Substep):
    """Compute the new state and its sums."""
    count = step.rows.shape[0]
    offset = step.sums.shape[0] - 1
    for group in range(part.first // WIDTH, part.last // WIDTH):
        moved = step.in_lanes[group] + step.sums[offset, group]
        for a in range(count):
            part.old[a] = step.rows[a, group]
        for a in range(count):
            total = moved * step.follow[a]
            for b in range(count):
                total += part.old[b] * step.carry[a, b]
            step.rows[a, group] = total
    add_up(part.first // WIDTH, part.last // WIDTH, step)


@wp.kernel
def begin_substeps(step: Substep):
    """Compute the sums of the state for the first substep."""
    add_up(0, step.rows.shape[1], step)


# Both passes of a branch are in one launch, because threads wait for each other after a launch


@wp.kernel
def go_down(part: Part, step: Substep):
    """Run the forward pass of a branch."""
    weigh(part, step)
    multiply(part, step)
    forward(part, step)


@wp.kernel
def turn_round(part: Part, step: Substep):
    """Run the backward pass of a branch and the forward pass of the next substep, whose weights are available."""
    backward(part, step)
    advance(part, step)
    weigh(part, step)
    multiply(part, step)
    forward(part, step)


@wp.kernel
def go_up(part: Part, step: Substep):
    """Run the last backward pass of a branch."""
    backward(part, step)
    advance(part, step)


@wp.kernel
def pass_trunk(part: Part, one: wp.array(dtype=wp.float64), other: wp.array(dtype=wp.float64), step: Substep):
    """Run both passes of the trunk; one, other: right sides of the branches."""
    weigh(part, step)
    multiply(part, step)
    collect(one, part)
    collect(other, part)
    forward(part, step)
    backward(part, step)
    advance(part, step)
