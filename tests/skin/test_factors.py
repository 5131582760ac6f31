"""Factors by blocks against dense algebra: real and complex, one right-hand side and many."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from palmfield.skin.fem.complex_factor import ComplexFactor
from palmfield.skin.fem.elimination import COLUMNS, SPLIT
from palmfield.skin.fem.factor import CHUNK, FEW, Cholesky, Factor, factorise
from palmfield.threads import limit


def definite(n, per_node, rng):
    """A symmetric positive definite matrix with numbers in random places."""
    row, column = rng.integers(0, n, (2, round(per_node * n)))
    half = sparse.coo_matrix((rng.standard_normal(len(row)), (row, column)), shape=(n, n)).tocsr()
    both = half + half.T
    return sparse.csr_matrix(both + sparse.diags(1.0 + np.abs(both).sum(axis=1).A1))


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 120), per_node=st.floats(0.0, 4.0), seed=st.integers(0, 2**31))
def test_real_matrices_in_any_order_are_solved_as_dense_algebra_does(n, per_node, seed):
    rng = np.random.default_rng(seed)
    matrix = definite(n, per_node, rng)
    factor = factorise(matrix, rng.permutation(n).astype(np.int32))
    assert isinstance(factor, Cholesky) and factor.fill >= matrix.nnz
    dense = matrix.toarray()
    for right in (
        rng.standard_normal(n),
        np.asfortranarray(rng.standard_normal((n, FEW))),
        rng.standard_normal((n, CHUNK + 3)),
        rng.standard_normal((n, 2)) + 1j * rng.standard_normal((n, 2)),
    ):
        solved = factor.solve(right)
        assert solved.dtype == right.dtype and solved.shape == right.shape
        expected = np.linalg.solve(dense, right)
        np.testing.assert_allclose(solved, expected, atol=1e-12 * np.abs(expected).max())


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 4 * COLUMNS),
    per_node=st.floats(0.0, 8.0),
    turn=st.floats(0.0, 6.0),
    seed=st.integers(0, 2**31),
)
def test_complex_matrices_with_a_definite_part_after_a_turn_are_solved(n, per_node, turn, seed):
    rng = np.random.default_rng(seed)
    swinging = definite(n, per_node, rng)
    matrix = sparse.csr_matrix(np.exp(1j * turn) * (definite(n, per_node, rng) + 1j * (swinging - 2.0 * sparse.eye(n))))
    factor = factorise(matrix, rng.permutation(n).astype(np.int32))
    assert isinstance(factor, ComplexFactor) and factor.fill >= matrix.nnz
    for right in (rng.standard_normal(n), rng.standard_normal((n, 3)) + 1j * rng.standard_normal((n, 3))):
        expected = np.linalg.solve(matrix.toarray(), right)
        np.testing.assert_allclose(factor.solve(right), expected, atol=1e-10 * np.abs(expected).max())


def test_numbers_that_round_off_has_made_0_on_one_side_only_are_no_gaps():
    """They are where elimination puts one anyway, or not."""
    rng = np.random.default_rng(0)
    matrix = definite(60, 3.0, rng).tolil()
    for row, column in rng.integers(0, 60, (40, 2)):
        if row != column:
            matrix[row, column], matrix[column, row] = 1e-17, 0.0
    matrix = matrix.tocsr()
    matrix.eliminate_zeros()
    order, right = rng.permutation(60).astype(np.int32), rng.standard_normal(60)
    expected = np.linalg.solve(matrix.toarray(), right)
    np.testing.assert_allclose(Cholesky(matrix, order).solve(right), expected, rtol=1e-10)


def test_what_blocks_cannot_take_goes_to_superlu():
    waves = sparse.csr_matrix(np.array([[1.0, 2.0], [2.0, 1.0]]))
    order = np.array([1, 0], np.int32)
    with pytest.raises(RuntimeError, match="matrix of 2 unknowns is not positive definite at unknowns 0 to 1"):
        Cholesky(waves, order)
    factor = factorise(waves, order)
    assert isinstance(factor, Factor)
    np.testing.assert_allclose(factor.solve(np.array([3.0, 3.0])), [1.0, 1.0])
    with pytest.raises(RuntimeError, match="matrix of 2 unknowns"):
        ComplexFactor(sparse.csr_matrix(np.array([[0.0, 1.0], [1.0, 0.0]]), dtype=complex), order)


@pytest.mark.numerics
@pytest.mark.usefixtures("all_cores")
@pytest.mark.parametrize("kind", [float, complex])
def test_one_thread_and_two_give_the_same_bits(kind):
    """Two branches, and a trunk of two supernodes: threads share out the products of its first one."""
    sizes = [300, 300, 130, SPLIT + 4, 200]
    links = np.array([[1, 0, 1, 0, 0], [0, 1, 1, 0, 0], [1, 1, 1, 1, 0], [0, 0, 1, 1, 1], [0, 0, 0, 1, 1]])
    coupled = np.repeat(np.repeat(links, sizes, axis=0), sizes, axis=1)
    half = np.random.default_rng(0).standard_normal(coupled.shape) * coupled
    matrix = sparse.csr_matrix(((half + half.T) * (1.0 - 0.1j if kind is complex else 1.0)).astype(kind))
    matrix += 200.0 * sparse.eye(sum(sizes))
    solved = []
    try:
        for threads in (1, 2):
            limit(threads)
            factor = factorise(matrix, np.arange(sum(sizes), dtype=np.int32))
            assert not isinstance(factor, Factor)
            solved.append(factor.solve(np.ones(sum(sizes))))
    finally:
        limit(None)
    assert np.array_equal(*solved)


@pytest.mark.numerics
def test_a_layer_is_solved_as_by_superlu(make_spot):
    system = make_spot(0.006, 2, radius_m=0.04).system
    stiff = system.mass / 1e-8 + system.elastic + system.parts[0].stiffness
    rng = np.random.default_rng(0)
    for matrix in (stiff, sparse.csr_matrix(stiff * (1.0 - 0.3j) - 2.0 * system.mass / 1e-8)):
        right = rng.standard_normal((system.ndof, CHUNK))
        expected = factorise(matrix).solve(right)
        factor = factorise(matrix, system.elimination_order())
        assert not isinstance(factor, Factor)
        np.testing.assert_allclose(factor.solve(right), expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(factor.solve(right[:, 0]), expected[:, 0], atol=1e-9 * np.abs(expected[:, 0]).max())
