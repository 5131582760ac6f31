"""Products of large matrices by tiles, for GPUs."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

ROWS = 64
"""Number of rows of the result in a tile."""
COLUMNS = 128
DEPTH = 32


@wp.kernel
def product(
    left: wp.array(dtype=wp.float32, ndim=2),
    right: wp.array(dtype=wp.float32, ndim=2),
    result: wp.array(dtype=wp.float32, ndim=2),
):
    """Compute left @ right, one tile per block; entries beyond the edges are zero."""
    i, j = wp.tid()
    total = wp.tile_zeros(shape=(ROWS, COLUMNS), dtype=wp.float32)
    for k in range((left.shape[1] + DEPTH - 1) / DEPTH):
        a = wp.tile_load(left, shape=(ROWS, DEPTH), offset=(i * ROWS, k * DEPTH))
        b = wp.tile_load(right, shape=(DEPTH, COLUMNS), offset=(k * DEPTH, j * COLUMNS))
        wp.tile_matmul(a, b, total)
    wp.tile_store(result, total, offset=(i * ROWS, j * COLUMNS))
