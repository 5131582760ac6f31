"""Scans that were moved are found again on planes, cylinders and ellipsoids; what a shape doesn't tell is counted."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from palmfield.errors import MeasurementError
from palmfield.instruments.registration import by_fiducials, registration
from palmfield.transforms import Transform

MOVED = Transform(np.array([1e-3, -2e-3, 3e-3]), Rotation.from_euler("xyz", [3, -2, 4], degrees=True).as_matrix())


def ellipsoid():
    ball = trimesh.creation.icosphere(subdivisions=5)
    return ball.vertices * [0.06, 0.04, 0.03], ball.faces


def scan(vertices, count=200, seed=0):
    high = vertices[vertices[:, 2] > 0.008]
    return high[np.random.default_rng(seed).permutation(len(high))[:count]]


def test_a_scan_on_an_ellipsoid_is_found_in_all_six_directions():
    vertices, faces = ellipsoid()
    true = scan(vertices)
    found = registration(MOVED.inverse_points(true), vertices, faces)
    assert found.undetermined == 0 and found.rms_m < 2e-6
    assert np.abs(found.transform.points(MOVED.inverse_points(true)) - true).max() < 1e-4


def test_noise_stays_in_the_residual():
    vertices, faces = ellipsoid()
    true = scan(vertices, 400)
    noisy = MOVED.inverse_points(true + np.random.default_rng(1).normal(0.0, 2e-4, true.shape))
    found = registration(noisy, vertices, faces)
    assert found.rms_m == pytest.approx(2e-4, rel=0.15)


def plane():
    at = np.linspace(-0.06, 0.06, 13)
    x, y = (part.ravel() for part in np.meshgrid(at, at, indexing="ij"))
    n = np.arange(169).reshape(13, 13)
    a, b, c, d = n[:-1, :-1].ravel(), n[1:, :-1].ravel(), n[1:, 1:].ravel(), n[:-1, 1:].ravel()
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.column_stack([x, y, np.zeros(169)]), faces


def test_on_a_plane_three_directions_are_left_alone_and_fiducials_tell_them():
    vertices, faces = plane()
    true = 0.5 * vertices[::3]
    lifted = Transform(np.array([0.0, 0.0, 4e-3]), Rotation.from_euler("x", 2, degrees=True).as_matrix())
    found = registration(lifted.inverse_points(true), vertices, faces)
    assert found.undetermined == 3 and found.residual_m.max() < 1e-9
    assert np.abs(found.transform.points(lifted.inverse_points(true)) - true).max() < 5e-4
    pairs = MOVED.inverse_points(vertices[[0, 12, 168]]), vertices[[0, 12, 168]]
    told = registration(MOVED.inverse_points(true), vertices, faces, pairs=pairs)
    assert np.abs(told.transform.points(MOVED.inverse_points(true)) - true).max() < 1e-9
    assert told.fiducials_m.max() < 1e-9


def test_a_scan_may_stay_where_it_is():
    vertices, faces = plane()
    found = registration(0.5 * vertices + [0, 0, 1e-3], vertices, faces, surface=False)
    assert found.rms_m == pytest.approx(1e-3) and np.array_equal(found.transform.rotation, np.eye(3))


def test_fiducials_must_tell_a_place():
    line = np.array([[0.0, 0, 0], [1e-2, 0, 0], [2e-2, 0, 0]])
    with pytest.raises(MeasurementError, match="lie on one line"):
        by_fiducials(line, line)
    with pytest.raises(MeasurementError, match="three or more"):
        by_fiducials(line[:2], line[:2])
    with pytest.raises(MeasurementError, match="the fiducials at"):
        by_fiducials(np.full((3, 3), np.nan), np.eye(3))
