"""Calibration from synthetic readings: the truth lies within the error bars as often as it should."""

import numpy as np
import pytest
from scipy import stats

from palmfield.acoustics.arrays import layout, with_faults
from palmfield.acoustics.calibrate import calibrate_p0
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air

AIR = Air()
TRUE_P0 = 3.7
ARRAY = layout("autd3", TRUE_P0)
DRIVE = focus(ARRAY, AIR, (0.0, 0.0, 0.2))
POINTS = np.random.default_rng(0).normal([0.0, 0.0, 0.2], [0.004, 0.004, 0.015], (12, 3))
CLEAN = np.abs(pressure64(POINTS, ARRAY, DRIVE, AIR)[0])


def test_exact_readings_give_p0_back() -> None:
    p0, error = calibrate_p0(POINTS, CLEAN, layout("autd3", 1.0), DRIVE, AIR)
    assert p0 == pytest.approx(TRUE_P0, rel=1e-12)
    assert error < 1e-12


def test_faults_of_the_board_are_part_of_the_model() -> None:
    faulty = with_faults(ARRAY, dead=range(0, 60), inverted=range(100, 110))
    readings = np.abs(pressure64(POINTS, faulty, DRIVE, AIR)[0])
    assert calibrate_p0(POINTS, readings, faulty, DRIVE, AIR)[0] == pytest.approx(TRUE_P0, rel=1e-12)
    assert calibrate_p0(POINTS, readings, ARRAY, DRIVE, AIR)[0] < 0.8 * TRUE_P0


def test_truth_lies_within_the_error_bars_at_the_right_rate() -> None:
    """With Gaussian noise (p0 - truth)/error follows Student's t with n - 1 degrees of freedom."""
    random, trials = np.random.default_rng(7), 600
    noise = 0.05 * CLEAN.max()
    found = np.array(
        [calibrate_p0(POINTS, CLEAN + noise * random.normal(size=12), ARRAY, DRIVE, AIR) for _ in range(trials)]
    )
    score = (found[:, 0] - TRUE_P0) / found[:, 1]
    for level in (0.5, 0.68, 0.95):
        within = np.abs(score) < stats.t.ppf(0.5 + level / 2, df=11)
        assert within.mean() == pytest.approx(level, abs=3 * np.sqrt(level * (1 - level) / trials))
    assert stats.kstest(score, stats.t(df=11).cdf).pvalue > 0.01
    assert np.sqrt(np.mean(found[:, 1] ** 2)) == pytest.approx(found[:, 0].std(), rel=0.1)


def test_error_falls_with_the_square_root_of_the_number_of_readings() -> None:
    random = np.random.default_rng(3)
    errors = []
    for repeats in (20, 320):
        points, clean = np.tile(POINTS, (repeats, 1)), np.tile(CLEAN, repeats)
        readings = clean + 0.02 * clean.max() * random.normal(size=len(clean))
        errors.append(calibrate_p0(points, readings, ARRAY, DRIVE, AIR)[1])
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize(
    ("points", "readings", "drive", "match"),
    [
        (POINTS, CLEAN[:5], DRIVE, "one reading per point"),
        (POINTS[:1], CLEAN[:1], DRIVE, "at least 2"),
        (POINTS, -CLEAN, DRIVE, r"pressures_Pa\[0\]"),
        (POINTS, np.where(np.arange(12) == 4, np.nan, CLEAN), DRIVE, r"pressures_Pa\[4\]"),
        (POINTS, CLEAN, 0 * DRIVE, "no sound"),
        (-POINTS, CLEAN, DRIVE, "no sound"),
    ],
)
def test_readings_that_say_nothing_are_refused(
    points: np.ndarray, readings: np.ndarray, drive: np.ndarray, match: str
) -> None:
    with pytest.raises(PalmfieldError, match=match):
        calibrate_p0(points, readings, ARRAY, drive, AIR)
