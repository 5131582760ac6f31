"""The float64 twin against closed forms and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1

from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array

AIR = Air()
K = 2 * np.pi * 40e3 / sound_speed(AIR)
ONE = Array("one", np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), p0_Pa_m=2.53)


def tilted(array: Array, seed: int = 3) -> Array:
    """The array with its normals tilted at random by up to some 20 degrees."""
    normals = array.normals + np.random.default_rng(seed).uniform(-0.25, 0.25, array.normals.shape)
    return replace(array, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))


def test_one_piston_on_its_axis() -> None:
    d = 0.31
    found, _ = pressure64([[0.0, 0.0, d]], ONE, [0.5j], AIR)
    expected = 0.5j * 2.53 / d * np.exp(1j * K * d - absorption_Np_m(AIR, 40e3) * d)
    assert found[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("degrees", [10.0, 45.0, 80.0])
def test_one_piston_off_its_axis(degrees: float) -> None:
    t, d = np.radians(degrees), 0.2
    found, _ = pressure64([[d * np.sin(t), 0.0, d * np.cos(t)]], ONE, [1.0], AIR, absorption_Np_m=0.0)
    x = K * 4.5e-3 * np.sin(t)
    assert abs(found[0]) == pytest.approx(2.53 / d * 2 * j1(x) / x, rel=1e-12)


def test_far_field_of_the_directivity_is_that_of_a_rayleigh_integral() -> None:
    """Monopoles spread over the piston's disc, their phases summed directly, give the same directivity."""
    steps = np.linspace(-4.5e-3, 4.5e-3, 401)
    x, y = np.meshgrid(steps, steps)
    disc = x**2 + y**2 <= (4.5e-3) ** 2
    for degrees in (20.0, 60.0):
        t = np.radians(degrees)
        summed = np.exp(-1j * K * x[disc] * np.sin(t)).mean()
        found, _ = pressure64([[np.sin(t), 0.0, np.cos(t)]], ONE, [1.0], AIR, absorption_Np_m=0.0)
        assert abs(found[0]) / 2.53 == pytest.approx(abs(summed), rel=2e-3)


def test_baffle_silences_the_plane_and_all_behind() -> None:
    points = [[0.1, 0.0, 0.0], [0.0, 0.0, -0.1], [0.0, 0.0, 0.0]]
    found, gradient = pressure64(points, ONE, [1.0], AIR, gradient=True)
    assert gradient is not None
    assert np.all(found == 0.0) and np.all(gradient == 0.0)


def test_gradient_converges_to_finite_differences_at_fourth_order() -> None:
    array = tilted(layout("uhev1"))
    drive = focus(layout("uhev1"), AIR, [0.01, 0.02, 0.15])
    points = np.random.default_rng(0).uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (40, 3))
    _, gradient = pressure64(points, array, drive, AIR, gradient=True)
    assert gradient is not None
    errors = []
    for h in (2e-4, 1e-4):
        numeric = np.empty_like(gradient)
        for axis in range(3):
            step = np.eye(3)[axis] * h
            p = [pressure64(points + m * step, array, drive, AIR)[0] for m in (-2, -1, 1, 2)]
            numeric[:, axis] = (p[0] - 8 * p[1] + 8 * p[2] - p[3]) / (12 * h)
        errors.append(np.linalg.norm(numeric - gradient) / np.linalg.norm(gradient))
    assert errors[1] < (K * 1e-4) ** 4 / 30  # truncation of the stencil for waves of number K
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)


def test_gradient_has_the_terms_beside_the_phase() -> None:
    """Close to one piston, 1/d, directivity and a strong absorption all matter; each is seen by the differences."""
    points = np.array([[0.004, 0.003, 0.006], [0.01, -0.002, 0.004]])
    _, gradient = pressure64(points, ONE, [1.0], AIR, gradient=True, absorption_Np_m=20.0)
    assert gradient is not None
    h = 1e-7
    for axis in range(3):
        step = np.eye(3)[axis] * h
        ahead, _ = pressure64(points + step, ONE, [1.0], AIR, absorption_Np_m=20.0)
        behind, _ = pressure64(points - step, ONE, [1.0], AIR, absorption_Np_m=20.0)
        np.testing.assert_allclose(gradient[:, axis], (ahead - behind) / (2 * h), rtol=1e-6)


def test_field_solves_the_helmholtz_equation_in_the_far_field_of_a_small_source() -> None:
    """A piston of radius 0 without absorption is a monopole, an exact solution: the Laplacian is -k^2 p."""
    monopole = replace(ONE, piston_radius_m=0.0)
    at = np.array([0.05, 0.03, 0.2])
    h = 2e-4
    offsets = np.concatenate([[np.zeros(3)], np.eye(3) * h, -np.eye(3) * h])
    p, _ = pressure64(at + offsets, monopole, [1.0], AIR, absorption_Np_m=0.0)
    laplacian = (p[1:].sum() - 6 * p[0]) / h**2
    assert laplacian == pytest.approx(-(K**2) * p[0], rel=3e-3)
