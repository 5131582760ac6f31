"""Gain, delay, difference and coherence on records of which they are known."""

import numpy as np
import pytest

from palmfield.errors import MeasurementError
from palmfield.instruments.agreement import agreement, shifted

RATE = 8e3
TIMES = np.arange(2400) / RATE


def bursts(count=3, seed=0):
    rng = np.random.default_rng(seed)
    shape = np.exp(-(((TIMES[:, None] - 0.12) / 0.05) ** 2))
    return shape * np.stack(
        [sum(rng.normal() * np.sin(2 * np.pi * f * TIMES + rng.uniform(0, 6)) for f in range(40, 400, 17))
         for _ in range(count)], axis=1
    )  # fmt: skip


@pytest.mark.parametrize("delay", [0.0, 0.58e-3, -1.37e-3])
@pytest.mark.parametrize("gain", [1.0, 2.5, -0.4])
def test_a_record_that_is_later_and_larger(gain, delay):
    ours = bursts()
    theirs = gain * shifted(ours, 1.0 / RATE, np.full(3, delay))
    found = agreement(TIMES, theirs, ours, most_delay_s=5e-3)
    assert found.gain == pytest.approx(gain, rel=3e-3)
    assert found.delay_s == pytest.approx(delay, abs=3e-6)
    assert found.l2_shape.max() < 0.02 and not found.ambiguous.any()
    exact = np.linalg.norm(theirs - ours, axis=0) / np.linalg.norm(theirs, axis=0)
    assert found.l2 == pytest.approx(exact) and found.level.max() == 1.0
    assert found.coherence.min() > 0.9


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0])
def test_noise_takes_its_share_of_the_coherence(noise):
    rng = np.random.default_rng(4)
    ours = rng.normal(size=(20_000, 40))
    theirs = ours + noise * rng.normal(size=ours.shape)
    exact = 1.0 / (1.0 + noise**2)
    found = agreement(np.arange(20_000) / RATE, theirs, ours, most_delay_s=1e-3)
    # Of eight windows half over one another some 1/5 of the noise's share is taken for linear
    assert exact - 0.02 <= np.mean(found.coherence) <= exact + 0.25 * (1.0 - exact)
    assert found.l2_shape.mean() == pytest.approx(noise / np.hypot(1.0, noise), abs=0.01)


def test_what_repeats_has_more_than_one_delay():
    sine = np.sin(2 * np.pi * 200 * TIMES)[:, None]
    assert agreement(TIMES, sine, sine, most_delay_s=8e-3).ambiguous[0]
    assert not agreement(TIMES, sine, sine, most_delay_s=3e-3).ambiguous[0]


def test_what_can_not_be_compared_is_told():
    ours = bursts()
    with pytest.raises(MeasurementError, match="measured record of point 1 is 0"):
        agreement(TIMES, ours * [1, 0, 1], ours, most_delay_s=1e-3)
    with pytest.raises(MeasurementError, match="too short for a coherence"):
        agreement(TIMES[:40], ours[700:740], ours[700:740], most_delay_s=1e-3)
    with pytest.raises(MeasurementError, match="records have shapes"):
        agreement(TIMES, ours, ours[:, :2], most_delay_s=1e-3)
    with pytest.raises(MeasurementError, match="most_delay_s is 0"):
        agreement(TIMES, ours, ours, most_delay_s=0.0)


@pytest.mark.parametrize("offset, drift", [(0.0, 0.0), (0.05, 0.0), (2.0, 0.0), (0.0, 0.3), (-5.0, 4.0)])
def test_offset_and_drift_are_fitted_beside_gain_and_delay(offset, drift):
    """Of the peak; ours has a mean of its own, as a pressed skin has."""
    times = np.arange(1024) / 5000.0

    def motion(late_s):
        at = times - 0.02 - late_s
        return np.where(at > 0, np.exp(-at / 0.05) * np.sin(2 * np.pi * 70 * at) - 0.3 * (1 - np.exp(-at / 0.01)), 0.0)

    line = offset + drift * (times / times[-1] - 0.5)
    found = agreement(times, 0.8 * motion(0.002)[:, None] + line[:, None], motion(0.0)[:, None], most_delay_s=0.01)
    assert found.gain[0] == pytest.approx(0.8, rel=0.02)
    assert found.delay_s[0] == pytest.approx(0.002, abs=2e-4)
    assert found.offset[0] == pytest.approx(offset, abs=0.01) and found.drift[0] == pytest.approx(drift, abs=0.02)
    assert found.l2_shape[0] < 0.03
