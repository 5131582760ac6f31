"""The force threshold against its printed figures, sums of ARP against exact integrals, and refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.config import StimulusConfig
from palmfield.errors import OutputError
from palmfield.perception.force_threshold import FORCE_OBSERVER, force_level_dB_SL, force_near_peak_N, why_refused
from palmfield.perception.registry import ALL_OBSERVERS
from palmfield.stimulus.am_table import AmTable
from palmfield.stimulus.resolved import resolved

AM = {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": 200.0, "am_depth": 1.0}
AREA = 144e-6


def test_the_printed_threshold():
    """beta 0.02 of the 20 mN that the device exerts on 12 x 12 mm, below the mean of half as much."""
    assert FORCE_OBSERVER.threshold_N == pytest.approx(0.02 * 20e-3)
    assert FORCE_OBSERVER.area_m2 == pytest.approx(0.012**2)
    assert FORCE_OBSERVER.mean_N == pytest.approx(20e-3 / 2)
    assert force_level_dB_SL(FORCE_OBSERVER, 0.02 * 20e-3) == pytest.approx(0.0, abs=1e-9)
    # 0 dB of the figure is 2 gf, of which the threshold is 0.02: 34 dB
    assert force_level_dB_SL(FORCE_OBSERVER, 2e-3 * 9.80665) == pytest.approx(34, abs=0.3)
    assert force_level_dB_SL(FORCE_OBSERVER, 0.0) == -np.inf


@given(amplitude=st.floats(1e-9, 1.0))
def test_twice_the_force_is_6_dB_more(amplitude):
    once, twice = (force_level_dB_SL(FORCE_OBSERVER, factor * amplitude) for factor in (1, 2))
    assert twice - once == pytest.approx(6.0206, abs=1e-4)


@pytest.mark.parametrize("amplitude", [-1e-3, np.nan])
def test_no_amplitude(amplitude):
    with pytest.raises(OutputError, match=r"amplitude_N is .*; allowed: 0 or more"):
        force_level_dB_SL(FORCE_OBSERVER, amplitude)


def test_the_observer_of_mid_air_comes_first():
    assert next(iter(ALL_OBSERVERS)) == "hasegawa_2018" and len(ALL_OBSERVERS) == 4


def plane(edge_m, half_m=0.02):
    """A square of triangles in the plane: vertices and faces."""
    count = round(2 * half_m / edge_m) + 1
    x, y = np.meshgrid(*[np.linspace(-half_m, half_m, count)] * 2, indexing="ij")
    number = np.arange(count * count).reshape(count, count)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))])
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), faces


def gaussian(vertices, fwhm_m, peak=100.0):
    return peak * np.exp(-4 * np.log(2) * (vertices**2).sum(axis=1) / fwhm_m**2)


@pytest.mark.parametrize(("edge_m", "within"), [(0.0025, 0.03), (0.0005, 0.003)])
def test_force_of_a_gaussian_spot_on_a_disc(edge_m, within):
    """P pi w^2 / (4 ln 2) (1 - 2^(-4 A / (pi w^2))) for a spot of full width w at half maximum."""
    width = 0.0103
    vertices, faces = plane(edge_m)
    exact = 100.0 * np.pi * width**2 / (4 * np.log(2)) * (1 - 2 ** (-4 * AREA / (np.pi * width**2)))
    force = force_near_peak_N(vertices, faces, gaussian(vertices, width), AREA)
    assert force == pytest.approx(exact, rel=within)


def test_force_is_taken_round_the_highest_arp_wherever_it_is():
    vertices, faces = plane(0.001)
    at_middle = force_near_peak_N(vertices, faces, gaussian(vertices, 0.008), AREA)
    aside = gaussian(vertices - [0.006, -0.004, 0.0], 0.008)
    assert force_near_peak_N(vertices, faces, aside, AREA) == pytest.approx(at_middle, rel=1e-6)
    assert force_near_peak_N(vertices, faces, 2.0 * aside, AREA) == pytest.approx(2.0 * at_middle, rel=1e-6)


@pytest.mark.parametrize("quantity", ["arp", "amplitude"])
def test_it_applies_under_sinusoidal_am_of_both_quantities(quantity):
    assert why_refused(StimulusConfig(**AM | {"am_quantity": quantity, "ramp_s": 0.01})) is None


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"am_frequency_Hz": 150.0}, "printed for 200 Hz only, but the sound has 150 Hz"),
        ({"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 5.0}, "stationary focus, but path is 'circle'"),
        ({"foci_m": (0.0, 0.0, 0.0, 0.02, 0.0, 0.0)}, "with one focus, but the stimulus has 2"),
        (
            {"burst_window": "hann", "burst_length_s": 0.005, "burst_period_s": 0.01},
            "a steady sine, but burst_window is 'hann'",
        ),
    ],
)
def test_other_stimuli_are_refused(keys, reason):
    assert reason in why_refused(StimulusConfig(**AM | keys))


def test_sound_without_modulation_is_refused():
    assert "not modulated" in why_refused(StimulusConfig())


def test_modulation_that_is_no_sine_is_refused():
    """A square wave has 8 / pi^2 of its power in the first line."""
    square = StimulusConfig(**AM, am_waveform="rectangle", am_waveform_duty=0.5)
    assert "81 % of the power of this modulation" in why_refused(square)
    course = AM | {"am_frequency_Hz": None, "am_waveform": "file", "am_file": "course.csv"}
    table = AmTable("course", tuple(np.arange(1000) / 1000), tuple(np.sin(0.4 * np.pi * np.arange(1000))))
    assert "this modulation comes from a file" in why_refused(resolved(StimulusConfig(**course), am_table=table))


def test_it_applies_to_what_it_was_measured_with():
    """A sine on a constant half under a Hann window of 1 s."""
    bursts = {"am_waveform": "burst", "am_burst_length_s": 1.0, "am_burst_period_s": 3.0}
    assert why_refused(StimulusConfig(**AM | bursts, am_normalisation="carrier", drive_amplitude=0.5**0.5)) is None
