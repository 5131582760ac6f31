from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import combined, layout, placed
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.drive import shapes
from palmfield.drive.foci import solve_foci
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex, Float

UHEV1, AIR = layout("uhev1"), Air()
AHEAD = (0.0, 0.0, 0.2)
ASIDE = (0.05, -0.03, 0.16)


def field(points: Float, drive: Complex, array: Array = UHEV1) -> Complex:
    return pressure64(points, array, drive, AIR)[0]


def sharp(point: tuple[float, float, float]) -> float:
    """Peak pressure of the plain focus there."""
    return float(np.abs(field(np.array([point]), focus(UHEV1, AIR, point)))[0])


def round_board(rings: int = 8, pitch: float = 10.3e-3) -> Array:
    """6 j transducers on ring j: symmetric under turns by 60 degrees, unlike a square."""
    sites = [
        (j * pitch * np.cos(a), j * pitch * np.sin(a), 0.0)
        for j in range(1, rings + 1)
        for a in 2 * np.pi * np.arange(6 * j) / (6 * j)
    ]
    return Array("rings", np.array(sites), np.tile([0.0, 0.0, 1.0], (len(sites), 1)), 2.53)


@pytest.mark.parametrize(
    ("azimuth", "level", "u"), [(0.0, 0.7246, 2.331), (0.5 * np.pi, 0.7246, 2.331), (0.25 * np.pi, 2 / np.pi, np.pi)]
)
def test_twin_trap_is_silent_on_its_plane_and_loud_beside_it(azimuth: float, level: float, u: float) -> None:
    """Lobes of two halves in antiphase, from the paraxial aperture integral, relative to the plain focus.

    Halves of a square, edge on: (1 - cos u)/u; corner on: 2 (u - sin u)/u^2; u = k x a/z with a the half width.
    """
    drive = shapes.twin_trap(UHEV1, AIR, AHEAD, azimuth)
    diagonal = azimuth == 0.25 * np.pi
    assert np.count_nonzero(drive == 0) == (16 if diagonal else 0)  # those of a square's diagonal are on the line
    v, z = map(np.ravel, np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(0.05, 0.4, 15)))
    plane = np.column_stack([-v * np.sin(azimuth), v * np.cos(azimuth), z])
    assert np.abs(field(plane, drive)).max() < 1e-12 * sharp(AHEAD)
    side = np.linspace(-0.02, 0.02, 401)
    line = np.column_stack([side * np.cos(azimuth), side * np.sin(azimuth), np.full(401, 0.2)])
    lobes = field(line, drive)
    np.testing.assert_allclose(lobes, -lobes[::-1], atol=1e-12 * sharp(AHEAD))
    assert np.abs(lobes).max() == pytest.approx(level * sharp(AHEAD), rel=0.02)
    half_width = 8 * 10.3e-3 * (np.sqrt(2) if diagonal else 1.0)
    k = 2 * np.pi * UHEV1.frequency_Hz / sound_speed(AIR)
    corner = np.hypot(0.2, np.sqrt(2) * 8 * 10.3e-3)  # the rays' lengths, in place of the paraxial z
    nearest, farthest = u * 0.2 / (k * half_width), u * corner / (k * half_width)
    assert nearest < abs(side[np.abs(lobes).argmax()]) < farthest


def test_twin_trap_of_any_azimuth_has_its_lobes_there() -> None:
    array = round_board()
    ring = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    points = np.column_stack([8e-3 * np.cos(ring), 8e-3 * np.sin(ring), np.full(720, 0.2)])
    for azimuth in (0.3, 1.1, 2.5):
        loud = np.abs(field(points, shapes.twin_trap(array, AIR, AHEAD, azimuth), array))
        found = 0.5 * np.angle(np.sum(loud**2 * np.exp(2j * ring)))  # two lobes: the double angle has one direction
        assert abs((found - azimuth + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(2)


@pytest.mark.parametrize("order", [-3, -1, 1, 2, 3])
def test_vortex_winds_its_phase(order: int) -> None:
    array = round_board()
    drive = shapes.vortex(array, AIR, AHEAD, order)
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    for radius in (4e-3, 7e-3, 10e-3):
        ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(72, 0.2)])
        sound = field(ring, drive, array)
        winding = np.angle(np.roll(sound, -1) / sound).sum() / (2 * np.pi)
        assert winding == pytest.approx(order, abs=1e-9)
    core = field(np.array([AHEAD]), drive, array)
    assert abs(core[0]) < 1e-12 * sharp(AHEAD)


def test_core_of_a_vortex_grows_with_its_order() -> None:
    """Focused vortices of order l go as J_l: their rings lie at growing radii, in the order of the Bessel maxima."""
    array = round_board()
    radius = np.linspace(0, 0.03, 301)
    line = np.column_stack([radius, 0 * radius, np.full(301, 0.2)])
    rings = [
        radius[np.abs(field(line, shapes.vortex(array, AIR, AHEAD, order), array)).argmax()] for order in (1, 2, 3)
    ]
    assert rings[0] < rings[1] < rings[2]


def test_bottle_is_silent_within_and_loud_before_behind_and_round() -> None:
    for point, hole in ((AHEAD, 0.05), (ASIDE, 0.05)):
        drive = shapes.bottle(UHEV1, AIR, point)
        loud = sharp(point)
        target = np.array(point)
        assert abs(field(target[None], drive)[0]) < hole * loud
        centre_ray = target / np.linalg.norm(target)
        for direction in (centre_ray, -centre_ray, *np.eye(3)[:2], *-np.eye(3)[:2]):
            walk = target + np.linspace(0, 0.07, 141)[:, None] * direction
            assert np.abs(field(walk, drive)).max() > 0.2 * loud


def test_shapes_stay_silent_at_a_focus_to_the_side() -> None:
    """The beam there leans by 20 degrees, and parts round the board's normal are not balanced."""
    x, y, _ = UHEV1.positions.T
    plain = focus(UHEV1, AIR, ASIDE)
    target = np.array([ASIDE])
    for shape, naive in ((shapes.twin_trap, np.sign(x)), (shapes.vortex, np.exp(1j * np.arctan2(y, x)))):
        left = abs(field(target, shape(UHEV1, AIR, ASIDE))[0])
        assert left < 0.35 * abs(field(target, plain * naive)[0])
        assert left < 0.1 * sharp(ASIDE)


def test_plane_wave_before_a_wide_array() -> None:
    """Before an endless array of pitch b the wave has |p| = 2 pi p0 D/(k b^2 cos), and the phase k n.x.

    From the sum over a lattice of point sources (Poisson); its grating orders average to nothing over a cell. A finite
    board adds waves from its edges, which fall as the board grows.
    """
    pitch = 8e-3
    errors = []
    for sites in (24, 72):
        steps = (np.arange(sites) - 0.5 * (sites - 1)) * pitch
        x, y = map(np.ravel, np.meshgrid(steps, steps))
        normals = np.tile([0.0, 0.0, 1.0], (sites**2, 1))
        board = Array("wide", np.column_stack([x, y, 0 * x]), normals, 2.53, piston_radius_m=0.0)
        direction = np.array([np.sin(0.15), 0.0, np.cos(0.15)])
        drive = shapes.plane_wave(board, AIR, 3.0 * direction)
        cell = (np.arange(8) + 0.5) / 8 * pitch
        u, v, w = map(np.ravel, np.meshgrid(cell, cell, np.linspace(0.03, 0.04, 9)))
        points = np.column_stack([u, v, w])
        k = 2 * np.pi * board.frequency_Hz / sound_speed(AIR)
        sound = pressure64(points, board, drive, AIR, absorption_Np_m=0.0)[0]
        amplitude = np.mean(sound * np.exp(-1j * k * points @ direction))
        expected = 1j * 2 * np.pi * board.p0_Pa_m / (k * pitch**2 * np.cos(0.15))
        errors.append(abs(amplitude / expected - 1))
    assert errors[1] < 0.1
    assert errors[1] < 0.6 * errors[0]


def test_plane_wave_is_loudest_in_its_direction_far_away() -> None:
    direction = np.array([0.15, -0.1, 0.9])
    direction /= np.linalg.norm(direction)
    sideways = np.linspace(-0.1, 0.1, 41)
    u, v = map(np.ravel, np.meshgrid(direction[0] + sideways, direction[1] + sideways))
    rays = np.column_stack([u, v, np.sqrt(1 - u**2 - v**2)])
    sound = pressure64(30.0 * rays, UHEV1, shapes.plane_wave(UHEV1, AIR, direction), AIR, absorption_Np_m=0.0)[0]
    assert np.rad2deg(np.arccos(rays[np.abs(sound).argmax()] @ direction)) < 0.5  # a step is 0.3 degrees


@pytest.mark.parametrize(
    "turn",
    [("x", 90.0), ("x", -90.0), ("y", 90.0), ("y", -90.0), ("y", 180.0), ("x", 60.0), ("y", -120.0)],
    ids=lambda turn: f"{turn[0]} {turn[1]:g}",
)
def test_turned_arrays_shape_their_beams_the_same(turn: tuple[str, float]) -> None:
    """A board turned about its x or y, up to a right angle or half a turn, has the drives that it had."""
    matrix = Rotation.from_euler(*turn, degrees=True).as_matrix()
    shift = np.array([0.1, -0.2, 0.3])
    there = placed(UHEV1, shift, matrix)
    point = matrix @ ASIDE + shift
    for work in (
        lambda array, at: shapes.twin_trap(array, AIR, at, 0.3),
        lambda array, at: shapes.vortex(array, AIR, at, 2),
        lambda array, at: shapes.bottle(array, AIR, at),
    ):
        np.testing.assert_allclose(work(there, point), work(UHEV1, np.array(ASIDE)), atol=1e-6)


def test_an_array_turned_anyhow_has_its_vortex_round_the_beam() -> None:
    """The frame's x may stand anywhere round the beam: the drive then differs by one phase factor."""
    matrix = Rotation.from_euler("zyx", [40.0, 130.0, -70.0], degrees=True).as_matrix()
    there = shapes.vortex(placed(UHEV1, [0.0, 0.0, 0.0], matrix), AIR, matrix @ ASIDE)
    ratio = there / shapes.vortex(UHEV1, AIR, ASIDE)
    np.testing.assert_allclose(ratio, ratio[0], atol=1e-6)
    bottle = shapes.bottle(placed(UHEV1, [0.0, 0.0, 0.0], matrix), AIR, matrix @ ASIDE)
    np.testing.assert_allclose(bottle, shapes.bottle(UHEV1, AIR, ASIDE), atol=1e-6)


def test_messages_for_a_turned_array_say_what_was_given() -> None:
    """It looks along -z: z > 0 would be the wrong advice."""
    down = placed(UHEV1, [0.0, 0.0, 0.4], np.diag([1.0, -1.0, -1.0]))
    with pytest.raises(SceneError, match=r"\[0.0, 0.0, 0.6\] is behind .*-0\.2 m in front .*in front of the array"):
        focus(down, AIR, (0.0, 0.0, 0.6))
    with pytest.raises(SceneError, match=r"\[0.0, 0.0, 1.0\].*faces \[0.0, 0.0, -1.0\].*to the front of the array"):
        shapes.plane_wave(down, AIR, (0.0, 0.0, 1.0))
    with pytest.raises(SceneError, match=r"focus 1 at \[0.0, 0.0, 0.5\] is behind .*in front of the array"):
        solve_foci([(0.0, 0.0, 0.2), (0.0, 0.0, 0.5)], down, AIR)
    facing = combined([UHEV1, down])
    with pytest.raises(SceneError, match="not along the array's mean normal"):
        shapes.bottle(facing, AIR, (0.0, 0.0, 0.2))


def test_every_drive_is_of_phases_only() -> None:
    drives = [
        shapes.vortex(UHEV1, AIR, ASIDE, 2),
        shapes.bottle(UHEV1, AIR, ASIDE),
        shapes.plane_wave(UHEV1, AIR, (0.1, 0.0, 1.0)),
    ]
    for drive in drives:
        np.testing.assert_allclose(np.abs(drive), 1.0, rtol=1e-12)
    on = np.abs(shapes.twin_trap(UHEV1, AIR, AHEAD, 0.25 * np.pi))
    assert set(np.round(on, 12)) == {0.0, 1.0}


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda: shapes.twin_trap(UHEV1, AIR, (0, 0, -0.2)), "give a point in front of the array"),
        (lambda: shapes.twin_trap(UHEV1, AIR, AHEAD, np.nan), "azimuth_rad = nan"),
        (lambda: shapes.vortex(UHEV1, AIR, AHEAD, 1.5), "order = 1.5 is not a whole number"),
        (lambda: shapes.bottle(UHEV1, AIR, (0, np.inf, 0.2)), "not a finite position"),
        (lambda: shapes.plane_wave(UHEV1, AIR, (0, 0, 0)), "other than 0"),
        (lambda: shapes.plane_wave(UHEV1, AIR, (1, 0, -0.1)), "does not point out"),
    ],
)
def test_what_makes_no_sense_is_refused(work: Callable[[], Complex], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        work()
