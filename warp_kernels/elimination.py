"""Structure of the triangular factor of a sparse symmetric matrix, before its values are computed."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT | {"max_unroll": 1})


@wp.kernel
def elimination_tree(
    starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    above: wp.array(dtype=wp.int32),
    parent: wp.array(dtype=wp.int32),
    below: wp.array(dtype=wp.int32),
):
    """Compute parents in the elimination tree, -1 for a root, and the count below the diagonal of each factor column.

    starts, columns: of the rows of the whole matrix; above: work array, one entry per row
    A row of the factor consists of the columns on the tree paths from the entries of the row to its diagonal (Liu, ACM
    Trans. Math. Softw. 12, 1986).
    """
    count = parent.shape[0]
    for row in range(count):
        parent[row] = wp.int32(-1)
        above[row] = wp.int32(-1)
        for at in range(starts[row], starts[row + 1]):
            column = columns[at]
            while column != -1 and column < row:
                following = above[column]
                # Later paths are short
                above[column] = row
                if following == -1:
                    parent[column] = row
                column = following
    for row in range(count):
        below[row] = wp.int32(0)
        above[row] = wp.int32(-1)
    for row in range(count):
        above[row] = row
        for at in range(starts[row], starts[row + 1]):
            column = columns[at]
            if column < row:
                while above[column] != row:
                    above[column] = row
                    below[column] = below[column] + 1
                    column = parent[column]
