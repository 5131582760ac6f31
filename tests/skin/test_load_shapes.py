"""Classes of pressures: what few shapes and few points tell of them."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.skin.reduction.load_shapes import POINTS, TURNS, load_shapes


def spots(count=600, seed=0, width=0.01):
    """Gaussian spots on a square grid of 40 mm, and the areas of its points."""
    side = np.linspace(-0.02, 0.02, 25)
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = np.random.default_rng(seed).uniform(-0.012, 0.012, (count, 1, 2))
    pressures = 100.0 * np.exp(-2.77 * (((grid - centres) / width) ** 2).sum(axis=2))
    return pressures, np.full(len(grid), (side[1] - side[0]) ** 2)


def norm(pressures, weights):
    return np.sqrt((pressures**2 @ weights).sum())


def amplified(made):
    """By how much the fit can amplify what is seen at the points of anything else, at most, rms."""
    return np.linalg.norm(made.fit) / np.linalg.norm(np.linalg.pinv(made.shapes.T))


@pytest.mark.parametrize("tolerance", [0.1, 0.01, 0.001])
def test_shapes_leave_out_what_is_allowed_and_few_points_hardly_more(tolerance):
    examples, weights = spots()
    others, _ = spots(seed=1)
    made = load_shapes(examples, weights, tolerance)
    projected = (examples * weights) @ made.shapes.T @ made.shapes
    assert norm(examples - projected, weights) <= tolerance * norm(examples, weights)
    fewer = made.shapes[:-1]
    assert norm(examples - (examples * weights) @ fewer.T @ fewer, weights) > tolerance * norm(examples, weights)
    assert len(made.points) == POINTS * len(made.shapes) < len(weights)
    seen = (others[:, made.points] @ made.fit.T) @ made.shapes
    best = (others * weights) @ made.shapes.T @ made.shapes
    assert norm(others - best, weights) < 2.0 * tolerance * norm(others, weights)
    assert norm(others - seen, weights) < (1.0 + amplified(made)) * norm(others - best, weights)


def test_shapes_are_orthonormal_and_their_sizes_those_of_the_examples():
    examples, weights = spots()
    made = load_shapes(examples, weights, 0.01)
    np.testing.assert_allclose((made.shapes * weights) @ made.shapes.T, np.eye(len(made.shapes)), atol=1e-8)
    shares = (examples * weights) @ made.shapes.T
    np.testing.assert_allclose(np.sqrt((shares**2).mean(axis=0)), made.sizes, rtol=1e-8)


@pytest.mark.parametrize("tolerance", [0.1, 0.001, 1e-5])
def test_shapes_are_the_leading_singular_vectors(tolerance):
    examples, weights = spots()
    made = load_shapes(examples, weights, tolerance)
    count = len(made.sizes)
    _, sizes, rows = np.linalg.svd(examples * np.sqrt(weights), full_matrices=False)
    np.testing.assert_allclose(made.sizes, sizes[:count] / np.sqrt(len(examples)), rtol=1e-6)
    flat = made.shapes * np.sqrt(weights)
    assert np.linalg.norm(flat - (flat @ rows[:count].T) @ rows[:count]) < 1e-3


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 8), st.integers(0, 1000))
def test_any_sum_of_few_shapes_is_told_by_its_points(count, seed):
    rng = np.random.default_rng(seed)
    patterns, weights = rng.standard_normal((count, 60)), rng.uniform(0.5, 2.0, 60)
    made = load_shapes(rng.standard_normal((20, count)) @ patterns, weights, 1e-6)
    load = rng.standard_normal(count) @ patterns
    np.testing.assert_allclose((made.fit @ load[made.points]) @ made.shapes, load, atol=1e-6 * np.abs(load).max())


def test_points_that_lu_takes_of_many_shapes_tell_them_as_well(monkeypatch):
    examples, weights = spots()
    others, _ = spots(seed=1)
    errors = []
    for many in (10**6, 1):
        monkeypatch.setattr("palmfield.skin.reduction.load_shapes.MANY", many)
        made = load_shapes(examples, weights, 0.001)
        seen = (others[:, made.points] @ made.fit.T) @ made.shapes
        errors.append(norm(others - seen, weights))
    assert errors[1] != errors[0]
    assert errors[1] < 2.0 * errors[0]


def test_ctrl_c_does_not_wait_for_the_search_for_shapes(monkeypatch):
    threads, qr = [], np.linalg.qr

    def noted(matrix):
        threads.append(threading.current_thread().name)
        return qr(matrix)

    monkeypatch.setattr(np.linalg, "qr", noted)
    examples, weights = spots()
    load_shapes(examples, weights, 0.01)
    assert threads[:TURNS] == ["palmfield-native"] * TURNS


def test_what_can_be_no_class_is_refused():
    examples, weights = spots(20)
    with pytest.raises(SceneError, match="does not reach the skin"):
        load_shapes(0.0 * examples, weights, 0.01)
    examples[3, 5] = np.nan
    with pytest.raises(SceneError, match="not finite"):
        load_shapes(examples, weights, 0.01)
