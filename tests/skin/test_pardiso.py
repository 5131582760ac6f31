"""PARDISO behind the seam of factors, where the extra `mkl` is installed; and what switches it off, everywhere."""

import gc
import os
import threading

import numpy as np
import pytest
from scipy import sparse

from palmfield.errors import PalmfieldError
from palmfield.skin.fem import pardiso
from palmfield.skin.fem.factor import SWITCH, Factor, factorise
from palmfield.skin.fem.pardiso import PardisoFactor, library

installed = pytest.mark.skipif(library() is None, reason="the extra 'mkl' is not installed")


@pytest.fixture
def stiff():
    """A symmetric positive definite matrix of a grid, 400 unknowns, whose inverse is known densely."""
    line = sparse.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(20, 20))
    return sparse.csr_matrix(sparse.kronsum(line, line))


@installed
def test_real_matrices_are_solved_as_dense_algebra_does(stiff):
    factor, rng = factorise(stiff), np.random.default_rng(0)
    assert isinstance(factor, PardisoFactor) and factor.fill > stiff.nnz
    inverse = np.linalg.inv(stiff.toarray())
    for right in (
        rng.normal(size=400),
        np.asfortranarray(rng.normal(size=(400, 7))),
        rng.normal(size=(400, 3)) + 1j * rng.normal(size=(400, 3)),
    ):
        solved = factor.solve(right)
        assert solved.dtype == right.dtype
        assert np.linalg.norm(solved - inverse @ right) < 1e-11 * np.linalg.norm(solved)


@installed
def test_several_factors_live_at_once_and_serve_a_thread_at_a_time(stiff):
    factors = [factorise(stiff + shift * sparse.identity(400)) for shift in (0.0, 1.0)]
    right = np.arange(400.0)
    expected = [np.linalg.solve(stiff.toarray() + shift * np.eye(400), right) for shift in (0.0, 1.0)]
    found = []

    def ask(which):
        for _ in range(20):
            found.append(np.linalg.norm(factors[which].solve(right) - expected[which]))

    threads = [threading.Thread(target=ask, args=(n % 2,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 80 and max(found) < 1e-10 * np.linalg.norm(expected[1])
    del factors[0]
    gc.collect()
    assert np.linalg.norm(factors[0].solve(right) - expected[1]) < 1e-10 * np.linalg.norm(expected[1])


@installed
def test_matrices_that_it_cannot_take_go_to_superlu(stiff):
    waves = stiff - 2.0 * sparse.identity(400)
    assert np.linalg.eigvalsh(waves.toarray())[0] < 0.0
    with pytest.raises(RuntimeError, match="matrix of 400 unknowns is not positive definite"):
        PardisoFactor(waves)
    factor = factorise(waves)
    assert isinstance(factor, Factor)
    assert np.abs(waves @ factor.solve(np.ones(400)) - 1.0).max() < 1e-9
    assert isinstance(factorise(stiff.astype(complex)), Factor)


@installed
def test_a_factor_is_not_used_after_a_fork(stiff, monkeypatch):
    factor = factorise(stiff)
    monkeypatch.setattr(os, "getpid", lambda: 1)
    with pytest.raises(RuntimeError, match="is used in process 1, which was forked from it"):
        factor.solve(np.ones(400))


@installed
@pytest.mark.parametrize("word", ["off", "0", "None"])
def test_it_is_switched_off_by_the_environment(stiff, monkeypatch, word):
    monkeypatch.setenv(SWITCH, word)
    assert isinstance(factorise(stiff), Factor)


def test_a_switch_that_is_neither_is_refused(stiff, monkeypatch):
    monkeypatch.setenv(SWITCH, "maybe")
    with pytest.raises(PalmfieldError, match="PALMFIELD_PARDISO is 'maybe'; allowed: on, or off, 0, none"):
        factorise(stiff)


def test_superlu_serves_where_it_is_not_installed(stiff, monkeypatch):
    monkeypatch.setattr(pardiso, "library", lambda: None)
    factor = factorise(stiff)
    assert isinstance(factor, Factor)
    assert np.abs(stiff @ factor.solve(np.ones(400)) - 1.0).max() < 1e-12
