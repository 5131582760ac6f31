import math

import numpy as np
import pytest
from scipy.stats import norm

from palmfield.errors import OutputError
from palmfield.perception import OBSERVERS, direction_share, level_course, noise_for, separation, threshold_m
from palmfield.perception.direction import weighted

OBSERVER = OBSERVERS["afferent_human"]
TIMES = np.arange(2000) / 2000.0


def test_a_sine_weighs_its_amplitude_over_its_threshold():
    motion = 3e-6 * np.sin(2 * np.pi * 100.0 * TIMES)[:, None]
    felt = weighted(TIMES, motion, OBSERVER)[400:1600, 0]
    assert np.abs(felt).max() == pytest.approx(3e-6 / threshold_m(OBSERVER, 100.0), rel=0.02)


def test_nothing_is_felt_beyond_the_table():
    motion = 1e-5 * np.sin(2 * np.pi * 600.0 * TIMES)[:, None] * np.hanning(2000)[:, None]
    assert np.abs(weighted(TIMES, motion, OBSERVER)).max() < 1e-3 * 1e-5 / threshold_m(OBSERVER, 350.0)


def test_the_running_mean_of_a_steady_sine_is_its_rms():
    motion = 1e-6 * np.sin(2 * np.pi * 100.0 * TIMES)[:, None]
    level = level_course(TIMES, motion, OBSERVER, integration_s=0.05)
    assert level[1200, 0] == pytest.approx(1e-6 / threshold_m(OBSERVER, 100.0) / math.sqrt(2.0), rel=0.02)


def test_a_longer_memory_hides_the_order_of_arrival():
    places = np.linspace(-0.08, 0.08, 33)
    begin = 0.3 + 0.01 * (places / 0.08)
    bursts = np.sin(2 * np.pi * 200.0 * TIMES)[:, None] * np.exp(-(((TIMES[:, None] - begin) / 0.004) ** 2))
    found = []
    for memory in (0.0, 0.02, 0.2):
        level = level_course(TIMES, 1e-6 * bursts, OBSERVER, integration_s=memory)
        apart = separation(level, level[:, ::-1], 5e-4, 5e-3)
        found.append(apart / separation(level, np.zeros_like(level), 5e-4, 5e-3))
    assert found[0] > 2.0 * found[1] > 4.0 * found[2]


def test_shares_are_those_of_a_likelihood_ratio_in_white_noise():
    """Against trials: noise is drawn, and the likelier direction is answered."""
    rng = np.random.default_rng(3)
    forward = rng.standard_normal((40, 5))
    other = forward[:, ::-1]
    step_s, step_m, noise = 1e-3, 5e-3, 0.02
    expected = direction_share(separation(forward, other, step_s, step_m), noise)
    heard = forward + noise / math.sqrt(step_s * step_m) * rng.standard_normal((20_000, 40, 5))
    right = ((heard - forward) ** 2).sum(axis=(1, 2)) < ((heard - other) ** 2).sum(axis=(1, 2))
    assert 0.6 < expected < 0.95
    assert right.mean() == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1 - expected) / 20_000))


def test_noise_is_that_at_which_the_mean_is_as_asked():
    noise = noise_for([2.0], 0.9)
    assert noise == pytest.approx(1.0 / norm.ppf(0.9), rel=1e-9)
    several = noise_for([1.0, 3.0], 0.8)
    assert np.mean([direction_share(one, several) for one in (1.0, 3.0)]) == pytest.approx(0.8, rel=1e-9)


def test_what_is_no_course_is_refused():
    with pytest.raises(OutputError, match="even"):
        weighted([0.0, 1.0, 3.0], np.zeros((3, 1)), OBSERVER)
    with pytest.raises(OutputError, match="shape"):
        level_course(TIMES, np.zeros(2000), OBSERVER)
    with pytest.raises(OutputError, match="integration_s"):
        level_course(TIMES, np.zeros((2000, 1)), OBSERVER, integration_s=-1.0)
    with pytest.raises(OutputError, match="equal shapes"):
        separation(np.zeros((2, 2)), np.zeros((2, 3)), 1.0, 1.0)
    with pytest.raises(OutputError, match="noise"):
        direction_share(1.0, 0.0)
    with pytest.raises(OutputError, match="share"):
        noise_for([1.0], 0.5)
