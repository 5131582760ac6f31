"""Velocity and intensity against plane waves, radiated power and conservation of energy."""

import numpy as np
import pytest

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.derived import intensity, particle_velocity
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex, Field, Float

AIR = Air()
RHO, C = density(AIR), sound_speed(AIR)
FREQUENCY_Hz = 40e3
K = 2 * np.pi * FREQUENCY_Hz / C


def reactive_intensity(field: Field) -> Float:
    """Im(p u*)/2 [W/m2], shape (n, 3): energy that swings to and fro."""
    return (field.pressure[:, None] * particle_velocity(field, AIR, FREQUENCY_Hz).conj()).imag / 2.0


def plane_wave(direction: Float, amplitude: complex) -> Field:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 3))
    p = amplitude * np.exp(1j * K * points @ direction)
    return Field(p.astype(np.complex64), (1j * K * p[:, None] * direction).astype(np.complex64))


def test_plane_wave() -> None:
    direction, amplitude = np.array([2.0, -3.0, 6.0]) / 7.0, 300.0 * np.exp(0.7j)
    wave = plane_wave(direction, amplitude)
    # In phase with the pressure and along the way it goes, so that it carries energy forwards
    expected = wave.pressure[:, None] / (RHO * C) * direction
    np.testing.assert_allclose(particle_velocity(wave, AIR, FREQUENCY_Hz), expected, rtol=1e-5)
    power = 300.0**2 / (2 * RHO * C)
    np.testing.assert_allclose(intensity(wave, AIR, FREQUENCY_Hz), np.tile(power * direction, (50, 1)), rtol=1e-5)
    assert np.abs(reactive_intensity(wave)).max() < 1e-5 * power


def test_standing_wave_carries_nothing() -> None:
    x = np.linspace(0.0, 0.01, 40)
    p, slope = np.cos(K * x), np.zeros((40, 3))
    slope[:, 0] = -K * np.sin(K * x)
    field = Field(p.astype(np.complex64), slope.astype(np.complex64))
    assert np.abs(intensity(field, AIR, FREQUENCY_Hz)).max() == 0.0
    expected = -np.sin(2 * K * x) / (4 * RHO * C)  # grad cos^2(kx)/(4 w rho)
    np.testing.assert_allclose(reactive_intensity(field)[:, 0], expected, atol=1e-6 / (RHO * C))


def flux(array: Array, drive: Complex, height_m: float, half_m: float, spacing_m: float = 4e-3) -> float:
    """Energy through a square of a plane [W]: beyond its edge hardly any sound may go."""
    axis = np.arange(-half_m, half_m + spacing_m / 2, spacing_m)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height_m)])
    evaluator = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.0, mode="accurate")
    field = evaluator.pressure(points, drive, gradient=True)
    return float(intensity(field, AIR, FREQUENCY_Hz)[:, 2].sum() * spacing_m**2)


def beam() -> tuple[Array, Complex]:
    """Point sources less than half a wavelength apart under a Gaussian, focused: nothing radiates to the sides."""
    steps = 4e-3 * (np.arange(32) - 15.5)
    x, y = map(np.ravel, np.meshgrid(steps, steps))
    positions = np.column_stack([x, y, np.zeros(1024)])
    array = Array("beam", positions, np.tile([0.0, 0.0, 1.0], (1024, 1)), p0_Pa_m=1.0, piston_radius_m=0.0)
    drive = focus(array, AIR, [0.02, 0.01, 0.2]) * np.exp(-((positions / 0.02) ** 2).sum(axis=1))
    return array, drive


def test_the_same_energy_passes_two_planes_and_is_what_was_radiated() -> None:
    array, drive = beam()
    # Half of the power of monopoles in free space: pi p0^2/(rho c) sum a_i a_j* sin(kd)/(kd)
    d = np.linalg.norm(array.positions[:, None] - array.positions, axis=2)
    radiated = np.pi / (RHO * C) * np.vdot(drive, np.sinc(K * d / np.pi) @ drive).real
    low, high = flux(array, drive, 0.1, 0.25), flux(array, drive, 0.2, 0.35)
    assert low == pytest.approx(high, rel=5e-6)
    assert low == pytest.approx(radiated, rel=5e-6)


def test_reactive_intensity_is_the_slope_of_loudness() -> None:
    array = layout("uhev1")
    drive = focus(array, AIR, [0.0, 0.0, 0.2])
    evaluator = FieldEvaluator(array, AIR, "cpu", mode="accurate")
    points = np.random.default_rng(2).uniform([-0.02, -0.02, 0.18], [0.02, 0.02, 0.22], (60, 3))
    found = reactive_intensity(evaluator.pressure(points, drive, gradient=True))
    step = 1e-4
    expected = np.empty((60, 3))
    for i, axis in enumerate(np.eye(3)):
        ahead, behind = (np.abs(evaluator.pressure(points + s * step * axis, drive).pressure) ** 2 for s in (1, -1))
        expected[:, i] = (ahead - behind) / (2 * step) / (8 * np.pi * FREQUENCY_Hz * RHO)
    # Central differences over 1/86 of a wave are off by (k step)^2/6 of the wave's own slope, 1e-4
    assert np.linalg.norm(found - expected) < 1e-3 * np.linalg.norm(expected)


def test_bad_input() -> None:
    bare = Field(np.ones(3, np.complex64))
    with pytest.raises(PalmfieldError, match="no gradient"):
        intensity(bare, AIR, FREQUENCY_Hz)
    with pytest.raises(PalmfieldError, match="frequency_Hz = 0"):
        particle_velocity(plane_wave(np.array([0.0, 0.0, 1.0]), 1.0), AIR, 0)
