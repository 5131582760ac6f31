"""Many frames by a matrix product, against the field kernel frame by frame."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout, with_faults
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transfer import DROPPED, Transfer, arp_frames, span
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Array, Complex, Float

AIR = Air()


def skin(count: int, seed: int = 0) -> tuple[Float, Float]:
    """Points on a shallow dome over the array, and its normals, which look down."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-0.05, 0.05, (2, count))
    points = np.column_stack([x, y, 0.2 + 2.0 * (x * x + y * y)])
    normals = np.column_stack([4.0 * x, 4.0 * y, -np.ones(count)])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def circle(array: Array, count: int, radius: float = 0.01) -> Complex:
    angle = 2 * np.pi * np.arange(count) / count
    places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, 0.2)])
    return np.array([focus(array, AIR, place) for place in places])


def one_by_one(array: Array, points: Float, normals: Float, drives: Complex, law: str = "default") -> Float:
    rows = []
    for drive in drives:
        p, g = pressure64(points, array, drive, AIR, gradient=True)
        k = 2 * np.pi * array.frequency_Hz / 343.2
        assert g is not None and k > 0
        field = FieldEvaluator(array, AIR, "cpu", mode="accurate").pressure(points, drive, gradient=True)
        assert np.linalg.norm(field.pressure - p) < 1e-4 * np.linalg.norm(p)
        rows.append(arp(field, normals, AIR, array.frequency_Hz, law=law, device="cpu"))
    return np.array(rows, dtype=float)


@pytest.mark.parametrize("law", ["default", "alpha"])
@pytest.mark.parametrize("frames", [20, 600])
def test_arp_of_many_frames_equals_that_of_each(frames: int, law: str) -> None:
    array = layout("uhev1")
    points, normals = skin(217)
    drives = circle(array, frames)
    found = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals, AIR).arp(drives, law)
    some = slice(0, frames, frames // 10)
    expected = one_by_one(array, points, normals, drives[some], law)
    assert np.linalg.norm(found[some] - expected) < 1e-4 * np.linalg.norm(expected)


def test_frames_without_structure_are_not_reduced_and_stay_right() -> None:
    array = layout("uhev1")
    points, normals = skin(50)
    drives = np.exp(2j * np.pi * np.random.default_rng(3).random((600, 256)))
    found = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals, AIR).arp(drives)
    expected = one_by_one(array, points, normals, drives[:5])
    assert np.linalg.norm(found[:5] - expected) < 1e-4 * np.linalg.norm(expected)


def test_span_finds_a_frame_that_is_unlike_all_others() -> None:
    drives = circle(layout("uhev1"), 3000)
    drives[1234] = np.exp(2j * np.pi * np.random.default_rng(4).random(256))
    found = span(drives)
    assert found is not None
    coordinates, basis = found
    assert basis.shape[1] < 40
    assert np.linalg.norm(basis.conj().T @ basis - np.eye(basis.shape[1])) < 1e-12
    assert np.linalg.norm(coordinates @ basis.conj().T - drives) <= DROPPED * np.linalg.norm(drives)


def test_span_of_silence_and_of_noise() -> None:
    assert span(np.zeros((600, 256), complex)) is None
    noise = np.random.default_rng(5).normal(size=(600, 256, 2)) @ [1.0, 1j]
    assert span(noise) is None
    low = noise[:, :100] @ noise[:100]
    found = span(low)
    assert found is not None and found[1].shape == (256, 100)
    assert np.linalg.norm(found[0] @ found[1].conj().T - low) < DROPPED * np.linalg.norm(low)


def test_gain_tilt_and_pressure() -> None:
    flat = layout("uhev1")
    normals = flat.normals + np.random.default_rng(1).uniform(-0.3, 0.3, (256, 3))
    array = with_faults(
        replace(flat, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True)), dead=[4], inverted=[9, 10]
    )
    points, outward = skin(101)
    drives = circle(flat, 20)
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu"), points, outward, AIR)
    expected = np.array([pressure64(points, array, drive, AIR)[0] for drive in drives])
    assert np.linalg.norm(transfer.pressure(drives) - expected) < 3e-5 * np.linalg.norm(expected)
    found = transfer.arp(drives)
    wanted = one_by_one(array, points, outward, drives)
    assert np.linalg.norm(found - wanted) < 1e-4 * np.linalg.norm(wanted)


def test_the_cheaper_way_gives_the_same() -> None:
    array = layout("uhev1")
    points, normals = skin(150)
    drives = circle(array, 40)
    evaluator = FieldEvaluator(array, AIR, "cpu")
    many = arp_frames(evaluator, points, normals, drives, AIR)
    few = np.concatenate([arp_frames(evaluator, points, normals, drives[i : i + 4], AIR) for i in range(0, 40, 4)])
    assert np.linalg.norm(many - few) < 1e-4 * np.linalg.norm(few)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_memory_given_is_filled_whatever_the_threads(threads: int) -> None:
    array = layout("uhev1")
    points, normals = skin(700)
    drives = circle(array, 530)
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu", threads=threads), points, normals, AIR)
    room = np.full((530, 700), np.nan, np.float32)
    assert transfer.arp(drives, out=room) is room
    np.testing.assert_array_equal(room, transfer.arp(drives))
    expected = one_by_one(array, points, normals, drives[::100])
    assert np.linalg.norm(room[::100] - expected) < 1e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("frames", [70, 600])
def test_kernels_for_gpus_give_the_same_in_several_batches(frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palmfield.acoustics.transfer.GPU_SCRATCH_BYTES", 0)
    array = layout("uhev1")
    points, normals = skin(40)
    drives = circle(array, frames)
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals, AIR)
    expected = transfer.arp(drives)
    assert np.linalg.norm(transfer.arp_on_gpu(drives).numpy() - expected) < 1e-5 * np.linalg.norm(expected)
    assert transfer.arp_on_gpu(drives[:0]).shape == (0, 40)


def test_bad_input() -> None:
    array = layout("uhev1")
    points, normals = skin(10)
    evaluator = FieldEvaluator(array, AIR, "cpu")
    transfer = Transfer(evaluator, points, normals, AIR)
    with pytest.raises(PalmfieldError, match=r"shape \(3, 255\)"):
        transfer.arp(np.ones((3, 255)))
    drives = np.ones((3, 256), complex)
    drives[1, 7] = np.nan
    with pytest.raises(PalmfieldError, match=r"drives\[1\]"):
        transfer.arp(drives)
    with pytest.raises(SceneError, match="ARP law 'beta'"):
        transfer.arp(np.ones((3, 256)), "beta")
    for room in (np.empty((3, 11), np.float32), np.empty((3, 10)), np.empty((10, 3), np.float32).T):
        with pytest.raises(PalmfieldError, match="out is float"):
            transfer.arp(np.ones((3, 256)), out=room)
    with pytest.raises(PalmfieldError, match="GiB"):
        Transfer(evaluator, np.tile(points, (100_000, 1)), np.tile(normals, (100_000, 1)), AIR)
    with pytest.raises(PalmfieldError, match="near and far"):
        Transfer(FieldEvaluator(array, AIR, "cpu", absorption_Np_m=9.0), points, normals, AIR)
    assert transfer.arp(np.ones((0, 256))).shape == (0, 10)
    assert Transfer(evaluator, np.zeros((0, 3)), np.zeros((0, 3)), AIR).arp(np.ones((2, 256))).shape == (2, 0)
