"""Knife edges behind a finger against boundary elements; the whole comparison is in docs/bench/shadows.md."""

import numpy as np
import pytest
from check_shadows import array, wavelength
from check_shadows_bem import WANTED, compared, finger, plane

pytestmark = pytest.mark.slow


def test_the_sound_behind_a_finger_is_that_of_boundary_elements():
    """Where its shadow is steepest, rms with nodes 4 mm apart; rays miss it by half of the free peak there."""
    arrays = array()
    place = plane(arrays, np.linspace(-0.018, 0.018, 25), np.array([0.0, 0.006]))
    found = compared(arrays, place, np.array([0.004, 0.008]), finger(0.015, wavelength(arrays) / 6.5, length_m=0.05))
    knife, closer, rays = (np.abs(by - found.true) for by in (found.knife, found.closer, found.rays))
    assert found.true.min() < 0.1 and found.true.max() > 0.3
    rms = [np.sqrt((error**2).mean()) for error in (closer, knife, rays)]
    assert rms[0] < WANTED and rms[0] < rms[1] < rms[2]
    assert closer.max() < 0.2 and rays.max() > 0.5
