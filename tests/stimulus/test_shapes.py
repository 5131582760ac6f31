import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.stimulus.curves import (
    GLYPHS,
    PlanePath,
    circle,
    letters,
    line,
    lissajous,
    polyline,
    square,
    z_shape,
    zigzag,
    zigzagged,
)

SHAPES = [
    line(0.03),
    circle(0.02),
    zigzag(0.04, 0.01, 3),
    square(0.02),
    z_shape(0.02, 0.03),
    lissajous(0.03, 0.02, 3, 2, 30.0),
    letters("PALM 42", 0.01),
    polyline([[0.0, 0.0], [0.01, 0.0], [0.01, 0.02], [0.0, 0.0]]),
]


def test_lengths_are_those_of_geometry():
    assert line(0.03).length_m == pytest.approx(0.03, rel=1e-12)
    assert circle(0.02).length_m == pytest.approx(math.pi * 0.02, rel=1e-4)
    assert zigzag(0.04, 0.01, 3).length_m == pytest.approx(4 * math.hypot(0.01, 0.01), rel=1e-12)
    assert square(0.02).length_m == pytest.approx(0.08, rel=1e-12)
    assert z_shape(0.02, 0.03).length_m == pytest.approx(0.04 + math.hypot(0.02, 0.03), rel=1e-12)
    # With a quarter turn of phase and equal counts, a Lissajous figure is a circle
    assert lissajous(0.02, 0.02, 1, 1, 90.0).length_m == pytest.approx(math.pi * 0.02, rel=1e-4)


def test_starting_points_are_as_documented():
    starts = [path.at(0.0)[0] for path in SHAPES[:6]]
    wanted = [[-0.015, 0], [0.01, 0], [-0.02, -0.005], [-0.01, -0.01], [-0.01, 0.015], [0.0075, 0]]
    assert np.allclose(starts, wanted, atol=1e-12)


@pytest.mark.parametrize("path", SHAPES)
def test_every_shape_is_centred(path):
    middle = 0.5 * (path.points.min(axis=0) + path.points.max(axis=0))
    assert np.abs(middle).max() < 1e-6


def test_a_circle_goes_counter_clockwise_and_is_round():
    path = circle(0.02)
    quarter = path.at(0.25 * path.length_m)
    assert np.allclose(quarter, [[0.0, 0.01]], atol=1e-9)
    radius = np.linalg.norm(path.at(np.linspace(0.0, path.length_m, 1000)), axis=1)
    assert np.ptp(radius) < 1e-4 * 0.01


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(SHAPES) - 1), st.floats(-0.5, 0.5), st.floats(0.0, 0.001))
def test_at_goes_round_or_there_and_back_and_never_faster_than_the_arc(which, arc, step):
    path = SHAPES[which]
    length = path.length_m
    again = arc + length if path.closed else 2.0 * length - arc
    assert np.allclose(path.at([arc]), path.at([again]), atol=1e-12)
    one, other = path.at([arc, arc + step])
    assert np.linalg.norm(other - one) <= step + 1e-12


def test_arc_length_along_a_straight_stroke_is_distance():
    path = z_shape(0.02, 0.03)
    assert np.allclose(path.at([0.005, 0.02]), [[-0.005, 0.015], [0.01, 0.015]])
    assert np.allclose(path.at([path.length_m, path.length_m + 0.004]), [[0.01, -0.015], [0.006, -0.015]])


def test_lissajous_counts_its_oscillations_and_fills_its_box():
    path = lissajous(0.03, 0.02, 3, 2, 20.0)
    x, y = path.points.T
    for values, oscillations, half in ((x, 3, 0.015), (y, 2, 0.01)):
        # Zeros can fall on a sample, so crossings are counted of a level that none has
        above = values > 0.1234 * half
        assert np.count_nonzero(above != np.roll(above, 1)) == 2 * oscillations
        assert np.abs(values).max() == pytest.approx(half, rel=1e-4)


def test_letters_lift_the_pen_on_straight_moves():
    path = letters("TI", 0.012)
    arcs = (np.arange(20000) + 0.5) / 20000 * path.length_m
    # T is 4/6 and 1 high, I is 1: the ink of both
    ink = 0.012 * (4 / 6 + 1 + 1)
    assert path.length_m * path.pen_down(arcs).mean() == pytest.approx(ink, rel=1e-3)
    back = 2.0 * path.length_m - arcs
    assert np.array_equal(path.pen_down(back), path.pen_down(arcs))
    assert circle(0.01).pen_down([0.0, 1.0]).all()


def test_ink_of_a_text_stands_on_the_letters_own_lines():
    path = letters("L", 0.012)
    assert path.pen_down(np.linspace(0.0, path.length_m, 1000)).all()
    assert np.allclose(path.points, [[-0.004, 0.006], [-0.004, -0.006], [0.004, -0.006]])


def test_the_font_has_all_letters_and_digits_of_full_height_and_none_twice():
    assert set(GLYPHS) == set("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789")
    assert len(set(GLYPHS.values())) == len(GLYPHS)
    for letter in GLYPHS:
        path = letters(letter.lower(), 0.01)
        assert np.ptp(path.points[:, 1]) == pytest.approx(0.01), letter
        assert np.ptp(path.points[:, 0]) <= 0.01 * 4 / 6 + 1e-12, letter


def test_a_polyline_that_ends_where_it_began_is_closed_and_repeats_are_dropped():
    path = polyline([[0.0, 0.0], [0.0, 0.0], [0.01, 0.0], [0.01, 0.02], [0.0, 0.0]])
    assert path.closed
    assert len(path.points) == 3
    assert path.length_m == pytest.approx(0.03 + math.hypot(0.01, 0.02))
    assert not polyline([[0.0, 0.0], [0.01, 0.0]]).closed


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (lambda: line(0.0), "length_m = 0.0"),
        (lambda: circle(math.nan), "diameter_m = nan"),
        (lambda: square(-0.01), "side_m = -0.01"),
        (lambda: z_shape(0.01, math.inf), "height_m = inf"),
        (lambda: zigzag(0.01, 0.01, 0), "turns = 0"),
        (lambda: zigzag(0.01, 0.01, 1.5), "turns = 1.5"),
        (lambda: lissajous(0.01, 0.01, 2, 4, 0.0), "divide both by 2"),
        (lambda: lissajous(0.01, 0.01, 1, 2, math.nan), "phase_deg = nan"),
        (lambda: letters("A+", 0.01), "'\\+'"),
        (lambda: letters("  ", 0.01), "no letters or digits"),
        (lambda: letters("A", 0.0), "height_m = 0.0"),
        (lambda: polyline([[0.0, 0.0, 0.0]]), r"\(1, 3\)"),
        (lambda: polyline(np.zeros((0, 2))), "0 distinct"),
        (lambda: polyline([[0.0, 0.0], [0.0, 0.0]]), "1 distinct"),
        (lambda: polyline([[0.0, math.nan], [0.0, 0.0]]), "not finite"),
    ],
)
def test_bad_sizes_are_named(make, part):
    with pytest.raises(SceneError, match=part):
        make()


def test_a_path_of_ones_own_needs_points_and_closed_only():
    path = PlanePath(np.array([[0.0, 0.0], [0.0, 0.01]]), closed=False)
    assert np.allclose(path.at(0.004), [[0.0, 0.004]])


def test_a_zigzag_about_a_line_runs_from_edge_to_edge_and_ends_with_the_line():
    """2 cm wide at 2.5 m/s across and 4 m/s along, a stroke each 3.2 cm of 10: three and an eighth."""
    path = zigzagged(line(0.1), 0.02, 0.032)
    strokes = 0.1 / 0.032
    assert path.points[:4] == pytest.approx(
        np.array([[-0.05, -0.01], [-0.018, 0.01], [0.014, -0.01], [0.046, 0.01]]), abs=1e-12
    )
    assert path.points[4] == pytest.approx([0.05, 0.01 - 0.02 * (strokes - 3.0)], abs=1e-12)
    assert path.length_m == pytest.approx(strokes * math.hypot(0.032, 0.02), rel=1e-12)


def test_a_zigzag_about_a_polyline_lies_beside_the_leg_that_it_is_at():
    path = zigzagged(polyline([[0.0, 0.0], [0.04, 0.0], [0.04, 0.04]]), 0.01, 0.01)
    middle = np.array([0.02, 0.02])
    assert path.points[1] + middle == pytest.approx([0.01, 0.005], abs=1e-12)
    assert path.points[6] + middle == pytest.approx([0.045, 0.02], abs=1e-12)
    assert path.points[7] + middle == pytest.approx([0.035, 0.03], abs=1e-12)


def test_a_zigzag_about_a_closed_path_is_refused():
    with pytest.raises(SceneError, match="closed"):
        zigzagged(circle(0.1), 0.01, 0.01)
