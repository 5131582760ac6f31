"""Directivity models against the piston's closed form, the table itself and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval
from scipy.special import j1

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.acoustics.directivities.t4010a1 import T4010A1_DIRECTIVITY
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transducer import table_misfit
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Float

AIR = Air()
K = 2 * np.pi * 40e3 / sound_speed(AIR)
ONE = Array("one", np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), p0_Pa_m=2.53)
MEASURED = replace(ONE, directivity_table=T4010A1_DIRECTIVITY)


def off_axis(array: Array, degrees: Float) -> Float:
    """Loudness at 1 m at angles off the axis, relative to the axis, through the float64 field."""
    t = np.radians(degrees)
    points = np.column_stack([np.sin(t), np.zeros_like(t), np.cos(t)])
    return np.abs(pressure64(points, array, [1.0], AIR, absorption_Np_m=0.0)[0]) / array.p0_Pa_m


def piston_table(step_deg: float) -> Float:
    t = np.arange(0.0, 90.0 + step_deg / 2, step_deg)
    x = K * 4.5e-3 * np.sin(np.radians(t[1:]))
    return np.column_stack([t, np.concatenate([[1.0], 2 * j1(x) / x])])


def test_t4010a1_is_its_decibels() -> None:
    decibels = 20 * np.log10(T4010A1_DIRECTIVITY[:, 1])
    np.testing.assert_allclose(decibels, [0, 0, 0, -1, -3, -6, -9, -12, -14, -15], atol=0.03)


def test_field_of_a_measured_transducer_passes_near_its_table() -> None:
    degrees = T4010A1_DIRECTIVITY[:-1, 0]  # at 90 deg it is silent: the baffle
    distance = np.abs(off_axis(MEASURED, degrees) - T4010A1_DIRECTIVITY[:-1, 1]).max()
    misfit = table_misfit(T4010A1_DIRECTIVITY)
    assert distance == pytest.approx(misfit, abs=1e-9)  # the worst entry is not at 90 deg
    assert misfit < 0.01
    assert off_axis(MEASURED, np.array([0.0]))[0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("step_deg", "limit"), [(10.0, 6e-3), (5.0, 1.5e-3), (1.0, 1e-4)])
def test_table_of_a_piston_sounds_like_the_piston_the_more_so_the_finer(step_deg: float, limit: float) -> None:
    degrees = np.arange(0.0, 90.0, 0.7)
    found = off_axis(replace(ONE, directivity_table=piston_table(step_deg)), degrees)
    assert np.abs(found - off_axis(ONE, degrees)).max() < limit


@pytest.mark.parametrize("array", [ONE, MEASURED, replace(ONE, piston_radius_m=0.0)], ids=["piston", "table", "point"])
def test_second_coefficients_are_the_derivative_of_the_first(array: Array) -> None:
    quintic, slope = directivity_coefficients(array, K)
    assert quintic.shape == (6,) and slope.shape == (5,)
    s, h = np.linspace(0.05, 0.95, 19), 1e-5
    np.testing.assert_allclose(
        polyval(s, slope), (polyval(s + h, quintic) - polyval(s - h, quintic)) / (2 * h), atol=1e-8
    )


def test_point_source_and_piston_coefficients() -> None:
    point, slope = directivity_coefficients(replace(ONE, piston_radius_m=0.0), K)
    np.testing.assert_array_equal(point, [1, 0, 0, 0, 0, 0])
    assert not slope.any()
    piston, _ = directivity_coefficients(ONE, K)
    for degrees in (10.0, 45.0, 90.0):
        x = K * 4.5e-3 * np.sin(np.radians(degrees))
        assert polyval(np.sin(np.radians(degrees)) ** 2, piston) == pytest.approx(2 * j1(x) / x, abs=1e-7)


def test_gradient_of_measured_transducers_agrees_with_differences() -> None:
    random = np.random.default_rng(2)
    normals = random.normal(size=(20, 3)) * 0.2 + [0.0, 0.0, 1.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    array = Array("tilted", random.uniform(-0.05, 0.05, (20, 3)) * [1, 1, 0], normals, 2.53,
                  gain=random.normal(size=20) + 1j, directivity_table=T4010A1_DIRECTIVITY)  # fmt: skip
    points, drive, h = random.uniform([-0.05, -0.05, 0.01], [0.05, 0.05, 0.1], (30, 3)), np.ones(20), 1e-6
    _, gradient = pressure64(points, array, drive, AIR, gradient=True)
    assert gradient is not None
    for axis in range(3):
        step = np.eye(3)[axis] * h
        ahead, behind = (pressure64(points + m * step, array, drive, AIR)[0] for m in (1, -1))
        error = np.abs(gradient[:, axis] - (ahead - behind) / (2 * h)).max()
        assert error < 1e-5 * np.abs(gradient).max()


def changed(row: int, column: int, value: float) -> Float:
    table = T4010A1_DIRECTIVITY.copy()
    table[row, column] = value
    return table


@pytest.mark.parametrize(
    ("table", "match"),
    [
        (changed(5, 1, 0.1), "the quintic fit in"),
        (changed(0, 1, 0.99), "divide the table by its value on the axis"),
        (changed(4, 1, -0.7), "use magnitudes"),
        (changed(0, 0, 5.0), "5 to 90 deg"),
        (changed(9, 0, 85.0), "0 to 85 deg"),
        (changed(3, 0, 20.0), "rising"),
        (changed(3, 1, np.nan), "finite"),
        (T4010A1_DIRECTIVITY[:, :1], "shape"),
        (T4010A1_DIRECTIVITY[[0, 9]], "3 or more"),
    ],
)
def test_tables_that_cannot_be_followed_are_refused(table: Float, match: str) -> None:
    with pytest.raises(SceneError, match=match):
        pressure64([[0.0, 0.0, 0.1]], replace(ONE, directivity_table=table), [1.0], AIR)
