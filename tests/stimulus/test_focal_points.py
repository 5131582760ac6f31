"""From the stimulus's points to places."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from palmfield.stimulus.curves import circle
from palmfield.stimulus.focal_points import FocalPoints, SurfaceCourse
from palmfield.stimulus.surface_path import drawn
from palmfield.transforms import IDENTITY, Transform
from palmfield.types import Surface

QUATERNIONS = st.tuples(*[st.floats(0.1, 1.0)] * 4).map(lambda q: np.array(q) / np.linalg.norm(q))
POINTS = st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array)


def flat():
    side = np.linspace(-0.05, 0.05, 6)
    x, y = np.meshgrid(side, side)
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(36)])
    corner = np.array([6 * i + j for i in range(5) for j in range(5)])
    faces = np.concatenate([
        np.stack([corner, corner + 1, corner + 7], axis=1), np.stack([corner, corner + 7, corner + 6], axis=1)
    ]).astype(np.int32)  # fmt: skip
    return Surface(vertices, faces, np.tile([0.0, 0.0, 1.0], (36, 1)))


@given(quaternion=QUATERNIONS, position=POINTS, point=POINTS)
def test_points_of_a_frame(quaternion, position, point):
    frame = Transform(position, Rotation.from_quat(quaternion, scalar_first=True).as_matrix())
    offsets = np.array([[0.01, 0.0, 0.0], [0.0, -0.02, 0.0]])
    single, several = FocalPoints(frame), FocalPoints(frame, offsets)
    expected = position + Rotation.from_quat(quaternion, scalar_first=True).as_matrix() @ point
    np.testing.assert_allclose(single.at(point), expected, atol=1e-14)
    np.testing.assert_allclose(single.along(np.array([point, 2 * point]))[0], expected, atol=1e-14)
    # Several go with the frame's axes, and `along` tells their middle
    assert several.at(point).shape == (2, 3)
    np.testing.assert_allclose(several.at(point) - expected, offsets @ frame.rotation.T, atol=1e-14)
    np.testing.assert_allclose(several.along(point[None])[0], expected, atol=1e-14)


@given(quaternion=QUATERNIONS, position=POINTS)
@settings(deadline=None)
def test_a_path_on_a_surface_goes_with_the_body_and_its_shape(quaternion, position):
    surface = flat()
    path = drawn(surface, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], circle(0.03))
    body = Transform(position, Rotation.from_quat(quaternion, scalar_first=True).as_matrix())
    arcs = np.zeros((5, 3))
    arcs[:, 0] = np.linspace(0.0, 0.9 * path.length_m, 5)
    raised = surface.vertices + np.array([0.0, 0.0, 0.01])
    here = FocalPoints(IDENTITY, on_surface=SurfaceCourse(path, raised, surface.faces, body)).along(arcs)
    local = body.inverse_points(here)
    np.testing.assert_allclose(local[:, 2], 0.01, atol=1e-12)
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), 0.015, atol=1e-5)
    at, _ = path.at(arcs[:, 0], raised, surface.faces)
    np.testing.assert_allclose(local, at, atol=1e-12)
