"""Calibrations of arrays as files, and what the keys of a scene make of them."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.acoustics.calibration_file import Calibration, read_calibration, write_calibration
from palmfield.acoustics.layouts import LAYOUTS
from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.acoustics.transducer import ANY_P0
from palmfield.config import ArrayConfig
from palmfield.errors import OutputError, SceneError
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Estimate

HERE = Placement.of(IDENTITY)
LEVEL = Estimate(1.31, 1.22, 1.4, "measured", 'our laboratory, 1/8" microphone')
FILE = '[p0]\nvalue = 1.31\nlow = 1.22\nhigh = 1.4\nsource = "us"\n'


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(1.0, 9.0), st.text(min_size=1).filter(str.strip))
def test_what_is_written_is_read_back(tmp_path_factory, value, width, source):
    path = tmp_path_factory.mktemp("calibration") / "array.toml"
    written = Calibration(
        Estimate(value, value / width, value * width, "measured", source.strip()),
        Estimate(21.0, 19.0, 23.0, "measured", "ring-down"),
    )
    write_calibration(path, written)
    assert read_calibration(path) == written


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[p0", "cannot be read"),
        ("", "table 'p0' is missing"),
        (FILE + "[gain]\n", "'gain' is unknown; allowed: tables p0, quality and elements"),
        ("p0 = 1.3", "table 'p0' has 1.3; give value, low, high, source"),
        (FILE.replace("low = 1.22\n", ""), "table 'p0' has value, high, source; give"),
        (FILE.replace("1.22", '"1.22"'), "p0.low = '1.22'; give a number"),
        (FILE.replace("1.22", "true"), "p0.low = True; give a number"),
        (FILE.replace("1.22", "1.5"), "low 1.5, value 1.31 and high 1.4; give 0 < low <= value <= high"),
        (FILE.replace("1.22", "-1"), "low -1, value 1.31"),
        (FILE.replace("1.4", "inf"), "high inf"),
        (FILE.replace("1.31", "nan"), "value nan"),
        (FILE.replace("us", " "), "say who measured when"),
    ],
)
def test_a_bad_file_is_told_with_its_place(tmp_path, text, told):
    path = tmp_path / "array.toml"
    path.write_text(text)
    with pytest.raises(SceneError) as error:
        read_calibration(path)
    assert str(path) in str(error.value) and told in str(error.value)


def test_a_file_that_is_not_there_and_one_that_cannot_be_written(tmp_path):
    with pytest.raises(SceneError, match="cannot be read"):
        read_calibration(tmp_path / "none.toml")
    with pytest.raises(OutputError, match="cannot be written"):
        write_calibration(tmp_path / "no" / "array.toml", Calibration(LEVEL))


def known(**keys):
    calibration = keys.pop("calibration", None)
    return ArrayInstance(ArrayConfig(**keys), HERE, calibration)


def test_p0_is_that_of_the_layout_the_key_or_the_calibration():
    assert known().p0 is LAYOUTS["uhev1"].p0 and known(layout="sites", sites="t").p0 is ANY_P0
    given_alone = known(p0_Pa_m=5.0).p0
    assert (given_alone.value, given_alone.low, given_alone.high) == (5.0, LAYOUTS["uhev1"].p0.low, 5.0)
    in_range = known(p0_Pa_m=5.0, p0_low_Pa_m=4.0, p0_high_Pa_m=6.0).p0
    assert (in_range.low, in_range.high, in_range.kind) == (4.0, 6.0, "assumed")
    calibrated = known(calibration=Calibration(LEVEL))
    assert calibrated.p0 is LEVEL and calibrated.array().p0_Pa_m == 1.31
    assert known(quality=40).quality.high == 40.0 and calibrated.quality is LAYOUTS["uhev1"].quality


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"p0_low_Pa_m": 1.0, "p0_high_Pa_m": 2.0}, "are the range of key p0_Pa_m"),
        ({"p0_Pa_m": 1.0, "p0_low_Pa_m": 1.0}, "belong together"),
        ({"p0_Pa_m": 3.0, "p0_low_Pa_m": 1.0, "p0_high_Pa_m": 2.0}, "is needed"),
        ({"calibration": "a.toml", "p0_Pa_m": 1.0}, "calibration says p0 and quality"),
        ({"layout": "csv"}, "layout 'csv' needs transducers"),
        ({"transducers": "a.csv"}, "layout 'csv' needs transducers"),
    ],
)
def test_keys_that_do_not_fit_together_are_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        ArrayConfig(**keys)
