"""ARP of drives that a few span, against double precision point by point."""

import numpy as np
import pytest

from palmfield.acoustics.arrays import layout, with_faults
from palmfield.acoustics.focus import focus
from palmfield.acoustics.phased_array import MultiArrayField, directivity_groups
from palmfield.acoustics.spanned_arp import SpannedArp, drives_span, spanned_fields
from palmfield.types import Air, Array, Complex, Float

pytestmark = pytest.mark.numerics

AIR = Air()


def circle(array: Array, count: int, radius_m: float = 0.01, phase: float = 0.0) -> Complex:
    """Drives of foci round a circle 0.2 m above the array."""
    angle = phase + 2.0 * np.pi * np.arange(count) / count
    foci = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(count, 0.2)])
    return np.array([focus(array, AIR, one) for one in foci])


def dome(count: int) -> tuple[Float, Float]:
    """Points on a shallow dome over the array, and its normals, which look down, half of them away from it."""
    x, y = np.random.default_rng(0).uniform(-0.05, 0.05, (2, count))
    normals = np.column_stack([4.0 * x, 4.0 * y, -np.ones(count)])
    normals[::2, 2] *= -1.0
    points = np.column_stack([x, y, 0.2 + 2.0 * (x * x + y * y)])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def spanned(array: Array, points: Float, normals: Float) -> SpannedArp:
    """ARP at the points, of drives on the circle."""
    basis = drives_span(circle(array, 120))
    assert basis is not None and basis.shape[1] < 40
    field = MultiArrayField(directivity_groups([array]), AIR, "cpu")
    return SpannedArp(spanned_fields(field, points, normals, basis))


@pytest.mark.parametrize("count", [1, 16, 2500])
@pytest.mark.parametrize("faulty", [False, True])
def test_it_is_the_law_in_double_precision(count, faulty, arp64):
    array = layout("uhev1")
    if faulty:
        array = with_faults(array, dead=[3, 100], inverted=[17, 18])
    points, normals = dome(count)
    at = spanned(array, points, normals)
    drives = circle(array, 7, phase=0.123)
    got = at.evaluate(drives)
    assert got is not None and got.shape == (7, count)
    expected = np.array([arp64(points, normals, array, drive) for drive in drives])
    # Of the focus: points where lit and dark meet may fall on either side, with next to no pressure
    assert np.abs(got - expected).max() < 1e-5 * max(np.abs(expected).max(), 1.0)
    single = at.evaluate(drives[3:4])
    assert single is not None and np.array_equal(single[0], got[3])


def test_drives_outside_the_span_are_not_taken():
    array = layout("uhev1")
    at = spanned(array, *dome(40))
    on_path = circle(array, 3, phase=0.4)
    assert at.evaluate(on_path) is not None
    off_path = np.concatenate([on_path[:2], circle(array, 1, radius_m=0.0125)])
    assert at.evaluate(off_path) is None
    assert at.evaluate(0.0 * on_path) is not None, "silence is in every span"


def test_drives_of_all_kinds_have_no_small_span():
    random = np.random.default_rng(0)
    assert drives_span(random.normal(size=(300, 256)) + 1j * random.normal(size=(300, 256))) is None
    assert drives_span(np.zeros((4, 256), complex)) is None
