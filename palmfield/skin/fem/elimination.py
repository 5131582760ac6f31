"""Sparse factors L L^T by dense blocks: groups of unknowns are eliminated together, in parts that threads share.

The method is that of fronts (Duff & Reid, ACM Trans. Math. Softw. 9, 1983). A supernode is a run of unknowns with the
same rows below. Its front is the sum, in these columns, of the matrix and the remainders of earlier supernodes. Dense
products compute its own remainder for later supernodes. Independent branches of the elimination tree run in parallel.

SuperLU solves number by number on one thread. The two passes over blocks (`warp_kernels.supernodes`,
`warp_kernels.block_solves`) read half as much, in storage order. They solve independent branches of the elimination
tree in parallel. For layers of 4000 to 7000 unknowns this is twice as fast on one thread, and three times on two.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from scipy import sparse
from scipy.linalg import lapack

from palmfield.blas import one_blas_thread
from palmfield.device import run_kernel, whole_numbers
from palmfield.threads import cores, share
from palmfield.types import Complex, Float, Int
from warp_kernels import elimination as kernels
from warp_kernels.supernodes import WIDTH, Supernodes, lanes

BRANCHES = 2
"""Number of parts that run in parallel. It is not the number of cores, so that all machines give the same bits."""
MOST_ADDED = 0.1
"""Largest growth of the stored numbers by a merger of two supernodes, as a share."""
SMALLEST = 16
"""Number of unknowns up to which supernodes are always merged."""
COLUMNS = 32
"""Largest size of a complex block whose root is computed column by column."""
SPLIT = 256
"""Least number of rows for which products of the trunk use two threads."""


@dataclass
class Supernode:
    """A run of columns, and the rows below it, ascending, numbered in order of elimination."""

    first: int
    last: int
    rows: Int

    @property
    def stored(self) -> int:
        size = self.last - self.first
        return size * (size + len(self.rows))


def lower_triangle(matrix: Any, order: Int) -> sparse.csc_matrix:
    """Return the lower triangle of a symmetric matrix, sparse (n, n), in elimination order.

    order: old index at each new place, shape (n,)
    """
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    parts = sparse.coo_matrix(matrix)
    row, column = place[parts.row], place[parts.col]
    lower = row >= column
    return sparse.csc_matrix((parts.data[lower], (row[lower], column[lower])), shape=matrix.shape)


def supernodes(matrix: sparse.csc_matrix) -> list[Supernode]:
    """Return the supernodes of a symmetric matrix from its lower triangle, csc (n, n), with a full diagonal."""
    parent, below = _tree(matrix.tocsr())
    count = len(parent)
    begins = np.ones(count, dtype=bool)
    begins[1:] = (parent[:-1] != np.arange(1, count)) | (below[:-1] != below[1:] + 1)
    run_of = np.cumsum(begins) - 1
    firsts = np.flatnonzero(begins).tolist()
    updates: list[list[Int]] = [[] for _ in firsts]
    runs = []
    for first, last, before in zip(firsts, [*firsts[1:], count], updates, strict=True):
        columns = matrix.indices[matrix.indptr[first] : matrix.indptr[first + 1]]
        rows = np.unique(np.concatenate([part[part >= last] for part in (columns, *before)]))
        before.clear()
        runs.append(Supernode(first, last, rows))
        if len(rows):
            updates[run_of[rows[0]]].append(rows)
    return _merged(runs)


def _tree(matrix: sparse.csr_matrix) -> tuple[Int, Int]:
    count = matrix.shape[0]
    above, parent, below = (wp.zeros(count, dtype=wp.int32, device="cpu") for _ in range(3))
    inputs = [whole_numbers(matrix.indptr), whole_numbers(matrix.indices), above, parent, below]
    run_kernel(kernels.elimination_tree, 1, inputs=inputs, device="cpu")
    return parent.numpy(), below.numpy()


def _merged(runs: list[Supernode]) -> list[Supernode]:
    """Merge consecutive supernodes if this adds few numbers."""
    result: list[Supernode] = []
    for run in runs:
        result.append(run)
        while len(result) > 1:
            child, parent = result[-2:]
            if len(child.rows) == 0 or child.rows[0] >= parent.last:
                break
            merged = Supernode(child.first, parent.last, parent.rows)
            few = merged.stored <= (1.0 + MOST_ADDED) * (child.stored + parent.stored)
            if not few and merged.last - merged.first > SMALLEST:
                break
            result[-2:] = [merged]
    return result


def branches(supernodes: list[Supernode]) -> list[list[int]]:
    """Return the numbers of the supernodes, in order, of a trunk and of BRANCHES parts of about equal work."""
    parents = parents_of(supernodes)
    children: list[list[int]] = [[] for _ in supernodes]
    roots = []
    work = np.array([node.stored for node in supernodes], dtype=np.float64)
    for number, parent in enumerate(parents):
        if parent < 0:
            roots.append(number)
        else:
            children[parent].append(number)
            work[parent] += work[number]
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
    for members in best[2]:
        todo, group = list(members), []
        while todo:
            number = todo.pop()
            group.append(number)
            todo.extend(children[number])
        result.append(sorted(group))
    return [*result, sorted(best[1])]


def parents_of(supernodes: list[Supernode]) -> list[int]:
    """Return for each supernode the supernode that contains its first row below, or -1."""
    node_of = np.repeat(np.arange(len(supernodes)), [node.last - node.first for node in supernodes])
    return [int(node_of[node.rows[0]]) if len(node.rows) else -1 for node in supernodes]


def _shared(roots: list[int], work: Float) -> list[list[int]]:
    """Assign trees to parts, the largest tree first, each to the part with the least work; return the trees by part."""
    shares: list[list[int]] = [[] for _ in range(BRANCHES)]
    sums = [0.0] * BRANCHES
    for number in sorted(roots, key=lambda number: (-work[number], number)):
        least = sums.index(min(sums))
        shares[least].append(number)
        sums[least] += float(work[number])
    return shares


def eliminate(
    matrix: sparse.csc_matrix,
    supernodes: list[Supernode],
    groups: Sequence[Sequence[int]],
    store: Callable[[int, Any, Any], object],
) -> None:
    """Compute the factor L of a symmetric matrix L L^T, supernode by supernode.

    matrix: its lower triangle, as for `supernodes`; real and positive definite, or complex with a positive definite
        real part, perhaps after multiplication by a phase factor. groups: as returned by `branches`.
    store: called from several threads with the number of each supernode, the inverse of its own part of L (lower
        triangular, (w, w)), and the part of L below, (rows, w).
    Raises RuntimeError if a real matrix is not positive definite, or if a pivot of a complex matrix is 0.
    """
    parents = parents_of(supernodes)
    updates: list[list[tuple[int, Any]]] = [[] for _ in supernodes]
    root = _complex_root if matrix.dtype.kind == "c" else _real_root

    def go(numbers: Sequence[int], threads: int) -> None:
        for number in numbers:
            node = supernodes[number]
            # The order of the sum is fixed, independent of the order of threads
            before = [(supernodes[child].rows, rest) for child, rest in sorted(updates[number], key=lambda one: one[0])]
            updates[number].clear()
            panel, rest = _front(matrix, node, before)
            before.clear()
            size = node.last - node.first
            try:
                inverse = root(panel[:size])
            except np.linalg.LinAlgError:
                raise RuntimeError(
                    f"the matrix of {matrix.shape[0]} unknowns is not positive definite at unknowns {node.first} "
                    f"to {node.last - 1} (elimination order): check the support and the material of the layer"
                ) from None
            below = panel[size:] @ inverse.T
            if len(node.rows):
                _subtract(rest, below, threads)
                updates[parents[number]].append((number, rest))
            store(number, inverse, below)

    threads = min(cores(), BRANCHES)
    with one_blas_thread:
        *branches, trunk = groups
        share([(partial(go, numbers, 1),) for numbers in branches], threads)
        go(trunk, threads)


def _real_root(own: Float) -> Float:
    """Return the inverse of the lower triangle L of own = L L^T; only the lower triangle of `own` is read."""
    root, failed = lapack.dpotrf(own, lower=1)
    if failed:
        raise np.linalg.LinAlgError
    return np.asarray(lapack.dtrtri(root, lower=1)[0], dtype=np.float64)


def _complex_root(own: Complex) -> Complex:
    """Return the same as `_real_root` for a complex symmetric matrix, by halves; no library offers it."""
    size = len(own)
    inverse = np.zeros((size, size), dtype=complex)
    if size <= COLUMNS:
        root = np.tril(own)
        for j in range(size):
            column = root[j:, j]
            column -= root[j:, :j] @ root[j, :j]
            if column[0] == 0.0:
                raise np.linalg.LinAlgError
            column /= np.sqrt(column[0])
        return np.asarray(np.linalg.inv(root) if size else root)
    half = size // 2
    upper = inverse[:half, :half] = _complex_root(own[:half, :half])
    between = own[half:, :half] @ upper.T
    lower = inverse[half:, half:] = _complex_root(own[half:, half:] - between @ between.T)
    inverse[half:, :half] = -lower @ (between @ upper)
    return inverse


def _front(matrix: sparse.csc_matrix, node: Supernode, before: list[tuple[Int, Any]]) -> tuple[Any, Any]:
    """Return the columns of a supernode, (w + rows, w), and the sum of the remainders for the rows below, (rows, rows).

    Only the lower triangles of symmetric parts are valid. before: rows and remainder of each earlier supernode.
    """
    first, last, rows = node.first, node.last, node.rows
    size = last - first
    panel = np.zeros((size + len(rows), size), dtype=matrix.dtype)
    rest = np.zeros((len(rows), len(rows)), dtype=matrix.dtype)
    begin, end = matrix.indptr[first], matrix.indptr[last]
    row, column = matrix.indices[begin:end], np.repeat(np.arange(size), np.diff(matrix.indptr[first : last + 1]))
    panel[np.where(row < last, row - first, size + np.searchsorted(rows, row)), column] = matrix.data[begin:end]
    for where, values in before:
        runs = _runs(np.where(where < last, where - first, size + np.searchsorted(rows, where)), size)
        for number, (begin, end, at) in enumerate(runs):
            for start, stop, to in runs[: number + 1]:
                front, shift = (panel, 0) if to < size else (rest, size)
                front[at - shift : at - shift + end - begin, to - shift : to - shift + stop - start] += values[
                    begin:end, start:stop
                ]
    return panel, rest


def _runs(places: Int, cut: int) -> list[tuple[int, int, int]]:
    """Return the runs of consecutive `places`, split at place `cut`: index of first, index after last, first place."""
    breaks = np.flatnonzero((np.diff(places) != 1) | (places[1:] == cut)) + 1
    starts = [0, *breaks.tolist()]
    return list(zip(starts, [*starts[1:], len(places)], places[starts].tolist(), strict=True))


def _subtract(rest: Any, below: Any, threads: int) -> None:
    """Compute rest -= below @ below.T, at least the lower triangle, in two halves of equal work.

    One thread uses the same halves as two, because the rounding of BLAS depends on the size of blocks.
    """
    if len(rest) < SPLIT:
        rest -= below @ below.T
        return
    half = len(rest) // 2
    upper, lower = below[:half], below[half:]

    def corners() -> None:
        rest[:half, :half] -= upper @ upper.T
        rest[half:, half:] -= lower @ lower.T

    def between() -> None:
        rest[half:, :half] -= lower @ upper.T

    share([(corners,), (between,)], threads)


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
