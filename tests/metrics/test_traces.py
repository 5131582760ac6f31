"""Metrics of a trace against the formulas of a damped oscillator and of sines."""

import numpy as np
import pytest

from palmfield.errors import MeasurementError
from palmfield.metrics import (
    harmonics,
    last_periods,
    overshoot,
    peak,
    peak_to_peak,
    rms,
    rms_map,
    settling_time,
    spectral_centroid,
    steady_value,
    strongest_line,
)

T = np.arange(0.0, 0.4, 1e-5)


def step_response(damping, f_Hz=100.0, size=-2e-6):
    """Of an oscillator at rest to a step: 1 - e^{-dwt} (cos w't + d/sqrt(1-d^2) sin w't)."""
    w = 2.0 * np.pi * f_Hz
    damped = w * np.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * w * T)
    return size * (1.0 - decay * (np.cos(damped * T) + damping * w / damped * np.sin(damped * T)))


@pytest.mark.parametrize("damping", [0.1, 0.3, 0.6])
def test_overshoot_and_peak_of_an_oscillator_are_those_of_its_formula(damping):
    """exp(-pi d/sqrt(1-d^2)), at half a damped period."""
    trace = step_response(damping)
    steady = steady_value(T, trace, (0.38, 0.4))
    assert steady == pytest.approx(-2e-6, rel=1e-6)
    assert overshoot(T, trace, steady) == pytest.approx(np.exp(-np.pi * damping / np.sqrt(1 - damping**2)), rel=1e-4)
    when, value = peak(T, trace)
    assert when == pytest.approx(0.5 / (100.0 * np.sqrt(1.0 - damping**2)), abs=1e-5)
    assert value < -2e-6 and peak(T, trace, of="positive")[1] == pytest.approx(0.0, abs=1e-12)


def test_a_trace_that_does_not_overshoot_has_none():
    assert overshoot(T, 1.0 - np.exp(-T / 0.01), 1.0) == 0.0


@pytest.mark.parametrize("band", [0.02, 0.05, 0.1])
def test_exponential_settles_after_tau_times_the_log_of_its_band(band):
    trace = -3.0 * (1.0 - np.exp(-T / 0.02))
    assert settling_time(T, trace, -3.0, band) == pytest.approx(0.02 * np.log(1.0 / band), abs=1e-8)
    late = np.where(T < 0.1, 0.0, -3.0 * (1.0 - np.exp(-(T - 0.1) / 0.02)))
    assert settling_time(T, late, -3.0, band, start_s=0.1) == pytest.approx(0.02 * np.log(1.0 / band), abs=1e-7)


def test_settling_of_an_oscillator_lies_below_its_envelopes():
    trace = step_response(0.1)
    envelope = np.log(1.0 / (0.05 * np.sqrt(1.0 - 0.1**2))) / (0.1 * 2.0 * np.pi * 100.0)
    found = settling_time(T, trace, -2e-6, 0.05)
    assert envelope - 0.5 / (100.0 * np.sqrt(1.0 - 0.01)) < found <= envelope


def test_a_trace_that_never_settles_and_a_band_of_nothing_are_refused():
    with pytest.raises(MeasurementError, match="the signal is 100 % from its steady value"):
        settling_time(T, 1.0 + np.cos(2 * np.pi * 100 * T[: len(T)]) * (T < 1), 1.0, 0.05, end_s=0.39)
    with pytest.raises(MeasurementError, match="band is 0"):
        settling_time(T, T, 1.0, 0.0)
    with pytest.raises(MeasurementError, match="not 0"):
        overshoot(T, T, 0.0)


def test_peak_to_peak_from_rest_and_over_the_last_periods_differ_by_the_onset():
    trace = np.sin(2 * np.pi * 200 * T) + 3.0 * np.exp(-T / 0.01)
    assert peak_to_peak(T, trace, last_periods(T, 200.0, 5)) == pytest.approx(2.0, rel=1e-5)
    assert peak_to_peak(T, trace) > 4.0
    with pytest.raises(MeasurementError, match=r"100 periods of 200 Hz take 0\.5 s"):
        last_periods(T, 200.0, 100)


def test_rms_of_a_sine_with_a_mean():
    trace = 5.0 + 2.0 * np.sin(2 * np.pi * 200 * T)
    window = last_periods(T, 200.0, 4)
    assert rms(T, trace, window, mean="removed") == pytest.approx(np.sqrt(2.0), rel=1e-9)
    assert rms(T, trace, window) == pytest.approx(np.sqrt(27.0), rel=1e-9)
    both = rms_map(T, np.stack([trace, 2.0 * trace], axis=1), window)
    assert both == pytest.approx([np.sqrt(27.0), 2.0 * np.sqrt(27.0)], rel=1e-9)


def test_windows_hold_their_ends_and_at_least_two_samples():
    ramp = np.arange(11.0)
    assert steady_value(0.1 * ramp, ramp, (0.5, 0.7)) == pytest.approx(6.0)
    with pytest.raises(MeasurementError, match="holds 1 samples"):
        steady_value(0.1 * ramp, ramp, (0.95, 2.0))
    with pytest.raises(MeasurementError, match="is nan"):
        rms([0.0, 1.0], [0.0, np.nan])


def test_harmonics_of_a_squared_sine():
    """AM of pressure of depth m pushes as (1 + m sin)^2: lines 2m and m^2/2, so 2f/f is m/4, on any record."""
    cut = T < 0.0337
    lines = harmonics(T[cut], (1.0 + 0.8 * np.sin(2 * np.pi * 200 * T[cut] + 0.3)) ** 2, 200.0, 3)
    assert lines == pytest.approx([1.6, 0.32, 0.0], abs=1e-9)
    with pytest.raises(MeasurementError, match="half the sampling rate"):
        harmonics(T, T, 30e3, 2)


def test_strongest_line_and_centroid_of_two_lines():
    signal = 2.0 * np.sin(2 * np.pi * 100 * T) + np.sin(2 * np.pi * 400 * T) + 9.0
    assert strongest_line(T, signal, (10.0, 1000.0)) == pytest.approx((100.0, 2.0))
    assert strongest_line(T, signal, (200.0, 1000.0)) == pytest.approx((400.0, 1.0))
    assert spectral_centroid(T, signal, (10.0, 1000.0)) == pytest.approx((4 * 100 + 400) / 5, rel=1e-9)
    with pytest.raises(MeasurementError, match="has no line between"):
        spectral_centroid(T, signal, (1.0, 2.0))
