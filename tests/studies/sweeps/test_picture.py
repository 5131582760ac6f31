"""Pictures of sweeps: which kind is drawn of what, and what they say."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.image import imread

from palmfield.errors import OutputError
from palmfield.studies.sweeps import picture
from palmfield.studies.sweeps.design import grid, listed
from palmfield.studies.sweeps.store import DONE, FAILED, NOT_DONE

SKINS, OBSERVERS = ["palm", "tip"], ["first", "second"]


def dataset(design, status=None):
    """Made-up numbers of a design: levels that rise with the point's number."""
    dims, shape = design.dims, design.shape
    rising = np.arange(design.count, dtype=float).reshape(shape)
    state = np.full(shape, DONE, np.int8) if status is None else np.array(status, np.int8).reshape(shape)
    rising[state != DONE] = np.nan
    level = rising[..., None, None] + np.array([[0.0, 4.0], [10.0, 14.0]])
    size = 1e-6 * (1.0 + rising[..., None] + np.array([0.0, 0.5]))
    arrays = {
        "level_all_lines": ((*dims, "skin", "observer"), level),
        "peak_displacement": ((*dims, "skin"), size),
        "peak_velocity": ((*dims, "skin"), 1e3 * size),
        "status": (dims, state),
    }
    coordinates = {key: (key if design.kind == "grid" else "point", list(v)) for key, v in design.values.items()}
    identity = json.dumps({"design": design.as_json()})
    made = xr.Dataset(
        arrays, {**coordinates, "skin": SKINS, "observer": OBSERVERS}, {"scene": "a/b.xml", "identity": identity}
    )
    for key in design.values:
        made[key].attrs["units"] = "m"
    return made


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """The figure that a dataset's picture is."""
    figures = []
    plain = picture.save

    def save(figure: Figure, *arguments):
        figures.append(figure)
        plain(figure, *arguments)

    monkeypatch.setattr(picture, "save", save)

    def draw(made):
        picture.plot_sweep(made, tmp_path / "sweep.png")
        assert imread(tmp_path / "sweep.png").std() > 0.02
        return figures.pop()

    return draw


def test_one_key_is_drawn_as_lines(drawn):
    figure = drawn(dataset(grid({"a.x": [1.0, 2.0, 4.0, 8.0]})))
    level, displacement, velocity = figure.axes
    lines = {line.get_label(): line.get_ydata() for line in level.get_lines() if len(line.get_xdata()) == 4}
    np.testing.assert_array_equal(lines["'palm', first"], [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(lines["'tip', second"], [14.0, 15.0, 16.0, 17.0])
    np.testing.assert_allclose(displacement.get_lines()[0].get_ydata(), [1.0, 2.0, 3.0, 4.0])
    assert velocity.get_xlabel() == "a.x [m]" and velocity.get_xscale() == "log"
    assert "dB SL" in level.get_ylabel() and "µm" in displacement.get_ylabel()


def test_evenly_spaced_values_have_an_even_axis(drawn):
    assert drawn(dataset(grid({"a.x": [1.0, 2.0, 3.0, 4.0]}))).axes[-1].get_xscale() == "linear"


def test_two_keys_are_drawn_as_maps_with_failed_points_marked(drawn):
    design = grid({"a.x": [1.0, 2.0], "a.w": ["u", "v", "w"]})
    figure = drawn(dataset(design, [DONE, DONE, FAILED, DONE, DONE, NOT_DONE]))
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    assert len(panels) == 4
    (mesh,) = panels[0].collections
    np.testing.assert_array_equal(mesh.get_array().filled(-1.0), [[0.0, 1.0, -1.0], [3.0, 4.0, -1.0]])
    assert [label.get_text() for label in panels[0].get_xticklabels()] == ["u", "v", "w"]
    (crosses,) = panels[0].get_lines()
    assert crosses.get_xydata().tolist() == [[2.0, 1.0]]
    assert "1 points failed; 1 points not computed yet" in figure.get_suptitle()


def test_an_observer_who_is_refused_everywhere_is_left_out(drawn):
    line, plane = (dataset(grid(keys)) for keys in ({"a.x": [1.0, 2.0]}, {"a.x": [1.0, 2.0], "a.y": [1.0, 2.0]}))
    for made in (line, plane):
        made["level_all_lines"].loc[{"observer": "first"}] = np.nan
    level = drawn(line).axes[0]
    labels = [one.get_label() for one in level.get_lines() if len(one.get_xdata()) == 2 and "'" in one.get_label()]
    assert labels == ["'palm', second", "'tip', second"]
    panel = drawn(plane).axes[0]
    np.testing.assert_array_equal(panel.collections[0].get_array(), [[4.0, 5.0], [6.0, 7.0]])
    assert "(second)" in panel.get_title("left")


@pytest.mark.parametrize(
    "design",
    [
        listed({"a.x": [1.0, 3.0, 2.0, 5.0], "a.w": ["u", "v", "u", "v"]}),
        grid({"a.x": [1.0, 2.0], "a.y": [1.0, 2.0], "a.z": [1.0, 2.0]}),
    ],
    ids=["list", "three keys"],
)
def test_anything_else_is_drawn_point_by_point(design, drawn):
    figure = drawn(dataset(design))
    assert len(figure.axes) == 2 * len(design.keys)
    first = figure.axes[0].get_lines()[0]
    by_number = [design.point(number)["a.x"] for number in range(design.count)]
    np.testing.assert_array_equal(first.get_xdata(), by_number)
    np.testing.assert_array_equal(first.get_ydata(), np.arange(design.count))


def test_nothing_is_drawn_of_failures_alone(tmp_path):
    with pytest.raises(OutputError, match="no point of the sweep has results yet"):
        picture.plot_sweep(dataset(grid({"a.x": [1.0, 2.0]}), [FAILED, NOT_DONE]), tmp_path / "sweep.png")
