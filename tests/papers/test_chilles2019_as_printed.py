"""What Chilles et al. 2019 print of the radiation pressure, against waves that are known exactly."""

import numpy as np
import pytest

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Field, Float
from palmfield_papers.chilles2019.as_printed import incident_lagrangian_as_printed

AIR = Air()
RHO, C = density(AIR), sound_speed(AIR)
HZ = 40e3
K = 2.0 * np.pi * HZ / C
POINTS: Float = np.random.default_rng(0).uniform(-0.05, 0.05, (7, 3)) * [1.0, 1.0, 0.0]
DOWN = np.tile([0.0, 0.0, -1.0], (7, 1))


def waves(*parts: tuple[float, float]) -> Field:
    """The sum of plane waves of 100 Pa, each by its directions along x and z, in double precision."""
    pressure, gradient = np.zeros(7, complex), np.zeros((7, 3), complex)
    for along, ahead in parts:
        direction = np.array([along, 0.0, ahead])
        p = 100.0 * np.exp(1j * K * POINTS @ direction)
        pressure += p
        gradient += 1j * K * p[:, None] * direction
    return Field(pressure, gradient)


@pytest.mark.parametrize("degrees", [0.0, 40.0])
def test_a_plane_wave_pushes_nothing_as_printed_and_twice_its_energy_corrected(degrees: float) -> None:
    t = np.radians(degrees)
    incident, energy = waves((np.sin(t), np.cos(t))), 100.0**2 / (2.0 * RHO * C**2)
    np.testing.assert_allclose(incident_lagrangian_as_printed(incident, AIR, HZ), 0.0, atol=1e-12 * energy)
    right = arp(incident, DOWN, AIR, HZ, device="cpu")
    np.testing.assert_allclose(right, 2.0 * energy * np.cos(t) ** 2, rtol=1e-4)


@pytest.mark.parametrize("degrees", [0.0, 40.0])
def test_of_the_total_field_on_a_rigid_wall_it_is_the_default_law_of_the_incident_one(degrees: float) -> None:
    """The wall is z = 0, where incident wave and echo have the same phase."""
    t = np.radians(degrees)
    total = waves((np.sin(t), np.cos(t)), (np.sin(t), -np.cos(t)))
    expected = arp(waves((np.sin(t), np.cos(t))), DOWN, AIR, HZ, device="cpu")
    np.testing.assert_allclose(incident_lagrangian_as_printed(total, AIR, HZ), expected, rtol=1e-4)


def test_at_a_focus_little_is_left_of_the_right_pressure() -> None:
    """Their array and depth: 256 pistons, 200 mm."""
    array = layout("uhev1")
    drive = focus(array, AIR, [0.0, 0.0, 0.2])
    pressure, gradient = pressure64([[0.0, 0.0, 0.2]], array, drive, AIR, gradient=True)
    field = Field(pressure, gradient)
    printed = incident_lagrangian_as_printed(field, AIR, HZ)[0]
    right = arp(field, DOWN[:1], AIR, HZ, device="cpu")[0]
    # Velocity and pressure of sound that comes in at angles t are as mean cos t: 1 - (mean cos t)^2 is left, over 4
    rays = np.array([0.0, 0.0, 0.2]) - array.positions
    ways = np.linalg.norm(rays, axis=1)
    alone = [abs(pressure64([[0.0, 0.0, 0.2]], array, drive * one, AIR)[0][0]) for one in np.eye(256)]
    mean = float(alone @ (rays[:, 2] / ways) / np.sum(alone))
    assert printed / right == pytest.approx((1.0 - mean**2) / 4.0, rel=5e-3)
    assert printed / right == pytest.approx(0.0231, abs=1e-4)


def test_a_field_that_cannot_be_is_refused() -> None:
    with pytest.raises(PalmfieldError, match="no gradient"):
        incident_lagrangian_as_printed(Field(np.ones(2, complex), None), AIR, HZ)
    broken = Field(np.array([1.0, np.nan], complex), np.zeros((2, 3), complex))
    with pytest.raises(PalmfieldError, match=r"pressure\[1\] is not finite"):
        incident_lagrangian_as_printed(broken, AIR, HZ)
