"""The field as a solution of the wave equation: propagated from plane to plane, and held against mass conservation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import fft2, fftfreq, ifft2

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array, Complex

AIR = Air()
RHO, C = density(AIR), sound_speed(AIR)
OMEGA = 2 * np.pi * 40e3
K = OMEGA / C
FOCUS = np.array([0.02, 0.01, 0.2])


def dense_monopoles() -> tuple[Array, Complex]:
    """Point sources less than half a wavelength apart under a Gaussian, focused: nothing radiates to the sides."""
    steps = 4e-3 * (np.arange(32) - 15.5)
    y, x = np.meshgrid(steps, steps, indexing="ij")
    positions = np.column_stack([x.ravel(), y.ravel(), np.zeros(1024)])
    array = Array("dense", positions, np.tile([0.0, 0.0, 1.0], (1024, 1)), p0_Pa_m=1.0, piston_radius_m=0.0)
    return array, focus(array, AIR, FOCUS) * np.exp(-((positions / 0.02) ** 2).sum(axis=1))


def angular_spectrum(plane: Complex, spacing_m: float, distance_m: float) -> Complex:
    """A plane of pressure carried on by the Fourier transform, wave by wave (Goodman, Fourier Optics, sect. 3.10)."""
    k = 2 * np.pi * fftfreq(len(plane), spacing_m)
    kz = np.sqrt((K**2 - k[:, None] ** 2 - k**2).astype(complex))
    return ifft2(fft2(plane) * np.exp(1j * kz * distance_m))


def propagated_error(array: Array, drive: Complex, count: int, inside_m: float, taper: bool = False) -> float:
    """Relative L2 difference in the plane at 0.2 m between the field there and the one carried on from 0.1 m."""
    spacing = 4e-3
    axis = spacing * (np.arange(count) - count // 2)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    flat = np.column_stack([x.ravel(), y.ravel(), np.full(count**2, 0.1)])
    found = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.0).pressure(flat, drive).pressure
    plane = found.reshape(count, count).astype(complex)
    if taper:
        window = np.sqrt(np.hanning(count))
        plane *= window[:, None] * window
    inside = (np.abs(x) < inside_m) & (np.abs(y) < inside_m)
    carried = angular_spectrum(plane, spacing, 0.1)[inside]
    there = flat[inside.ravel()] + [0.0, 0.0, 0.1]
    expected, _ = pressure64(there, array, drive, AIR, absorption_Np_m=0.0)
    return float(np.linalg.norm(carried - expected) / np.linalg.norm(expected))


def test_a_plane_of_monopoles_field_propagates_to_the_field_farther_off() -> None:
    """An exact solution in both ways, so only float32 is left."""
    assert propagated_error(*dense_monopoles(), count=128, inside_m=0.1) < 2e-5


def test_pistons_propagate_but_for_the_far_field_directivity() -> None:
    """The model of a piston solves the wave equation only far away: 1.5 % for a 16 x 16 array between 0.1 and 0.2 m."""
    array = layout("uhev1")
    drive = focus(array, AIR, FOCUS)
    assert propagated_error(array, drive, 1024, 0.05, taper=True) < 0.02


def continuity_error(array: Array, drive: Complex, single: bool, points: np.ndarray, step_m: float) -> float:
    """Relative L2 of div u - i w p/(rho c^2), u = grad p/(i w rho), with differences of fourth order."""

    def field(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if single:
            found = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.0).pressure(at, drive, gradient=True)
            p, gradient = found.pressure, found.gradient
        else:
            p, gradient = pressure64(at, array, drive, AIR, gradient=True, absorption_Np_m=0.0)
        assert gradient is not None
        return p.astype(complex), gradient.astype(complex) / (1j * OMEGA * RHO)

    divergence = np.zeros(len(points), complex)
    for axis in range(3):
        for offset, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
            _, velocity = field(points + offset * step_m * np.eye(3)[axis])
            divergence += weight * velocity[:, axis] / (12 * step_m)
    expected = 1j * OMEGA * field(points)[0] / (RHO * C**2)
    return float(np.linalg.norm(divergence - expected) / np.linalg.norm(expected))


def some_points() -> np.ndarray:
    points = np.random.default_rng(0).uniform([-0.05, -0.05, 0.1], [0.05, 0.05, 0.3], (200, 3))
    return points.astype(np.float32).astype(float)


def test_gradient_conserves_mass_at_fourth_order() -> None:
    array = replace(layout("uhev1"), piston_radius_m=0.0)
    drive = focus(array, AIR, FOCUS)
    errors = [continuity_error(array, drive, False, some_points(), h) for h in (2e-4, 1e-4)]
    assert errors[1] < (K * 1e-4) ** 4 / 30  # truncation of the stencil for waves of number K
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def test_float32_gradient_conserves_mass() -> None:
    array = replace(layout("uhev1"), piston_radius_m=0.0)
    # A step of 2^-12 m moves float32 coordinates without rounding
    assert continuity_error(array, focus(array, AIR, FOCUS), True, some_points(), 2.0**-12) < 3e-4


def test_pistons_conserve_mass_but_for_the_far_field_directivity() -> None:
    """The directivity of the far field adds about (angular Laplacian of D)/(k d)^2, which dies out with distance."""
    array = layout("uhev1")
    errors = []
    for distance in (0.1, 0.2, 0.4):
        points = some_points() * [1.0, 1.0, 0.0] + [0.0, 0.0, distance]
        errors.append(continuity_error(array, focus(array, AIR, [0.0, 0.0, distance]), False, points, 1e-4))
    assert errors[0] < 1e-3 and errors[2] < 1e-4
    assert errors[2] < errors[1] < errors[0]
