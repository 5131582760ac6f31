from pathlib import Path

import numpy as np
import pytest

from palmfield.errors import OutputError
from palmfield.outputs.schema import (
    GROUPS,
    LABELS,
    ROOT,
    check,
    group,
    has_records,
    instances,
    kind_and_instance,
    tree,
)


def test_every_variable_says_what_it_is():
    for variables in (ROOT, *GROUPS.values()):
        for name, variable in variables.items():
            said = variable.attributes
            # It is the label of an axis, or the title of a plot
            assert 0 < len(said["long_name"]) <= 40, name
            assert variable.dtype == "str" or said["units"], name
            # A vector or a pose means nothing without its frame.
            assert ("frame" in said) == (variable.dims[-1:] in (("xyz",), ("pose7",))), name
    signed = {n for v in GROUPS.values() for n, variable in v.items() if variable.sign}
    assert {"displacement", "velocity", "arp", "loudest_arp", "drive_phase", "force", "torque", "rest_normal"} <= signed


def test_units_are_those_of_udunits():
    units = {v.units for variables in (ROOT, *GROUPS.values()) for v in variables.values()}
    assert units == {"s", "m", "1", "m s-1", "Pa", "Pa m", "rad", "degree", "N", "N m", "kg", "kg m2", ""}


def test_no_variable_has_the_name_of_a_dimension_that_it_shares_with_others():
    """xarray and CF take such a variable as the dimension's coordinate, which has that dimension only."""
    for variables in (ROOT, *GROUPS.values()):
        dims = {dim for variable in variables.values() for dim in variable.dims}
        for name in dims & set(variables):
            assert variables[name].dims == (name,)


def test_a_result_has_every_group_and_variable(result):
    for kind, variables in GROUPS.items():
        found = instances(result, kind)
        assert found, kind
        names = {str(name) for ds in found.values() for name in ds.variables}
        assert set(variables) - names <= {"obstacle_position", "obstacle_face", "motion_displacement"}
        for ds in found.values():
            for name in variables.keys() & set(ds.variables):
                assert ds[name].dims == variables[name].dims
                assert ds[name].attrs == variables[name].attributes
                assert variables[name].dtype == "str" or ds[name].dtype == np.dtype(variables[name].dtype)


def test_groups_have_the_roots_times_and_labels(result):
    skin = instances(result, "skin")["tip"]
    assert skin["displacement"].sel(xyz="x", time=0.02, method=None).shape == (127,)
    assert {"time", *LABELS} <= set(skin.coords)
    assert result.attrs["schema_version"] == 2 and result.attrs["Conventions"].startswith("CF-1.")


@pytest.mark.parametrize("name", ["palm", "left/palm", "a b", "ä%2F", "..", ".", "left.palm", "x-1"])
def test_any_name_makes_a_group(name):
    path = group("skin", name)
    assert kind_and_instance(path) == ("skin", name)
    held = tree({path: {"rest_position": np.zeros((2, 3))}})
    assert list(instances(held, "skin")) == [name]


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"/skin/p": {"loudness": np.zeros(3)}}, ["'loudness' of group '/skin/p'", "unknown", "loudest_pressure"]),
        ({"/palm": {}}, ["'/palm'", "/skin/NAME"]),
        ({"/skin": {}}, ["'/skin'", "/skin/NAME"]),
        ({"/skin/p": {"loudest_arp": np.zeros(3)}}, ["/skin/p/loudest_arp", "float64", "float32", ".astype"]),
        ({"/skin/p": {"rest_position": np.zeros(3)}}, ["shape (3,)", "(vertex, xyz)"]),
        ({"/skin/p": {"rest_position": np.zeros((4, 2))}}, ["2 along 'xyz'", "3"]),
        (
            {"/skin/p": {"rest_position": np.zeros((4, 3)), "depth": np.zeros(5)}},
            ["depth' has length 5 along 'vertex'", "4"],
        ),
        ({"/": {"step_time": np.zeros(1)}, "/array/a": {"pose": np.zeros((1, 6))}}, ["6 along 'pose7'", "7"]),
        ({"/skin/p": {"arp": np.zeros((2, 3), np.float32)}}, ["/skin/p/arp", "has no times", "give 'time'"]),
        ({"/": {"time": np.zeros(3)}, "/skin/p": {"arp": np.zeros((2, 3), np.float32)}}, ["2 along 'time'", "3"]),
        (
            {"/surface/p": {"obstacle_position": np.zeros((0, 3))}},
            ["has length 0 along 'obstacle_vertex'", "omit it"],
        ),
        ({"/stimulus/s": {"sounding": np.zeros(1)}}, ["float64", "bool"]),
        ({"/sensors/s": {"channel": np.zeros(1)}}, ["float64", "str"]),
    ],
)
def test_what_does_not_fit_the_schema_is_named(arrays, words):
    with pytest.raises(OutputError) as caught:
        check(arrays, {})
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(("kind", "name"), [("hand", "x"), ("skin", "")])
def test_groups_that_cannot_be(kind, name):
    with pytest.raises(OutputError, match="no group"):
        group(kind, name)


def test_a_run_cut_off_before_its_first_step_is_fine():
    empty = tree({"/": {"time": np.zeros(0)}, "/skin/p": {"arp": np.zeros((0, 4), np.float32)}})
    assert empty.sizes["time"] == 0
    skin = instances(empty, "skin")["p"]
    assert not has_records(skin, "arp") and not has_records(skin, "time") and not has_records(skin, "velocity")
    assert instances(empty, "array") == {}


def test_the_page_on_results_lists_every_variable():
    page = (Path(__file__).parents[2] / "docs" / "results.md").read_text()
    parts = {part.split("`")[1]: part for part in page.split("\n### ")[1:]}
    for kind, variables in {"/": ROOT, **GROUPS}.items():
        part = parts["/" if kind == "/" else f"/{kind}/NAME"]
        rows = [line.split(" | ") for line in part.splitlines() if line.startswith("| `")]
        told = {row[0].strip("| `"): row[1:4] for row in rows}
        assert list(told) == list(variables)
        for name, variable in variables.items():
            units = "m, 1" if variable.dims[-1:] == ("pose7",) else variable.units or "-"
            assert told[name] == [", ".join(variable.dims) or "-", variable.dtype, units]
