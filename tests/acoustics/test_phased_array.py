"""Several arrays as one: numbering, frames, directivities, and the field against the float64 reference."""

import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.acoustics.arrays import layout, placed
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray, only
from palmfield.acoustics.reference import pressure64
from palmfield.config import ArrayConfig
from palmfield.errors import PalmfieldError, SceneError
from palmfield.transforms import IDENTITY, Placement, Transform

HERE = Placement.of(IDENTITY)
TILTED = Transform(np.array([0.25, 0.0, 0.05]), Rotation.from_euler("y", -40, degrees=True).as_matrix())


def instance(placement: Placement = HERE, **keys: object) -> ArrayInstance:
    return ArrayInstance(ArrayConfig.model_validate(keys), placement)


def two(second: dict[str, object], device: str = "cpu") -> PhasedArray:
    place = Placement.of(TILTED)
    return PhasedArray([instance(), instance(place, **second)], [HERE, place], device)


def random_drive(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(0, 1, count) * np.exp(2j * np.pi * rng.uniform(0, 1, count))


def test_transducers_are_numbered_from_array_to_array() -> None:
    array = two({"layout": "sonicsurface"})
    assert len(array) == sum(len(part) for part in array.parts)
    assert [part.stop - part.start for part in array.slices] == [len(part) for part in array.parts]
    assert array.slices[0].start == 0 and array.slices[1].start == array.slices[0].stop
    second = placed(layout("sonicsurface"), *TILTED)
    np.testing.assert_allclose(array.array.positions[array.slices[1]], second.positions, atol=1e-15)
    np.testing.assert_allclose(array.facing[:, 1], TILTED.rotation[:, 2], atol=1e-12)
    assert array.heights[1] == pytest.approx(TILTED.rotation[:, 2] @ TILTED.position, abs=1e-12)


@pytest.mark.parametrize("second", [{}, {"directivity": "t4010a1"}])
def test_fields_of_all_arrays_add(second: dict[str, object]) -> None:
    array = two(second)
    assert len(array.groups) == (2 if second else 1)
    points = np.random.default_rng(1).uniform(-0.03, 0.03, (40, 3)) - [-0.05, 0.0, -0.2]
    drive = random_drive(len(array))
    moved = [array.parts[0], placed(array.parts[1], *TILTED)]
    expected = sum(
        pressure64(points, part, drive[own], array.air)[0] for part, own in zip(moved, array.slices, strict=True)
    )
    np.testing.assert_allclose(array.pressure64(points, drive), expected, rtol=1e-12)
    field = array.field.pressure(points, drive)
    assert array.field.count == len(array)
    np.testing.assert_allclose(field.pressure, expected, atol=3e-5 * np.abs(expected).max())
    there = array.field.pressure(array.field.upload(points), drive).pressure
    np.testing.assert_array_equal(there.numpy().view(np.complex64)[:, 0], field.pressure)
    slopes = array.field.pressure(points, drive, gradient=True).gradient
    alone = [array.field.pressure(points, np.where(np.arange(len(array)) < array.slices[1].start, *two), True).gradient
             for two in ((drive, 0.0), (0.0, drive))]  # fmt: skip
    assert slopes is not None and alone[0] is not None and alone[1] is not None
    np.testing.assert_allclose(slopes, alone[0] + alone[1], atol=1e-5 * np.abs(slopes).max())
    with pytest.raises(PalmfieldError, match=f"drive has shape .* but the field has {len(array)} transducers"):
        array.field.pressure(points, drive[1:])


def test_the_field_is_made_once_whoever_asks() -> None:
    array = two({})
    seen: list[object] = []
    threads = [threading.Thread(target=lambda: seen.append(array.field)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(field is seen[0] for field in seen)


def test_same_placements_to_a_nanometre() -> None:
    array = two({})
    nudged = Placement.of(Transform(TILTED.position + 1e-10, TILTED.rotation))
    moved = Placement.of(Transform(TILTED.position + 1e-6, TILTED.rotation))
    assert array.same(array.placements) and array.same([HERE, nudged]) and not array.same([HERE, moved])


def test_sites_are_transducers() -> None:
    sites = (((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ((0.01, 0.0, 0.0), (0.0, 0.0, 1.0)))
    place = Placement((0.0,) * 3, tuple(np.eye(3).ravel()), sites)
    array = PhasedArray([instance(place, layout="sites", sites="t")], [place], "cpu")
    np.testing.assert_array_equal(array.array.positions, [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])


def test_bad_arrays_are_refused_by_name() -> None:
    with pytest.raises(SceneError, match="has no piston: remove the radius or set directivity to piston") as caught:
        PhasedArray([instance(directivity="point", piston_radius_m=0.004)], [HERE])
    assert caught.value.setting == "piston_radius_m"
    with pytest.raises(SceneError, match="256"):
        PhasedArray([instance(dead=(256,))], [HERE])
    with pytest.raises(PalmfieldError, match="cuda:99"):
        _ = PhasedArray([instance()], [HERE], "cuda:99").field


def test_only_some_transducers() -> None:
    array = layout("sonicsurface")
    mask = array.positions[:, 0] > 0.0
    some = only(array, mask)
    assert len(some) == mask.sum() and some.address is not None and len(some.address) == len(some)
    np.testing.assert_array_equal(only(array, np.flatnonzero(mask).astype(np.int32)).positions, some.positions)
