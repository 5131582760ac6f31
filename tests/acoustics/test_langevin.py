"""Radiation stress on plane waves, walls and spheres, where momentum is known."""

import numpy as np
import pytest
from rigid_sphere import geodesic
from scattered_sound import scattered_field, wall_force

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.langevin import radiation_force, radiation_stress
from palmfield.acoustics.scattering import scatter
from palmfield.errors import PalmfieldError
from palmfield.hand.triangles import face_normals
from palmfield.types import Air, Field, Float

AIR = Air()
RHO, C = density(AIR), sound_speed(AIR)
FREQUENCY_HZ = 40e3
K = 2 * np.pi * FREQUENCY_HZ / C
PRESSURE_PA = 100.0
ENERGY = PRESSURE_PA**2 / (2 * RHO * C**2)


def wave(points: Float, direction: Float) -> Field:
    pressure = PRESSURE_PA * np.exp(1j * K * points @ direction)
    return Field(pressure.astype(np.complex64), (1j * K * pressure[:, None] * direction).astype(np.complex64))


def both(a: Field, b: Field) -> Field:
    assert a.gradient is not None
    assert b.gradient is not None
    return Field(a.pressure + b.pressure, a.gradient + b.gradient)


def test_plane_wave_carries_momentum_along_its_direction_only() -> None:
    direction = np.array([0.48, -0.6, 0.64])
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (9, 3))
    stress = radiation_stress(wave(points, direction), AIR, FREQUENCY_HZ)
    np.testing.assert_allclose(stress, ENERGY * np.tile(np.outer(direction, direction), (9, 1, 1)), atol=1e-5 * ENERGY)


def test_absorber_is_pushed_by_E() -> None:
    """All sound goes in through the front of a box and none comes out at its back: E times its face."""
    front = np.column_stack([np.random.default_rng(1).uniform(0, 0.01, (50, 2)), np.zeros(50)])
    lit = wave(front, np.array([0.0, 0.0, 1.0]))
    force = radiation_force(lit, np.tile([0.0, 0.0, -1.0], (50, 1)), np.full(50, 1e-4 / 50), AIR, FREQUENCY_HZ)
    np.testing.assert_allclose(force, [0.0, 0.0, 1e-4 * ENERGY], atol=1e-9 * ENERGY)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 80.0])
def test_tilted_rigid_wall_feels_2_E_cos_squared(degrees: float) -> None:
    """Incident wave and its mirror image, through a plane in front of the wall, whole periods of their pattern."""
    t = np.radians(degrees)
    period = 2 * np.pi / (K * max(np.sin(t), 0.1))
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16 * period, (np.arange(8) + 0.5) / 8 * 0.01)
    for distance in (0.0, 0.0013, 0.004):
        points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -distance)])
        total = both(
            wave(points, np.array([np.sin(t), 0, np.cos(t)])), wave(points, np.array([np.sin(t), 0, -np.cos(t)]))
        )
        normals, areas = np.tile([0.0, 0.0, -1.0], (x.size, 1)), np.full(x.size, 1.0 / x.size)
        force = radiation_force(total, normals, areas, AIR, FREQUENCY_HZ)
        assert force[2] == pytest.approx(2 * ENERGY * np.cos(t) ** 2, rel=1e-4, abs=1e-5 * ENERGY)


def test_standing_wave_presses_alike_everywhere() -> None:
    """Between walls the momentum flux of a standing wave is E of each of the two waves, at nodes and antinodes."""
    points = np.column_stack([np.zeros((40, 2)), np.linspace(0, 0.01, 40)])
    up = np.array([0.0, 0.0, 1.0])
    stress = radiation_stress(both(wave(points, up), wave(points, -up)), AIR, FREQUENCY_HZ)
    np.testing.assert_allclose(stress[:, 2, 2], 2 * ENERGY, rtol=1e-4)
    assert np.ptp(stress[:, 0, 0]) > 1.9 * ENERGY


@pytest.mark.parametrize(("ka", "known"), [(1.0, 0.4736), (3.0, 0.8261)])
def test_force_on_a_sphere_is_the_same_through_any_surface(ka: float, known: float) -> None:
    along = np.array([0.0, 0.0, 1.0])
    radius = ka / K
    body = scatter(*geodesic(radius, 6), lambda points: wave(points, along).pressure, K, device="cpu")
    own = wall_force(body, AIR)
    for factor, shift in ((2.5, 0.0), (6.0, 1.5)):
        vertices, faces = geodesic(factor * radius, round(4 + 2 * factor * ka))
        vertices = vertices + shift * radius * np.array([1.0, 0.5, -0.3])
        normals, areas = face_normals(vertices, faces)
        middle = vertices[faces].mean(axis=1)
        around = scattered_field(body, middle, gradient=True, device="cpu")
        far = radiation_force(both(wave(middle, along), around), normals, areas, AIR, FREQUENCY_HZ)
        assert far[2] / (np.pi * radius**2 * ENERGY) == pytest.approx(known, rel=0.015)
        assert far[2] == pytest.approx(own[2], rel=0.015)
        assert np.abs(far[:2]).max() < 0.01 * far[2]


def test_empty_surface_holds_no_force() -> None:
    """A wave that passes through leaves as much momentum as it brings."""
    vertices, faces = geodesic(0.01, 12)
    normals, areas = face_normals(vertices, faces)
    force = radiation_force(
        wave(vertices[faces].mean(axis=1), np.array([0.6, 0.0, 0.8])), normals, areas, AIR, FREQUENCY_HZ
    )
    assert np.abs(force).max() < 1e-5 * ENERGY * np.pi * 0.01**2


def test_default_law_on_a_lit_ball_gives_pi_a_squared_E() -> None:
    """Ray acoustics: all that meets a sphere is scattered evenly, whatever its size."""
    vertices, faces = geodesic(0.025, 40)
    normals, areas = face_normals(vertices, faces)
    field = wave(vertices[faces].mean(axis=1), np.array([0.0, 0.0, 1.0]))
    pressed = arp(field, normals, AIR, FREQUENCY_HZ, device="cpu")
    force = -(areas * pressed) @ normals
    np.testing.assert_allclose(force / (np.pi * 0.025**2 * ENERGY), [0.0, 0.0, 1.0], atol=0.01)


def test_what_cannot_be_used_is_refused() -> None:
    field = wave(np.zeros((3, 3)), np.array([0.0, 0.0, 1.0]))
    with pytest.raises(PalmfieldError, match="gradient=True"):
        radiation_stress(Field(field.pressure), AIR, FREQUENCY_HZ)
    with pytest.raises(PalmfieldError, match="frequency_Hz"):
        radiation_stress(field, AIR, -1.0)
    with pytest.raises(PalmfieldError, match=r"\(3, 3\)"):
        radiation_force(field, np.zeros((2, 3)), np.ones(3), AIR, FREQUENCY_HZ)
