"""Lateral modulation: a focus that goes to and fro on a short line, in steps or without."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.config import StimulusConfig, parse
from palmfield.errors import SceneError
from palmfield.simulation.small_models.known_load import period_s
from palmfield.stimulus.schedule import (
    frame_at,
    frame_rates,
    frames_at,
    main_frequencies,
    points_a_turn,
    substep_moments,
    turn_m,
    turn_rate_Hz,
)


def lm(width=0.004, rate=10.0, **more):
    return StimulusConfig(path="lm", path_width_m=width, path_rate_Hz=rate, focus_m=(0.01, 0.02, 0.2), **more)


def test_it_steps_to_and_fro_between_equal_points():
    """Five points 1 mm apart: 0 1 2 3 4 3 2 1, each for an eighth of a turn."""
    config = lm(path_step_m=0.001)
    assert points_a_turn(config) == 8 and frame_rates(config) == [80]
    middles = (np.arange(16) + 0.5) / 80
    foci, level = frames_at(config, middles)
    stairs = [0, 1, 2, 3, 4, 3, 2, 1]
    assert foci[:, 0] == pytest.approx(0.01 + 0.001 * np.array(2 * stairs) - 0.002, abs=1e-12)
    assert (foci[:, 1:] == [0.02, 0.2]).all() and (level == 1.0).all()


def test_two_points():
    config = lm(0.003, 5.0, path_step_m=0.003)
    foci, _ = frames_at(config, np.array([0.0, 0.09, 0.11, 0.19, 0.21]))
    assert foci[:, 0] - 0.01 == pytest.approx([-0.0015, -0.0015, 0.0015, 0.0015, -0.0015], abs=1e-12)
    # A step over the jump is cut there
    moments = substep_moments((config,), 0.0995, 0.001, 1)
    assert moments.first[0] == pytest.approx([0.5, 0.5])


@given(width=st.floats(1e-4, 0.02), direction=st.floats(-360, 360), turn=st.floats(0, 3))
def test_without_steps_it_is_a_triangle_in_its_direction(width, direction, turn):
    config = lm(width, 10.0, path_direction_deg=direction)
    along = width * (2 / math.pi * math.asin(math.sin(2 * math.pi * (turn - 0.25)))) / 2
    expected = 0.01 + along * math.cos(math.radians(direction)), 0.02 + along * math.sin(math.radians(direction)), 0.2
    assert frame_at(config, turn / 10.0).focus == pytest.approx(expected, abs=1e-9)


def test_rates_and_lengths():
    assert turn_m(lm()) == pytest.approx(0.008) and turn_rate_Hz(lm()) == 10
    by_speed = StimulusConfig(path="lm", path_width_m=0.004, path_speed_m_s=0.08)
    assert turn_rate_Hz(by_speed) == pytest.approx(10.0)
    am = {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": 30.0, "am_depth": 1.0}
    assert period_s(lm(**am)) == pytest.approx(0.1)


def test_frequencies():
    """A triangle has odd lines as 1 / n^2, a square wave as 1 / n; passing a point twice a turn gives the second.

    Skin follows lines over their frequency.
    """
    assert main_frequencies(lm()) == [10, 20]
    assert main_frequencies(lm(path_step_m=0.004)) == [10, 20, 30]
    assert main_frequencies(lm(rate=400.0, path_step_m=0.004)) == [400, 800]
    # Stairs of 20 steps have their own lines 39 and 41 times the turns, a fortieth as large: too small to count
    assert main_frequencies(lm(path_step_m=0.0002)) == [10, 20]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"path_step_m": "0.003"}, "path_width_m 0.004 must be a whole number of steps of path_step_m 0.003, but it "
         "is 1.33333 steps; for example, set path_step_m to 0.004"),
        ({"path_step_m": "0.01"}, "path_step_m 0.01, but it is 0.4 steps; for example, set path_step_m to 0.004"),
        ({"path_step_m": "0.002", "path_points": "4"}, "path_step_m and path_points 4 both set where"),
        ({"path_step_m": "0.002", "path_end": "jump"}, "path_end is 'jump'; allowed with path_step_m: back"),
        ({"path_width_m": ""}, "path 'lm' needs path_width_m"),
        ({"path": "line", "path_step_m": "0.002"}, "path_step_m does not apply to path 'line'"),
        ({"path_corners": "2"}, "path_corners does not apply to path 'lm', which takes path_width_m"),
    ],
)  # fmt: skip
def test_keys_that_do_not_fit_are_named(keys, words):
    good = {"path": "lm", "path_width_m": "0.004", "path_rate_Hz": "10"}
    given = {key: value for key, value in (good | keys).items() if value}
    with pytest.raises(SceneError, match=words):
        parse(StimulusConfig, given, "the stimulus")
