"""Pressures between points on curved surfaces, on lines and alone, against the pressure they were taken from."""

import numpy as np
import pytest

from palmfield.skin.fem.traction import between_points, spread_forces

RADIUS = 0.006
SPACING = 1e-3


def on_cylinder(step_m, length_m=0.02, shift=0.0):
    """Points of a grid, turned and moved by `shift` steps, with normals and areas."""
    count = round(2.0 * np.pi * RADIUS / step_m)
    angle = 2.0 * np.pi * (np.arange(count) + shift) / count
    along = np.arange(-0.5 * length_m, 0.5 * length_m + 1e-9, step_m) + shift * step_m
    x, a = (part.ravel() for part in np.meshgrid(along, angle, indexing="ij"))
    normals = np.column_stack([np.zeros_like(a), np.cos(a), np.sin(a)])
    points = np.column_stack([x, RADIUS * normals[:, 1:]])
    return points, normals, np.full(len(x), step_m * 2.0 * np.pi * RADIUS / count)


def smooth(points):
    return np.cos(2.0 * np.arctan2(points[:, 2], points[:, 1])) * np.exp(-((points[:, 0] / 0.006) ** 2))


def error(step_m):
    points, normals, areas = on_cylinder(step_m)
    places, facing, _ = on_cylinder(0.37e-3, 0.015, 0.3)
    shares = between_points(points, normals, areas, places, facing)
    assert np.asarray(shares.sum(axis=1)).ravel() == pytest.approx(1.0, abs=1e-12)
    return np.abs(shares @ smooth(points) - smooth(places)).max()


def test_a_smooth_pressure_on_a_body_comes_back():
    coarse, fine = error(1e-3), error(0.5e-3)
    # (k d)^2 / 8 of both directions, k = 2 / 6 mm and the Gaussian's sqrt(2) / 6 mm
    assert coarse < 0.025
    assert 3.0 < coarse / fine < 5.0


def test_a_pressure_that_is_linear_in_a_plane_is_kept_between_and_ends_half_a_spacing_outside():
    x = SPACING * np.arange(-5, 6)
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((11, 11))], axis=-1).reshape(-1, 3)
    up = np.tile([0.0, 0.0, 1.0], (121, 1))
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(-8e-3, 8e-3, (4000, 2)), np.zeros(4000)])
    shares = between_points(points, up, np.full(121, SPACING**2), places, np.tile([0.0, 0.0, 1.0], (4000, 1)))
    covered = np.asarray(shares.sum(axis=1)).ravel()
    far = np.abs(places[:, :2]).max(axis=1)
    assert covered[far < 5e-3] == pytest.approx(1.0)
    assert covered[far > 5.6e-3] == pytest.approx(0.0)
    inside = far < 5e-3
    wanted = 2.0 + 300.0 * points[:, 0] - 100.0 * points[:, 1]
    at = 2.0 + 300.0 * places[:, 0] - 100.0 * places[:, 1]
    assert (shares @ wanted)[inside] == pytest.approx(at[inside], rel=1e-9)


def flat_grid(half_m, step_m):
    x = np.arange(-half_m, half_m, step_m) + 0.5 * step_m
    places = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((len(x), len(x)))], axis=-1).reshape(-1, 3)
    return places, np.tile([0.0, 0.0, 1.0], (len(places), 1)), np.full(len(places), step_m**2)


def test_a_force_is_spread_over_a_disc_of_its_area_and_not_through_a_finger():
    points, up = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    places, facing, weights = flat_grid(2e-3, 4e-5)
    pressure = spread_forces(points, up, np.array([4e-6]), places, facing, weights).toarray()[:, 0]
    assert pressure @ weights == pytest.approx(4e-6)
    # the moment of a disc of 4 mm^2: area x radius^2 / 2
    assert (pressure * weights) @ (places**2).sum(axis=1) == pytest.approx(4e-6 * 4e-6 / np.pi / 2.0, rel=0.01)
    assert spread_forces(points, up, np.array([4e-6]), places, -facing, weights).sum() == 0.0


def test_forces_at_one_place_and_on_a_line_add_up():
    places, facing, weights = flat_grid(5e-3, 1e-4)
    points = np.array([[0.0, 0.0, 0.0], [1e-5, 0.0, 0.0], [2e-3, 0.0, 0.0], [3e-3, 0.0, 0.0]])
    areas = np.array([1e-6, 2e-6, 1e-6, 1e-6])
    shares = spread_forces(points, np.tile([0.0, 0.0, 1.0], (4, 1)), areas, places, facing, weights)
    assert shares.T @ weights == pytest.approx(areas, rel=1e-12)
