"""Points on the faces of pistons against the closed form on the axis and the far field."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.acoustics.arrays import from_poses, layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.errors import SceneError
from palmfield.types import Air
from palmfield_papers.piston_axis import on_axis
from palmfield_papers.piston_faces import as_faces


def test_faces_are_rayleighs_integral():
    """One speaker on its own axis has a closed form, 8 % below the far field at its Rayleigh length."""
    speaker = replace(from_poses("one", np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 1.0), piston_radius_m=6e-3)
    sources, emitted = as_faces(speaker, np.ones(1, complex))
    distance = np.array([0.010, 0.013, 0.030, 0.050])
    points = np.column_stack([np.zeros((4, 2)), distance])
    found, _ = pressure64(points, sources, emitted, Air(), absorption_Np_m=0.0)
    wavenumber = 2.0 * np.pi * 40e3 / 343.204
    assert np.abs(found) == pytest.approx(np.abs(on_axis(distance, 6e-3, wavenumber)), rel=2e-4)


def test_far_away_they_are_the_pistons():
    """With a gain, and tilted, so that the ring's directions count."""
    tilt = np.array([[0.6, 0.0, 0.8], [0.0, -0.6, 0.8]])
    two = from_poses("two", np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]), tilt, 1.0, piston_radius_m=5e-3)
    two = replace(two, gain=np.array([1.0, -0.5j]))
    points = 100.0 * np.array([[0.3, 0.1, 2.0], [-0.5, 0.2, 1.8]])
    drive = np.array([1.0, 0.7 + 0.2j])
    near, _ = pressure64(points, *as_faces(two, drive), Air(), absorption_Np_m=0.0)
    assert near == pytest.approx(pressure64(points, two, drive, Air(), absorption_Np_m=0.0)[0], rel=5e-4)


def test_an_array_without_pistons_is_refused():
    units = layout("autd2018")
    with pytest.raises(SceneError, match="directivity 'table'"):
        as_faces(units, focus(units, Air(), [0.0, 0.0, 0.2]))
