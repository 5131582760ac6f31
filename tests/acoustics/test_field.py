"""Consistency: the float32 kernels with the float64 twin, and with one another."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyder

from palmfield.acoustics import field, polynomials
from palmfield.acoustics.arrays import layout, with_faults
from palmfield.acoustics.directivities import FORMS
from palmfield.acoustics.directivities.t4010a1 import T4010A1_DIRECTIVITY
from palmfield.acoustics.field import (
    MODES,
    SIZES_STORED,
    CUBIC_REACH_Np,
    FieldEvaluator,
    Mode,
    polynomial_fall,
    pressure,
)
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.validity import PalmfieldWarning
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Array, Field

pytestmark = pytest.mark.numerics

AIR = Air()
LIMIT = 3e-5


def cloud(count: int, seed: int = 0, low: float = 0.05, high: float = 0.4) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-0.1, -0.1, low], [0.1, 0.1, high], (count, 3))


def difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def assert_close(found: Field, points: np.ndarray, array: Array, drive: np.ndarray, **options: float) -> None:
    p, g = pressure64(points, array, drive, AIR, gradient=True, **options)
    assert found.gradient is not None and g is not None
    assert found.pressure.dtype == found.gradient.dtype == np.complex64
    assert difference(found.pressure, p) < LIMIT
    assert difference(found.gradient, g) < LIMIT


@pytest.mark.parametrize("name", ["uhev1", "sonicsurface"])
@pytest.mark.parametrize("target", [(0.0, 0.0, 0.2), (0.05, -0.03, 0.1), (-0.08, 0.06, 0.35)])
def test_field_agrees_with_its_float64_twin(name: str, target: tuple[float, float, float]) -> None:
    array = layout(name)
    drive = focus(array, AIR, target)
    points = cloud(3001)
    found = pressure(points, array, drive, AIR, gradient=True, device="cpu", warn=False)
    assert_close(found, points, array, drive)
    only = pressure(points, array, drive, AIR, device="cpu", warn=False)
    assert only.gradient is None
    # Each kernel rounds in its own units of length
    assert difference(only.pressure, found.pressure.astype(complex)) < LIMIT


@pytest.mark.parametrize(("mode", "low", "high", "limit"), [
    ("fast", 0.05, 0.4, 3e-5), ("fast", 0.4, 1.2, 1e-4), ("accurate", 0.05, 0.4, 2e-5), ("accurate", 0.4, 1.2, 2e-5),
])  # fmt: skip
def test_error_by_mode_and_distance(mode: Mode, low: float, high: float, limit: float) -> None:
    array = layout("autd3_2x2")
    drive = focus(array, AIR, (0.02, 0.01, 0.2))
    points = cloud(2003, low=low, high=high)
    found = FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, drive, gradient=True)
    p, g = pressure64(points, array, drive, AIR, gradient=True)
    assert found.gradient is not None and g is not None
    assert difference(found.pressure, p) < limit
    assert difference(found.gradient, g) < limit


def test_accurate_mode_keeps_what_float32_positions_lose() -> None:
    array = layout("uhev1")
    drive = focus(array, AIR, (0.0, 0.0, 3.0))
    points = cloud(500, low=2.9, high=3.1)
    exact, _ = pressure64(points, array, drive, AIR)
    errors = [
        difference(FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, drive).pressure, exact)
        for mode in ("fast", "accurate")
    ]
    assert errors[1] < 2e-5 < errors[0]


def test_gain_and_measured_directivity_reach_the_kernels() -> None:
    flat = layout("uhev1")
    array = replace(with_faults(flat, dead=[3, 77], inverted=[5, 200]), directivity_table=T4010A1_DIRECTIVITY)
    drive = np.random.default_rng(2).normal(size=(256, 2)) @ [1, 1j]
    points = cloud(1501)
    found = FieldEvaluator(array, AIR, "cpu").pressure(points, drive, gradient=True)
    assert_close(found, points, array, drive)
    without = FieldEvaluator(flat, AIR, "cpu").pressure(points, drive)
    assert difference(without.pressure, found.pressure.astype(complex)) > 0.01


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(PalmfieldError, match=r"'exact'.*fast, accurate"):
        FieldEvaluator(layout("uhev1"), AIR, "cpu", mode=cast(Any, "exact"))


@pytest.mark.parametrize("mode", MODES)
def test_tilted_transducers_and_points_behind_some_of_them(mode: Mode) -> None:
    flat = layout("uhev1")
    normals = flat.normals + np.random.default_rng(1).uniform(-0.6, 0.6, (256, 3))
    array = replace(flat, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))
    drive = np.random.default_rng(2).normal(size=(256, 2)) @ [1, 1j]
    points = cloud(500, low=0.01, high=0.1)
    behind = np.einsum("ijk,jk->ij", points[:, None] - array.positions, array.normals) <= 0
    assert behind.any()
    found = FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, drive, gradient=True)
    assert_close(found, points, array, drive)


@pytest.mark.parametrize("mode", MODES)
def test_baffle_and_an_elements_own_position(mode: Mode) -> None:
    array = layout("uhev1")
    points = np.array([array.positions[17], [0.0, 0.0, -0.1], [0.3, 0.0, 0.0]])
    found = FieldEvaluator(array, AIR, "cpu", mode=mode).pressure(points, np.ones(256), gradient=True)
    assert found.gradient is not None
    assert np.all(found.pressure == 0.0) and np.all(found.gradient == 0.0)


def test_far_points_and_strong_absorption_leave_the_polynomial_fall_and_stay_right() -> None:
    array = layout("uhev1")
    drive = focus(array, AIR, (0.0, 0.0, 0.2))
    points = cloud(300)
    evaluator = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=8.0)
    assert CUBIC_REACH_Np < 8.0 * 0.35
    assert_close(evaluator.pressure(points, drive, gradient=True), points, array, drive, absorption_Np_m=8.0)


def test_large_sets_are_shared_among_threads_with_the_same_result() -> None:
    array = layout("uhev1")
    drive = focus(array, AIR, (0.0, 0.0, 0.2))
    points = cloud(20_011).astype(np.float32)
    one = FieldEvaluator(array, AIR, "cpu", threads=1).pressure(points, drive, gradient=True)
    three = FieldEvaluator(array, AIR, "cpu", threads=3).pressure(points, drive, gradient=True)
    np.testing.assert_array_equal(one.pressure, three.pressure)
    np.testing.assert_array_equal(one.gradient, three.gradient)


def test_one_evaluator_serves_several_threads_at_once() -> None:
    array = layout("uhev1")
    evaluator = FieldEvaluator(array, AIR, "cpu")
    points = cloud(8000)
    drives = [focus(array, AIR, (0.0, y, 0.2)) for y in (-0.03, -0.01, 0.01, 0.03)]
    alone = [evaluator.pressure(points, drive).pressure for drive in drives]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda drive: evaluator.pressure(points, drive).pressure, drives * 3))
    for i, found in enumerate(together):
        np.testing.assert_array_equal(found, alone[i % 4])


@pytest.mark.parametrize("threads", [0, -1])
def test_threads_must_be_able_to_compute(threads: int) -> None:
    with pytest.raises(PalmfieldError, match=f"threads = {threads}; allowed: 1 or more"):
        FieldEvaluator(layout("uhev1"), AIR, "cpu", threads=threads)


@pytest.mark.usefixtures("all_cores")
def test_threads_are_as_many_as_the_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 6}, raising=False)
    assert FieldEvaluator(layout("uhev1"), AIR, "cpu").threads == 3


FORKED = """
import os, signal, sys
import numpy as np
from palmfield.acoustics import FieldEvaluator, layout
from palmfield.types import Air
evaluator = FieldEvaluator(layout("uhev1"), Air(), "cpu", threads=2)
points = np.random.default_rng(0).uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.3], (20_000, 3))
before = evaluator.pressure(points, np.ones(256)).pressure
child = os.fork()
if child == 0:
    signal.alarm(30)
    os._exit(0 if np.array_equal(evaluator.pressure(points, np.ones(256)).pressure, before) else 1)
sys.exit(os.waitpid(child, 0)[1])
"""


def test_a_forked_child_computes_too() -> None:
    assert subprocess.run([sys.executable, "-c", FORKED], timeout=120).returncode == 0


def test_pressure_warns_once_a_call_where_the_model_ends() -> None:
    array = layout("uhev1", 0.1)
    at = array.positions[5] + [0.0, 0.0, 0.02]
    drive = focus(array, AIR, (0.0, 0.0, 0.2))
    with pytest.warns(PalmfieldWarning, match=r"20\.0 mm from a transducer") as found:
        pressure(np.array([at, at, [0.0, 0.0, 0.2]]), array, drive, AIR, device="cpu")
    assert len(found) == 1
    assert found[0].filename == __file__
    with pytest.warns(PalmfieldWarning, match="a shock forms"):
        pressure([[0.0, 0.0, 0.2]], layout("uhev1", 4.0), drive, AIR, device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pressure([[0.0, 0.0, 0.2]], array, drive, AIR, device="cpu")
        pressure([at], array, drive, AIR, device="cpu", warn=False)
        FieldEvaluator(array, AIR, "cpu").pressure([at], drive)


def test_no_points_give_an_empty_field() -> None:
    found = pressure(np.zeros((0, 3)), layout("uhev1"), np.ones(256), AIR, gradient=True, device="cpu", warn=False)
    assert found.pressure.shape == (0,)
    assert found.gradient is not None and found.gradient.shape == (0, 3)


@settings(max_examples=40, deadline=None)
@given(points=st.integers(1, 131), transducers=st.integers(1, 70), seed=st.integers(0, 2**31))
def test_any_number_of_points_and_transducers(points: int, transducers: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    positions = np.column_stack([random.uniform(-0.1, 0.1, (transducers, 2)), np.zeros(transducers)])
    array = Array("any", positions, np.tile([0.0, 0.0, 1.0], (transducers, 1)), p0_Pa_m=2.53)
    drive = random.normal(size=(transducers, 2)) @ [1, 1j]
    where = cloud(points, seed)
    p, g = pressure64(where, array, drive, AIR, gradient=True)
    found = pressure(where, array, drive, AIR, gradient=True, device="cpu", warn=False)
    # One point can lie in a null, so the scale is that of the parts, not of the sum
    scale = np.sqrt(points) * 2.53 / 0.4 * np.linalg.norm(drive)
    assert g is not None and found.gradient is not None
    assert np.linalg.norm(found.pressure - p) < 1e-4 * scale
    assert np.linalg.norm(found.gradient - g) < 1e-4 * 732.0 * scale


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_points_and_drive_must_be_finite(bad: float) -> None:
    points, drive = cloud(5), np.ones(256, complex)
    points[3, 1] = bad
    with pytest.raises(PalmfieldError, match=r"points\[3\]"):
        pressure(points, layout("uhev1"), drive, AIR, device="cpu")
    drive[17] = bad
    with pytest.raises(PalmfieldError, match=r"drive\[17\]"):
        pressure(cloud(5), layout("uhev1"), drive, AIR, device="cpu")


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(PalmfieldError, match=r"\(n, 3\)"):
        pressure(np.zeros((4, 2)), layout("uhev1"), np.ones(256), AIR, device="cpu")
    with pytest.raises(PalmfieldError, match="256 transducers"):
        pressure(cloud(4), layout("uhev1"), np.ones(255), AIR, device="cpu")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"piston_radius_m": 8e-3}, "directivity 'piston' at k.radius"),
        ({"p0_Pa_m": np.nan}, "p0_Pa_m"),
        ({"normals": np.tile([0.0, 0.0, 2.0], (256, 1))}, "length"),
        ({"positions": np.full((256, 3), np.nan)}, "positions"),
    ],
)
def test_arrays_that_cannot_radiate_are_refused(change: dict[str, object], match: str) -> None:
    with pytest.raises(SceneError, match=match):
        FieldEvaluator(replace(layout("uhev1"), **change), AIR, "cpu")


def test_polynomials_hold_their_printed_errors() -> None:
    f = np.linspace(-0.5, 0.5, 2001)
    sine, cosine = polynomials.sine_cosine()
    evaluate = np.polynomial.polynomial.polyval
    assert np.abs(f * evaluate(f * f, sine) - np.sin(2 * np.pi * f)).max() < 1e-6
    assert np.abs(evaluate(f * f, cosine) - np.cos(2 * np.pi * f)).max() < 1e-6
    d = np.linspace(0.2, 0.2 + CUBIC_REACH_Np / 0.15, 500)
    assert np.abs(evaluate(d, polynomial_fall(0.15, d[0], d[-1])) * np.exp(0.15 * d) - 1).max() < 1e-5
    directivity = FORMS["piston"].polynomial(3.30)
    slope = polyder(directivity)
    s = np.linspace(0.0, 1.0, 500)
    assert np.abs(evaluate(s, directivity) - polynomials.piston(3.30 * np.sqrt(s))).max() < 5e-8
    np.testing.assert_allclose(evaluate(s, slope), np.gradient(evaluate(s, directivity), s, edge_order=2), atol=1e-5)


@pytest.mark.parametrize("gradient", [False, True])
def test_small_calls_leave_nothing_to_the_next(gradient: bool) -> None:
    """Their buffers are used again, also with other drives and points, and by any number of threads."""
    array = layout("uhev1")
    rng = np.random.default_rng(0)
    evaluator = FieldEvaluator(array, AIR, "cpu", threads=4)
    for count in (700, 2000, 700):
        points = cloud(count)
        drive = np.exp(2j * np.pi * rng.uniform(size=256))
        evaluator.pressure(points, 1e3 * drive, gradient)
        found = evaluator.pressure(points, drive, gradient)
        again = FieldEvaluator(array, AIR, "cpu", threads=1).pressure(points, drive, gradient)
        np.testing.assert_array_equal(found.pressure, again.pressure)
        if gradient:
            np.testing.assert_array_equal(found.gradient, again.gradient)


def test_python_calls_of_a_small_call(python_calls: Callable[[Callable[[], object]], int]) -> None:
    """2,000 points once took 0.2 ms beside the arithmetic, in 316 functions."""
    evaluator = FieldEvaluator(layout("uhev1"), AIR, "cpu")
    points = cloud(2000)
    drive = np.ones(256, complex)
    evaluator.pressure(points, drive)
    assert python_calls(lambda: evaluator.pressure(points, drive)) <= 40


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("how", ["pressure", "gradient", "normals"])
def test_points_on_the_device_give_the_same_there(mode: Mode, how: str) -> None:
    evaluator = FieldEvaluator(with_faults(layout("uhev1"), [3], [7]), AIR, "cpu", mode=mode)
    points, drive = cloud(3000).astype(evaluator.real), focus(layout("uhev1"), AIR, (0.0, 0.0, 0.2))
    normals = np.tile(np.array([0.6, 0.0, -0.8], np.float32), (3000, 1)) if how == "normals" else None
    expected = evaluator.pressure(points, drive, how == "gradient", normals)
    there = wp.array(points, dtype=wp.vec3 if mode == "fast" else wp.vec3d, device="cpu")
    outward = None if normals is None else wp.array(normals, dtype=wp.vec3, device="cpu")
    for where in (there, evaluator.upload(points), there):
        found = evaluator.pressure(where, drive, how == "gradient", outward)
        for mine, theirs in ((found.pressure, expected.pressure), (found.gradient, expected.gradient)):
            assert (mine is None) == (theirs is None) == (theirs is expected.gradient and how == "pressure")
            if mine is not None:
                assert isinstance(mine, wp.array)
                np.testing.assert_array_equal(mine.numpy().view(np.complex64)[..., 0], theirs)


def test_results_on_the_device_are_the_callers_own() -> None:
    evaluator = FieldEvaluator(layout("uhev1"), AIR, "cpu")
    there, drive = evaluator.upload(cloud(40)), np.ones(256)
    first = evaluator.pressure(there, drive).pressure
    kept = first.numpy().copy()
    assert not np.array_equal(evaluator.pressure(there, 2.0 * drive).pressure.numpy(), kept)
    np.testing.assert_array_equal(first.numpy(), kept)


def test_points_on_the_device_that_are_none() -> None:
    evaluator = FieldEvaluator(layout("uhev1"), AIR, "cpu")
    drive, there = np.ones(256), wp.array(cloud(4), dtype=wp.vec3, device="cpu")
    wanted = r"allowed: a Warp array of vec3f, shape \(4,\), on cpu"
    with pytest.raises(PalmfieldError, match=f"points is a Warp array of vec3d, .*; {wanted}"):
        evaluator.pressure(wp.array(cloud(4), dtype=wp.vec3d, device="cpu"), drive)
    with pytest.raises(PalmfieldError, match=rf"shape \(4, 3\), on cpu; {wanted}"):
        evaluator.pressure(wp.array(cloud(4), dtype=wp.float32, device="cpu"), drive)
    with pytest.raises(PalmfieldError, match=f"normals is a ndarray; {wanted}"):
        evaluator.pressure(there, drive, normals=np.zeros((4, 3), np.float32))
    with pytest.raises(PalmfieldError, match=rf"normals is a .*shape \(3,\), on cpu; {wanted}"):
        evaluator.pressure(there, drive, normals=there[:3])
    there.numpy()[2, 1] = np.nan
    with pytest.raises(PalmfieldError, match=r"points\[2\]"):
        evaluator.pressure(there, drive)
    assert evaluator.pressure(there[:0], drive, True).gradient.shape == (0, 3)


@pytest.mark.parametrize(("count", "row"), [(5, 3), (9000, 8999)])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e5, 1e300])
def test_a_refused_point_leaves_nothing_to_the_next_call(count: int, row: int, bad: float) -> None:
    evaluator = FieldEvaluator(layout("uhev1"), AIR, "cpu")
    points, drive = cloud(count), np.ones(256)
    before = evaluator.pressure(points, drive, True)
    broken = points.copy()
    broken[row, 2] = bad
    with pytest.raises(PalmfieldError, match=rf"points\[{row}\]"):
        evaluator.pressure(broken, drive, True)
    np.testing.assert_array_equal(evaluator.pressure(points, drive, True).gradient, before.gradient)


@pytest.mark.parametrize("gradient", [False, True])
def test_points_in_turns_and_transducers_in_parts(gradient: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a GPU shares out the transducers over few points."""
    array, points = layout("two_bow_corrected"), cloud(2500)
    drive = np.exp(2j * np.pi * np.random.default_rng(0).uniform(size=len(array)))
    whole = FieldEvaluator(array, AIR, "cpu").pressure(points, drive, gradient)
    monkeypatch.setattr(field, "splits", lambda *_: 7)
    monkeypatch.setattr(field, "MOST_POINTS", 700)
    evaluator = FieldEvaluator(array, AIR, "cpu")
    found, again = (evaluator.pressure(points, drive, gradient) for _ in range(2))
    there = evaluator.pressure(evaluator.upload(points), drive, gradient)
    for name in ("pressure", "gradient")[: 1 + gradient]:
        expected, mine = getattr(whole, name), getattr(found, name)
        assert difference(mine, expected) < LIMIT
        assert difference(getattr(there, name).numpy().view(np.complex64)[..., 0], expected) < LIMIT
        np.testing.assert_array_equal(mine, getattr(again, name))


def test_a_size_that_was_there_before_takes_no_memory_of_warp(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluator = FieldEvaluator(layout("uhev1"), AIR, "cpu")
    before = evaluator.pressure(cloud(100), np.ones(256), True)
    monkeypatch.setattr(wp.array, "__init__", lambda *_, **__: pytest.fail("a Warp array is made"))
    np.testing.assert_array_equal(evaluator.pressure(cloud(100), np.ones(256), True).gradient, before.gradient)


@pytest.mark.parametrize("shape", [(1, 3), (1000, 3), (3000, 3), (4 * field.WIDE, 3)])
def test_corners_of_points(shape: tuple[int, int]) -> None:
    points = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    assert field.corners(points) == (points.min(axis=0).tolist(), points.max(axis=0).tolist())
    points[-1, 1] = points[0, 2] = np.nan
    assert np.isnan(np.sum(field.corners(points), axis=0)).tolist() == [False, True, True]


def test_many_sizes_of_small_calls_keep_few_buffers() -> None:
    evaluator = FieldEvaluator(layout("uhev1"), AIR, "cpu")
    for count in range(1, 4 * SIZES_STORED):
        evaluator.pressure(np.full((count, 3), 0.1), np.ones(256))
    assert len(evaluator._calls) <= SIZES_STORED
