"""Solve with a Cholesky factor L stored as dense blocks of supernodes, in float64 on the CPU.

Blocks are stored as in `warp_kernels.supernodes`, with the inverse of the diagonal block of L and the rows of L below:

    forward  y_k = L_k^-1 b_k,  b_below -= L_below y_k,    backward  x_k = L_k^-T (y_k - L_below^T x_below).
"""

import warp as wp

from warp_kernels import FUSED
from warp_kernels.supernodes import WIDTH, Supernodes, lanes

wp.set_module_options(FUSED)


@wp.struct
class Solve:
    """Supernodes of a part, from the first to the one after the last, and work arrays.

    right: right side of the part, and its contribution to that of the trunk; solved: y; solution: x, (n + WIDTH,)
    work: one entry per unknown of the widest supernode
    """

    first: wp.int32
    last: wp.int32
    first_node: wp.int32
    last_node: wp.int32
    nodes: Supernodes
    right: wp.array(dtype=wp.float64)
    solved: wp.array(dtype=wp.float64)
    solution: wp.array(dtype=wp.float64)
    work: wp.array(dtype=lanes)


@wp.func
def down(part: Solve):
    """Run the forward pass."""
    for k in range(part.first_node, part.last_node):
        size = part.nodes.size[k]
        begin = part.nodes.column[k]
        at = part.nodes.value[k]
        for group in range((size + WIDTH - 1) // WIDTH):
            total = lanes()
            # All entries above the diagonal are zero
            for j in range(wp.min(size, (group + 1) * WIDTH)):
                total += part.nodes.values[at + j] * part.right[begin + j]
            at += size
            for i in range(WIDTH):
                if group * WIDTH + i < size:
                    part.solved[begin + group * WIDTH + i] = total[i]
        row = part.nodes.row[k]
        for _group in range(part.nodes.below[k]):
            total = lanes()
            for j in range(size):
                total += part.nodes.values[at + j] * part.solved[begin + j]
            at += size
            for i in range(WIDTH):
                where = part.nodes.rows[row + i]
                part.right[where] = part.right[where] - total[i]
            row += WIDTH


@wp.func
def up(part: Solve):
    """Run the backward pass, after the solution below is computed."""
    for back in range(part.last_node - part.first_node):
        k = part.last_node - 1 - back
        size = part.nodes.size[k]
        begin = part.nodes.column[k]
        own = (size + WIDTH - 1) // WIDTH
        at = part.nodes.value[k] + size * own
        row = part.nodes.row[k]
        for j in range(size):
            part.work[j] = lanes()
        for _group in range(part.nodes.below[k]):
            moved = lanes()
            for i in range(WIDTH):
                moved[i] = part.solution[part.nodes.rows[row + i]]
            for j in range(size):
                part.work[j] = part.work[j] + wp.cw_mul(part.nodes.values[at + j], moved)
            at += size
            row += WIDTH
        for j in range(size):
            parts = part.work[j]
            total = wp.float64(0.0)
            for i in range(WIDTH):
                total += parts[i]
            part.solved[begin + j] = part.solved[begin + j] - total
            part.work[j] = lanes()
        at = part.nodes.value[k]
        for group in range(own):
            moved = lanes()
            for i in range(WIDTH):
                if group * WIDTH + i < size:
                    moved[i] = part.solved[begin + group * WIDTH + i]
            for j in range(wp.min(size, (group + 1) * WIDTH)):
                part.work[j] = part.work[j] + wp.cw_mul(part.nodes.values[at + j], moved)
            at += size
        for j in range(size):
            parts = part.work[j]
            total = wp.float64(0.0)
            for i in range(WIDTH):
                total += parts[i]
            part.solution[begin + j] = total


@wp.kernel
def go_down(part: Solve):
    """Run the forward pass of a branch; its contribution to the trunk begins with 0."""
    for row in range(part.last, part.right.shape[0]):
        part.right[row] = wp.float64(0.0)
    down(part)


@wp.kernel
def pass_trunk(part: Solve, one: wp.array(dtype=wp.float64), other: wp.array(dtype=wp.float64)):
    """Run both passes of the trunk; one, other: right sides of the branches."""
    for row in range(part.first, part.last):
        part.right[row] = part.right[row] + one[row] + other[row]
    down(part)
    up(part)


@wp.kernel
def go_up(part: Solve):
    """Run the backward pass of a branch."""
    up(part)
