"""Sparse matrices as groups of rows with numbers in the same columns, for the products of `warp_kernels.supernodes`.

An ordinary sparse product reads the column of each number. With groups of ROWS rows, each column is read once.
"""

from collections.abc import Sequence

import numpy as np
import warp as wp
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from palmfield.device import whole_numbers
from palmfield.types import Int
from warp_kernels.supernodes import ROWS, GroupedRows, rows_of_group


def grouped_rows(
    matrices: Sequence[sparse.csr_matrix], ranges: Sequence[tuple[int, int]]
) -> tuple[GroupedRows, list[tuple[int, int]]]:
    """Return the matrices side by side, shape (n, m n), with the groups of each range of rows together.

    matrices: m matrices, csr (n, n); ranges: first row, and row after the last, of each; they contain each non-zero row
        once.
    Also returns the first group of each range and the group after its last.
    """
    n = matrices[0].shape[0]
    rows, starts, columns, values, groups = [], [np.zeros(1, np.int64)], [], [], []
    count, ended = 0, 0
    for first, last in ranges:
        begin = count
        for number, matrix in enumerate(matrices):
            part = matrix[first:last].tocoo()
            order = _alike(matrix, first, last)
            members = -(-len(order) // ROWS)
            padded = np.full(members * ROWS, n, np.int32)
            padded[: len(order)] = order
            place = np.empty(last - first, np.int64)
            place[order - first] = np.arange(len(order))
            row = place[part.row]
            pairs, where = np.unique((row // ROWS) * n + part.col, return_inverse=True)
            block = np.zeros((len(pairs), ROWS))
            block[where, row % ROWS] = part.data
            ends = np.searchsorted(pairs, n * np.arange(1, members + 1))
            rows.append(padded)
            starts.append(ended + ends)
            ended += len(pairs)
            columns.append(pairs % n + number * n)
            values.append(block)
            count += members
        groups.append((begin, count))
    result = GroupedRows()
    result.rows, result.start = whole_numbers(np.concatenate(rows)), whole_numbers(np.concatenate(starts))
    result.columns = whole_numbers(np.concatenate(columns))
    result.values = wp.array(np.concatenate(values), dtype=rows_of_group, device="cpu")
    return result, groups


def _alike(matrix: sparse.csr_matrix, first: int, last: int) -> Int:
    """Return the rows first..last - 1, sorted so that rows with equal columns are adjacent (mass couples no x to y)."""
    _, part = connected_components(matrix, directed=False)
    return (first + np.argsort(part[first:last], kind="stable")).astype(np.int32)
