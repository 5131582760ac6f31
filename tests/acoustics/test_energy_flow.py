"""Flow of energy from the field and its gradient: conserved between planes, and what was radiated."""

import numpy as np
import pytest

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.types import Air, Array, Complex, Field, Float

AIR = Air()
RHO, C = density(AIR), sound_speed(AIR)
FREQUENCY_Hz = 40e3
K = 2 * np.pi * FREQUENCY_Hz / C


def particle_velocity(field: Field) -> Complex:
    """u = grad p/(i w rho) [m/s], shape (n, 3): Euler's equation for e^{-iwt}."""
    assert field.gradient is not None
    return field.gradient.astype(np.complex128) / (2j * np.pi * FREQUENCY_Hz * RHO)


def intensity(field: Field) -> Float:
    """Re(p u*)/2 [W/m2], shape (n, 3): the energy that flows through an area, mean over a period."""
    return (field.pressure[:, None] * particle_velocity(field).conj()).real / 2.0


def reactive_intensity(field: Field) -> Float:
    """Im(p u*)/2 [W/m2], shape (n, 3): energy that swings to and fro."""
    return (field.pressure[:, None] * particle_velocity(field).conj()).imag / 2.0


def flux(array: Array, drive: Complex, height_m: float, half_m: float, spacing_m: float = 4e-3) -> float:
    """Energy through a square of a plane [W]: beyond its edge hardly any sound may go."""
    axis = np.arange(-half_m, half_m + spacing_m / 2, spacing_m)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height_m)])
    evaluator = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.0, mode="accurate")
    field = evaluator.pressure(points, drive, gradient=True)
    return float(intensity(field)[:, 2].sum() * spacing_m**2)


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
