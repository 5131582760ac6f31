import numpy as np
import pytest

from palmfield.errors import OutputError
from palmfield.outputs.schema import LABELS, OPTIONAL, SCHEMA, dataset


def test_every_variable_and_coordinate_has_units_and_a_long_name(result):
    assert set(result.variables) == set(SCHEMA) - OPTIONAL | set(LABELS)
    for name, variable in result.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name


def test_dims_and_dtypes_are_the_schema_s(result):
    for name in set(SCHEMA) - OPTIONAL:
        wanted = SCHEMA[name]
        assert result[name].dims == wanted.dims
        assert result[name].dtype == np.dtype(wanted.dtype)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"pressure": np.zeros(3)}, ["'pressure'", "unknown", "skin_pressure"]),
        ({"skin_pressure": np.zeros(3)}, ["float64", "float32", ".astype"]),
        ({"skin_position": np.zeros(3)}, ["shape (3,)", "(vertex, xyz)"]),
        ({"skin_position": np.zeros((4, 2))}, ["2 along 'xyz'", "3"]),
        ({"skin_position": np.zeros((4, 3)), "skin_depth": np.zeros(5)}, ["5 along 'vertex'", "'skin_position' has 4"]),
        ({"array_pose": np.zeros(6)}, ["6 along 'pose7'", "7"]),
        ({"arp": np.zeros((2, 3), np.float32)}, ["along 'time'", "give 'time'"]),
        ({"drive_phase": np.zeros((2, 3), np.float32)}, ["along 'frame'", "give 'frame_time'"]),
    ],
)
def test_what_does_not_fit_the_schema_is_named(arrays, words):
    with pytest.raises(OutputError) as caught:
        dataset(**arrays)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_run_cut_off_before_its_first_step_is_fine():
    empty = dataset(time=np.zeros(0), arp=np.zeros((0, 4), np.float32), skin_position=np.zeros((4, 3)))
    assert empty.sizes["time"] == 0
