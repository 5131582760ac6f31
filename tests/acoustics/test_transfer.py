"""Many frames by a matrix product, against the field kernel frame by frame."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout, with_faults
from palmfield.acoustics.field import CUBIC_REACH_Np, FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transfer import (
    BYTES_LIMIT,
    DROPPED,
    Transfer,
    arp_frames,
    memory_limit,
    span,
)
from palmfield.device import available_bytes
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Array, Complex, Field, Float

pytestmark = pytest.mark.numerics

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
        p, _ = pressure64(points, array, drive, AIR, normals=normals)
        evaluator = FieldEvaluator(array, AIR, "cpu", mode="accurate")
        field = evaluator.pressure(points, drive, normals=normals.astype(np.float32))
        assert np.linalg.norm(field.pressure - p) < 1e-4 * np.linalg.norm(p)
        rows.append(arp(field, normals, AIR, array.frequency_Hz, law=law, device="cpu"))
    return np.array(rows, dtype=float)


@pytest.mark.parametrize("law", ["default", "alpha"])
@pytest.mark.parametrize("frames", [20, 600])
def test_arp_of_many_frames_equals_that_of_each(frames: int, law: str) -> None:
    array = layout("uhev1")
    points, normals = skin(217)
    drives = circle(array, frames)
    found = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals).arp(drives, law)
    some = slice(0, frames, frames // 10)
    expected = one_by_one(array, points, normals, drives[some], law)
    assert np.linalg.norm(found[some] - expected) < 1e-4 * np.linalg.norm(expected)


def test_frames_without_structure_are_not_reduced_and_stay_right() -> None:
    array = layout("uhev1")
    points, normals = skin(50)
    drives = np.exp(2j * np.pi * np.random.default_rng(3).random((600, 256)))
    found = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals).arp(drives)
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


@pytest.mark.parametrize("level", [1e-3, 1e-9])
def test_a_quiet_frame_is_kept_as_well_as_a_loud_one(level: float) -> None:
    drives = circle(layout("uhev1"), 700)
    drives[634] = level * np.exp(2j * np.pi * np.random.default_rng(4).random(256))
    drives[77] = 0.0
    found = span(drives)
    assert found is not None
    lost = np.linalg.norm(found[0] @ found[1].conj().T - drives, axis=1)
    assert np.all(lost <= DROPPED * np.linalg.norm(drives, axis=1))
    assert lost[77] == 0.0


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
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu"), points, outward)
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
    many = arp_frames(evaluator, points, normals, drives)
    few = np.concatenate([arp_frames(evaluator, points, normals, drives[i : i + 4]) for i in range(0, 40, 4)])
    assert np.linalg.norm(many - few) < 1e-4 * np.linalg.norm(few)


def count_ways(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[int]]:
    """Points of each matrix, and of each field, that are computed from now on."""
    seen: dict[str, list[int]] = {"matrix": [], "field": []}
    make, compute = Transfer.__init__, FieldEvaluator.pressure

    def matrix(self: Transfer, evaluator: FieldEvaluator, points: Float, normals: Float) -> None:
        seen["matrix"].append(len(points))
        make(self, evaluator, points, normals)

    def field(self: FieldEvaluator, points: Float, drive: Complex, **keys: Any) -> Field:
        seen["field"].append(len(points))
        return compute(self, points, drive, **keys)

    monkeypatch.setattr(Transfer, "__init__", matrix)
    monkeypatch.setattr(FieldEvaluator, "pressure", field)
    return seen


def test_many_points_go_in_blocks_that_fit_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    array = layout("uhev1")
    points, normals = skin(1000)
    drives = circle(array, 20)
    evaluator = FieldEvaluator(array, AIR, "cpu")
    whole = arp_frames(evaluator, points, normals, drives)
    monkeypatch.setattr("palmfield.acoustics.transfer.available_bytes", lambda: 2 * 32 * 256 * 400)
    seen = count_ways(monkeypatch)
    parts = arp_frames(evaluator, points, normals, drives)
    assert seen["field"] == [] and sum(seen["matrix"]) == 1000 and 300 < max(seen["matrix"]) <= 400
    assert np.linalg.norm(parts - whole) < 1e-5 * np.linalg.norm(whole)  # the cubic fall is that of each block
    with pytest.raises(PalmfieldError, match="GiB"):
        Transfer(evaluator, points, normals)


def test_the_memory_that_is_free_is_the_systems() -> None:
    total = int(re.findall(r"MemTotal: +(\d+) kB", Path("/proc/meminfo").read_text())[0]) * 1024
    assert 0 < available_bytes() < total
    assert memory_limit("cpu") <= min(BYTES_LIMIT, total // 2)


def test_accurate_evaluators_go_frame_by_frame(monkeypatch: pytest.MonkeyPatch, arp64) -> None:
    """At 3 m the phase in float32 is off: a matrix would miss what the mode promises."""
    array = layout("uhev1")
    points, normals = skin(60)
    points[:, 2] += 3.0
    drives = circle(array, 20)
    evaluator = FieldEvaluator(array, AIR, "cpu", mode="accurate")
    with pytest.raises(PalmfieldError, match=r"evaluator has mode 'accurate': use mode 'fast', or arp_frames"):
        Transfer(evaluator, points, normals)
    seen = count_ways(monkeypatch)
    found = arp_frames(evaluator, points, normals, drives)
    assert seen == {"matrix": [], "field": [60] * 20}
    expected = np.array([arp64(points, normals, array, drive) for drive in drives])
    rough = arp_frames(FieldEvaluator(array, AIR, "cpu"), points, normals, drives)
    errors = [np.linalg.norm(one - expected) / np.linalg.norm(expected) for one in (found, rough)]
    assert errors[0] < 2e-5 < errors[1]


def test_points_far_apart_go_frame_by_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    array = layout("uhev1")
    points, normals = skin(60)
    points[::2, 2] += 3.0
    drives = circle(array, 20)
    evaluator = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.2)
    assert CUBIC_REACH_Np < 3.0 * 0.2
    with pytest.raises(PalmfieldError, match="near and far"):
        Transfer(evaluator, points, normals)
    seen = count_ways(monkeypatch)
    found = arp_frames(evaluator, points, normals, drives)
    assert seen == {"matrix": [], "field": [60] * 20}
    one = arp(
        evaluator.pressure(points, drives[7], normals=normals.astype(np.float32)),
        normals,
        AIR,
        array.frequency_Hz,
        device="cpu",
    )
    np.testing.assert_array_equal(found[7], one)


def test_drives_in_any_order_of_memory() -> None:
    array = layout("uhev1")
    points, normals = skin(40)
    drives = circle(array, 600)
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals)
    np.testing.assert_array_equal(transfer.arp(np.asfortranarray(drives)), transfer.arp(drives))


def test_air_is_that_of_the_evaluator() -> None:
    array, cold = layout("uhev1"), Air(temperature_C=-10.0, pressure_Pa=80e3)
    points, normals = skin(40)
    drives = circle(array, 20)
    evaluator = FieldEvaluator(array, cold, "cpu")
    assert evaluator.air == cold
    found = Transfer(evaluator, points, normals).arp(drives)
    field = evaluator.pressure(points, drives[3], normals=normals.astype(np.float32))
    expected = arp(field, normals, cold, array.frequency_Hz, device="cpu")
    assert np.linalg.norm(found[3] - expected) < 1e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_memory_given_is_filled_whatever_the_threads(threads: int) -> None:
    array = layout("uhev1")
    points, normals = skin(700)
    drives = circle(array, 530)
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu", threads=threads), points, normals)
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
    transfer = Transfer(FieldEvaluator(array, AIR, "cpu"), points, normals)
    expected = transfer.arp(drives)
    assert np.linalg.norm(transfer.arp_on_gpu(drives).numpy() - expected) < 1e-5 * np.linalg.norm(expected)
    assert transfer.arp_on_gpu(drives[:0]).shape == (0, 40)


def test_bad_input() -> None:
    array = layout("uhev1")
    points, normals = skin(10)
    evaluator = FieldEvaluator(array, AIR, "cpu")
    transfer = Transfer(evaluator, points, normals)
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
        Transfer(evaluator, np.tile(points, (100_000, 1)), np.tile(normals, (100_000, 1)))
    with pytest.raises(PalmfieldError, match="near and far"):
        Transfer(FieldEvaluator(array, AIR, "cpu", absorption_Np_m=9.0), points, normals)
    assert transfer.arp(np.ones((0, 256))).shape == (0, 10)
    assert Transfer(evaluator, np.zeros((0, 3)), np.zeros((0, 3))).arp(np.ones((2, 256))).shape == (2, 0)
