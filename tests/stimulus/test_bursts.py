from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.stimulus.bursts import burst, onsets

TRAIN = {"length_s": 0.02, "period_s": 0.05, "count": 4}


def analytic_transform(window, frequency, length_s, period_s, count):
    """Fourier integral of a train: that of one window centred on 0, moved, times the sum over the bursts."""
    turns = frequency * length_s
    one = length_s * np.sinc(turns)
    if window == "hann":
        one = 0.5 * one / (1.0 - turns**2)
    moments = 0.5 * length_s + period_s * np.arange(count)
    return one * np.exp(-2j * np.pi * frequency[:, None] * moments).sum(axis=1)


@pytest.mark.parametrize("window", ["rectangular", "hann"])
def test_spectra_are_those_of_the_analytic_transform(window):
    frequency = np.array([0.0, 3.0, 11.0, 20.0, 37.0, 61.0, 130.0, 444.4])
    step = 1e-5
    times = (np.arange(-1000, 30000) + 0.5) * step
    level = burst(times, window=window, **TRAIN)
    found = step * np.exp(-2j * np.pi * frequency[:, None] * times) @ level
    wanted = analytic_transform(window, frequency, **TRAIN)
    assert np.abs(found - wanted).max() < 1e-4 * np.abs(wanted).max()


def test_hann_sidelobes_fall_far_below_the_rectangles():
    step = 1e-5
    times = (np.arange(2000) + 0.5) * step
    frequency = np.linspace(400.0, 800.0, 200)
    kernel = np.exp(-2j * np.pi * frequency[:, None] * times)
    one = {"length_s": 0.02, "period_s": 0.05, "count": 1}
    loudest = {w: np.abs(kernel @ burst(times, window=w, **one)).max() for w in ("rectangular", "hann")}
    assert loudest["hann"] < 0.03 * loudest["rectangular"]


def test_levels_at_named_moments():
    times = [-0.001, 0.0, 0.0199, 0.02, 0.05, 0.21, 0.16, 0.17]
    assert burst(times, window="rectangular", **TRAIN).tolist() == [0, 1, 1, 0, 1, 0, 1, 0]
    assert burst([0.0, 0.005, 0.01, 0.06], window="hann", **TRAIN) == pytest.approx([0.0, 0.5, 1.0, 1.0])


def test_without_a_count_it_never_ends_and_touching_bursts_leave_no_gap():
    assert burst([1e4 + 0.01], window="rectangular", length_s=0.02, period_s=0.05) == 1.0
    touching = {"length_s": 0.05, "period_s": 0.05, "count": 3}
    times = np.arange(0, 1500) * 1e-4
    assert burst(times, window="rectangular", **touching).all()
    assert burst([0.15], window="rectangular", **touching) == 0.0
    assert onsets(-1.0, 1.0, **touching) == pytest.approx([0.0, 0.15])
    assert len(onsets(0.0, 1.0, length_s=0.05, period_s=0.05)) == 0


@settings(max_examples=80, deadline=None)
@given(
    st.floats(0.001, 0.2),
    st.floats(0.05, 0.95),
    st.one_of(st.none(), st.integers(1, 5)),
    st.floats(-0.1, 0.5),
    st.floats(0.001, 0.5),
)
def test_onsets_are_exactly_the_moments_at_which_the_level_jumps(period, share, count, start, span):
    train = {"length_s": share * period, "period_s": period, "count": count}
    jumps = onsets(start, start + span, **train)
    assert np.all((jumps > start) & (jumps <= start + span))
    before = burst(jumps - 1e-7, window="rectangular", **train)
    after = burst(jumps, window="rectangular", **train)
    assert np.all(before != after)
    # Between two jumps, and before the first and after the last, the level stays
    ends = np.concatenate([[start], jumps, [start + span]])
    for low, high in pairwise(ends):
        if high - low > 1e-5:
            inside = burst(np.linspace(low + 2e-7, high - 2e-7, 20), window="rectangular", **train)
            assert np.ptp(inside) == 0.0


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"length_s": 0.0}, "length_s = 0.0"),
        ({"length_s": 0.06}, "length_s = 0.06"),
        ({"period_s": float("nan")}, "period_s = nan"),
        ({"count": 0}, "count = 0"),
        ({"window": "hamming"}, "'hamming'"),
    ],
)
def test_bad_trains_are_named(change, part):
    with pytest.raises(SceneError, match=part):
        burst([0.0], **{"window": "hann", **TRAIN, **change})
