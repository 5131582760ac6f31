"""Focus and level over time, against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.config import StimulusConfig
from palmfield.stimulus import frame_at, frame_rates, held_frames, main_frequencies, mean_arp_factor


def am(of, depth=1.0, **more):
    return StimulusConfig(modulation="am", am_of=of, am_frequency_Hz=200, am_depth=depth, **more)


def harmonics(config, count=2000):
    """Mean, 200 Hz and 400 Hz amplitude of the ARP over one period."""
    t = np.arange(count) / count / 200
    level = np.array([frame_at(config, x).arp_factor for x in t])
    lines = np.fft.rfft(level) / count
    return lines[0].real, 2 * abs(lines[1]), 2 * abs(lines[2])


@pytest.mark.parametrize("depth", [0.3, 1.0])
def test_am_of_pressure_has_the_octave_that_squaring_gives(depth):
    mean, first, second = harmonics(am("pressure", depth))
    # (1 + m sin)^2 = 1 + m^2/2 + 2 m sin - m^2/2 cos 2wt
    assert first / mean == pytest.approx(2 * depth / (1 + depth**2 / 2), rel=1e-6)
    assert second / first == pytest.approx(depth / 4, rel=1e-6)


def test_am_of_arp_is_a_single_line():
    mean, first, second = harmonics(am("arp", 0.5))
    assert first / mean == pytest.approx(0.5, rel=1e-6)
    assert second < 1e-12


@given(t=st.floats(0, 1), depth=st.floats(0, 1))
def test_level_stays_between_silence_and_the_loudest_moment(t, depth):
    assert 0 <= frame_at(am("pressure", depth), t).arp_factor <= 1 + 1e-12


def test_circle():
    config = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=70, focus_m=(0.01, 0, 0.2))
    points = np.array([frame_at(config, t).focus for t in np.linspace(0, 1 / 70, 200)])
    assert np.allclose(np.hypot(points[:, 0] - 0.01, points[:, 1]), 0.01)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() * 70
    assert speed == pytest.approx(4.398, rel=1e-3)  # the paper's 4.40 m/s


def test_stepped_circle_holds_its_points():
    config = StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=10, path_points=8)
    assert frame_rates(config) == [80]
    places = {tuple(np.round(frame_at(config, t).focus, 9)) for t in np.linspace(0, 0.0999, 500)}
    assert len(places) == 8


@given(start=st.floats(0, 0.5), length=st.floats(1e-4, 0.05), rate=st.floats(5, 5000))
def test_held_frames_share_out_the_whole_step(start, length, rate):
    shares = held_frames(am("arp", control_rate_Hz=rate), start, start + length)
    assert sum(share for _, share in shares) == pytest.approx(1, abs=1e-6)


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
    assert mean_arp_factor(am("pressure"), 0.001, 0.006, 64) == pytest.approx(1.5 / 4, rel=1e-6)


def test_mean_factor_of_a_sound_that_starts_within_the_step():
    assert mean_arp_factor(StimulusConfig(start_s=0.00033), 0, 0.001, 4) == pytest.approx(0.67, rel=1e-9)


def test_on_off_and_ramp():
    config = StimulusConfig(start_s=0.01, stop_s=0.05, ramp_s=0.002)
    level = [frame_at(config, t).arp_factor for t in (0.0, 0.0099, 0.011, 0.012, 0.049, 0.05)]
    assert level == pytest.approx([0, 0, 0.5, 1, 1, 0])


def test_main_frequencies():
    assert main_frequencies(am("pressure")) == [200, 400]
    assert main_frequencies(am("arp")) == [200]
    assert main_frequencies(StimulusConfig()) == []
    assert math.isclose(main_frequencies(StimulusConfig(path="circle", path_diameter_m=0.02, path_rate_Hz=70))[0], 70)
