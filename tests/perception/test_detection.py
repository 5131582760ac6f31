"""Detection and summation over time against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.errors import OutputError
from palmfield.perception.detection import detection_probability, summed_gain
from palmfield.perception.observers import OBSERVERS, level_dB_SL, threshold_m

PROBE = OBSERVERS["bolanowski_1988"]


@given(slope=st.floats(0.5, 6.0), guess=st.sampled_from([0.0, 0.5, 1 / 3]))
def test_at_threshold_half_of_what_is_not_guessed(slope, guess):
    assert detection_probability(0.0, slope=slope, guess=guess) == pytest.approx(guess + (1 - guess) / 2)
    assert detection_probability(-math.inf, slope=slope, guess=guess) == pytest.approx(guess)
    assert detection_probability(200.0, slope=slope, guess=guess) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("level", "slope", "lapse", "wanted"),
    [
        (6.0206, 2.0, 0.0, 1 - 2**-4),
        (6.0206, 1.0, 0.0, 1 - 2**-2),
        (-6.0206, 2.0, 0.0, 1 - 2**-0.25),
        (0, 3, 0.1, 0.45),
    ],
)
def test_probabilities_by_hand(level, slope, lapse, wanted):
    """1 - 2^-(E^b), E twice or half."""
    assert detection_probability([level], slope=slope, lapse=lapse) == pytest.approx([wanted], abs=1e-5)


def test_a_slope_that_is_none():
    with pytest.raises(OutputError, match="slope 0; allowed: above 0"):
        detection_probability(0.0, slope=0.0)


@pytest.mark.parametrize("length_s", [0.02, 0.2, 1.0])
def test_a_burst_sums_to_one_minus_its_decay(length_s):
    """y' = (1 - y)/tau: the root of 1 - exp(-T/tau), and a silence after it changes nothing."""
    step, tau = 1e-4, 0.2
    burst = np.concatenate([np.ones(round(length_s / step)), np.zeros(500)])
    assert summed_gain(burst, step, tau) == pytest.approx(math.sqrt(1 - math.exp(-length_s / tau)), rel=1e-9)


def test_a_slow_sine_of_power_sums_as_a_low_pass_says():
    """Power 1 + cos(w t): its swing is cut by 1/sqrt(1 + (w tau)^2), once the beginning is over."""
    step, tau, omega = 1e-3, 0.2, 2 * math.pi * 1.5
    envelope = np.sqrt(1.0 + np.cos(omega * np.arange(0.0, 20.0, step)))
    wanted = math.sqrt(1.0 + 1.0 / math.hypot(1.0, omega * tau))
    assert summed_gain(envelope, step, tau) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(("step", "tau"), [(0.0, 0.2), (1e-3, 0.0)])
def test_no_time_to_sum_over(step, tau):
    with pytest.raises(OutputError, match="allowed: above 0"):
        summed_gain([1.0], step, tau)


@pytest.mark.parametrize("envelope", [[], [1.0, math.nan], [[1.0]]])
def test_an_envelope_that_is_none(envelope):
    with pytest.raises(OutputError, match="the envelope has shape"):
        summed_gain(envelope, 1e-3, 0.2)


def test_short_stimuli_need_more_in_the_pacinian_channel_alone():
    """10 log10(1/(1 - exp(-T/0.2))): 10.3 dB at 20 ms, and nothing at 20 Hz."""
    long, short = (threshold_m(PROBE, [20.0, 250.0], duration_s=duration) for duration in (100.0, 0.02))
    assert long == pytest.approx(threshold_m(PROBE, [20.0, 250.0]))
    change = 20 * np.log10(short / long)
    assert change == pytest.approx([0.0, -10 * math.log10(1 - math.exp(-0.1))], abs=1e-9)
    assert change[1] == pytest.approx(10.2, abs=0.1)
    level = level_dB_SL(PROBE, [250.0], [1e-6], duration_s=0.02)
    assert level == pytest.approx(level_dB_SL(PROBE, [250.0], [1e-6]) - change[1])


def test_the_law_of_durations_is_the_closed_form_of_the_sum():
    """Threshold and gain are two ways to one number."""
    short, long = (float(threshold_m(PROBE, 250.0, duration_s=duration)) for duration in (0.1, 1e3))
    assert short / long == pytest.approx(1.0 / summed_gain(np.ones(1000), 1e-4, PROBE.temporal.tau_s), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "duration", "told"),
    [
        ("afferent_human", 1.0, "has no law for durations: omit duration_s, or use bolanowski_1988"),
        ("bolanowski_1988", 0.0, "duration_s is 0.0"),
        ("bolanowski_1988", math.nan, "duration_s is nan"),
    ],
)
def test_durations_that_can_not_be(name, duration, told):
    with pytest.raises(OutputError, match=told):
        threshold_m(OBSERVERS[name], 200.0, duration_s=duration)
