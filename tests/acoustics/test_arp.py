"""Radiation pressure against plane waves, momentum conservation and known overstatements."""

import numpy as np
import pytest

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import LAWS, alpha_law, arp
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Field

AIR = Air()
RHO, C = density(AIR), sound_speed(AIR)
FREQUENCY_HZ = 40e3
OMEGA = 2 * np.pi * FREQUENCY_HZ
K = OMEGA / C


def plane_wave(direction: np.ndarray, count: int = 7, amplitude: float = 100.0) -> Field:
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (count, 3))
    p = amplitude * np.exp(1j * K * points @ direction)
    return Field(p.astype(np.complex64), (1j * K * p[:, None] * direction).astype(np.complex64))


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 75.0])
def test_plane_wave_presses_2_E_cos_squared(degrees: float) -> None:
    t = np.radians(degrees)
    field = plane_wave(np.array([np.sin(t), 0.0, np.cos(t)]))
    energy = 100.0**2 / (2 * RHO * C**2)
    found = arp(field, np.tile([0.0, 0.0, -1.0], (7, 1)), AIR, FREQUENCY_HZ, device="cpu")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 2 * energy * np.cos(t) ** 2, rtol=1e-4)


def test_alpha_law_is_right_at_normal_incidence_only() -> None:
    energy = 100.0**2 / (2 * RHO * C**2)
    normals = np.tile([0.0, 0.0, -1.0], (7, 1))
    for degrees in (0.0, 45.0):
        t = np.radians(degrees)
        field = plane_wave(np.array([np.sin(t), 0.0, np.cos(t)]))
        found = arp(field, normals, AIR, FREQUENCY_HZ, law="alpha", device="cpu")
        np.testing.assert_allclose(found, 2 * energy, rtol=1e-4)


@pytest.mark.parametrize("alpha", [1.0, 1.4, 2.0])
def test_alpha_is_one_plus_the_share_of_the_energy_that_comes_back(alpha: float) -> None:
    """The momentum that a plane wave brings and that its echo takes away, over time: (1 + R) p_rms^2/(rho c^2)."""
    brought = (100.0**2 / 2.0) / (RHO * C**2)
    taken = (alpha - 1.0) * brought
    field = plane_wave(np.array([0.0, 0.0, 1.0]))
    found = arp(field, np.tile([0.0, 0.0, -1.0], (7, 1)), AIR, FREQUENCY_HZ, law=alpha_law(alpha), device="cpu")
    np.testing.assert_allclose(found, brought + taken, rtol=1e-4)


def test_alpha_of_two_is_the_law_by_its_name() -> None:
    assert alpha_law(2.0) is LAWS["alpha"]
    assert "1.4 p_rms^2" in alpha_law(1.4).about and "reflects 40 %" in alpha_law(1.4).about


@pytest.mark.parametrize("alpha", [0.99, 2.01, float("nan"), -1.0])
def test_alpha_outside_its_range_is_refused(alpha: float) -> None:
    with pytest.raises(SceneError, match=rf"alpha of the ARP law is {alpha:g}; allowed: 1 .* to 2"):
        alpha_law(alpha)


@pytest.mark.parametrize("law", LAWS)
def test_shadow_feels_nothing(law: str) -> None:
    field = plane_wave(np.array([0.0, 0.0, 1.0]))
    found = arp(field, np.tile([0.0, 0.6, 0.8], (7, 1)), AIR, FREQUENCY_HZ, law=law, device="cpu")
    assert np.all(found == 0.0)


def test_sound_along_the_surface_can_suck() -> None:
    """Two crossed waves whose pressures cancel on a line leave only tangential velocity there: -4 rho u^2 sin^2."""
    t = np.radians(50.0)
    left, right = np.array([-np.sin(t), 0.0, np.cos(t)]), np.array([np.sin(t), 0.0, np.cos(t)])
    # out of phase up to a little of one wave, so that some sound still flows in
    p = np.array([100.0, -99.0])
    field = Field(np.array([p.sum()], np.complex64), (1j * K * (p[0] * left + p[1] * right))[None].astype(np.complex64))
    found = arp(field, [[0.0, 0.0, -1.0]], AIR, FREQUENCY_HZ, device="cpu")
    expected = (p.sum() ** 2 - (199.0 * np.sin(t)) ** 2) / (RHO * C**2)
    assert found[0] == pytest.approx(expected, rel=1e-4)
    assert found[0] < 0


def quarter_plane(half_width_m: float, z: float, pitch_m: float = 4e-3) -> np.ndarray:
    """Points of one quadrant, spaced under half a wavelength, where a sum is a spectrally exact integral."""
    steps = np.arange(0.0, half_width_m, pitch_m) + pitch_m / 2
    x, y = np.meshgrid(steps, steps)
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])


def momentum_flux(field: Field) -> np.ndarray:
    """Time-averaged flux of z-momentum along z: <p2> + rho <u_z^2>, with <p2> = <p^2>/(2 rho c^2) - rho <u^2>/2."""
    assert field.gradient is not None
    u = field.gradient.astype(complex) / (1j * OMEGA * RHO)
    square = np.abs(field.pressure.astype(complex)) ** 2
    lagrangian = square / (4 * RHO * C**2) - RHO * (np.abs(u) ** 2).sum(axis=1) / 4
    return lagrangian + RHO * np.abs(u[:, 2]) ** 2 / 2


def test_force_on_a_large_plane_is_twice_the_incident_momentum_flux() -> None:
    array = layout("uhev1")
    evaluator = FieldEvaluator(array, AIR, "cpu", absorption_Np_m=0.0)
    drive = focus(array, AIR, (0.0, 0.0, 0.2))
    wall = quarter_plane(1.0, 0.2)
    normals = np.tile([0.0, 0.0, -1.0], (len(wall), 1))
    field = evaluator.pressure(wall, drive, gradient=True)
    force = arp(field, normals, AIR, FREQUENCY_HZ, device="cpu").sum(dtype=float)
    for z in (0.05, 0.1, 0.15):
        flux = momentum_flux(evaluator.pressure(quarter_plane(1.0, z), drive, gradient=True)).sum()
        assert force == pytest.approx(2 * flux, rel=2e-3)
    # the usual form breaks the same law by far: the grating lobes graze the wall
    overstated = arp(field, normals, AIR, FREQUENCY_HZ, law="alpha", device="cpu").sum(dtype=float)
    assert overstated > 1.5 * force


def test_alpha_law_overstates_the_focus() -> None:
    """On a disc of 100 mm radius, as large as a hand, true over alpha is 0.91 at 200 mm."""
    array = layout("uhev1")
    points = quarter_plane(0.1, 0.2, 1e-3)
    points = points[np.hypot(points[:, 0], points[:, 1]) < 0.1]
    normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    field = FieldEvaluator(array, AIR, "cpu").pressure(points, focus(array, AIR, (0.0, 0.0, 0.2)), gradient=True)
    laws = "default", "alpha"
    true, alpha = (arp(field, normals, AIR, FREQUENCY_HZ, law=law, device="cpu").sum(dtype=float) for law in laws)
    assert true / alpha == pytest.approx(0.91, rel=0.02)


def width(array_pitch_m: float, z: float) -> float:
    """Full width at half maximum of the ARP along x in the focal plane [m], with linear interpolation."""
    array = layout("uhev1")
    assert array.positions[1, 0] - array.positions[0, 0] == pytest.approx(array_pitch_m)
    x = np.linspace(0.0, 0.02, 801)
    points = np.column_stack([x, np.zeros_like(x), np.full_like(x, z)])
    field = FieldEvaluator(array, AIR, "cpu").pressure(points, focus(array, AIR, (0.0, 0.0, z)), gradient=True)
    p = arp(field, np.tile([0.0, 0.0, -1.0], (801, 1)), AIR, FREQUENCY_HZ, device="cpu")
    below = int(np.argmax(p < p[0] / 2))
    share = (p[below - 1] - p[0] / 2) / (p[below - 1] - p[below])
    return 2 * float(x[below - 1] + share * (x[1] - x[0]))


def test_focal_spot_is_as_wide_as_diffraction_by_the_aperture() -> None:
    """0.886 lambda z/L is the half-power width of a uniform aperture; directivity tapers it, so a bit wider."""
    found = width(10.3e-3, 0.2)
    uniform = 0.886 * (2 * np.pi / K) * 0.2 / (16 * 10.3e-3)
    assert uniform < found < 1.15 * uniform
    assert found == pytest.approx(10.3e-3, rel=0.06)


def test_what_cannot_be_used_is_refused() -> None:
    field = plane_wave(np.array([0.0, 0.0, 1.0]))
    up = np.tile([0.0, 0.0, 1.0], (7, 1))
    with pytest.raises(SceneError, match="default, alpha"):
        arp(field, up, AIR, FREQUENCY_HZ, law="beta", device="cpu")
    with pytest.raises(SceneError, match="frequency_Hz"):
        arp(field, up, AIR, 0.0, device="cpu")
    with pytest.raises(PalmfieldError, match="gradient=True"):
        arp(Field(field.pressure), up, AIR, FREQUENCY_HZ, device="cpu")
    with pytest.raises(PalmfieldError, match=r"\(7, 3\)"):
        arp(field, up[:6], AIR, FREQUENCY_HZ, device="cpu")
    for bad in (0.9, np.nan):
        normals = up.copy()
        normals[4, 2] = bad
        with pytest.raises(PalmfieldError, match=r"normals\[4\]"):
            arp(field, normals, AIR, FREQUENCY_HZ, device="cpu")
    holed = Field(np.where(np.arange(7) == 2, np.nan, field.pressure).astype(np.complex64), field.gradient)
    with pytest.raises(PalmfieldError, match=r"pressure\[2\]"):
        arp(holed, up, AIR, FREQUENCY_HZ, device="cpu")


def test_no_points_feel_nothing() -> None:
    empty = Field(np.zeros(0, np.complex64), np.zeros((0, 3), np.complex64))
    assert arp(empty, np.zeros((0, 3)), AIR, FREQUENCY_HZ, device="cpu").shape == (0,)
