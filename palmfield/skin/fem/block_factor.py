"""A factorised matrix as dense blocks, split into parts that threads solve in parallel.

SuperLU solves number by number on one thread. The two passes over blocks (`warp_kernels.supernodes`,
`warp_kernels.block_solves`) read half as much, in storage order. They solve independent branches of the elimination
tree in parallel. For layers of 4000 to 7000 unknowns this is twice as fast on one thread, and three times on two.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from palmfield.device import whole_numbers
from palmfield.skin.fem.elimination import branches, eliminate, lower_triangle, supernodes
from palmfield.types import Float, Int
from warp_kernels.supernodes import WIDTH, Supernodes, lanes


class Part(NamedTuple):
    """Ranges of unknowns and supernodes that are solved together: the first, and the one after the last."""

    first: int
    last: int
    first_node: int
    last_node: int


@dataclass(frozen=True)
class BlockFactor:
    """Data of the solve kernels. Unknowns are numbered by places: part by part, each padded to groups of WIDTH.

    size: number of places, a multiple of WIDTH. place: place of each unknown of the matrix, shape (n,).
    branches: independent parts. trunk: the part that all branches lead to.
    nodes: the blocks. widest: number of unknowns of the largest supernode. stored: count of numbers in all blocks.
    """

    size: int
    place: Int
    branches: tuple[Part, ...]
    trunk: Part
    nodes: Supernodes
    widest: int
    stored: int


def block_factor(matrix: Any, order: Int, *, multiplied: bool = True) -> BlockFactor:
    """Factorise a real symmetric positive definite matrix, sparse (n, n), eliminated in this order, shape (n,).

    multiplied: whether a block contains S^-1 of its own part and L_below L_own^-1: a solution then reads the least
    data. Otherwise a block contains L_own^-1 and L_below: solutions are then three digits more precise.
    Raises RuntimeError if the matrix is not positive definite.
    """
    lower = lower_triangle(matrix, order)
    nodes = supernodes(lower)
    groups = branches(nodes)
    numbers = [number for group in groups for number in group]
    place, ends = np.empty(len(order), np.int32), []
    at = 0
    for group in groups:
        first = at
        for number in group:
            node = nodes[number]
            place[order[node.first : node.last]] = np.arange(at, at + node.last - node.first)
            at += node.last - node.first
        ends.append((first, -(-at // WIDTH) * WIDTH))
        at = ends[-1][1]
    starts = np.cumsum([0, *(len(group) for group in groups)])
    parts = [Part(*ends[i], int(starts[i]), int(starts[i + 1])) for i in range(len(groups))]
    sizes = np.array([nodes[number].last - nodes[number].first for number in numbers])
    own, below = (-(-count // WIDTH) for count in (sizes, np.array([len(nodes[number].rows) for number in numbers])))
    value_starts = np.concatenate(([0], np.cumsum((own + below) * sizes)))
    row_starts = np.concatenate(([0], WIDTH * np.cumsum(below)))
    values, rows = np.zeros((value_starts[-1], WIDTH)), np.full(row_starts[-1], at, np.int32)
    for number, start in zip(numbers, row_starts, strict=False):
        rows[start : start + len(nodes[number].rows)] = place[order[nodes[number].rows]]
    rank = np.argsort(numbers)

    def store(number: int, inverse: Float, under: Float) -> None:
        here, width = rank[number], len(inverse)
        if multiplied:
            inverse, under = inverse.T @ inverse, under @ inverse
        block = values[value_starts[here] : value_starts[here + 1]].reshape(-1, width, WIDTH)
        for rows_of, groups_of in ((inverse, block[: own[here]]), (under, block[own[here] :])):
            whole = len(rows_of) // WIDTH
            groups_of[:whole] = rows_of[: whole * WIDTH].reshape(whole, WIDTH, width).transpose(0, 2, 1)
            for spare in range(whole * WIDTH, len(rows_of)):
                groups_of[whole, :, spare % WIDTH] = rows_of[spare]

    eliminate(lower, nodes, groups, store)
    blocks = Supernodes()
    blocks.column = whole_numbers([place[order[nodes[number].first]] for number in numbers])
    blocks.size, blocks.below = whole_numbers(sizes), whole_numbers(below)
    blocks.value, blocks.row = whole_numbers(value_starts[:-1]), whole_numbers(row_starts[:-1])
    blocks.rows = whole_numbers(rows)
    blocks.values = wp.array(values, dtype=lanes, device="cpu", copy=False)
    stored = sum(node.stored for node in nodes)
    return BlockFactor(at, place, tuple(parts[:-1]), parts[-1], blocks, int(sizes.max()), stored)
