"""Levels of many stimuli at once, against each by itself."""

import numpy as np
import pytest

from palmfield.config import StimulusConfig
from palmfield.stimulus.levels import Levels, goes_smoothly
from palmfield.stimulus.schedule import frame_at, jumps

AM = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200.0, "am_depth": 1.0}
SMOOTH = [
    AM,
    AM | {"am_depth": 0.3, "am_frequency_Hz": 70.0, "start_s": 0.0013},
    AM | {"am_quantity": "arp", "ramp_s": 0.004},
    AM | {"am_quantity": "arp", "am_depth": 0.5, "ramp_s": 0.002, "start_s": 0.001},
    {},
    {"start_s": 0.002, "stop_s": 0.007},
    {"stop_s": 0.005, "ramp_s": 0.003},
    AM | {"am_quantity": "duty", "drive_amplitude": 0.7},
    AM | {"am_quantity": "duty", "am_depth": 0.4, "drive_amplitude": 0.2, "am_normalisation": "mean"},
    AM | {"am_waveform": "hann", "am_waveform_duty": 0.4, "am_depth": 0.8},
    AM | {"am_waveform": "hann"},
    AM | {"am_waveform": "burst", "am_burst_length_s": 0.005, "am_burst_period_s": 0.007},
    AM | {"am_waveform": "burst", "am_burst_length_s": 0.006, "am_burst_period_s": 0.006, "am_depth": 0.3},
    AM | {"am_waveform": "burst", "am_burst_length_s": 0.006, "am_burst_period_s": 0.006, "am_burst_phase_deg": 90.0},
]


def configs():
    return [StimulusConfig(**keys) for keys in SMOOTH]


def test_levels_of_many_are_those_of_each():
    times = np.linspace(0.0, 0.01, 41)
    together = Levels(configs()).at(times)
    alone = [[frame_at(config, time).arp_factor for time in times] for config in configs()]
    np.testing.assert_allclose(together, alone, rtol=0.0, atol=1e-15)
    assert together.shape == (len(SMOOTH), 41) and together.max() == 1.0 and together.min() == 0.0


def test_levels_of_one_kind_are_those_of_each():
    times = np.array([0.0, 0.0021])
    some = configs()[:2]
    alone = [[frame_at(config, time).arp_factor for time in times] for config in some]
    np.testing.assert_allclose(Levels(some).at(times), alone, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("start", [0.0, 0.001, 0.0013, 0.0049, 0.005, 0.0061])
def test_jumps_are_beginnings_and_ends_within_a_step(start):
    end = start + 0.001
    found = Levels(configs()).jump(start, end)
    expected = [any(start < t <= end for t in jumps(config, start, end)) for config in configs()]
    np.testing.assert_array_equal(found, expected)


def test_what_does_not_go_smoothly():
    assert all(map(goes_smoothly, configs()))
    burst = {"burst_window": "hann", "burst_length_s": 0.01, "burst_period_s": 0.02}
    circle = {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 100.0}
    rectangle = AM | {"am_waveform": "rectangle", "am_waveform_duty": 0.5}
    for keys in (burst, circle, {"control_rate_Hz": 1000.0}, rectangle):
        assert not goes_smoothly(StimulusConfig(**keys))
