"""Bad input is refused in one clear line, whatever its kind."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.acoustics import check
from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout, placed, with_faults
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.langevin import radiation_stress
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.validity import warnings
from palmfield.drive.foci import solve_transfer
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Field

AIR = Air()
UHEV1 = layout("uhev1")


@pytest.mark.parametrize(
    ("points", "match"),
    [
        ([[0.0, 0.0, 0.1], [0.0, 2e4, 0.1]], r"points\[1\] = .* over 10000 m away: give metres"),
        ([[0.0, 0.0, 1e300]], r"points\[0\]"),
        (np.array([[0.0, 0.0, 0.1j]]), "points are complex"),
        ([[0.0, 0.0, 0.1], [0.0, 0.1]], "unequal length"),
        ([["a", "b", "c"]], "points have type"),
        ([["1", "2", "3"]], "points have type"),
        ([[None, 0.0, 0.1]], "points have type object"),
    ],
)
def test_points_that_are_none(points: Any, match: str) -> None:
    for work in (
        lambda: FieldEvaluator(UHEV1, AIR, "cpu").pressure(points, np.ones(256)),
        lambda: pressure64(points, UHEV1, np.ones(256), AIR),
        lambda: warnings(UHEV1, points, np.ones(len(points)), AIR),
    ):
        with pytest.raises(PalmfieldError, match=match):
            work()


def test_drives_that_are_none() -> None:
    for drive, match in ((["full"] * 256, "drive have type"), ([[1.0], 2.0], "unequal length")):
        with pytest.raises(PalmfieldError, match=match):
            check.drive(drive, UHEV1)
        with pytest.raises(PalmfieldError, match=match.replace("drive", "drives")):
            check.frames(drive, UHEV1)


def test_frames_are_contiguous_whatever_their_order() -> None:
    drives = np.asfortranarray(np.random.default_rng(0).normal(size=(20, 256)) + 1j)
    found = check.frames(drives, UHEV1)
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, drives)


@pytest.mark.parametrize("name", ["positions", "normals", "gain", "directivity_table"])
def test_lists_in_an_array_are_named(name: str) -> None:
    table = np.array([[0.0, 1.0], [45.0, 0.7], [90.0, 0.4]])
    array = replace(UHEV1, gain=np.ones(256, complex), directivity_table=table)
    changed = replace(array, **{name: getattr(array, name).tolist()})
    with pytest.raises(SceneError, match=rf"array 'uhev1' {name} is a list: give a NumPy array"):
        FieldEvaluator(changed, AIR, "cpu")


@pytest.mark.parametrize("frequency", [0.0, -40e3, np.nan, np.inf])
def test_one_message_for_every_bad_carrier(frequency: float) -> None:
    field = Field(np.ones(1, np.complex64), np.ones((1, 3), np.complex64))
    for work in (
        lambda: arp(field, [[0.0, 0.0, 1.0]], AIR, frequency, device="cpu"),
        lambda: radiation_stress(field, AIR, frequency),
        lambda: check.angular_frequency(frequency),
    ):
        with pytest.raises(SceneError, match=f"frequency_Hz = {frequency} is not positive and finite"):
            work()


def test_transfer_matrices_that_are_none() -> None:
    matrix = np.ones((2, 5), complex)
    matrix[1, 3] = np.nan
    with pytest.raises(SceneError, match=r"transfer\[1\] is not finite"):
        solve_transfer(matrix)
    with pytest.raises(SceneError, match=r"transfer has shape \(5,\)"):
        solve_transfer(np.ones(5, complex))


def test_faults_by_mask() -> None:
    dead, inverted = np.zeros(256, bool), np.zeros(256, bool)
    dead[[3, 77]], inverted[[5]] = True, True
    by_mask, by_number = with_faults(UHEV1, dead, inverted), with_faults(UHEV1, [3, 77], [5])
    assert by_mask.gain is not None
    np.testing.assert_array_equal(by_mask.gain, by_number.gain)
    np.testing.assert_array_equal(with_faults(UHEV1, dead.tolist()).gain, with_faults(UHEV1, [3, 77]).gain)
    with pytest.raises(SceneError, match=r"mask dead has shape \(255,\): give \(256,\)"):
        with_faults(UHEV1, dead[:255])
    with pytest.raises(SceneError, match=r"dead = \[0\.5\] are not indices"):
        with_faults(UHEV1, cast(Any, [0.5]))


def test_a_rotation_in_float32_is_taken_for_the_nearest() -> None:
    exact = Rotation.from_euler("xyz", [20.0, -35.0, 10.0], degrees=True).as_matrix()
    found = placed(UHEV1, [0.0, 0.0, 0.1], exact.astype(np.float32))
    np.testing.assert_allclose(found.positions, placed(UHEV1, [0.0, 0.0, 0.1], exact).positions, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-15)
    with pytest.raises(SceneError, match="not a rotation matrix"):
        placed(UHEV1, [0.0, 0.0, 0.1], exact * (1.0 + 1e-6))
