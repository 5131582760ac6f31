"""Structure of the triangular factor of a sparse symmetric matrix, before its values are computed."""

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def elimination_tree(
    starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    above: wp.array(dtype=wp.int32),
    parent: wp.array(dtype=wp.int32),
    below: wp.array(dtype=wp.int32),
):
    """Parents in the elimination tree, -1 for a root, and numbers below the diagonal of each column of the factor.

    starts, columns: of the rows of the whole matrix; above: work, as long as there are rows
    Liu, ACM Trans. Math. Softw. 12, 1986: a row of the factor is what the ways from the row's numbers to its own
    column pass.
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
