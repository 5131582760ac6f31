"""Limits of the model, against the Rayleigh integral and published shock distances."""

from dataclasses import replace

import numpy as np
import pytest
from rayleigh import hemisphere, one_piston, piston
from scipy.spatial.transform import Rotation

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import layout, with_faults
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.validity import far_field_m, least_radius_m, warnings
from palmfield.errors import PalmfieldError
from palmfield.types import Air

AIR = Air()
K = 2 * np.pi * 40e3 / sound_speed(AIR)
FOCUS = np.array([0.0, 0.0, 0.2])


@pytest.mark.parametrize("kb", [1.0, 2.0, 3.0, 3.3])
@pytest.mark.parametrize("error", [0.1, 0.01, 1e-3])
def test_far_field_begins_where_the_rayleigh_integral_says(kb: float, error: float) -> None:
    one = one_piston(kb / K)
    distance = far_field_m(one, error)
    points = hemisphere(distance)
    ratio = pressure64(points, one, [1.0], AIR, absorption_Np_m=0.0)[0] / piston(points, kb / K, K, 1.0)
    assert 0.5 * error < np.abs(np.abs(ratio) - 1.0).max() < 1.01 * error
    assert np.abs(np.angle(ratio)).max() < 1.4 * kb**2 / (4.0 * K * distance)


def ball(radius: float, points: int = 400) -> np.ndarray:
    """Points evenly on a cap of 10 mm round the top of a ball at the origin."""
    rng = np.random.default_rng(1)
    flat = rng.uniform(-0.01, 0.01, (points, 2))
    return np.column_stack([flat, np.sqrt(radius**2 - (flat**2).sum(axis=1)) - radius])


@pytest.mark.parametrize("radius", [0.012, 0.03, 0.2])
def test_least_radius_of_a_ball_a_cylinder_and_a_plane(radius: float) -> None:
    points, turn = ball(radius + 0.01), Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    # A paraboloid through a cap of 6 mm bends less than a ball of 22 mm by some percent
    assert least_radius_m(points @ turn.T, turn @ [0.0, 0.0, 1e-3], 6e-3) == pytest.approx(radius + 0.01, rel=0.06)
    pipe = np.column_stack([points[:, 0], points[:, 1], np.sqrt((radius + 0.01) ** 2 - points[:, 0] ** 2)])
    assert least_radius_m(pipe, pipe[0], 6e-3) == pytest.approx(radius + 0.01, rel=0.06)
    plane = np.column_stack([points[:, :2], np.zeros(len(points))])
    assert least_radius_m(plane @ turn.T, np.zeros(3), 6e-3) > 1e3
    assert least_radius_m(points, np.array([0.0, 0.0, 0.05]), 6e-3) is None


def focused(p0_Pa_m: float, z: float = 0.2, name: str = "uhev1") -> list[str]:
    array = layout(name, p0_Pa_m)
    at = np.array([0.0, 0.0, z])
    return warnings(array, at, pressure64(at[None], array, focus(array, AIR, at), AIR)[0], AIR)


def test_a_quiet_far_focus_needs_no_warning() -> None:
    assert focused(0.2) == []


def test_warnings_come_with_loudness() -> None:
    assert focused(2.53) == []
    (shock,) = focused(3.4)
    assert shock.startswith("sigma is 1.38 along a beam") and "removes 9 % of the ARP" in shock
    shock, saturation = focused(4.386, name="autd3_2x2")
    assert "radiation pressure" in saturation and "saturate near 500 Pa" in saturation


def test_a_near_point_is_warned_of() -> None:
    array = layout("uhev1")
    points = np.array([[0.0, 0.0, 0.1], array.positions[5] + [0.0, 0.0, 0.02]])
    (near,) = warnings(array, points, np.ones(2), AIR)
    assert near.startswith("a point is 20.0 mm from a transducer; below 30 mm")
    assert warnings(replace(array, piston_radius_m=0.0), points, np.ones(2), AIR) == []


def test_pressure_that_the_array_cannot_give_is_implausible() -> None:
    array = layout("uhev1", 0.3)
    most = float((0.3 / np.linalg.norm(array.positions - FOCUS, axis=1)).sum())
    assert not any("exceeds the output" in line for line in warnings(array, FOCUS, most, AIR))
    assert any("exceeds the output" in line for line in warnings(array, FOCUS, 1.01 * most, AIR))
    halved = with_faults(array, dead=list(range(128)))
    assert any("exceeds the output" in line for line in warnings(halved, FOCUS, most, AIR))
    assert any("static pressure of the air" in line for line in warnings(array, FOCUS, 2e5j, AIR))


def test_bad_input() -> None:
    array = layout("uhev1")
    with pytest.raises(PalmfieldError, match=r"pressure has shape \(2,\)"):
        warnings(array, FOCUS, [1.0, 2.0], AIR)
    with pytest.raises(PalmfieldError, match=r"pressure\[0\] is not finite"):
        warnings(array, FOCUS, np.nan, AIR)
    with pytest.raises(PalmfieldError, match=r"error = 0\.5"):
        far_field_m(array, 0.5)
    assert warnings(array, np.zeros((0, 3)), [], AIR) == []
