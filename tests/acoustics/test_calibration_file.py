"""Calibrations of arrays as files, and what the keys of a scene make of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import (
    Calibration,
    Elements,
    Level,
    Pose,
    WarmUp,
    calibrated,
    read_calibration,
    write_calibration,
)
from palmfield.acoustics.focus import compensate, focus
from palmfield.acoustics.layouts import LAYOUTS
from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transducer import ANY_P0
from palmfield.config import ArrayConfig
from palmfield.errors import OutputError, SceneError
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Air, Estimate

HERE = Placement.of(IDENTITY)
LEVEL = Estimate(1.31, 1.22, 1.4, "measured", 'our laboratory, 1/8" microphone')
NUMBERS = st.floats(-3.0, 3.0)


@st.composite
def elements(draw, count=4):
    many = {"min_size": count, "max_size": count}
    values = {name: tuple(draw(st.lists(NUMBERS.map(abs), **many))) for name in ("gain", "gain_sd", "phase_sd_rad")}
    return Elements(
        enabled=tuple(draw(st.lists(st.booleans(), **many))),
        polarity=tuple(draw(st.lists(st.sampled_from([-1, 1]), **many))),
        phase_rad=tuple(draw(st.lists(NUMBERS, **many))),
        address=draw(st.none() | st.permutations(range(count)).map(tuple)),
        **values,
    )


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(1.0, 9.0), st.text(min_size=1).filter(str.strip), st.none() | elements())
def test_what_is_written_is_read_back(tmp_path_factory, value, width, source, each):
    path = tmp_path_factory.mktemp("calibration") / "array.json"
    written = Calibration(
        layout="uhev1",
        p0=Estimate(value, value / width, value * width, "measured", source),
        quality=Estimate(21.0, 19.0, 23.0, "measured", "ring-down"),
        elements=each,
        pose=Pose(offset_m=(1e-3, 0.0, -2e-3)),
        phase_offset_rad=0.2,
        level=Level(exponent=0.75, exponent_sd=0.01, linear_to=0.9),
        warm_up=WarmUp(drop=0.05, drop_sd=0.01, time_s=300.0),
    )
    write_calibration(path, written)
    assert read_calibration(path) == written


FILE = {
    "format": "palmfield calibration", "version": 1, "layout": "uhev1",
    "p0": {"value": 1.31, "low": 1.22, "high": 1.4, "kind": "measured", "source": "us"},
}  # fmt: skip
TWO = {
    "enabled": [True, True], "polarity": [1, -1], "phase_rad": [0, 0], "phase_sd_rad": [0, 0],
    "gain": [1, 1], "gain_sd": [0, 0],
}  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"gain": 2}, "gain is unknown"),
        ({"layout": None}, "layout = None"),
        ({"version": 2}, "version = 2"),
        ({"p0": FILE["p0"] | {"low": 1.5}}, "1.5 <= 1.31 <= 1.4 does not hold"),
        ({"p0": FILE["p0"] | {"value": "loud"}}, "p0.value = 'loud'"),
        ({"p0": FILE["p0"] | {"source": " "}}, "state who measured it, when"),
        ({"p0": FILE["p0"] | {"kind": "assumed"}}, "allowed in a calibration: measured"),
        ({"elements": TWO | {"polarity": [1, 2]}}, "elements.polarity.1 = 2"),
        ({"elements": TWO | {"gain": [1]}}, "gain has 1 entries and enabled 2"),
        ({"elements": TWO | {"gain": [1, -1]}}, "elements.gain.1 = -1"),
        ({"elements": TWO | {"address": [0, 0]}}, "address must hold each number from 0 to 1 once"),
        ({"phase_offset_rad": float("nan")}, "phase_offset_rad"),
        ({"phase_offset_rad": float("nan")}, "allowed: a finite number"),
        ({"elements": TWO | {"phase_rad": [0, 180]}}, "phase_rad.1 = 180; allowed: -6.2832 to 6.2832, in radians"),
        ({"elements": TWO | {"resonance_Hz": [40.1, 39.9]}}, "elements.resonance_Hz.0 = 40.1; allowed: 20000 to"),
        ({"elements": TWO | {"quality": [25, 1e6]}}, "elements.quality.1 = 1e+06; allowed: 1 to 1000"),
        ({"quality": FILE["p0"] | {"value": 1e6, "low": 1, "high": 1e7}}, "quality.value = 1e+06; allowed: 1 to"),
    ],
)
def test_a_bad_file_is_told_with_its_place(tmp_path, changed, told):
    path = tmp_path / "array.json"
    path.write_text(json.dumps(FILE))
    assert read_calibration(path).p0.value == 1.31
    path.write_text(json.dumps(FILE | changed))
    with pytest.raises(SceneError) as error:
        read_calibration(path)
    assert str(path) in str(error.value) and told in str(error.value) and "\n" not in str(error.value)


def test_numbers_of_a_transducer_that_is_off_count_for_nothing(tmp_path):
    path = tmp_path / "array.json"
    elements = TWO | {"phase_rad": [0, 180], "quality": [25, 1e6]}
    path.write_text(json.dumps(FILE | {"elements": elements | {"enabled": [True, False]}}))
    assert read_calibration(path).elements.quality == (25.0, 1e6)


def test_a_file_that_is_not_there_that_is_no_json_and_one_that_cannot_be_written(tmp_path):
    with pytest.raises(SceneError, match="cannot be read"):
        read_calibration(tmp_path / "none.json")
    (tmp_path / "old.toml").write_text("[p0]")
    with pytest.raises(SceneError, match="JSON file"):
        read_calibration(tmp_path / "old.toml")
    with pytest.raises(OutputError, match="cannot write"):
        write_calibration(tmp_path / "no" / "array.json", Calibration(layout="uhev1", p0=LEVEL))


def measured_elements(count, **changed):
    zeros, ones = (0.0,) * count, (1.0,) * count
    numbers = {"enabled": (True,) * count, "polarity": (1,) * count, "phase_rad": zeros, "gain": ones}
    return Elements(**(numbers | changed), phase_sd_rad=zeros, gain_sd=zeros)


def test_a_driver_that_knows_the_wiring_takes_it_off_and_gains_and_faults_stay():
    """The field of the board as wired, under what the driver makes of a focus, is that of the calibrated array."""
    count, random = 256, np.random.default_rng(0)
    enabled, gain = random.random(count) > 0.05, random.normal(1.0, 0.1, count)
    polarity, phase = np.where(random.random(count) < 0.5, -1, 1), random.normal(0.0, 0.2, count)
    calibration = Calibration(
        layout="sonicsurface",
        phase_offset_rad=0.3,
        elements=measured_elements(
            count, enabled=tuple(enabled.tolist()), gain=tuple(gain.tolist()), polarity=tuple(polarity.tolist()),
            phase_rad=tuple(phase.tolist()),
        ),
    )  # fmt: skip
    board = layout("sonicsurface")
    asked = focus(board, Air(), (0.01, 0.0, 0.15))
    wired = replace(board, gain=enabled * gain * polarity * np.exp(1j * (phase + 0.3)))
    at = np.array([[0.01, 0.0, 0.15], [0.0, 0.02, 0.1]])
    known = calibrated(board, calibration)
    assert np.allclose(pressure64(at, wired, asked, Air())[0], pressure64(at, known, asked, Air())[0], rtol=1e-12)
    sent = pressure64(at, wired, compensate(known, asked), Air())[0]
    plain = pressure64(at, replace(board, gain=enabled * gain), asked, Air())[0]
    assert np.allclose(sent, plain, rtol=1e-12), "only gains and silent ones are left"
    assert abs(sent[0]) > 5.0 * abs(pressure64(at, wired, asked, Air())[0][0]), "as wired it does not focus"


def test_the_boards_place_moves_its_transducers():
    board = layout("sonicsurface")
    moved = calibrated(
        board, Calibration(layout="sonicsurface", pose=Pose(offset_m=(1e-3, 0, 0), turn_rad=(0, 0, 0.1)))
    )
    assert moved.positions[7] == pytest.approx(
        [
            np.cos(0.1) * board.positions[7, 0] - np.sin(0.1) * board.positions[7, 1] + 1e-3,
            np.sin(0.1) * board.positions[7, 0] + np.cos(0.1) * board.positions[7, 1],
            board.positions[7, 2],
        ]
    )


@pytest.mark.parametrize(
    ("calibration", "told"),
    [
        (Calibration(layout="uhev1"), "is for layout 'uhev1', but the array is 'sonicsurface'"),
        (Calibration(layout="sonicsurface", elements=measured_elements(3)), "has 3 transducers, but the array has 256"),
    ],
)
def test_the_calibration_of_another_board_is_refused(calibration, told):
    with pytest.raises(SceneError, match=told):
        known(layout="sonicsurface", calibration=calibration).array()


def test_resonances_that_were_measured_reach_the_poles():
    each = measured_elements(2, resonance_Hz=(40100.0, 39900.0), quality=(20.0, 30.0))
    one = Estimate(40200.0, 40100.0, 40300.0, "measured", "sweep")
    f0, quality = known(calibration=Calibration(layout="uhev1", elements=each)).pole(2)
    assert f0.tolist() == [40100.0, 39900.0] and quality.tolist() == [20.0, 30.0]
    f0, quality = known(calibration=Calibration(layout="uhev1", resonance_Hz=one)).pole(3)
    assert f0.tolist() == [40200.0] * 3 and quality.tolist() == [LAYOUTS["uhev1"].quality.value] * 3


def known(**keys):
    calibration = keys.pop("calibration", None)
    return ArrayInstance(ArrayConfig(**keys), HERE, calibration)


def test_p0_is_that_of_the_layout_the_key_or_the_calibration():
    assert known().p0 is LAYOUTS["uhev1"].p0 and known(layout="sites", sites="t").p0 is ANY_P0
    given_alone = known(p0_Pa_m=5.0).p0
    assert (given_alone.value, given_alone.low, given_alone.high) == (5.0, LAYOUTS["uhev1"].p0.low, 5.0)
    in_range = known(p0_Pa_m=5.0, p0_low_Pa_m=4.0, p0_high_Pa_m=6.0).p0
    assert (in_range.low, in_range.high, in_range.kind) == (4.0, 6.0, "assumed")
    one = known(calibration=Calibration(layout="uhev1", p0=LEVEL))
    assert one.p0 is LEVEL and one.array().p0_Pa_m == 1.31
    assert known(quality=40).quality.high == 40.0 and one.quality is LAYOUTS["uhev1"].quality
    assert known(calibration=Calibration(layout="uhev1")).p0 is LAYOUTS["uhev1"].p0


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"p0_low_Pa_m": 1.0, "p0_high_Pa_m": 2.0}, "are the range of key p0_Pa_m"),
        ({"p0_Pa_m": 1.0, "p0_low_Pa_m": 1.0}, "must be given together"),
        ({"p0_Pa_m": 3.0, "p0_low_Pa_m": 1.0, "p0_high_Pa_m": 2.0}, "is outside its range"),
        ({"layout": "csv"}, "layout 'csv' and key transducers"),
        ({"transducers": "a.csv"}, "layout 'csv' and key transducers"),
    ],
)
def test_keys_that_do_not_fit_together_are_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        ArrayConfig(**keys)
