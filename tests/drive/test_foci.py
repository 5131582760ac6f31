import dataclasses
from typing import get_args

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.directivities.t4010a1 import T4010A1_DIRECTIVITY
from palmfield.acoustics.field import pressure
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.drive.foci import (
    FAINT,
    Method,
    in_gauge,
    misfit,
    reinforcing_phases,
    soft_minimum,
    solve_foci,
    solve_transfer,
    transfer64,
)
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Array, Complex, Float

pytestmark = pytest.mark.numerics

ARRAY, AIR = layout("uhev1"), Air()
METHODS: tuple[Method, ...] = get_args(Method)
ITERATIVE: tuple[Method, ...] = ("gs", "gsw", "lbfgs")


def ring(count: int, radius: float = 0.03, z: float = 0.2) -> Float:
    turn = 2 * np.pi * np.arange(count) / count
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, z)])


def faulty() -> Array:
    gain = np.exp(1j * np.random.default_rng(0).normal(scale=0.2, size=len(ARRAY)))
    gain[::2] *= -1.0
    gain[[3, 77, 200]] = 0.0
    return dataclasses.replace(ARRAY, gain=gain)


def small_transfer(foci: int, transducers: int, seed: int) -> Complex:
    random = np.random.default_rng(seed)
    return random.normal(size=(foci, transducers)) + 1j * random.normal(size=(foci, transducers))


def test_transfer_times_drive_is_the_pressure() -> None:
    random = np.random.default_rng(1)
    points = random.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (7, 3))
    drive = random.normal(size=256) + 1j * random.normal(size=256)
    tilted = np.column_stack([0.3 * np.cos(ARRAY.positions[:, 0] * 90), 0 * ARRAY.positions[:, 0], np.ones(256)])
    tilted /= np.linalg.norm(tilted, axis=1)[:, None]
    measured = dataclasses.replace(ARRAY, directivity_table=T4010A1_DIRECTIVITY)
    for array in (ARRAY, faulty(), measured, dataclasses.replace(ARRAY, normals=tilted)):
        expected = pressure64(points, array, drive, AIR)[0]
        np.testing.assert_allclose(transfer64(points, array, AIR) @ drive, expected, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_a_single_focus_is_the_plain_focus(method: Method) -> None:
    """Up to a phase of all transducers, and for the amplitude method up to what it drives below full."""
    point = np.array([[0.02, -0.01, 0.2]])
    found = solve_foci(point, ARRAY, AIR, method=method)
    turned = found.drive * np.conj(focus(ARRAY, AIR, point[0]))
    np.testing.assert_allclose(turned / np.abs(turned), turned[0] / abs(turned[0]), atol=1e-9)
    assert found.uniformity == 1.0
    if method != "tikhonov":
        assert found.level == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_what_is_reported_is_what_the_field_gives(method: Method) -> None:
    """By the float32 kernels, whose code is their own."""
    points = ring(5)
    targets = np.array([1.0, 2.0, 1.0, 0.5, 1.5])
    found = solve_foci(points, ARRAY, AIR, amplitudes=targets, method=method)
    there = np.abs(pressure(points, ARRAY, found.drive, AIR, device="cpu", warn=False).pressure)
    np.testing.assert_allclose(found.magnitude_Pa, there, rtol=1e-3)
    ratio = there / targets
    assert found.uniformity == pytest.approx(ratio.min() / ratio.max(), rel=1e-3)
    singles = [np.abs(pressure64(p[None], ARRAY, focus(ARRAY, AIR, p), AIR)[0][0]) for p in points]
    np.testing.assert_allclose(found.bound_Pa, singles, rtol=1e-12)
    assert found.level == pytest.approx(np.mean(there / singles), rel=1e-3)
    assert found.residual[-1] == pytest.approx(misfit(found.pressure, targets), abs=1e-12)
    assert len(found.residual) == found.iterations + 1


@pytest.mark.parametrize("method", METHODS)
def test_drives_stay_within_full(method: Method) -> None:
    magnitude = np.abs(solve_foci(ring(6), ARRAY, AIR, method=method).drive)
    assert magnitude.max() == pytest.approx(1.0, abs=1e-12)
    if method != "tikhonov":
        assert magnitude.min() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("method", ["gsw", "lbfgs", "tikhonov"])
def test_foci_are_as_loud_as_wanted(method: Method) -> None:
    targets = np.array([1.0, 0.6, 1.0, 0.8])
    found = solve_foci(ring(4), ARRAY, AIR, amplitudes=targets, method=method)
    np.testing.assert_allclose(found.magnitude_Pa / found.magnitude_Pa.max(), targets, rtol=0.02)


def test_foci_are_peaks_of_the_field() -> None:
    """A scan of the focal plane, by the fast field: each focus has its own peak within 2.5 mm, and none is louder."""
    points = ring(4)
    found = solve_foci(points, ARRAY, AIR)
    x, y = map(np.ravel, np.meshgrid(np.arange(-60, 61) * 1e-3, np.arange(-60, 61) * 1e-3))
    plane = np.column_stack([x, y, np.full(len(x), 0.2)])
    loud = np.abs(pressure(plane, ARRAY, found.drive, AIR, device="cpu", warn=False).pressure)
    for point in points:
        near = np.linalg.norm(plane - point, axis=1) < 8e-3
        peak = plane[near][loud[near].argmax()]
        assert np.linalg.norm(peak - point) < 2.5e-3
    far = np.linalg.norm(plane[:, None] - points, axis=2).min(axis=1) > 12e-3
    assert loud[far].max() < found.magnitude_Pa.min()


def test_weights_help_and_the_optimiser_confirms() -> None:
    """The quietest focus: naive (mean of ten starts) < gs < gsw, and gsw within 2 % of the optimiser's."""
    transfer = transfer64(ring(8) + np.array([0.01, 0.005, 0.0]), ARRAY, AIR)
    levels = {m: solve_transfer(transfer, method=m).magnitude_Pa.min() for m in METHODS}
    levels["naive"] = np.mean([solve_transfer(transfer, method="naive", seed=s).magnitude_Pa.min() for s in range(10)])
    assert 1.05 * levels["naive"] < levels["gs"]
    assert 1.05 * levels["gs"] < levels["gsw"]
    assert levels["gsw"] == pytest.approx(levels["lbfgs"], rel=0.02)


def test_no_method_passes_the_greatest_singular_value() -> None:
    """sum |p|^2 <= s1^2 sum |a|^2, whatever the phases: foci can't be louder than the matrix allows."""
    for count in (2, 8, 16):
        transfer = transfer64(ring(count), ARRAY, AIR)
        greatest = np.linalg.svd(transfer, compute_uv=False)[0]
        for method in METHODS:
            found = solve_transfer(transfer, method=method)
            assert np.linalg.norm(found.pressure) <= greatest * np.linalg.norm(found.drive) * (1 + 1e-12)


@pytest.mark.parametrize("points", [[[0.015, 0.0, 0.15], [-0.02, 0.01, 0.2]], [[0.012, 0.0, 0.2], [-0.012, 0.0, 0.2]]])
def test_two_foci_meet_the_exact_optimum(points: Float) -> None:
    """With two foci the best drive is the phase of H1* + w e^{it} H2*: a search over t and w can't beat the solvers."""
    transfer = transfer64(np.array(points), ARRAY, AIR)
    bound = np.abs(transfer).sum(axis=1)
    rows = transfer / bound[:, None]
    best = 0.0
    for turn in np.linspace(0, 2 * np.pi, 181):
        for weight in np.geomspace(0.2, 5.0, 101):
            drive = np.exp(1j * np.angle(rows[0].conj() + weight * np.exp(1j * turn) * rows[1].conj()))
            best = max(best, np.abs(rows @ drive).min())
    for method in ("gsw", "lbfgs"):
        found = solve_transfer(transfer, amplitudes=bound, method=method)
        # Two foci that mirror each other keep their symmetry, which costs 0.7 % here; at most 0.2 % else.
        assert (found.magnitude_Pa / bound).min() == pytest.approx(best, rel=0.01 if points[0][0] == 0.012 else 2e-3)


def test_reinforcing_phases_are_the_eigenvector_of_the_effect_of_single_foci() -> None:
    """By NumPy's general eigenproblem on the matrix as Long et al. write it, up to a common phase."""
    transfer = transfer64(ring(5), ARRAY, AIR)
    targets = np.array([1.0, 2.0, 1.0, 0.5, 1.5])
    effect = np.empty((5, 5), complex)
    for k in range(5):
        alone = transfer[k].conj() * targets[k] / np.sum(np.abs(transfer[k]) ** 2)
        effect[:, k] = transfer @ alone
    values, vectors = np.linalg.eig(effect)
    dominant = vectors[:, np.abs(values).argmax()]
    turned = reinforcing_phases(transfer, targets) / (dominant / np.abs(dominant))
    np.testing.assert_allclose(turned, turned[0], atol=1e-9)


@given(
    foci=st.lists(st.tuples(*[st.floats(-0.03, 0.03)] * 3), min_size=2, max_size=5),
    seed=st.integers(0, 999),
    together=st.booleans(),
    method=st.sampled_from(METHODS),
)
@settings(max_examples=60, deadline=None)
def test_foci_that_move_a_little_get_a_drive_that_moves_a_little(
    foci: list[tuple[float, float, float]], seed: int, together: bool, method: Method
) -> None:
    """Its common phase too, which no solver fixes by itself; and the first focus sounds as a single one does."""
    points = np.array(foci) + np.array([0.0, 0.0, 0.18])
    apart = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
    assume(apart.min() > 5e-3)
    way = np.random.default_rng(seed).normal(size=(1 if together else len(points), 3))
    drives = []
    for step in (0.0, 1e-9, 2e-9):
        found = solve_foci(points + step * way, ARRAY, AIR, method=method, iterations=20)
        np.testing.assert_allclose(found.pressure[0], abs(found.pressure[0]), atol=1e-9 * found.magnitude_Pa.max())
        drives.append(found.drive)
    assert max(np.linalg.norm(one - drives[1]) for one in drives) < 0.02 * np.linalg.norm(drives[1])


@pytest.mark.parametrize("method", ["gs", "gsw", "naive", "tikhonov"])
@pytest.mark.parametrize(("count", "case"), [(2, 0), (3, 5), (4, 3), (5, 5)])
def test_a_drive_turns_slowly_in_steps_of_20_um(count: int, case: int, method: Method) -> None:
    """With all iterations of "gsw" free to turn the foci's phases, these jumped by 0.16, 0.78, 0.67 and 0.79."""
    random = np.random.default_rng(100 * count + case)
    points, apart = np.zeros((count, 3)), 0.0
    while apart < 8e-3:
        points = random.uniform([-0.03, -0.03, 0.15], [0.03, 0.03, 0.21], (count, 3))
        apart = (np.linalg.norm(points[:, None] - points, axis=2) + np.eye(count)).min()
    way = random.normal(size=(count, 3))
    way *= 20e-6 / np.linalg.norm(way, axis=1)[:, None]
    drives = np.array([solve_foci(points + k * way, ARRAY, AIR, method=method).drive for k in range(120)])
    turned = np.linalg.norm(np.diff(drives, axis=0), axis=1) / np.linalg.norm(drives[1:], axis=1)
    assert turned.max() < 0.15


def test_a_faint_first_focus_leaves_the_phase_to_the_next() -> None:
    transfer = transfer64(ring(3) + np.array([0.01, 0.005, 0.0]), ARRAY, AIR)
    found = solve_transfer(transfer, amplitudes=[0.5 * FAINT, 1.0, 1.0], method="tikhonov")
    assert abs(np.angle(found.pressure[0])) > 0.01
    assert np.angle(found.pressure[1]) == pytest.approx(0.0, abs=1e-9)
    louder = solve_transfer(transfer, amplitudes=[2.0 * FAINT, 1.0, 1.0], method="tikhonov")
    assert np.angle(louder.pressure[0]) == pytest.approx(0.0, abs=1e-9)


def test_pairs_of_foci_settle() -> None:
    """With the full correction of the weights half of such pairs swing for ever."""
    random = np.random.default_rng(11)
    for _ in range(40):
        pair = random.uniform([-0.05, -0.05, 0.15], [0.05, 0.05, 0.25], (2, 3))
        assert solve_foci(pair, ARRAY, AIR).residual[-1] < 1e-3


@given(foci=st.integers(1, 5), transducers=st.integers(5, 12), seed=st.integers(0, 999), sharpness=st.floats(1.0, 50.0))
@settings(max_examples=30, deadline=None)
def test_gradient_of_the_soft_minimum(foci: int, transducers: int, seed: int, sharpness: float) -> None:
    matrix = small_transfer(foci, transducers, seed) / transducers
    phases = np.random.default_rng(seed).uniform(-np.pi, np.pi, transducers)
    slope = soft_minimum(phases, matrix, sharpness)[1]
    h = 1e-6
    for j in range(transducers):
        step = h * np.eye(transducers)[j]
        up, down = (soft_minimum(phases + side * step, matrix, sharpness)[0] for side in (1, -1))
        assert (up - down) / (2 * h) == pytest.approx(slope[j], abs=1e-6)
    forward = approx_fprime(phases, lambda x: soft_minimum(x, matrix, sharpness)[0], 1e-7)
    np.testing.assert_allclose(forward, slope, atol=1e-4)


def test_soft_minimum_lies_below_the_minimum_by_at_most_its_bound() -> None:
    matrix = small_transfer(6, 20, 3) / 20
    phases = np.random.default_rng(5).uniform(-np.pi, np.pi, 20)
    least = np.abs(matrix @ np.exp(1j * phases)).min()
    for sharpness in (10.0, 100.0, 1000.0):
        soft = -soft_minimum(phases, matrix, sharpness)[0]
        assert least - np.log(6) / sharpness <= soft <= least


@pytest.mark.parametrize("method", METHODS)
def test_faulty_transducers_are_allowed_for(method: Method) -> None:
    """Inverted and turned ones change nothing in what is reached; dead ones are off, and take their share only."""
    points = ring(3) + np.array([0.012, -0.007, 0.0])
    turned = np.exp(1j * np.random.default_rng(0).normal(size=len(ARRAY)))
    turned[::2] *= -1
    whole = solve_foci(points, ARRAY, AIR, method=method)
    other = solve_foci(points, dataclasses.replace(ARRAY, gain=turned), AIR, method=method)
    np.testing.assert_allclose(other.magnitude_Pa, whole.magnitude_Pa, rtol=1e-3)
    some = solve_foci(points, faulty(), AIR, method=method)
    assert np.flatnonzero(some.drive == 0).tolist() == [3, 77, 200]
    assert some.bound_Pa / whole.bound_Pa == pytest.approx(253 / 256, abs=0.01)


def test_few_transducers_left_are_too_few() -> None:
    gain = np.zeros(len(ARRAY), complex)
    gain[:3] = 1.0
    with pytest.raises(SceneError, match="4 foci for 3 live transducers"):
        solve_foci(ring(4), dataclasses.replace(ARRAY, gain=gain), AIR)


@given(foci=st.integers(1, 6), seed=st.integers(0, 9999), method=st.sampled_from(METHODS))
@settings(max_examples=60, deadline=None)
def test_any_transfer_gives_a_drive_within_full(foci: int, seed: int, method: Method) -> None:
    targets = np.random.default_rng(seed).uniform(0.1, 10.0, foci)
    found = solve_transfer(small_transfer(foci, 24, seed), amplitudes=targets, method=method, iterations=8)
    assert np.isfinite(found.drive).all()
    assert np.abs(found.drive).max() <= 1.0 + 1e-12
    assert np.all(found.magnitude_Pa <= found.bound_Pa * (1 + 1e-12))
    assert found.iterations <= 8


@pytest.mark.parametrize("method", ITERATIVE)
def test_iterations_are_counted_and_zero_is_the_start(method: Method) -> None:
    found = solve_foci(ring(4), ARRAY, AIR, method=method, iterations=0)
    transfer = transfer64(ring(4), ARRAY, AIR)
    start = transfer.conj().T @ (reinforcing_phases(transfer, np.ones(4)) / np.sum(np.abs(transfer) ** 2, axis=1))
    np.testing.assert_allclose(found.drive, in_gauge(transfer, start / np.abs(start)), atol=1e-9)
    assert found.iterations == 0
    assert solve_foci(ring(4), ARRAY, AIR, method=method, iterations=7).iterations <= 7


def test_the_same_seed_gives_the_same_drive() -> None:
    first, second, other = (solve_foci(ring(8), ARRAY, AIR, method="naive", seed=seed).drive for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, second)
    assert np.abs(first - other).max() > 0.1


@pytest.mark.parametrize(
    ("points", "keywords", "message"),
    [
        ([(0, 0, 0.2), (0, 0, -0.2)], {}, "focus 1 at .* is behind array"),
        ([(0, 0, 0.2), (0.02, 0, 0.2), (0, 1e-6, 0.2)], {}, "foci 0 and 2 are 1e-06 m apart"),
        ([(0, 0, 0.2)] * 2, {}, "foci 0 and 1 are 0 m apart"),
        (np.zeros((0, 3)), {}, "list of foci is empty"),
        ([(0, 0, 0.2)], {"amplitudes": [1.0, 2.0]}, r"amplitudes have shape \(2,\) for 1 foci"),
        ([(0, 0, 0.2)], {"amplitudes": [0.0]}, r"amplitudes\[0\] = 0.0 is not positive"),
        ([(0, 0, 0.2)], {"amplitudes": [np.nan]}, r"amplitudes\[0\] = nan"),
        ([(0, 0, 0.2)], {"method": "magic"}, "method 'magic' is unknown"),
        ([(0, 0, 0.2)], {"iterations": -1}, "iterations = -1"),
    ],
)
def test_what_makes_no_sense_is_refused(points: Float, keywords: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        solve_foci(points, ARRAY, AIR, **keywords)


@pytest.mark.parametrize("points", [[(0, np.nan, 0.2)], [(0, 0.2)], [(np.inf, 0, 0.2)]])
def test_foci_must_be_positions(points: Float) -> None:
    with pytest.raises(PalmfieldError, match="points"):
        solve_foci(points, ARRAY, AIR)
