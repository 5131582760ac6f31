"""Factors as dense blocks, and sparse matrices by groups of rows, against SciPy."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from palmfield.device import filled
from palmfield.skin.fem.elimination import BRANCHES, block_factor
from palmfield.skin.fem.wedge_stepper import grouped_rows
from warp_kernels import supernodes as kernels


def numbers(values):
    return wp.array(values, dtype=wp.float64, device="cpu", copy=False)


def in_lanes(values):
    wide = values.reshape(*values.shape[:-1], -1, kernels.WIDTH)
    return wp.array(wide, dtype=kernels.lanes, device="cpu", copy=False)


NOTHING = sparse.csr_matrix((4, 4))


def solve(factor, right):
    """A substep of a state of one row that becomes the solution, under a force."""
    size = factor.size
    forces, rows, sums = (np.zeros((1, size)) for _ in range(3))
    forces[0, factor.place] = right
    solution = np.zeros(size + kernels.WIDTH)
    step = filled(
        kernels.Substep(),
        weights=numbers(np.ones(1)), forces=numbers(forces), matrix=grouped_rows([NOTHING], [(0, 4)])[0],
        nodes=factor.nodes, solved=numbers(np.zeros(size)), solution=numbers(solution), in_lanes=in_lanes(solution),
        rows=in_lanes(rows), carry=numbers(np.zeros((1, 1))), follow=numbers(np.ones(1)),
        into_sums=numbers(np.zeros((1, 1))), sums=in_lanes(sums), flat_sums=numbers(sums.ravel()),
    )  # fmt: skip
    work, old = (wp.zeros(count, dtype=kernels.lanes, device="cpu") for count in (factor.widest, 1))
    *branches, trunk = (
        filled(kernels.Part(), right=numbers(np.zeros(size + 1)), work=work, old=old, **part._asdict())
        for part in (*factor.branches, factor.trunk)
    )
    for branch in branches:
        wp.launch(kernels.go_down, 1, inputs=[branch, step], device="cpu")
    wp.launch(kernels.pass_trunk, 1, inputs=[trunk, *(branch.right for branch in branches), step], device="cpu")
    for branch in branches:
        wp.launch(kernels.go_up, 1, inputs=[branch, step], device="cpu")
    return rows[0, factor.place]


def spd(n, edges, rng):
    """A symmetric positive definite matrix with numbers at the edges of a graph, shape (e, 2)."""
    values = rng.standard_normal(len(edges))
    half = sparse.coo_matrix((values, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    both = half + half.T
    return (both + sparse.diags(1.0 + np.abs(both).sum(axis=1).A1)).tocsr()


@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 90), per_node=st.floats(0.0, 3.0), seed=st.integers(0, 2**31))
def test_any_graph_in_any_order_is_solved(n, per_node, seed):
    """Sparse ones fall into trees of their own, dense ones are one supernode."""
    rng = np.random.default_rng(seed)
    edges = rng.integers(0, n, (round(per_node * n), 2))
    matrix = spd(n, edges[edges[:, 0] != edges[:, 1]], rng)
    factor = block_factor(matrix, rng.permutation(n).astype(np.int32))
    parts = (*factor.branches, factor.trunk)
    assert len(factor.branches) == BRANCHES and len(np.unique(factor.place)) == n
    assert sum(part.last_node - part.first_node for part in parts) == len(factor.nodes.size.numpy())
    right = rng.standard_normal(n)
    np.testing.assert_allclose(matrix @ solve(factor, right), right, atol=1e-12 * np.abs(right).max())


def test_what_cancels_to_nothing_in_the_factor_is_no_gap_in_its_structure():
    """Column 19 has as many rows as the one before, but others: SuperLU has left out what came out as 0."""
    n, rng = 101, np.random.default_rng(0)
    lower = np.eye(n)

    def put(rows, column):
        for row in rows:
            lower[row, column] = rng.integers(1, 3) / 16

    for column in range(20):
        put(range(column + 1, 20), column)
    for column in range(19):
        put([*range(20, 30), 90], column)
    put([*range(21, 30), 60, 90], 19)
    for column in range(20, 40):
        put([*range(column + 1, 40), *range(40, 101)], column)
    for column in range(40, 101):
        put(range(column + 1, 101), column)
    matrix = sparse.csr_matrix(lower @ lower.T)
    right = np.arange(1.0, n + 1)
    solved = solve(block_factor(matrix, np.arange(n, dtype=np.int32)), right)
    np.testing.assert_allclose(matrix @ solved, right, atol=1e-9)


def test_islands_and_matrices_of_one_supernode_are_solved():
    rng = np.random.default_rng(0)
    full = rng.standard_normal((40, 40))
    full = full @ full.T + 40.0 * np.eye(40)
    for blocks in ([full], [full, full], [full, full, full], [np.eye(1)], [np.eye(7)]):
        matrix = sparse.block_diag(blocks, format="csr")
        n = matrix.shape[0]
        factor = block_factor(matrix, np.arange(n, dtype=np.int32))
        right = rng.standard_normal(n)
        np.testing.assert_allclose(matrix @ solve(factor, right), right, atol=1e-10)
        grouped_rows([matrix], [(part.first, part.last) for part in (*factor.branches, factor.trunk)])


@pytest.mark.numerics
def test_a_layer_is_solved_and_its_branches_share_the_work(make_spot):
    system = make_spot(0.006, 2, radius_m=0.04).system
    matrix = system.mass / 1e-8 + system.elastic + system.parts[0].stiffness
    factor = block_factor(matrix, system.elimination_order())
    right = np.random.default_rng(0).standard_normal(system.ndof)
    np.testing.assert_allclose(matrix @ solve(factor, right), right, atol=1e-10)
    sizes, below = factor.nodes.size.numpy(), kernels.WIDTH * factor.nodes.below.numpy()
    work = [(sizes * (sizes + below))[part.first_node : part.last_node].sum() for part in factor.branches]
    assert max(work) < 1.5 * min(work)
    assert sum(work) > 0.5 * (sizes * (sizes + below)).sum()


def test_a_matrix_that_is_not_definite_is_refused():
    swapped = sparse.csr_matrix(np.array([[0.0, 1.0], [1.0, 0.0]]))
    with pytest.raises(RuntimeError):
        block_factor(swapped, np.arange(2, dtype=np.int32))


@wp.kernel
def multiply(part: kernels.Part, step: kernels.Substep):
    kernels.multiply(part, step)


@settings(max_examples=40, deadline=None)
@given(n=st.integers(2, 70), density=st.floats(0.0, 0.5), seed=st.integers(0, 2**31))
def test_grouped_rows_multiply_as_the_matrices_do(n, density, seed):
    rng = np.random.default_rng(seed)
    matrices = [sparse.random(n, n, density, format="csr", random_state=rng) for _ in range(2)]
    # One that couples even with even rows only, as a mass does components
    odd = np.arange(n) % 2
    matrices.append(matrices[0].multiply(odd[:, None] == odd).tocsr())
    cut = int(rng.integers(1, n))
    grouped, groups = grouped_rows(matrices, [(0, cut), (cut, n)])
    sums = rng.standard_normal((3, n))
    for (first, last), rows in zip(groups, (slice(0, cut), slice(cut, n)), strict=True):
        right = np.zeros(n + 1)
        part = filled(kernels.Part(), first_group=first, last_group=last, right=numbers(right))
        step = filled(kernels.Substep(), matrix=grouped, flat_sums=numbers(sums.ravel()))
        wp.launch(multiply, 1, inputs=[part, step], device="cpu")
        expected = np.zeros(n)
        expected[rows] = sum(matrix @ part for matrix, part in zip(matrices, sums, strict=True))[rows]
        np.testing.assert_allclose(right[:n], expected, atol=1e-13)
        assert right[n] == 0.0
