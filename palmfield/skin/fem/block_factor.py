"""A factorised matrix as dense blocks, split into parts that threads solve side by side.

The factors are SuperLU's. Its own solve goes through both triangles number by number on one thread; the two passes
over blocks (`warp_kernels.supernodes`) read half as much, in the order in which it lies, and what the elimination tree
keeps apart is solved at the same time. For layers of 4000 to 7000 unknowns that is twice as fast on one thread, and
three times on two.
"""

import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from scipy import sparse
from scipy.linalg import solve_triangular

from palmfield.blas import one_blas_thread
from palmfield.device import whole_numbers
from palmfield.skin.fem.factor import superlu
from palmfield.types import Float, Int
from warp_kernels.supernodes import WIDTH, Supernodes, lanes

BRANCHES = 2
"""Parts that are solved side by side. Not the number of cores: results repeat to the bit on any machine."""
MOST_ADDED = 0.1
"""Of the numbers of two supernodes, by which making one of them may grow the block."""
SMALLEST = 16
"""Unknowns up to which supernodes are merged whatever that adds."""


class Part(NamedTuple):
    """Unknowns and supernodes that are solved together, each from the first to the one after the last."""

    first: int
    last: int
    first_node: int
    last_node: int


@dataclass(frozen=True)
class BlockFactor:
    """What the kernels solve with. Unknowns are numbered by places: part by part, each padded to groups of WIDTH.

    size: places, a multiple of WIDTH; place: of each unknown of the matrix, shape (n,)
    branches: parts that need nothing of one another; trunk: what all of them lead to
    nodes: the blocks; widest: unknowns of the largest supernode; stored: numbers in all blocks
    """

    size: int
    place: Int
    branches: tuple[Part, ...]
    trunk: Part
    nodes: Supernodes
    widest: int
    stored: int


@dataclass
class _Supernode:
    """A run of columns, and the rows below it, in order of elimination."""

    first: int
    last: int
    rows: Int

    @property
    def stored(self) -> int:
        size = self.last - self.first
        return size * (size + len(self.rows))


def block_factor(matrix: Any, order: Int) -> BlockFactor:
    """Factorise a symmetric positive definite matrix, sparse (n, n), eliminated in this order, shape (n,).

    Raises RuntimeError where a pivot is 0 or was exchanged, as for a matrix of another kind.
    """
    lower, diagonal, order = superlu(matrix, order).triangle()
    supernodes = _merged(lower)
    groups = _branches(supernodes)
    place, ends = np.empty(len(order), np.int32), []
    at = 0
    for group in groups:
        first = at
        for number in group:
            node = supernodes[number]
            place[order[node.first : node.last]] = np.arange(at, at + node.last - node.first)
            at += node.last - node.first
        ends.append((first, -(-at // WIDTH) * WIDTH))
        at = ends[-1][1]
    starts = np.cumsum([0, *(len(group) for group in groups)])
    parts = [Part(*ends[i], int(starts[i]), int(starts[i + 1])) for i in range(len(groups))]
    nodes = [supernodes[number] for group in groups for number in group]
    packed = _packed(nodes, lower, diagonal, place[order], at)
    widest = max(node.last - node.first for node in nodes)
    return BlockFactor(at, place, tuple(parts[:-1]), parts[-1], packed, widest, sum(node.stored for node in nodes))


def _merged(lower: sparse.csc_matrix) -> list[_Supernode]:
    """Runs of columns with the same rows below, and of such runs where that adds few numbers.

    SuperLU leaves out what has come out as exactly 0, so that the structure is closed here: what a run has below its
    parent, the run of its first row, the parent has too. Then all rows below a run lie on its way to the root.
    """
    starts, rows = lower.indptr, lower.indices
    columns = [rows[start + 1 : end] for start, end in itertools.pairwise(starts)]
    runs, first = [], 0
    for last in range(1, len(columns) + 1):
        before = columns[last - 1]
        leads_on = last < len(columns) and len(before) > 0 and before[0] == last
        if not (leads_on and np.array_equal(before[1:], columns[last])):
            runs.append(_Supernode(first, last, before))
            first = last
    run_of = np.repeat(np.arange(len(runs)), [run.last - run.first for run in runs])
    for run in runs:
        if len(run.rows):
            parent = runs[run_of[run.rows[0]]]
            parent.rows = np.union1d(parent.rows, run.rows[run.rows >= parent.last])
    result: list[_Supernode] = []
    for run in runs:
        result.append(run)
        while len(result) > 1:
            child, parent = result[-2:]
            if len(child.rows) == 0 or child.rows[0] >= parent.last:
                break
            merged = _Supernode(child.first, parent.last, parent.rows)
            few = merged.stored <= (1.0 + MOST_ADDED) * (child.stored + parent.stored)
            if not few and merged.last - merged.first > SMALLEST:
                break
            result[-2:] = [merged]
    return result


def _branches(supernodes: list[_Supernode]) -> list[list[int]]:
    """Numbers of the supernodes of BRANCHES parts with about the same work, and of the trunk, each in order."""
    node_of = np.repeat(np.arange(len(supernodes)), [node.last - node.first for node in supernodes])
    children: list[list[int]] = [[] for _ in supernodes]
    roots = []
    work = np.array([node.stored for node in supernodes], dtype=np.float64)
    for number, node in enumerate(supernodes):
        if len(node.rows):
            parent = int(node_of[node.rows[0]])
            children[parent].append(number)
            work[parent] += work[number]
        else:
            roots.append(number)
    trunk: list[int] = []
    best: tuple[float, list[int], list[list[int]]] | None = None
    while True:
        shares = _shared(roots, work)
        trunk_work = sum(supernodes[number].stored for number in trunk)
        time = trunk_work + max(sum(work[number] for number in share) for share in shares)
        if best is None or time < best[0]:
            best = time, list(trunk), shares
        if not roots or trunk_work > 0.5 * work.max():
            break
        largest = max(roots, key=lambda number: work[number])
        roots.remove(largest)
        roots.extend(children[largest])
        trunk.append(largest)
    result = []
    for share in best[2]:
        todo, members = list(share), []
        while todo:
            number = todo.pop()
            members.append(number)
            todo.extend(children[number])
        result.append(sorted(members))
    return [*result, sorted(best[1])]


def _shared(roots: list[int], work: Float) -> list[list[int]]:
    """Trees by the part that gets them: the largest first, each to the part with least to do."""
    shares: list[list[int]] = [[] for _ in range(BRANCHES)]
    sums = [0.0] * BRANCHES
    for number in sorted(roots, key=lambda number: (-work[number], number)):
        least = sums.index(min(sums))
        shares[least].append(number)
        sums[least] += float(work[number])
    return shares


def _packed(nodes: list[_Supernode], lower: sparse.csc_matrix, diagonal: Float, place: Int, size: int) -> Supernodes:
    """The blocks for the kernels. place: of each column of `lower`, shape (n,); size: places, to which padding goes."""
    groups = [(-(-(node.last - node.first) // WIDTH), -(-len(node.rows) // WIDTH)) for node in nodes]
    lengths = [(own + below) * (node.last - node.first) for node, (own, below) in zip(nodes, groups, strict=True)]
    values = np.zeros((sum(lengths), WIDTH))
    rows = np.full(WIDTH * sum(below for _, below in groups), size, np.int32)
    value_starts, row_starts = np.cumsum([0, *lengths]), WIDTH * np.cumsum([0, *(below for _, below in groups)])
    with one_blas_thread:
        for node, (own, below), value, row in zip(nodes, groups, value_starts, row_starts, strict=False):
            width = node.last - node.first
            begin, end = lower.indptr[node.first], lower.indptr[node.last]
            where = np.concatenate((np.arange(node.first, node.last), node.rows))
            columns = np.repeat(np.arange(width), np.diff(lower.indptr[node.first : node.last + 1]))
            block, row_of = np.zeros((len(where), width)), np.searchsorted(where, lower.indices[begin:end])
            assert np.array_equal(where[np.minimum(row_of, len(where) - 1)], lower.indices[begin:end])
            block[row_of, columns] = lower.data[begin:end]
            inverse = solve_triangular(block[:width], np.eye(width), lower=True, unit_diagonal=True)
            padded = np.zeros(((own + below) * WIDTH, width))
            padded[:width] = inverse.T @ (inverse / diagonal[node.first : node.last, None])
            padded[own * WIDTH : own * WIDTH + len(node.rows)] = block[width:] @ inverse
            by_column = padded.reshape(own + below, WIDTH, width).transpose(0, 2, 1)
            values[value : value + (own + below) * width] = by_column.reshape(-1, WIDTH)
            rows[row : row + len(node.rows)] = place[node.rows]
    result = Supernodes()
    result.column = whole_numbers([place[node.first] for node in nodes])
    result.size = whole_numbers([node.last - node.first for node in nodes])
    result.below = whole_numbers([below for _, below in groups])
    result.value, result.row = whole_numbers(value_starts[:-1]), whole_numbers(row_starts[:-1])
    result.rows = whole_numbers(rows)
    result.values = wp.array(values, dtype=lanes, device="cpu", copy=False)
    return result
