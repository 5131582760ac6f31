"""Focus and level over time, against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.config import StimulusConfig, parse
from palmfield.errors import SceneError
from palmfield.stimulus.schedule import (
    frame_at,
    frame_rates,
    frames_at,
    main_frequencies,
    mean_arp_factor,
    plane_path,
    silent_after_s,
    substep_moments,
    turn_rate_Hz,
)


def am(of, depth=1.0, **more):
    return StimulusConfig(modulation="am", am_quantity=of, am_frequency_Hz=200, am_depth=depth, **more)


def harmonics(config, count=2000):
    """Mean, 200 Hz and 400 Hz amplitude of the ARP over one period."""
    t = np.arange(count) / count / 200
    level = np.array([frame_at(config, x).arp_factor for x in t])
    lines = np.fft.rfft(level) / count
    return lines[0].real, 2 * abs(lines[1]), 2 * abs(lines[2])


@pytest.mark.parametrize("depth", [0.3, 1.0])
def test_am_of_amplitude_has_the_octave_that_squaring_gives(depth):
    mean, first, second = harmonics(am("amplitude", depth))
    # (1 + m sin)^2 = 1 + m^2/2 + 2 m sin - m^2/2 cos 2wt
    assert first / mean == pytest.approx(2 * depth / (1 + depth**2 / 2), rel=1e-6)
    assert second / first == pytest.approx(depth / 4, rel=1e-6)


def test_am_of_arp_is_a_single_line():
    mean, first, second = harmonics(am("arp", 0.5))
    assert first / mean == pytest.approx(0.5, rel=1e-6)
    assert second < 1e-12


@given(t=st.floats(0, 1), depth=st.floats(0, 1))
def test_level_stays_between_silence_and_the_loudest_moment(t, depth):
    assert 0 <= frame_at(am("amplitude", depth), t).arp_factor <= 1 + 1e-12


def test_circle():
    config = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=70, focus_m=(0.01, 0, 0.2))
    points = np.array([frame_at(config, t).focus for t in np.linspace(0, 1 / 70, 200)])
    assert np.allclose(np.hypot(points[:, 0] - 0.01, points[:, 1]), 0.01)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() * 70
    assert speed == pytest.approx(4.398, rel=1e-3)  # the paper's 4.40 m/s
    quarter = frame_at(config, 0.25 / 70).focus  # from +x by +y, counter-clockwise
    assert np.allclose(points[0], [0.02, 0, 0.2]) and np.allclose(quarter, [0.01, 0.01, 0.2])


def test_a_control_tick_counts_from_its_own_moment_on():
    config = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=10, control_rate_Hz=1000)
    ticks = np.arange(100)
    angle = 2 * np.pi * 10 * ticks / 1000
    on_time = 0.01 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for late_s in (0.0, 0.0005, 0.000999):
        foci, _ = frames_at(config, ticks / 1000 + late_s)
        assert np.allclose(foci[:, :2], on_time, atol=1e-9)


def test_stepped_circle_holds_its_points():
    config = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=10, path_points=8)
    assert frame_rates(config) == [80]
    places = {tuple(np.round(frame_at(config, t).focus, 9)) for t in np.linspace(0, 0.0999, 500)}
    assert len(places) == 8


@given(start=st.floats(0, 0.5), length=st.floats(1e-4, 0.05), rate=st.floats(5, 5000))
def test_held_moments_share_out_the_whole_step(start, length, rate):
    moments = substep_moments((am("arp", control_rate_Hz=rate),), start, length, 1)
    assert not moments.linear[-1] and moments.first.sum() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(("control", "start"), [(0, 0), (1000, 0), (0, 0.005), (1000, 0.005)])
def test_path_points_keep_their_angles_whatever_else_is_held(control, start):
    config = StimulusConfig(
        path="circle", path_diameter_m=0.02, path_rate_Hz=10, path_points=8, control_rate_Hz=control, start_s=start
    )
    points = np.array([frame_at(config, t).focus for t in start + np.linspace(0, 0.2, 777)])
    angle = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    assert np.abs(angle / 45 - np.round(angle / 45)).max() < 1e-6
    assert frame_at(config, start).focus[0] == pytest.approx(0.01)


def test_level_goes_on_between_path_points():
    config = am("arp", path="circle", path_diameter_m=0.02, path_rate_Hz=10, path_points=8)
    assert frame_at(config, 0.00125).arp_factor == pytest.approx(1)
    assert frame_at(config, 0.00375).arp_factor == pytest.approx(0, abs=1e-12)


def test_mean_factor_of_a_modulation_faster_than_the_step():
    assert mean_arp_factor(am("amplitude"), 0.001, 0.006, 64) == pytest.approx(1.5 / 4, rel=1e-6)


def test_mean_factor_of_a_sound_that_starts_within_the_step():
    assert mean_arp_factor(StimulusConfig(start_s=0.00033), 0, 0.001, 4) == pytest.approx(0.67, rel=1e-9)


def test_on_off_and_ramp():
    config = StimulusConfig(start_s=0.01, stop_s=0.05, ramp_s=0.002)
    level = [frame_at(config, t).arp_factor for t in (0.0, 0.0099, 0.011, 0.012, 0.049, 0.05)]
    assert level == pytest.approx([0, 0, 0.5, 1, 1, 0])


def test_main_frequencies():
    assert main_frequencies(am("amplitude")) == [200, 400]
    assert main_frequencies(am("arp")) == [200]
    assert main_frequencies(StimulusConfig()) == []
    assert math.isclose(main_frequencies(StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=70))[0], 70)


def of(**keys):
    return parse(StimulusConfig, {key: str(value) for key, value in keys.items()}, "the stimulus")


@pytest.mark.parametrize(
    "keys",
    [
        {"path": "line", "path_width_m": 0.03},
        {"path": "zigzag", "path_width_m": 0.03, "path_height_m": 0.02},
        {"path": "square", "path_width_m": 0.02},
        {"path": "z", "path_width_m": 0.03, "path_height_m": 0.02},
        {"path": "lissajous", "path_width_m": 0.03, "path_height_m": 0.02, "path_ratio": "3 2", "path_phase_deg": 90},
        {"path": "letters", "path_text": "PALM", "path_height_m": 0.02},
        {"path": "polyline", "path_through_m": "0 0 0.01 0 0.01 0.03"},
    ],
)
def test_every_path_goes_at_its_speed_and_comes_round(keys):
    config = of(**keys, path_speed_m_s=2.0, focus_m="0.01 0.02 0.2")
    turn = 1.0 / turn_rate_Hz(config)
    times = np.linspace(0.0, turn, 4001)
    foci, _ = frames_at(config, times)
    speed = np.linalg.norm(np.diff(foci, axis=0), axis=1) / np.diff(times)
    assert np.median(speed) == pytest.approx(2.0, rel=1e-3)
    assert foci[-1] == pytest.approx(foci[0], abs=2e-5)
    # The middle of the shape's extent is the asked one, and it stays in its plane.
    assert 0.5 * (foci.min(axis=0) + foci.max(axis=0)) == pytest.approx([0.01, 0.02, 0.2], abs=1e-4)
    by_rate = of(**keys, path_rate_Hz=1.0 / turn, focus_m="0.01 0.02 0.2")
    assert frames_at(by_rate, times)[0] == pytest.approx(foci, abs=1e-9)


def test_an_open_path_may_jump_or_stop_at_its_end():
    line = {"path": "line", "path_width_m": 0.04, "path_speed_m_s": 4.0, "start_s": 0.005}
    jump, stop = of(**line, path_end="jump"), of(**line, path_end="stop")
    assert turn_rate_Hz(of(**line)) == pytest.approx(50.0) and turn_rate_Hz(jump) == pytest.approx(100.0)
    assert frame_at(jump, 0.0149).focus[0] == pytest.approx(0.0196)
    assert frame_at(jump, 0.015).focus[0] == pytest.approx(-0.02, abs=1e-9)
    # A step over the jump is held in two parts; an impulse never counts the way back.
    moments = substep_moments((jump,), 0.0148, 0.0004, 1)
    assert moments.first[0] == pytest.approx([0.5, 0.5])
    assert [frame_at(jump, t).focus[0] for t in moments.times] == pytest.approx([0.0196, -0.0196], abs=1e-9)
    assert frame_at(stop, 0.0149).arp_factor == 1.0
    assert frame_at(stop, 0.0151).arp_factor == 0.0
    assert frame_at(stop, 0.0151).focus[0] == pytest.approx(0.02)


def test_letters_are_silent_between_strokes():
    config = of(path="letters", path_text="II", path_height_m=0.02, path_speed_m_s=1.0)
    _, factor = frames_at(config, np.linspace(0.0, 1.0 / turn_rate_Hz(config), 2001))
    path = plane_path(config)
    lifted = np.diff(path.corner_arcs)[path.lifted].sum() / path.length_m
    assert 0.1 < lifted < 0.7
    assert 1.0 - factor.mean() == pytest.approx(lifted, abs=0.01)


@pytest.mark.parametrize("window", ["rectangular", "hann"])
def test_bursts_of_a_modulated_path(window):
    """Level of a product: AM within bursts, each from start_s on; the focus goes on meanwhile."""
    keys = {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 30, "start_s": 0.01, "burst_window": window,
            "burst_length_s": 0.02, "burst_period_s": 0.05, "burst_count": 3}  # fmt: skip
    config = am("arp", **keys)
    times = np.linspace(0.0, 0.25, 5001)
    _, factor = frames_at(config, times)
    assert not factor[times < 0.01].any() and not factor[times > 0.131].any()
    on = np.array([((t - 0.01) % 0.05 < 0.02) and 0.01 <= t < 0.13 for t in times])
    assert factor[~on].max() < 1e-9 and factor[on].mean() == pytest.approx(
        {"rectangular": 0.5, "hann": 0.25}[window], rel=0.02
    )
    assert silent_after_s(config) == pytest.approx(0.13)
    mean = mean_arp_factor(config, 0.0, 0.2, 4000)
    assert mean == pytest.approx({"rectangular": 0.5, "hann": 0.25}[window] * 0.06 / 0.2, rel=2e-3)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"path": "circle", "path_rate_Hz": 1}, "path 'circle' needs path_diameter_m"),
        ({"path": "circle", "path_diameter_m": 0.01}, "path_rate_Hz"),
        ({"path": "line", "path_width_m": 0.1, "path_rate_Hz": 1, "path_speed_m_s": 1}, "not both"),
        ({"path": "line", "path_width_m": 0.1, "path_rate_Hz": 1, "path_text": "A"}, "path_text does not apply"),
        ({"path_rate_Hz": 1}, "path_rate_Hz applies to a moving path"),
        ({"path_on": "skin"}, "path_on applies to a moving path"),
        ({"path": "sites", "path_sites": "a b", "path_speed_m_s": 1}, "set path_on to skin"),
        (
            {"path": "line", "path_width_m": 0.1, "path_rate_Hz": 1, "path_zigzag_width_m": 0.02},
            "needs path_zigzag_speed_m_s and path_speed_m_s",
        ),
        (
            {"path": "circle", "path_diameter_m": 0.1, "path_speed_m_s": 1, "path_zigzag_width_m": 0.02},
            "path_zigzag_width_m does not apply",
        ),
        ({"path": "polyline", "path_through_m": "0 0 1", "path_rate_Hz": 1}, "3 numbers"),
        ({"foci_m": "0 0 0.1"}, "two foci or more"),
        ({"foci_m": "0 0 0 0.1 0 0", "foci_arp": "1"}, "'foci_arp' has value '1'; allowed: 2 numbers"),
        ({"foci_arp": "1 1"}, "'foci_arp' has value '1 1'; allowed: 0 numbers"),
        ({"foci_m": "0 0 0 0.1 0 0", "foci_arp": "0 0"}, "'foci_arp' has value '0 0'.*one above 0"),
        ({"foci_m": "0 0 0 0.1 0 0", "foci_arp": "1 -1"}, "'foci_arp' has value '1 -1'; allowed: finite numbers >= 0"),
        (
            {"foci_m": "0 0 0 0.1 0 0", "foci_arp": "1 nan"},
            "'1 nan'; allowed: finite numbers >= 0",
        ),
        ({"burst_length_s": 0.1}, "burst_length_s applies to bursts"),
        ({"burst_window": "hann", "burst_length_s": 0.2, "burst_period_s": 0.1}, "longer than burst_period_s"),
    ],
)
def test_keys_of_paths_that_do_not_fit_are_named(keys, words):
    with pytest.raises(SceneError, match=words):
        of(**keys)
