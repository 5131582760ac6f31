"""Consistency of SurfaceArp with the float64 reference and the field kernels, drive after drive and pose after pose."""

import multiprocessing
import sys
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import LAWS, arp
from palmfield.acoustics.arrays import placed
from palmfield.acoustics.field import RANGE_STEP_M, _fall
from palmfield.acoustics.focus import focus
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.surface_arp import MATRIX_FROM, SurfaceArp
from palmfield.config import ArrayConfig
from palmfield.errors import PalmfieldError, SceneError
from palmfield.threads import share
from palmfield.transforms import IDENTITY, Placement, Transform
from palmfield.types import Complex, Float
from warp_kernels.gradient import MOST

HERE = Placement.of(IDENTITY)
TILTED = Transform(np.array([0.25, 0.0, 0.05]), Rotation.from_euler("y", -40, degrees=True).as_matrix())
FOCUS = np.array([0.0, 0.0, 0.2])

ARRAYS: dict[str, list[dict[str, object]]] = {
    "a board": [{"layout": "uhev1"}],
    "a bowl": [{"layout": "two_bow_corrected"}],
    "faults": [{"layout": "uhev1", "dead": (3, 200), "inverted": (7,)}],
    "measured directivity": [{"layout": "sonicsurface", "directivity": "t4010a1"}],
    "two boards": [{"layout": "uhev1"}, {"layout": "uhev1"}],
    "two directivities": [{"layout": "uhev1"}, {"layout": "sonicsurface", "directivity": "point"}],
    "accurate": [{"layout": "uhev1", "precision": "accurate"}],
}


def phased(name: str = "a board", device: str = "cpu") -> PhasedArray:
    places = [HERE, Placement.of(TILTED)][: len(ARRAYS[name])]
    configs = [ArrayConfig.model_validate(keys) for keys in ARRAYS[name]]
    return PhasedArray([ArrayInstance(*pair) for pair in zip(configs, places, strict=True)], places, device)


def surface(count: int, centre: Float = FOCUS, seed: int = 0) -> tuple[Float, Float]:
    """Points of a bumpy patch and its normals, most of which face the array; the first is turned away from it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.03, 0.03, (count, 3)) * [1.0, 1.0, 0.3] + centre
    normals = rng.normal(size=(count, 3)) * 0.5 - [0.0, 0.0, 1.0]
    normals[:1] = 0.0, 0.1, 1.0
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def driven(array: PhasedArray, seed: int = 0) -> Complex:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 1.0, len(array)) * np.exp(2j * np.pi * rng.uniform(size=len(array)))


def expected(array: PhasedArray, points: Float, normals: Float, drive: Complex, law: str) -> tuple[Float, ...]:
    """ARP, |p| and flux in float64, and where the flow through the surface is small beyond float32."""
    p, g = np.zeros(len(points), complex), np.zeros((len(points), 3), complex)
    for part, own, place in zip(array.parts, array.slices, array.placements, strict=True):
        one = pressure64(points, placed(part, *place.transform), drive[own], array.air, gradient=True, normals=normals)
        assert one[1] is not None
        p, g = p + one[0], g + one[1]
    rho, c = density(array.air), sound_speed(array.air)
    u = g / (1j * 2 * np.pi * 40e3 * rho)
    through = np.einsum("ij,ij->i", u, normals)
    along = u - through[:, None] * normals
    load = (
        LAWS[law].pressure * np.abs(p) ** 2 / (rho * c**2)
        - LAWS[law].along * rho * (np.abs(along) ** 2).sum(axis=1)
        + LAWS[law].across * rho * np.abs(through) ** 2
    )
    inflow = np.real(p * np.conj(through))
    unsure = (inflow != 0.0) & (np.abs(inflow) < 1e-3 * np.abs(inflow).max())
    return np.where(inflow < 0.0, load, 0.0), np.abs(p), np.imag(np.conj(p)[:, None] * g), unsure


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ARRAYS)
def test_against_the_reference(name: str, law: str) -> None:
    array = phased(name)
    count = 333  # no multiple of a kernel's width
    points, normals = surface(count)
    at = SurfaceArp(array.field, count, law)
    for seed in range(2):  # the second call meets what the first one left
        drive = driven(array, seed)
        sound = at.evaluate(points, normals, drive, flux=True)
        load, amplitude, flux, unsure = expected(array, points, normals, drive, law)
        sure = ~unsure.astype(bool)
        assert sure.mean() > 0.9 and (load[sure] != 0.0).any() and (load[sure] == 0.0).any()
        np.testing.assert_allclose(sound.arp[sure], load[sure], atol=2e-4 * np.abs(load).max())
        np.testing.assert_allclose(sound.amplitude, amplitude, atol=5e-5 * amplitude.max())
        assert sound.flux is not None
        np.testing.assert_allclose(sound.flux, flux, atol=1e-4 * np.abs(flux).max())


@pytest.mark.parametrize("name", ARRAYS)
def test_equals_the_field_kernels_to_rounding(name: str) -> None:
    array = phased(name)
    points, normals = surface(200)
    drive = driven(array)
    sound = SurfaceArp(array.field, 200).evaluate(points, normals, drive)
    field = array.field.pressure(points, drive, normals=normals.astype(np.float32))
    before = arp(field, normals, array.air, 40e3, device="cpu")
    np.testing.assert_allclose(sound.amplitude, np.abs(field.pressure), atol=1e-6 * sound.amplitude.max())
    np.testing.assert_allclose(sound.arp, before, atol=3e-6 * before.max())
    assert sound.flux is None


@pytest.mark.parametrize("name", ARRAYS)
def test_silent_transducers_may_be_left_out(name: str) -> None:
    """At the ends of a board, in its middle, all of an array, or all of all."""
    array = phased(name)
    points, normals = surface(50)
    at = SurfaceArp(array.field, 50)
    whole = driven(array)
    ends = slice(0, 60), slice(len(array) - 5, None)
    for silent in (*ends, slice(70, 90), array.slices[-1], slice(None), slice(0, 0)):
        drive = whole.copy()
        drive[silent] = 0.0
        narrowed = at.evaluate(points, normals, drive).arp.copy()
        np.testing.assert_allclose(narrowed, at.evaluate(points, normals, drive + 1e-30).arp, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("name", ARRAYS)
def test_sums_of_few_drives_are_what_they_are_drive_by_drive(name: str) -> None:
    array = phased(name)
    points, normals = surface(300)
    rng = np.random.default_rng(1)
    units = np.array([driven(array, seed) for seed in range(3)])
    units[0, array.slices[0]] = 0.0
    levels = rng.standard_normal((6, 3)) + 1j * rng.standard_normal((6, 3))
    levels[2] = 0.0
    at = SurfaceArp(array.field, 300, threads=2)
    for first in (0, 100):
        normals = np.roll(normals, first, axis=0)
        sums = at.evaluate_sums(points, normals, units, levels)
        one_by_one = at.evaluate_many(points, normals, levels @ units)
        unsure = np.abs(one_by_one - sums) > 1e-4 * one_by_one.max()
        # Where hardly any sound flows through the surface, rounding may make it lit or dark
        assert unsure.mean() < 0.01
        assert sums.shape == (6, 300) and not sums[2].any()
    with pytest.raises(PalmfieldError, match="not finite"):
        at.evaluate_sums(points, normals, units * np.nan, levels)
    with pytest.raises(PalmfieldError, match="this SurfaceArp takes"):
        at.evaluate_sums(points, normals, units[:, 1:], levels)
    with pytest.raises(PalmfieldError, match=r"levels\[2\] .* is not finite"):
        at.evaluate_sums(points, normals, units, np.where(np.arange(6)[:, None] == 2, np.nan, levels))
    for bad in (levels[:, :1], np.hstack([levels, levels]), levels[0]):
        with pytest.raises(PalmfieldError, match="give \\(m, k\\)"):
            at.evaluate_sums(points, normals, units, bad)
    for bad in (normals[0], normals[:, :1]):
        for call in (
            lambda n: at.evaluate_sums(points, n, units, levels),
            lambda n: at.evaluate_many(points, n, units),
        ):
            with pytest.raises(PalmfieldError, match="this SurfaceArp takes"):
                call(bad)


@pytest.mark.parametrize("name", ARRAYS)
def test_drives_computed_together_are_to_the_bit_what_each_is_alone(name: str) -> None:
    """More than are taken at once, of which some are silent, or sound from one array or part of it alone."""
    array = phased(name)
    points, normals = surface(100)
    drives = np.array([driven(array, seed) for seed in range(MOST + 3)])
    drives[2] = drives[MOST + 1] = 0.0
    drives[4:6, array.slices[0]] = drives[6:9, array.slices[-1]] = drives[MOST:, 20:] = 0.0
    at = SurfaceArp(array.field, 100, threads=1)
    alone = np.array([at.evaluate(points, normals, drive).arp.copy() for drive in drives])
    together = SurfaceArp(array.field, 100, threads=2)
    for first in (0, 2, 5):
        np.testing.assert_array_equal(together.evaluate_many(points, normals, drives[first:]), alone[first:])
    sums = together.evaluate_sums(points, normals, drives, np.eye(len(drives), dtype=complex))
    np.testing.assert_allclose(sums, alone, atol=1e-6 * alone.max())


def test_a_surface_that_moves_far() -> None:
    """The fall of sound is fitted anew, by quadratic, cubic and exponential, and comes back to the same bits."""
    array = phased()
    points, normals = surface(64)
    drive = focus(array.array, array.air, FOCUS)
    at = SurfaceArp(array.field, 64)
    first = at.evaluate(points, normals, drive).arp.copy()
    for stretch in (1.0, 8.0, 25.0):
        where = (points - FOCUS) * [1.0, 1.0, 10.0 * stretch] + [0.0, 0.0, 0.1 + 0.09 * stretch]
        sound = at.evaluate(where, normals, drive)
        _, amplitude, _, _ = expected(array, where, normals, drive, "default")
        np.testing.assert_allclose(sound.amplitude, amplitude, atol=1e-4 * amplitude.max())
    np.testing.assert_array_equal(at.evaluate(points, normals, drive).arp, first)
    np.testing.assert_array_equal(SurfaceArp(array.field, 64).evaluate(points, normals, drive).arp, first)


def test_many_poses_keep_few_fits() -> None:
    array = phased()
    points, normals = surface(16)
    at = SurfaceArp(array.field, 16)
    drive = driven(array)
    for i in range(200):
        at.evaluate(points - [0.0, 0.0, -i * RANGE_STEP_M], normals, drive)
    assert _fall.cache_info().currsize <= 256 and len(at._recorded) <= 3


@pytest.mark.parametrize("count", [1, 15, 16, 17, 3000])
def test_threads_change_no_bit(count: int) -> None:
    array = phased()
    points, normals = surface(count)
    drive = driven(array)
    one = SurfaceArp(array.field, count, threads=1).evaluate(points, normals, drive, flux=True)
    shared = SurfaceArp(array.field, count, threads=3)
    assert len(shared._blocks) == (3 if count == 3000 else 1)
    for _ in range(3):
        several = shared.evaluate(points, normals, drive, flux=True)
        for a, b in zip(one, several, strict=True):
            np.testing.assert_array_equal(a, b)


def test_results_are_overwritten() -> None:
    array = phased()
    points, normals = surface(10)
    at = SurfaceArp(array.field, 10)
    first = at.evaluate(points, normals, driven(array))
    loud = first.arp.copy()
    at.evaluate(points, normals, 0.5 * driven(array))
    np.testing.assert_allclose(first.arp, 0.25 * loud, rtol=1e-5)


def test_a_call_that_was_interrupted_leaves_nothing_behind() -> None:
    array = phased()
    points, normals = surface(20)
    at = SurfaceArp(array.field, 20)
    drive = driven(array)
    good = at.evaluate(points, normals, drive).arp.copy()

    def stop() -> None:
        raise KeyboardInterrupt

    (blocks,) = at._recorded.values()
    field, arp = blocks[0]
    blocks[0] = [field, stop]
    with pytest.raises(KeyboardInterrupt):
        at.evaluate(points, normals, drive)
    blocks[0] = [field, arp]
    np.testing.assert_array_equal(at.evaluate(points, normals, drive).arp, good)


def test_no_points() -> None:
    array = phased()
    sound = SurfaceArp(array.field, 0).evaluate(np.zeros((0, 3)), np.zeros((0, 3)), driven(array))
    assert sound.arp.shape == sound.amplitude.shape == (0,)


def test_bad_input_names_what_is_wrong() -> None:
    array = phased()
    at = SurfaceArp(array.field, 8)
    points, normals = surface(8)
    drive = driven(array)
    good = at.evaluate(points, normals, drive).arp.copy()
    with pytest.raises(PalmfieldError, match=r"points \(7, 3\).*takes \(8, 3\), \(8, 3\) and \(256,\)"):
        at.evaluate(points[:7], normals, drive)
    bad = points.copy()
    bad[5, 1] = np.nan
    with pytest.raises(PalmfieldError, match=r"points\[5\]"):
        at.evaluate(bad, normals, drive)
    bad = drive.copy()
    bad[9] = np.inf
    with pytest.raises(PalmfieldError, match=r"drive\[9\]"):
        at.evaluate(points, normals, bad)
    bad = normals.copy()
    bad[2] = np.nan
    with pytest.raises(PalmfieldError, match=r"normals\[2\]"):
        at.evaluate(points, bad, drive)
    np.testing.assert_array_equal(at.evaluate(points, normals, drive).arp, good)
    with pytest.raises(SceneError, match="law 'none' is unknown"):
        SurfaceArp(array.field, 8, "none")


@pytest.mark.parametrize("name", ["a board", "two boards", "two directivities", "accurate", "faults"])
@pytest.mark.parametrize("frames", [3, MATRIX_FROM + 5])
def test_many_drives(name: str, frames: int) -> None:
    array = phased(name)
    points, normals = surface(100)
    at = SurfaceArp(array.field, 100)
    drives = np.array([driven(array, seed) for seed in range(frames)])
    one_by_one = np.array([at.evaluate(points, normals, drive).arp.copy() for drive in drives])
    sizes = np.array([at.evaluate(points, normals, drive).amplitude.copy() for drive in drives])
    amplitudes = np.empty_like(one_by_one)
    out = at.evaluate_many(points, normals, drives, amplitudes=amplitudes)
    np.testing.assert_allclose(amplitudes, sizes, atol=1e-4 * sizes.max())
    sure = np.abs(out - one_by_one) < 1e-4 * one_by_one.max()
    assert sure.mean() > 0.998  # the side of a grazing flow is float32's guess
    moved = points - [0.0, 0.0, 1e-3]
    np.testing.assert_array_equal(at.evaluate_many(points, normals, drives), out)
    assert np.abs(at.evaluate_many(moved, normals, drives) - out).max() > 1e-2 * out.max()


def test_python_calls_of_an_evaluation() -> None:
    array = phased()
    points, normals = surface(2000)
    at = SurfaceArp(array.field, 2000, threads=2)
    drive = driven(array)
    at.evaluate(points, normals, drive)
    calls = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(count)
    at.evaluate(points, normals, drive, flux=True)
    sys.setprofile(None)
    assert calls <= 25


def test_memory_does_not_grow() -> None:
    array = phased()
    points, normals = surface(50)
    at = SurfaceArp(array.field, 50)
    drive = driven(array)

    def steps(number: int) -> int:
        for _ in range(number):
            at.evaluate(points, normals, drive, flux=True)
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = steps(20)
        assert steps(200) - before < 4096
    finally:
        tracemalloc.stop()


def _in_child(at: SurfaceArp, points: Float, normals: Float, drive: Complex, queue: object) -> None:
    queue.put(at.evaluate(points, normals, drive).arp.copy())  # type: ignore[attr-defined]


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_has_threads_of_its_own() -> None:
    array = phased()
    points, normals = surface(2000)
    at = SurfaceArp(array.field, 2000, threads=2)
    drive = driven(array)
    here = at.evaluate(points, normals, drive).arp.copy()
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_in_child, args=(at, points, normals, drive, queue))
    child.start()
    there = queue.get(timeout=60)
    child.join(60)
    np.testing.assert_array_equal(there, here)


def test_share_does_all_blocks_and_passes_errors_on() -> None:
    done: list[int] = []
    share([[lambda i=i: done.append(i)] for i in range(50)], 4)  # type: ignore[misc]
    assert sorted(done) == list(range(50))

    def fail() -> None:
        raise ValueError("a block")

    for _ in range(20):
        with pytest.raises(ValueError, match="a block"):
            share([[fail], [fail]], 2)
