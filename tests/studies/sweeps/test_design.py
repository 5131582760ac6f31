"""Points of grids, lists, random and Sobol designs, from Python and from texts."""

import itertools

import numpy as np
import pytest
from scipy.stats import kstest, qmc

from palmfield.errors import SceneError
from palmfield.studies.sweeps.design import Range, grid, listed, random, sobol
from palmfield.studies.sweeps.keys import read_design


def points(design):
    return [design.point(number) for number in range(design.count)]


def test_a_grid_has_every_combination_once_with_the_last_key_fastest():
    design = grid({"a.x": [1.0, 2.0], "a.y": ["u", "v", "w"]})
    assert design.dims == ("a.x", "a.y") and design.shape == (2, 3)
    expected = [{"a.x": x, "a.y": y} for x, y in itertools.product([1.0, 2.0], "uvw")]
    assert points(design) == expected
    assert [design.index(number) for number in range(6)] == list(itertools.product(range(2), range(3)))


def test_vectors_and_numpys_numbers_become_plain_ones():
    design = grid({"a.v": np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]), "a.n": np.arange(2)})
    assert design.point(3) == {"a.v": (3.0, 4.0, 5.0), "a.n": 1}
    assert type(design.point(3)["a.n"]) is int


def test_a_list_takes_values_side_by_side():
    design = listed({"a.x": [1.0, 2.0], "a.y": ["u", "u"]})
    assert design.dims == ("point",)
    assert points(design) == [{"a.x": 1.0, "a.y": "u"}, {"a.x": 2.0, "a.y": "u"}]


@pytest.mark.parametrize("make", [random, sobol])
def test_drawn_points_repeat_for_a_seed_and_fill_their_ranges(make):
    ranges = {"a.x": Range(2.0, 6.0), "a.f": Range(10.0, 1000.0, logarithmic=True), "a.w": ["u", "v"]}
    design, again, other = (make(ranges, 256, seed) for seed in (3, 3, 4))
    assert design == again and design != other
    x, f = np.array(design.values["a.x"]), np.array(design.values["a.f"])
    assert kstest(x, "uniform", args=(2.0, 4.0)).pvalue > 0.01
    assert kstest(np.log10(f), "uniform", args=(1.0, 2.0)).pvalue > 0.01
    assert 64 < design.values["a.w"].count("u") < 192


def test_sobol_points_are_more_even_than_random_ones():
    ranges = {"a.x": Range(0.0, 1.0), "a.y": Range(0.0, 1.0)}
    uneven = [qmc.discrepancy(np.array(list(make(ranges, 128).values.values())).T) for make in (sobol, random)]
    assert uneven[0] < 0.3 * uneven[1]


def test_texts_give_the_points_that_they_say():
    design, fixed = read_design(["a.x=0:1:5", "a.f=10:1000:3:log", "a.w=u,v", "a.v=0 0 0.1,0 0 0.2", "a.k=7", "a.o="])
    assert design.values["a.x"] == (0.0, 0.25, 0.5, 0.75, 1.0)
    assert design.values["a.f"] == (10.0, 100.0, 1000.0)
    assert design.values["a.w"] == ("u", "v")
    assert design.values["a.v"] == ((0.0, 0.0, 0.1), (0.0, 0.0, 0.2))
    assert fixed == {"a.k": 7.0, "a.o": None} and design.count == 60


def test_texts_of_drawn_designs():
    design, fixed = read_design(["a.x=-1:1", "a.w=u,v", "a.k=7"], sobol_points=16, seed=5)
    assert design == sobol({"a.x": Range(-1.0, 1.0), "a.w": ["u", "v"]}, 16, 5)
    assert fixed == {"a.k": 7.0}


def test_a_table_is_read_row_by_row(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("a.x, a.w\n1, u\n\n2.5, v\n")
    design, fixed = read_design(["a.k=7"], table=path)
    assert points(design) == [{"a.x": 1.0, "a.w": "u"}, {"a.x": 2.5, "a.w": "v"}]
    assert fixed == {"a.k": 7.0}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["a.x"], r"--set a\.x has no values; write KEY=a:b:n"),
        (["=1:2:3"], "has no values"),
        (["a.x=1:2:0"], "is empty: it has 0 values; allowed: at least 1"),
        (["a.x=1:2:2.5"], "not a range of numbers"),
        (["a.x=one:2:3"], "not a range of numbers"),
        (["a.x=1:1:3"], "two different finite numbers"),
        (["a.x=0:nan:3"], "two different finite numbers"),
        (["a.x=1:2"], "is not a range; write KEY=a:b:n"),
        (["a.x=-1:1:3:log"], "allowed: both ends above 0"),
        (["a.x=1,,2"], "an empty value between commas"),
        (["a.x=1,1"], "the value 1.0 twice"),
        (["a.x=1,2", "a.x=3"], "given twice"),
        (["a.x=1"], "the sweep has no values"),
        ([], "the sweep has no values"),
        (["a.x=0:1:10000", "a.y=0:1:10000"], "100000000 points; allowed: at most 10000000"),
    ],
)
def test_settings_that_are_refused(settings, said):
    with pytest.raises(SceneError, match=said):
        read_design(settings)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file"),
        ("a.x\n", "has 1 lines; allowed"),
        ("a.x,a.x\n1,2\n", "'a.x' is given twice"),
        ("a.x,a.y\n1,2\n3\n", "line 3 has 1 values for 2 keys"),
        ("a.k\n1\n", "'a.k' is given twice"),
    ],
)
def test_tables_that_are_refused(content, said, tmp_path):
    path = tmp_path / "points.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SceneError, match=said):
        read_design(["a.k=7"], table=path)


def test_kinds_of_design_that_are_refused(tmp_path):
    with pytest.raises(SceneError, match="give one of them"):
        read_design(["a.x=1:2"], random_points=4, sobol_points=4)
    with pytest.raises(SceneError, match="has 0 points; allowed: at least 1"):
        read_design(["a.x=1:2"], random_points=0)
    with pytest.raises(SceneError, match="is not a range; write KEY=a:b,"):
        read_design(["a.x=1:2:3"], random_points=4)
    with pytest.raises(SceneError, match="no key to draw"):
        read_design(["a.x=1"], sobol_points=4)
    with pytest.raises(SceneError, match=r"a\.x: 2, a\.y: 1"):
        listed({"a.x": [1, 2], "a.y": [1]})
    with pytest.raises(SceneError, match="value nan"):
        grid({"a.x": [1.0, float("nan")]})
