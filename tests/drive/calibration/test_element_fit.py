"""Transducers one by one, judged on readings of a laboratory that shares no model with the fit."""

from typing import Any

import numpy as np
import pytest
from check_calibration import judged
from laboratory import Laboratory

from palmfield.acoustics.arrays import layout
from palmfield.drive.calibration.element_fit import fit_elements
from palmfield.errors import PalmfieldError
from palmfield.types import Air

BOARD = layout("sonicsurface")


@pytest.fixture(scope="module")
def rough() -> list[dict[str, Any]]:
    """Places 1 mm and air 1 K off (sd), a measured directivity for the piston, 10 % echo, 8 bits."""
    return [judged(seed) for seed in range(3)]


def test_a_real_room_gives_polarity_phase_and_gain(rough: list[dict[str, Any]]) -> None:
    """Asked are 15 deg and 8 %."""
    for one in rough:
        assert one["polarities"] == 0 and one["silent"], "five silent ones are found, and no other"
        assert np.degrees(np.sqrt(np.mean(one["phase"] ** 2))) < 5.0
        assert np.sqrt(np.mean(one["gain"] ** 2)) < 0.03
        assert abs(one["p0"]) < 0.03


def test_intervals_cover_the_truth(rough: list[dict[str, Any]]) -> None:
    """Errors of neighbours go together, so that three boards say little more than three errors of phase do."""
    phases = [np.abs(one["phase"]) < 1.96 * one["phase_sd"] for one in rough]
    gains = [np.abs(one["gain"]) < 1.96 * one["gain_sd"] for one in rough]
    assert np.mean(phases) > 0.8 and np.mean(gains) > 0.88
    assert all(abs(one["speed"]) < 3.0 * one["speed_sd"] for one in rough)


def test_exact_places_and_air_leave_the_readings_noise() -> None:
    one = judged(5, True)
    assert one["polarities"] == 0
    assert np.degrees(np.sqrt(np.mean(one["phase"] ** 2))) < 0.6 and np.sqrt(np.mean(one["gain"] ** 2)) < 0.01
    assert np.mean(np.abs(one["phase"]) < 1.96 * one["phase_sd"]) == pytest.approx(0.95, abs=0.05)


def test_a_board_without_faults_is_found_to_have_none() -> None:
    random = np.random.default_rng(2)
    at = np.column_stack([random.uniform(-0.05, 0.05, (4, 2)), random.uniform(0.15, 0.2, 4)])
    lab = Laboratory(BOARD.positions, np.ones(len(BOARD)), p0=1.0, noise=1e-4, random=random)
    elements = fit_elements(BOARD, Air(), at, lab.read(lab.each(at))).elements
    assert all(elements.enabled) and set(elements.polarity) == {1}
    assert np.degrees(np.abs(elements.phase_rad).max()) < 1.0 and np.abs(np.array(elements.gain) - 1.0).max() < 0.02


AT = np.array([[0.0, 0.0, 0.15], [0.02, 0.0, 0.2], [0.0, 0.03, 0.18]])
ONES = np.ones((3, len(BOARD)), complex)


@pytest.mark.parametrize(
    ("at", "readings", "told"),
    [
        (AT[:2], ONES[:2], "3 at least"),
        (AT, ONES[:, :7], "a column for each transducer"),
        (AT * [1, 1, -1], ONES, "not in front of all"),
        (AT, np.where(np.arange(len(BOARD)) == 9, np.nan, ONES), "transducer 9 has no finite reading"),
        (AT, np.where(np.arange(len(BOARD)) == 4, np.inf, ONES), "transducer 4 has no finite reading"),
        (AT, 0.0 * ONES, "all readings are 0"),
    ],
)
def test_readings_that_do_not_serve_are_refused(at: np.ndarray, readings: np.ndarray, told: str) -> None:
    with pytest.raises(PalmfieldError, match=told):
        fit_elements(BOARD, Air(), at, readings)
