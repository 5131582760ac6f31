"""Thresholds, levels and lines against values worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.errors import OutputError
from palmfield.perception.observers import (
    OBSERVERS,
    level_dB_SL,
    levels_dB_SL,
    line_amplitude,
    line_amplitudes,
    threshold_m,
)

HANDLE = OBSERVERS["morioka_griffin_2006"]
HUMAN = OBSERVERS["afferent_human"]
PROBE = OBSERVERS["bolanowski_1988"]


def test_observers_are_named_and_say_what_their_table_holds():
    assert list(OBSERVERS) == ["bolanowski_1988", "morioka_griffin_2006", "afferent_human"]
    for name, observer in OBSERVERS.items():
        assert observer.name == name
        assert observer.source and observer.why and observer.spread_of
        assert observer.spread_dB is None or observer.spread_dB > 0.0
        assert ("rms" in observer.stated) != ("um peak" in observer.stated)
        assert observer.frequency_Hz.shape == observer.peak_m.shape
        assert np.all(np.diff(observer.frequency_Hz) > 0)


@pytest.mark.parametrize(
    ("f_Hz", "peak_um"),
    [
        # sqrt(2) 0.029 / (2 pi 200)^2 = 0.041012 / 1.579137e6
        (200, 0.025971),
        # sqrt(2) 0.023 / (2 pi 100)^2 = 0.032527 / 3.947842e5
        (100, 0.082392),
        # sqrt(2) 0.095 / (2 pi 8)^2 = 0.134350 / 2526.619
        (8, 53.174),
    ],
)
def test_acceleration_thresholds_become_peak_displacement(f_Hz, peak_um):
    assert threshold_m(HANDLE, f_Hz) == pytest.approx(1e-6 * peak_um, rel=2e-4)


def test_table_points_of_the_second_observer():
    np.testing.assert_allclose(threshold_m(HUMAN, [2, 200, 350]), [24.3e-6, 0.042e-6, 0.12e-6])


@pytest.mark.parametrize(
    ("f_Hz", "dB"), [(1, 29), (10, 21), (20, 15), (40, 8), (100, -6), (250, -19), (400, -10), (500, -3)]
)
def test_the_composite_curve_in_dB_re_1_um(f_Hz, dB):
    assert 20 * np.log10(threshold_m(PROBE, f_Hz) / 1e-6) == pytest.approx(dB)


def test_channels_are_not_added_up():
    """Twice the threshold at 20 Hz and at 30 Hz in one channel, and three times it at 250 Hz in another: 3 counts."""
    at = threshold_m(PROBE, [20, 30, 250])
    assert level_dB_SL(PROBE, [20, 30, 250], at * [2, 2, 3]) == pytest.approx(20 * np.log10(3))
    assert level_dB_SL(PROBE, [20, 30, 250], at * [3, 4, 2]) == pytest.approx(20 * np.log10(5))


@given(area_cm2=st.floats(0.02, 1.45), frequency=st.floats(80, 320))
def test_doubling_the_area_lowers_the_threshold_by_3_dB(area_cm2, frequency):
    small, large = (threshold_m(PROBE, frequency, 1e-4 * area) for area in (area_cm2, 2 * area_cm2))
    assert 20 * np.log10(small / large) == pytest.approx(3.0103, abs=1e-4)
    assert threshold_m(PROBE, frequency, 2.9e-4) == pytest.approx(float(threshold_m(PROBE, frequency)))


def test_area_counts_within_the_bounds_of_its_law_only():
    assert threshold_m(PROBE, 200, 50e-4) == pytest.approx(float(threshold_m(PROBE, 200)))
    assert threshold_m(PROBE, 200, 1e-8) == pytest.approx(float(threshold_m(PROBE, 200, 0.02e-4)))
    np.testing.assert_allclose(threshold_m(PROBE, [20, 79, 321], 1e-5), threshold_m(PROBE, [20, 79, 321]))


def test_areas_that_are_none_are_refused():
    with pytest.raises(OutputError, match=r"observer 'afferent_human' has no law for areas.*bolanowski_1988"):
        threshold_m(HUMAN, 200, 1e-4)
    with pytest.raises(OutputError, match=r"area_m2 is 0\.0"):
        level_dB_SL(PROBE, [200], [1e-6], 0.0)


@given(name=st.sampled_from(sorted(OBSERVERS)), share=st.floats(0, 1), amplitude=st.floats(1e-9, 1e-3))
def test_twice_the_displacement_is_6_dB_more(name, share, amplitude):
    low, high = OBSERVERS[name].frequency_Hz[[0, -1]]
    frequency = min(low * (high / low) ** share, high)
    once, twice = (level_dB_SL(OBSERVERS[name], [frequency], [factor * amplitude]) for factor in (1, 2))
    assert twice - once == pytest.approx(6.0206, abs=1e-4)


def test_between_points_the_interpolation_is_log_log():
    # Halfway in log f between 10 Hz (5.34 um) and 20 Hz (1.87 um): sqrt(5.34 1.87) = 3.1600 um
    assert threshold_m(HUMAN, 10 * np.sqrt(2)) == pytest.approx(3.1600e-6, rel=1e-4)


def test_outside_the_table_there_is_no_threshold():
    assert np.isnan(threshold_m(HANDLE, [0, 7.99, 315.1, -10, np.nan])).all()
    assert threshold_m(HANDLE, [[8.0, 315.0]]).shape == (1, 2)


def test_a_line_at_threshold_is_0_dB_and_ten_times_that_20_dB():
    at_threshold = 0.042e-6
    assert level_dB_SL(HUMAN, [200], [at_threshold]) == pytest.approx(0, abs=1e-9)
    assert level_dB_SL(HUMAN, [200], [10 * at_threshold]) == pytest.approx(20)


def test_lines_add_by_energy_and_dc_and_outsiders_do_not():
    # 3 thresholds at 100 Hz and 4 at 200 Hz make 5: 20 log10 5 = 13.979 dB
    frequencies = [0, 1, 100, 200, 900]
    amplitudes = [1e-3, 1e-3, 3 * 0.079e-6, 4 * 0.042e-6, 1e-3]
    assert level_dB_SL(HUMAN, frequencies, amplitudes) == pytest.approx(13.979, abs=1e-3)


def test_nothing_that_moves_is_minus_infinity_and_what_the_table_lacks_has_no_value():
    assert level_dB_SL(HUMAN, [100], [0.0]) == -np.inf
    assert level_dB_SL(HUMAN, [0], [1e-3]) == -np.inf
    assert level_dB_SL(HUMAN, [1000], [0.0]) == -np.inf
    for name, f_Hz in (("morioka_griffin_2006", 5), ("morioka_griffin_2006", 500), ("afferent_human", 500),
                       ("bolanowski_1988", 1000), ("afferent_human", 1000)):  # fmt: skip
        assert np.isnan(level_dB_SL(OBSERVERS[name], [0, f_Hz], [1e-3, 1e-3])), (name, f_Hz)
    both = levels_dB_SL(HUMAN, [100, 1000], [[0.079e-6, 0.0, 0.0], [1e-3, 1e-3, 0.0]])
    assert both[0] == pytest.approx(0.0, abs=1e-9) and np.isnan(both[1]) and both[2] == -np.inf


@given(
    amplitude=st.floats(1e-9, 1e-3),
    phase=st.floats(-np.pi, np.pi),
    offset=st.floats(-1e-3, 1e-3),
    frequency=st.floats(5, 300),
)
def test_the_fit_finds_a_line_at_any_frequency_and_phase(amplitude, phase, offset, frequency):
    time = np.arange(3000) / 4000
    motion = offset + amplitude * np.sin(2 * np.pi * frequency * time + phase)
    # Rounding of the offset is what is left.
    assert line_amplitude(time, motion, frequency) == pytest.approx(amplitude, rel=1e-9, abs=1e-12 * abs(offset))


def test_many_courses_are_fitted_at_once():
    time = np.arange(400) / 4000
    sine = np.sin(2 * np.pi * 200 * time)
    courses = np.column_stack([sine, 3 * sine + 1, 0 * sine])
    np.testing.assert_allclose(line_amplitudes(time, courses, 200), [1, 3, 0], atol=1e-12)


def test_the_fit_uses_the_end_of_the_record():
    time = np.arange(2000) / 4000
    motion = np.where(time < 0.4, 7.0, np.sin(2 * np.pi * 200 * time))
    assert line_amplitude(time, motion, 200, periods=20) == pytest.approx(1.0)
    assert line_amplitude(time, motion, 200) < 0.5


def test_over_whole_periods_harmonics_do_not_leak_into_the_line():
    time = np.arange(1000) / 4000
    motion = np.sin(2 * np.pi * 200 * time) + 0.5 * np.sin(2 * np.pi * 400 * time + 1)
    assert line_amplitude(time, motion, 200, periods=3) == pytest.approx(1.0, rel=1e-9)
    assert line_amplitude(time, motion, 400, periods=6) == pytest.approx(0.5, rel=1e-9)


def test_one_period_is_enough_and_less_is_not():
    time = np.arange(20) / 4000
    assert line_amplitude(time, np.sin(2 * np.pi * 200 * time), 200) == pytest.approx(1.0)
    with pytest.raises(OutputError, match="holds 0"):
        line_amplitude(time[:-1], np.zeros(19), 200)
    with pytest.raises(OutputError, match="holds 1"):
        line_amplitude(time, np.zeros(20), 200, periods=2)


@pytest.mark.parametrize("frequency", [0.0, -5.0, np.nan])
def test_no_line_at_or_below_zero(frequency):
    with pytest.raises(OutputError, match="allowed: above 0"):
        line_amplitude(np.arange(100) / 100, np.zeros(100), frequency)


def test_too_few_samples_a_period():
    with pytest.raises(OutputError, match="3 or more samples"):
        line_amplitude(np.arange(100) / 100, np.zeros(100), 40)
    with pytest.raises(OutputError, match="holds 0"):
        line_amplitude([0.0], [1.0], 10)


def test_what_is_no_number_is_no_silence():
    observer = OBSERVERS["bolanowski_1988"]
    levels = levels_dB_SL(observer, [200.0, 400.0], [[np.nan, 1e-6], [1e-6, 0.0]])
    assert np.isnan(levels[0]) and levels[1] == pytest.approx(level_dB_SL(observer, [200.0], [1e-6]))
    assert level_dB_SL(observer, [200.0], [np.inf]) == np.inf
    with pytest.raises(OutputError, match=r"frequencies have shape \(2,\) and amplitudes \(1, 1\)"):
        level_dB_SL(observer, [100.0, 200.0], [1e-6])
    times = np.arange(100) / 1e3
    for wrong in ((times, times[:50], 100.0), (np.where(times < 0.05, times, np.nan), times, 100.0)):
        with pytest.raises(OutputError, match=r"give finite \(n,\) and \(n, m\)"):
            line_amplitude(*wrong)
    with pytest.raises(OutputError, match="frequency is inf Hz"):
        line_amplitude(times, times, np.inf)
