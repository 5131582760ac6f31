"""Places on a mesh, and the skin of a result between its vertices."""

import numpy as np
import pytest
import xarray as xr

from palmfield.errors import MeasurementError
from palmfield.instruments import of_skin
from palmfield.instruments.surface_motion import on_mesh


def skin(times=8):
    """A tilted plane of triangles whose motion is linear in the place."""
    at = np.linspace(-0.02, 0.02, 9)
    x, y = (part.ravel() for part in np.meshgrid(at, at, indexing="ij"))
    number = np.arange(81).reshape(9, 9)
    a, b, c, d = number[:-1, :-1].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    vertices = np.column_stack([x, y, 0.1 + 0.5 * x])
    t = np.arange(times) * 1e-3
    field = np.stack([x, 2.0 * y, x + y], axis=-1)[None] * np.cos(t)[:, None, None]
    normal = np.tile(np.array([-0.5, 0.0, 1.0]) / np.hypot(1.0, 0.5), (81, 1))
    return xr.Dataset(
        {
            "rest_position": (("vertex", "xyz"), vertices), "rest_normal": (("vertex", "xyz"), normal),
            "face": (("triangle", "corner"), np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])),
            "displacement": (("time", "vertex", "xyz"), field.astype("f4")),
            "velocity": (("time", "vertex", "xyz"), 2.0 * field.astype("f4")),
        },
        {"time": t},
    )  # fmt: skip


def test_linear_motion_is_exact_between_vertices():
    places = np.random.default_rng(0).uniform(-0.019, 0.019, (40, 2))
    lifted = np.column_stack([places, 0.1 + 0.5 * places[:, 0]])
    motion = of_skin(skin(), lifted)
    x, y = places.T
    exact = np.stack([x, 2.0 * y, x + y], axis=-1)
    assert motion.displacement_m[0] == pytest.approx(exact, abs=1e-8)
    assert motion.velocity_m_s[3] == pytest.approx(2.0 * exact * np.cos(3e-3), abs=1e-8)
    assert motion.points == pytest.approx(lifted, abs=1e-12) and motion.normals[0] @ [0.5, 0, -1] < 0
    whole = of_skin(skin())
    assert whole.displacement_m.shape == (8, 81, 3)


def test_distances_to_a_mesh():
    data = skin()
    normal = data["rest_normal"].values[0]
    found = on_mesh(data["rest_position"].values, data["face"].values, [[0.0, 0.0, 0.1] + 3e-3 * normal])
    assert found.distance_m[0] == pytest.approx(3e-3) and found.nearest[0] == pytest.approx([0.0, 0.0, 0.1], abs=1e-12)
    assert found.shares.sum() == pytest.approx(1.0)


def test_a_place_off_the_skin_is_named():
    with pytest.raises(MeasurementError, match=r"point 1 at \(0, 0, 0.2\) m is 0.0922 m from the skin"):
        of_skin(skin(), [[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]])
    with pytest.raises(MeasurementError, match="holds 2 times"):
        of_skin(skin(2))
    with pytest.raises(MeasurementError, match="places have shape"):
        of_skin(skin(), [[0.0, 0.1]])
