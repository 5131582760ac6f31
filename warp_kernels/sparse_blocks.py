"""Products, preconditioner and vector steps of conjugate gradients on 3x3 blocks in float64; sums in a fixed order.

Vectors are scalars, three a node. Block rows come in slices of `lanes` rows: entry j of row r lies at
slice_start[r / lanes] + j * lanes + r % lanes, so that neighbouring threads of a GPU read neighbouring blocks; with
one lane it is the usual compressed row. Scalars of the iteration (numerators, denominators) stay on the device.
"""

import warp as wp


@wp.kernel
def multiply(
    starts: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    rows: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    blocks: wp.array(dtype=wp.mat33d),
    lanes: wp.int32,
    x: wp.array(dtype=wp.float64),
    add: wp.int32,
    y: wp.array(dtype=wp.float64),
):
    """y = A x, or y += A x."""
    place = wp.tid()
    total = wp.vec3d()
    at = starts[place / lanes] + place % lanes
    for _ in range(counts[place]):
        c = 3 * columns[at]
        total += blocks[at] * wp.vec3d(x[c], x[c + 1], x[c + 2])
        at += lanes
    r = 3 * rows[place]
    if add != 0:
        total += wp.vec3d(y[r], y[r + 1], y[r + 2])
    y[r] = total[0]
    y[r + 1] = total[1]
    y[r + 2] = total[2]


@wp.kernel
def local_solve(
    inverses: wp.array(dtype=wp.float32),
    offsets: wp.array(dtype=wp.int64),
    firsts: wp.array(dtype=wp.int32),
    sizes: wp.array(dtype=wp.int32),
    members: wp.array(dtype=wp.int32),
    along_rows: wp.int32,
    residual: wp.array(dtype=wp.float64),
    out: wp.array(dtype=wp.float64),
):
    """Rows of the dense inverses of the overlapping subdomains times the residual's own entries.

    offsets: of the subdomain's matrix; firsts, sizes: of its members; all by copy. The matrices are symmetric:
    along_rows reads a thread's row (CPU), otherwise its column, which neighbours read side by side (GPU).
    """
    copy = wp.tid()
    first = firsts[copy]
    size = sizes[copy]
    local = copy - first
    at = offsets[copy]
    step = wp.int64(1)
    if along_rows != 0:
        at += wp.int64(local) * wp.int64(size)
    else:
        at += wp.int64(local)
        step = wp.int64(size)
    total = wp.float64(0.0)
    for j in range(size):
        total += wp.float64(inverses[at]) * residual[members[first + j]]
        at += step
    out[copy] = total


@wp.kernel
def gather(
    starts: wp.array(dtype=wp.int32),
    copies: wp.array(dtype=wp.int32),
    local: wp.array(dtype=wp.float64),
    out: wp.array(dtype=wp.float64),
):
    """Sum over the subdomains' copies of each entry, in their order."""
    i = wp.tid()
    total = wp.float64(0.0)
    for at in range(starts[i], starts[i + 1]):
        total += local[copies[at]]
    out[i] = total


@wp.kernel
def partial_dot(
    a: wp.array(dtype=wp.float64),
    b: wp.array(dtype=wp.float64),
    partial: wp.array(dtype=wp.float64),
):
    """Sum of a b over every len(partial)-th entry."""
    first = wp.tid()
    total = wp.float64(0.0)
    for i in range(first, a.shape[0], partial.shape[0]):
        total += a[i] * b[i]
    partial[first] = total


@wp.kernel
def whole_dot(
    partial: wp.array(dtype=wp.float64),
    values: wp.array(dtype=wp.float64),
    slot: wp.int32,
    shift: wp.int32,
):
    """values[slot] = the sum of the partial sums; the value before it moves to `shift`."""
    total = wp.float64(0.0)
    for i in range(partial.shape[0]):
        total += partial[i]
    values[shift] = values[slot]
    values[slot] = total


@wp.kernel
def descend(
    values: wp.array(dtype=wp.float64),
    direction: wp.array(dtype=wp.float64),
    image: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.float64),
    residual: wp.array(dtype=wp.float64),
):
    """x += alpha p, r -= alpha A p with alpha = (r, z) / (p, A p); nothing once the residual is gone."""
    i = wp.tid()
    alpha = wp.float64(0.0)
    if values[2] > wp.float64(0.0):
        alpha = values[0] / values[2]
    x[i] = x[i] + alpha * direction[i]
    residual[i] = residual[i] - alpha * image[i]


@wp.kernel
def turn(
    values: wp.array(dtype=wp.float64),
    preconditioned: wp.array(dtype=wp.float64),
    direction: wp.array(dtype=wp.float64),
):
    """p = z + beta p with beta = (r, z) new / old; beta is 0 where there is no old one."""
    i = wp.tid()
    beta = wp.float64(0.0)
    if values[1] > wp.float64(0.0):
        beta = values[0] / values[1]
    direction[i] = preconditioned[i] + beta * direction[i]


@wp.kernel
def combine(
    state: wp.array2d(dtype=wp.float64),
    weights: wp.array(dtype=wp.float64),
    out: wp.array(dtype=wp.float64),
):
    """out = weights @ state."""
    i = wp.tid()
    total = wp.float64(0.0)
    for r in range(state.shape[0]):
        total += weights[r] * state[r, i]
    out[i] = total


@wp.kernel
def advance(
    matrix: wp.array2d(dtype=wp.float64),
    follow: wp.array(dtype=wp.float64),
    moved: wp.array(dtype=wp.float64),
    before: wp.array2d(dtype=wp.float64),
    after: wp.array2d(dtype=wp.float64),
):
    """after = matrix @ before + follow x moved."""
    r, i = wp.tid()
    total = follow[r] * moved[i]
    for c in range(before.shape[0]):
        total += matrix[r, c] * before[c, i]
    after[r, i] = total


@wp.kernel
def subtract(
    a: wp.array(dtype=wp.float64),
    b: wp.array(dtype=wp.float64),
    out: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    out[i] = a[i] - b[i]
