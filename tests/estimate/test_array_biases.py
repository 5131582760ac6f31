"""What a calibration says of level and warm-up stands in the budget of what is left out."""

import numpy as np
import pytest

import palmfield
from palmfield.acoustics.calibration_file import Calibration, Level, WarmUp, write_calibration
from palmfield.estimate.biases import array_biases
from palmfield.planning.facts import first_drive

LEVEL = Level(exponent=1.2, exponent_sd=0.0, linear_to=0.8)
WARM_UP = WarmUp(drop=0.06, drop_sd=0.01, time_s=300.0)


def lines(scene: palmfield.Simulation) -> dict[str, object]:
    model = scene.runtime.model
    return {one.what: one for one in array_biases(model, 0, first_drive(model, 0))}


@pytest.fixture
def calibrated(small_scene, tmp_path):
    """A small scene at a level, with a calibration of level and warm-up."""

    def make(amplitude: float, **parts: object) -> palmfield.Simulation:
        write_calibration(tmp_path / "ours.json", Calibration(layout="uhev1", **parts))
        return palmfield.load(
            small_scene(array={"calibration": str(tmp_path / "ours.json")}, stimulus={"drive_amplitude": amplitude})
        )

    return make


def test_a_measured_exponent_and_warm_up(calibrated) -> None:
    """The ARP goes with p0^2 a^(2 exponent), where a run has p0^2 a^2; at first it is 1.06^2 of that in the end."""
    found = lines(calibrated(0.5, level=LEVEL, warm_up=WARM_UP))
    asked, real = 0.5**2, (0.5**1.2) ** 2
    assert found["level of the drive"].low == pytest.approx(real / asked - 1.0, rel=1e-6)
    assert found["level of the drive"].high == 0.0
    assert found["warm-up"].high == pytest.approx(1.06**2 - 1.0)
    assert f"within 1 % after {300 * np.log(6):.0f} s" in found["warm-up"].why


def test_full_drive_has_no_law_of_level(calibrated) -> None:
    straight = Level(exponent=1.2, exponent_sd=0.1, linear_to=1.0)
    found = lines(calibrated(1.0, level=straight))["level of the drive"]
    assert (found.low, found.high) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_level_that_saturates_has_no_figure(calibrated) -> None:
    found = lines(calibrated(0.9, level=LEVEL))
    assert found["saturation of the drive"].low is None
    assert "above level 0.8" in found["saturation of the drive"].why


def test_what_no_calibration_has_is_not_estimated(calibrated) -> None:
    found = lines(calibrated(0.5))
    assert found["warm-up"].low is None and "not in the calibration" in found["warm-up"].why
    assert "level of the drive" not in found
