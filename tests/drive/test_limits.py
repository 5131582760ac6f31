"""Ramps, and how long sound may last."""

import numpy as np
import pytest

from palmfield.drive.boards import BOARDS
from palmfield.drive.limits import WINDOW_S, SoundLimits, _duty
from palmfield.errors import DeviceError


def test_a_ramp_rises_from_nothing_and_falls_to_nothing():
    limits = SoundLimits(ramp_s=0.2)
    assert [limits.level_at(t, 1.0) for t in (0.0, 0.1, 0.2, 0.5, 0.9, 1.0)] == pytest.approx([0, 0.5, 1, 1, 0.5, 0])
    # A play that is shorter than two ramps has nothing but these
    assert SoundLimits(ramp_s=5.0).level_at(0.5, 1.0) == 1.0
    assert SoundLimits().level_at(0.0, 1.0) == 1.0


def test_ramps_have_as_many_steps_as_the_board_takes():
    times = SoundLimits(ramp_s=0.01).ramp_times(BOARDS["autd2018"], 1.0)
    assert sorted(times)[:3] == pytest.approx([0.0, 5e-4, 1e-3]) and len(times) == 41
    limits = SoundLimits(ramp_s=0.05)
    assert limits.ramp_times(BOARDS["sonicsurface"], 1.0) == []
    assert "no ramp: sonicsurface has no levels" in limits.in_words(BOARDS["sonicsurface"])
    assert limits.in_words(BOARDS["openmpd"]) == "sound rises and falls within 50 ms"


def test_more_than_is_allowed_is_refused():
    times, sounds = [0.0, 1.0, 2.0], [True, False, True]
    assert SoundLimits().check(times, sounds, 4.0) == pytest.approx((3.0, 0.75))
    with pytest.raises(DeviceError, match=r"has 3 s of sound; limit on_time_s allows 2\.5"):
        SoundLimits(on_time_s=2.5).check(times, sounds, 4.0)
    with pytest.raises(DeviceError, match="has sound in 75 % of 4 s; limit duty_limit allows 50 %"):
        SoundLimits(duty=0.5).check(times, sounds, 4.0)
    assert SoundLimits(on_time_s=3.0, duty=0.75).check(times, sounds, 4.0)
    assert SoundLimits().check([], [], 1.0) == (0, 0.0)


def test_the_largest_share_of_a_window_is_that_of_all_windows():
    random = np.random.default_rng(3)
    for _ in range(20):
        edges = np.sort(random.uniform(0.0, 60.0, 24))
        stretches = [(float(a), float(b)) for a, b in edges.reshape(-1, 2)]

        def cover(begin: float) -> float:
            return sum(max(0.0, min(b, begin + WINDOW_S) - max(a, begin)) for a, b in stretches)  # noqa: B023

        begins = {x for a, b in stretches for x in (a, b, a - WINDOW_S, b - WINDOW_S) if 0 <= x <= 60 - WINDOW_S}
        most = max(map(cover, begins | {0.0, 60.0 - WINDOW_S})) / WINDOW_S
        assert _duty(stretches, 60.0) == pytest.approx(most, rel=1e-9)
        assert _duty(stretches, 5.0) <= 1.0
