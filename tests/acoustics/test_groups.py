"""Groups of transducers, and the form of the kernels for boards that are not quite flat."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.acoustics.arrays import combined, layout, placed
from palmfield.acoustics.field import MODES, FieldEvaluator, Mode
from palmfield.acoustics.groups import groups
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array, Float

AIR = Air()
TURN = Rotation.from_euler("xyz", [20.0, -35.0, 10.0], degrees=True).as_matrix()


def rounded() -> Array:
    """A tilted board whose positions have six decimals, as files do."""
    array = placed(layout("uhev1"), [0.03, -0.02, 0.01], TURN)
    return replace(array, positions=np.round(array.positions, 6))


def before(array: Array, count: int, low: float = 0.05, high: float = 0.4) -> Float:
    """Points in front of a tilted board."""
    box = np.random.default_rng(0).uniform([-0.1, -0.1, low], [0.1, 0.1, high], (count, 3))
    return box @ TURN.T + array.positions.mean(axis=0)


def difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def test_boards_are_sorted_by_plane_or_by_axis() -> None:
    board = layout("uhev1")
    for array, count, flat in (
        (board, 1, True),
        (placed(board, [0.0, 0.1, 0.2], TURN), 1, True),
        (rounded(), 1, False),
        (combined([placed(board, [0.0, 0.0, 0.01 * i], np.eye(3)) for i in range(4)]), 4, True),
        (combined([rounded(), placed(rounded(), [0.2, 0.0, 0.0], TURN)]), 2, False),
    ):
        found = groups(array)
        assert (len(found.ranges), found.flat) == (count, flat)
        assert sorted(found.order) == list(range(len(array)))
    directions = np.random.default_rng(1).normal(size=(256, 3))
    normals = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert len(groups(replace(board, normals=normals)).ranges) == 256


@pytest.mark.parametrize(("mode", "limit"), [("fast", 3e-5), ("accurate", 2e-5)])
@pytest.mark.parametrize("spread_m", [0.0, 0.03])
def test_heights_are_exact(mode: Mode, limit: float, spread_m: float) -> None:
    """A board with rounded positions, and one whose transducers stand up to centimetres before or behind its plane."""
    array = rounded()
    random = np.random.default_rng(2)
    array = replace(array, positions=array.positions + random.uniform(-spread_m, spread_m, (256, 1)) * array.normals)
    assert not groups(array).flat
    drive = random.normal(size=(256, 2)) @ [1.0, 1.0j]
    points = before(array, 1501)
    found = FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, drive, gradient=True)
    p, g = pressure64(points, array, drive, AIR, gradient=True)
    assert found.gradient is not None and g is not None
    assert difference(found.pressure, p) < limit and difference(found.gradient, g) < limit
    alone = FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, drive)
    assert difference(alone.pressure, p) < limit


@pytest.mark.parametrize("mode", MODES)
def test_each_transducer_has_its_own_baffle(mode: Mode) -> None:
    """Points among the heights: in front of some transducers, behind others, and at one's own place."""
    array = rounded()
    random = np.random.default_rng(3)
    array = replace(array, positions=array.positions + random.uniform(-0.03, 0.03, (256, 1)) * array.normals)
    points = np.concatenate([before(array, 400, -0.02, 0.02), array.positions[:2]])
    height = np.einsum("ijk,jk->ij", points[:, None] - array.positions, array.normals)
    assert (height > 0.0).any(axis=1).all() and (height < 0.0).any(axis=1).all()
    drive = random.normal(size=(256, 2)) @ [1.0, 1.0j]
    drive[:2] = 0.0
    found = FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, drive, gradient=True)
    p, g = pressure64(points, array, drive, AIR, gradient=True)
    assert found.gradient is not None and g is not None
    assert difference(found.pressure, p) < 3e-5 and difference(found.gradient, g) < 1e-4


@pytest.mark.parametrize("gradient", [False, True])
def test_a_height_for_each_transducer_costs_little(gradient: bool) -> None:
    """Best of several runs in turns: more than half the speed of the same board without rounding."""
    boards = [placed(layout("uhev1"), [0.0, 0.0, 0.0], TURN), rounded()]
    points = before(boards[0], 8000).astype(np.float32)
    evaluators = [FieldEvaluator(board, AIR, "cpu", threads=1) for board in boards]
    assert [groups(board).flat for board in boards] == [True, False]
    seconds: list[list[float]] = [[], []]
    for _ in range(7):
        for evaluator, times in zip(evaluators, seconds, strict=True):
            start = time.thread_time()
            evaluator.pressure(points, np.ones(256), gradient)
            times.append(time.thread_time() - start)
    assert min(seconds[0]) / min(seconds[1]) > 0.5
