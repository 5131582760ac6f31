"""Wakes and frames that go along, on cones of a known angle, decays of a known length and waves that turn."""

import numpy as np
import pytest

from palmfield.errors import MeasurementError
from palmfield.metrics import (
    co_rotating_average,
    mach_angle,
    wake_along_path,
    wake_area,
    wake_length,
)

X = np.arange(-0.12, 0.0405, 0.001)
Y = np.arange(-0.08, 0.0805, 0.001)
XX, YY = np.meshgrid(X, Y, indexing="ij")
FOCUS = 0.03


def cone(half_angle_deg, width=0.003, focus=FOCUS):
    """Fronts |y| = (focus - x) tan b of Gaussian section that get slowly weaker along them."""
    behind = focus - XX
    off = (np.abs(YY) - behind * np.tan(np.radians(half_angle_deg))) * np.cos(np.radians(half_angle_deg))
    return np.where(behind > 0.0, np.exp(-((off / width) ** 2) - np.hypot(behind, YY) / 0.2), 0.0)


@pytest.mark.parametrize("angle", [25.0, 35.0, 45.6])
@pytest.mark.parametrize(("estimator", "within"), [("ridge", 1.0), ("slant_stack", 0.5)])
def test_the_angle_of_a_cone(angle, estimator, within):
    found = mach_angle(-cone(angle), X, Y, focus_x_m=FOCUS, estimator=estimator)
    assert found == pytest.approx(angle, abs=within)


def test_least_absolute_deviations_pass_over_outliers():
    values = cone(35.0)
    row = np.flatnonzero(np.isclose(X, FOCUS - 0.03))
    values[row, np.flatnonzero(np.isclose(Y, 0.075))] = 5.0
    values[row, np.flatnonzero(np.isclose(Y, -0.075))] = 5.0
    assert mach_angle(values, X, Y, focus_x_m=FOCUS) == pytest.approx(35.0, abs=1.0)


def test_a_window_without_places_is_refused():
    with pytest.raises(MeasurementError, match="needed: three or more"):
        mach_angle(cone(35.0), X, Y, focus_x_m=FOCUS, distances_m=(0.3, 0.4))
    with pytest.raises(MeasurementError, match="ridge or slant_stack"):
        mach_angle(cone(35.0), X, Y, focus_x_m=FOCUS, estimator="eye")


@pytest.mark.parametrize("threshold", [0.01, 0.1, 0.3])
def test_an_exponential_wake_ends_at_its_logarithm(threshold):
    trail = np.where(XX <= FOCUS + 1e-9, np.exp((XX - FOCUS) / 0.02), 0.0) * np.exp(-((YY / 0.01) ** 2))
    exact = 0.02 * np.log(1.0 / threshold)
    assert wake_length(-trail, X, Y, focus_x_m=FOCUS, threshold=threshold) == pytest.approx(exact, abs=1e-4)


def test_an_echo_counts_until_last_above_only_and_not_outside_the_window():
    trail = np.where(XX <= FOCUS + 1e-9, np.exp((XX - FOCUS) / 0.01), 0.0)
    echo = trail + 0.5 * np.exp(-(((XX + 0.08) / 0.003) ** 2 + ((YY - 0.06) / 0.01) ** 2))
    short = wake_length(trail, X, Y, focus_x_m=FOCUS)
    assert short == pytest.approx(0.01 * np.log(10.0), abs=1e-4)
    assert wake_length(echo, X, Y, focus_x_m=FOCUS) == pytest.approx(0.11 + 0.003 * np.sqrt(np.log(5.0)), abs=2e-4)
    assert wake_length(echo, X, Y, focus_x_m=FOCUS, until="first_below") == pytest.approx(short, abs=1e-9)
    assert wake_length(echo, X, Y, focus_x_m=FOCUS, lateral_m=0.04) == pytest.approx(short, abs=1e-9)


def test_area_of_a_triangular_wake():
    """|v| = 1 - b/L over |y| < b/2: at threshold h it ends at b = (1 - h) L, a triangle of area b^2/2."""
    behind = FOCUS - XX
    level = 1.0 - behind / 0.1
    triangle = np.where((behind >= 0.0) & (np.abs(YY) <= 0.5 * behind), level, -1.0 + 0.0 * XX)
    area = wake_area(np.maximum(triangle, 0.0), X, Y, threshold=0.3)
    assert area == pytest.approx(0.5 * 0.07**2, rel=0.05)


@pytest.mark.parametrize("turn_Hz", [70.0, -70.0])
def test_a_wave_that_turns_stands_in_the_turning_frame_and_another_vanishes(turn_Hz):
    t = np.arange(200) / (70.0 * 200)
    angles = 2.0 * np.pi * np.arange(24) / 24
    with_it = angles - 2.0 * np.pi * turn_Hz * t[:, None]
    against = angles + 2.0 * np.pi * turn_Hz * t[:, None]
    maps = np.stack([np.cos(3.0 * with_it + 0.4), np.cos(2.0 * against)], axis=1)
    out = np.linspace(-np.pi, np.pi, 17)
    found = co_rotating_average(t, maps, turn_Hz, out)
    assert found[0] == pytest.approx(np.cos(3.0 * out + 0.4), abs=1e-12)
    assert np.abs(found[1]).max() < 1e-12
    squares = co_rotating_average(t, maps, turn_Hz, out, square=True)
    assert squares[1] == pytest.approx(np.full(17, np.sqrt(0.5)), abs=1e-12)
    with pytest.raises(MeasurementError, match="is shorter than one turn"):
        co_rotating_average(t[:50], maps[:50], turn_Hz, out)


def test_velocities_that_are_no_numbers_have_no_wake():
    with pytest.raises(MeasurementError, match="the velocity at"):
        wake_along_path(1.0, [np.nan, 1.0], [0.0, 0.5], np.eye(2, dtype=bool))
