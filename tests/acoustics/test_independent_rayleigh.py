"""The far-field directivity against the Rayleigh integral over the piston's disc."""

import numpy as np
import pytest
from rayleigh import array_of_pistons, hemisphere, one_piston, piston

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air

AIR = Air()
ONE = one_piston()
RADIUS = ONE.piston_radius_m
K = 2 * np.pi * ONE.frequency_Hz / sound_speed(AIR)
LENGTH = K * RADIUS**2 / 2


def ratio(distance_m: float) -> np.ndarray:
    """Model over integral at all angles up to 85 degrees."""
    points = hemisphere(distance_m)
    found, _ = pressure64(points, ONE, [1.0], AIR, absorption_Np_m=0.0)
    return found / piston(points, RADIUS, K, 1.0)


def test_the_integral_gives_the_closed_form_on_the_axis() -> None:
    d = np.array([0.001, 0.004, 0.02, 0.1, 0.4])
    points = np.column_stack([0 * d, 0 * d, d])
    exact = 2 / (1j * K * RADIUS**2) * (np.exp(1j * K * np.hypot(d, RADIUS)) - np.exp(1j * K * d))
    np.testing.assert_allclose(piston(points, RADIUS, K, 1.0), exact, rtol=1e-9)


def test_model_and_integral_agree_far_away_at_all_angles() -> None:
    assert np.abs(ratio(1000 * LENGTH) - 1).max() < 1e-3


def test_amplitude_converges_at_second_order_and_phase_at_first() -> None:
    near, far = ratio(10 * LENGTH), ratio(20 * LENGTH)
    amplitudes = [np.abs(np.abs(some) - 1).max() for some in (near, far)]
    phases = [np.abs(np.angle(some)).max() for some in (near, far)]
    assert np.log2(amplitudes[0] / amplitudes[1]) == pytest.approx(2.0, abs=0.05)
    assert np.log2(phases[0] / phases[1]) == pytest.approx(1.0, abs=0.05)


def test_error_over_distance_is_the_one_documented() -> None:
    """docs/bench/peers.md: amplitude within 1 % from five Rayleigh lengths, 37 mm; phase within 2 degrees from 20."""
    assert np.abs(np.abs(ratio(5 * LENGTH)) - 1).max() < 0.01
    assert np.degrees(np.abs(np.angle(ratio(20 * LENGTH))).max()) < 2.0


def test_a_focus_has_the_magnitude_of_real_pistons() -> None:
    array = layout("uhev1")
    target = np.array([0.0, 0.0, 0.2])
    drive = focus(array, AIR, target)
    points = (target + np.random.default_rng(1).uniform(-0.02, 0.02, (60, 3))).astype(np.float32)
    true = array_of_pistons(points.astype(float), array, drive, K)
    found = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.0).pressure(points, drive).pressure
    assert np.linalg.norm(np.abs(found) - np.abs(true)) / np.linalg.norm(true) < 2.5e-3
    assert np.linalg.norm(found - true) / np.linalg.norm(true) < 2e-2
