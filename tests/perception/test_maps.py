"""Maps of levels against the levels of single places, and a field whose map is known."""

import numpy as np
import pytest

from palmfield.errors import OutputError
from palmfield.perception.maps import level_map
from palmfield.perception.observers import OBSERVERS, level_dB_SL, levels_dB_SL, threshold_m

TIMES = np.arange(400) / 8000.0


def test_a_motion_of_known_multiples_of_the_threshold():
    """Places that move by 0.5, 1, 2 and 10 thresholds at 200 Hz, and one at rest: -6, 0, 6, 20 dB, and none."""
    for observer in OBSERVERS.values():
        factors = np.array([0.5, 1.0, 2.0, 10.0, 0.0])
        motion = float(threshold_m(observer, 200.0)) * factors * np.sin(2 * np.pi * 200 * TIMES[:, None] + 0.3)
        levels = level_map(observer, TIMES, motion + 1e-6, [200.0])
        assert levels[4] < -100.0
        assert levels[:4] == pytest.approx([-6.0206, 0.0, 6.0206, 20.0], abs=1e-3)


def test_a_plane_wave_is_felt_alike_wherever_it_goes():
    phases = np.linspace(0.0, 7.0, 30)
    wave = 1e-6 * np.cos(2 * np.pi * 200 * TIMES[:, None] - phases)
    levels = level_map(OBSERVERS["afferent_human"], TIMES, wave, [200.0])
    assert levels == pytest.approx(np.full(30, 20 * np.log10(1.0 / 0.042)), abs=1e-6)


@pytest.mark.parametrize("name", list(OBSERVERS))
def test_levels_of_places_are_those_of_each(name):
    """Also with channels: 20 and 30 Hz add up, 100 and 200 Hz do, and the higher of both sums counts."""
    rng = np.random.default_rng(1)
    frequencies = [20.0, 30.0, 100.0, 200.0, 1000.0]
    lines = 1e-6 * rng.random((5, 7))
    each = [level_dB_SL(OBSERVERS[name], frequencies, lines[:, place]) for place in range(7)]
    assert levels_dB_SL(OBSERVERS[name], frequencies, lines) == pytest.approx(each)


def test_records_that_hold_no_line_are_refused():
    with pytest.raises(OutputError, match="that many whole periods"):
        level_map(OBSERVERS["afferent_human"], TIMES[:20], np.zeros((20, 3)), [200.0])
