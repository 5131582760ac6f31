"""The moments of a step at which loads are taken."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.config import StimulusConfig
from palmfield.stimulus.schedule import first_point, frame_at, frames_at, substep_moments

AM = StimulusConfig(modulation="am", am_quantity="arp", am_frequency_Hz=200, am_depth=1)
STARTS = st.floats(0, 0.3)
STEPS = st.floats(2e-5, 2e-3)
COUNTS = st.integers(1, 20)


@given(t0=STARTS, step=STEPS, count=COUNTS)
def test_a_smooth_load_is_taken_at_the_ends_of_the_steps(t0, step, count):
    moments = substep_moments((AM,), t0, step, count)
    np.testing.assert_allclose(moments.times, t0 + step * np.arange(count + 1), rtol=1e-12)
    load = np.random.default_rng(0).random(count + 1)
    np.testing.assert_array_equal(moments.first @ load, load[:-1])
    np.testing.assert_array_equal(moments.last @ load, load[1:])
    assert moments.linear == (False, *[True] * count) and not any(moments.held_s)


@given(
    t0=STARTS,
    step=STEPS,
    count=COUNTS,
    start=STARTS,
    length=st.floats(1e-4, 0.05),
    rate=st.sampled_from([0.0, 333.0, 1000.0, 7919.0]),
)
def test_the_impulse_of_any_part_that_sounds_is_right(t0, step, count, start, length, rate):
    """Of a sound that is only on or off, at jumps and ticks anywhere: its mean over each step, and over all."""
    config = StimulusConfig(start_s=start, stop_s=start + length, control_rate_Hz=rate)
    moments = substep_moments((config,), t0, step, count)
    _, on = frames_at(config, moments.times)
    edges = t0 + step * np.arange(count + 1)
    if rate == 0.0:
        sounding = np.clip(edges, start, start + length)
        exact = np.diff(sounding) / step
        np.testing.assert_allclose(0.5 * (moments.first + moments.last) @ on, exact, atol=1e-6)
    np.testing.assert_allclose(np.add.reduce(moments.first, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.add.reduce(moments.last, axis=1), 1.0, atol=1e-6)
    covered = sum(moments.held_s) + step * sum(moments.linear)
    assert covered == pytest.approx(count * step, abs=1e-9)
    assert (np.diff(moments.times) >= 0).all()


def test_smooth_and_cut_steps_in_one_call():
    config = StimulusConfig(start_s=0.00033)
    moments = substep_moments((config,), 0.0, 1e-4, 6)
    # The sound starts in the fourth step: its two parts; the others keep their ends
    np.testing.assert_allclose(moments.times, 1e-4 * np.array([0, 1, 2, 3, 3.15, 3.65, 4, 5, 6]), atol=1e-15)
    assert moments.linear == (False, True, True, True, False, False, False, True, True)
    np.testing.assert_allclose(moments.held_s, 1e-4 * np.array([0, 0, 0, 0, 0.3, 0.7, 0, 0, 0]), atol=1e-15)
    load = frames_at(config, moments.times)[1]
    np.testing.assert_allclose(moments.first @ load, [0, 0, 0, 0.7, 1, 1], atol=1e-9)
    np.testing.assert_allclose(moments.last @ load, [0, 0, 0, 0.7, 1, 1], atol=1e-9)


@given(t0=STARTS, step=STEPS, count=COUNTS)
def test_a_mean_takes_the_middle_of_each_step(t0, step, count):
    moments = substep_moments((AM,), t0, step, count, hold=True)
    np.testing.assert_allclose(moments.times, t0 + step * (np.arange(count) + 0.5), rtol=1e-12)
    np.testing.assert_array_equal(moments.first, np.eye(count))
    assert moments.held_s == (step,) * count and not any(moments.linear)


def test_stimuli_that_sound_together_share_their_moments():
    ticks = StimulusConfig(control_rate_Hz=3000)
    late = StimulusConfig(start_s=0.0012)
    together = substep_moments((AM, ticks, late), 0.001, 1e-4, 8)
    edges = np.concatenate([0.001 + 1e-4 * np.arange(9), np.array([4, 5]) / 3000])
    middles = np.sort(edges)
    np.testing.assert_allclose(together.times, 0.5 * (middles[1:] + middles[:-1]), atol=1e-12)
    assert all(together.held_s)


@given(t0=STARTS)
def test_moments_that_are_shared_cannot_be_written(t0):
    for hold in (False, True):
        moments = substep_moments((AM,), t0, 1e-4, 8, hold=hold)
        assert not moments.first.flags.writeable and not moments.last.flags.writeable


def test_the_first_point_is_where_the_sound_begins():
    config = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=10, start_s=0.013)
    np.testing.assert_array_equal(first_point(config), frame_at(config, 0.013).focus)
    assert not first_point(config).flags.writeable


def test_a_first_point_is_found_as_fast_where_another_stimulus_has_equal_keys(python_calls):
    """Equal scenes of one process: looking it up by its keys compared all 40 of them each time."""
    other = AM.model_copy()
    np.testing.assert_array_equal(first_point(AM), first_point(other))
    assert python_calls(lambda: first_point(other)) <= 1


def test_lean(python_calls):
    circle = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=70)
    letters = StimulusConfig(path="letters", path_text="PALM", path_height_m=0.02, path_speed_m_s=5)
    times = np.linspace(0.0, 0.1, 90)
    for config, most in ((AM, 4), (circle, 6), (letters, 12)):
        frames_at(config, times)
        assert python_calls(lambda config=config: frames_at(config, times)) <= most
    ticks = StimulusConfig(control_rate_Hz=3000)
    for config, most in ((AM, 6), (ticks, 8)):
        substep_moments((config,), 0.0, 1e-4, 8)
        assert python_calls(lambda config=config: substep_moments((config,), 0.01, 1e-4, 8)) <= most
