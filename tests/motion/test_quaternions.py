"""Quaternions of a few rotations, held against SciPy's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.motion.quaternions import inverse, matrices, of_turns, product, turns_of, unit

DRAWS = np.random.default_rng(3)
SIZES = np.concatenate([[0.0, 1e-12, 1e-5, 0.9e-3, 1.1e-3], DRAWS.uniform(0.0, np.pi, 30), [np.pi - 1e-9]])
AXES = DRAWS.normal(size=(len(SIZES), 3))
TURNS = SIZES[:, None] * AXES / np.linalg.norm(AXES, axis=1)[:, None]


def test_turns_quaternions_and_matrices_are_scipys():
    made = Rotation.from_rotvec(TURNS)
    np.testing.assert_allclose(of_turns(TURNS), made.as_quat(scalar_first=True), atol=1e-15)
    np.testing.assert_allclose(matrices(of_turns(TURNS)), made.as_matrix(), atol=1e-15)
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(turns_of(sign * of_turns(TURNS)), TURNS, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("length", [1.0, 1e-3, 7.0])
def test_products_and_inverses_are_scipys(length):
    first, then = Rotation.from_rotvec(TURNS), Rotation.from_rotvec(TURNS[::-1])
    a, b = (unit(length * one.as_quat(scalar_first=True)) for one in (then, first))
    np.testing.assert_allclose(matrices(product(a, b)), (then * first).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(matrices(product(a, inverse(a))), np.broadcast_to(np.eye(3), (len(a), 3, 3)), atol=1e-14)
