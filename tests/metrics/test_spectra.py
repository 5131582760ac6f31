import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import MeasurementError
from palmfield.metrics.spectra import amplitude_spectrum, spectral_peaks


def test_a_sine_on_a_bin_has_its_own_amplitude_and_dc_is_gone():
    time = np.arange(1000) * 1e-4
    frequency, amplitude = amplitude_spectrum(time, 5.0 + 3e-6 * np.sin(2 * np.pi * 200.0 * time))
    assert frequency[0] == pytest.approx(10.0)
    assert frequency[amplitude.argmax()] == pytest.approx(200.0)
    assert amplitude.max() == pytest.approx(3e-6, rel=1e-6)
    # The Hann window reaches one bin to each side; a constant of 5 leaves no more than its rounding elsewhere.
    away = np.abs(frequency - 200.0) > 15.0
    assert amplitude[away].max() < 1e-14


@settings(deadline=None)
@given(hertz=st.floats(60.0, 900.0), size=st.floats(1e-9, 1e-3), phase=st.floats(0, 6.3), count=st.integers(900, 1101))
def test_the_highest_peak_is_the_sine_within_the_stated_error(hertz, size, phase, count):
    time = np.arange(count) * 1e-4
    spectrum = amplitude_spectrum(time, size * np.sin(2 * np.pi * hertz * time + phase))
    found, height = spectral_peaks(*spectrum)[0]
    assert abs(found - hertz) < 0.01 * spectrum[0][0]
    assert height == pytest.approx(size, rel=0.001)


def test_two_sines_give_two_peaks_and_a_slow_drift_gives_none():
    time = np.arange(2000) * 1e-4
    signal = np.sin(2 * np.pi * 200 * time) + 0.1 * np.sin(2 * np.pi * 405 * time) - np.exp(-time / 0.05)
    peaks = spectral_peaks(*amplitude_spectrum(time, signal))
    assert [round(at) for at, _ in peaks] == [200, 405]


def test_silence_has_no_peak():
    assert spectral_peaks(*amplitude_spectrum(np.arange(10.0), np.zeros(10))) == []


def test_times_must_be_even_and_enough():
    with pytest.raises(MeasurementError, match="not evenly spaced"):
        amplitude_spectrum(np.array([0, 1, 2, 3, 4, 5, 6, 8.0]), np.zeros(8))
    with pytest.raises(MeasurementError, match="at least 8"):
        amplitude_spectrum(np.arange(7.0), np.zeros(7))
