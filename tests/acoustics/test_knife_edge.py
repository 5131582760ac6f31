"""Weights of shadows against Fresnel's half plane, Kirchhoff's screen by area in float64, and themselves in motion."""

import numpy as np
import pytest
import trimesh
from rigid_sphere import geodesic
from scipy.special import fresnel

from palmfield.acoustics.knife_edge import Emitters, KnifeEdges, shadow_nodes
from palmfield.acoustics.occlusion import Occlusion
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.surface_arp import SurfaceArp, rows_of
from palmfield.config import ArrayConfig
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Complex, Float, Int

FOCUS = np.array([0.0, 0.0, 0.2])
SCREEN_m = 0.1


class Behind:
    """Transducers of one board, and points looking at it with something that is moved in the way."""

    def __init__(self, points: Float, vertices: Float, faces: Int, **keys: object):
        place = Placement.of(IDENTITY)
        self.arrays = PhasedArray([ArrayInstance(ArrayConfig(layout="uhev1", **keys), place)], [place], "cpu")
        self.points, self.normals = points, np.tile([0.0, 0.0, -1.0], (len(points), 1))
        self.vertices, self.occlusion = vertices, Occlusion(vertices, faces, "cpu")
        self.rows = rows_of(self.arrays.field)
        emitters = Emitters(self.arrays, self.rows, "cpu")
        self.wavelength_m = emitters.wavelength_m
        self.nodes = shadow_nodes(points, self.normals, 0.008)
        self.edges = KnifeEdges(self.occlusion.outline, emitters, self.nodes, len(points))
        self.sound = SurfaceArp(self.arrays.field, len(points))
        away = np.linalg.norm(self.arrays.array.positions - FOCUS, axis=1)
        self.drive = np.exp(-2j * np.pi * away / self.wavelength_m)

    def there(self, x: float) -> bool:
        """Whether anything is in the way when the body is moved by x [m]."""
        self.occlusion.move(self.vertices + np.array([x, 0.0, 0.0]))
        return self.edges.evaluate(self.points[self.nodes.numbers], self.normals[self.nodes.numbers])

    def weights(self, x: float) -> Complex:
        """Of all transducers at all points, shape (n, N)."""
        if not self.there(x):
            return np.ones((len(self.points), len(self.arrays)), complex)
        both = self.edges.shades.real.numpy() + 1j * self.edges.shades.imag.numpy()
        return both.transpose(0, 2, 1).reshape(-1, both.shape[1])[: len(self.points)][:, self.rows]

    def square(self, x: float) -> Float:
        """|p|^2 at all points, shape (n,)."""
        shades = self.edges.shades if self.there(x) else None
        return self.sound.evaluate(self.points, self.normals, self.drive, shades=shades).amplitude.astype(float) ** 2


def plate(width_m: float, middle_m: float) -> tuple[Float, Int]:
    """A thin opaque plate, long in y."""
    box = trimesh.creation.box((width_m, 0.6, 2e-4))
    return np.array(box.vertices) + np.array([middle_m, 0.0, SCREEN_m]), np.array(box.faces, np.int32)


def test_a_half_plane_leaves_fresnels_integral() -> None:
    """By the shortest way over the edge, exact for a spherical wave in the paraxial limit; |v| < 1.8: nothing fades."""
    behind = Behind(FOCUS[None], *plate(0.4, 0.2))
    positions = behind.arrays.array.positions
    for x in (-0.02, 0.0, 0.013):
        along = np.linspace(-0.15, 0.15, 30001)
        edge = np.column_stack([np.full_like(along, x), along, np.full_like(along, SCREEN_m)])
        v = np.empty(len(positions))
        for e, place in enumerate(positions):
            ways = np.linalg.norm(edge - FOCUS, axis=1) + np.linalg.norm(edge - place, axis=1)
            detour = ways.min() - np.linalg.norm(FOCUS - place)
            v[e] = np.sign(x - 0.5 * place[0]) * np.sqrt(4.0 * max(detour, 0.0) / behind.wavelength_m)
        sine, cosine = fresnel(v)
        expected = 0.5 * (1.0 - 1j) * (0.5 + cosine + 1j * (0.5 + sine))
        near = np.abs(v) < 1.8
        assert near.sum() > 100
        assert np.abs(behind.weights(x)[0] - expected)[near].max() < 0.02


def screen_integral(behind: Behind, low_m: float, high_m: float) -> Complex:
    """Kirchhoff's integral over an opaque strip, area element by area element: what is left, shape (n, N)."""
    k, cell = 2.0 * np.pi / behind.wavelength_m, 5e-4
    x = np.arange(low_m + 0.5 * cell, high_m, cell)
    y = np.arange(-0.09 + 0.5 * cell, 0.09, cell)
    # Its ends in y fade, as it has none
    fade = np.where(np.abs(y) > 0.06, np.cos(0.5 * np.pi * (np.abs(y) - 0.06) / 0.03) ** 2, 1.0)
    cells = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), SCREEN_m)], axis=-1).reshape(-1, 3)
    area = cell**2 * np.tile(fade, len(x))
    places = behind.arrays.array.positions
    onward = np.linalg.norm(cells[:, None] - behind.points, axis=2)
    away = np.linalg.norm(cells[:, None] - places, axis=2).T
    there, arrives = np.exp(1j * k * onward) / onward, area * np.exp(1j * k * away) / away
    rising = there * (behind.points[:, 2] - SCREEN_m) / onward
    taken = 0.5 * ((arrives * SCREEN_m / away) @ there + arrives @ rising).T
    whole = np.linalg.norm(behind.points[:, None] - places, axis=2)
    return 1.0 - k / (2j * np.pi) * taken * whole * np.exp(-1j * k * whole)


@pytest.fixture(scope="module")
def strip() -> Behind:
    points = np.column_stack([np.linspace(-0.012, 0.012, 9), np.zeros(9), np.full(9, FOCUS[2])])
    return Behind(points, *plate(0.016, 0.0))


def test_the_sound_behind_a_strip_is_that_of_a_screen(strip: Behind) -> None:
    arrays = strip.arrays
    free, _ = pressure64(strip.points, arrays.array, strip.drive, arrays.air)
    peak = (np.abs(free) ** 2).max()
    dark = []
    for x in (0.0, 0.009, 0.018):
        left = screen_integral(strip, x - 0.008, x + 0.008)
        true = [
            abs(pressure64(point[None], arrays.array, strip.drive * rest, arrays.air)[0][0]) ** 2
            for point, rest in zip(strip.points, left, strict=True)
        ]
        got = strip.square(x)
        dark.append(true[4] / peak)
        assert np.abs(got - true).max() < 0.05 * peak
    assert max(dark) < 0.8


def test_no_jump_while_an_edge_moves(strip: Behind) -> None:
    behind = Behind(strip.points, *plate(0.4, 0.2))
    peak = behind.square(1.0).max()
    squares = np.array([behind.square(x) for x in np.arange(-0.03, 0.03, 1e-4)])
    assert np.abs(np.diff(squares, axis=0)).max() < 0.02 * peak
    assert np.ptp(squares[:, 4]) > 0.5 * peak


def test_gradient_is_weighted_as_the_pressure_is() -> None:
    """A weight that is alike for all transducers scales ARP by its square: far in the dark all of them are 0."""
    behind = Behind(FOCUS[None], *plate(0.4, 0.0))
    free = behind.sound.evaluate(behind.points, behind.normals, behind.drive).arp.copy()
    behind.there(0.0)
    dark = behind.sound.evaluate(behind.points, behind.normals, behind.drive, shades=behind.edges.shades).arp
    assert free[0] > 10.0 and abs(dark[0]) < 1e-3 * free[0]
    behind.edges.shades.real.fill_(0.6)
    behind.edges.shades.imag.fill_(0.3)
    scaled = behind.sound.evaluate(behind.points, behind.normals, behind.drive, shades=behind.edges.shades).arp
    np.testing.assert_allclose(scaled, (0.36 + 0.09) * free, rtol=1e-5)


def test_nothing_in_the_way_costs_no_weights() -> None:
    vertices, faces = geodesic(0.01, 12)
    behind = Behind(FOCUS[None], vertices + np.array([0.0, 0.0, SCREEN_m]), faces)
    assert behind.there(0.0)
    assert not behind.there(0.15)
    # Behind the board, and behind the skin
    behind.vertices = vertices + np.array([0.0, 0.0, -0.05])
    assert not behind.there(0.0)
    behind.vertices = vertices + np.array([0.0, 0.0, 0.25])
    assert not behind.there(0.0)


def test_layers_count_once() -> None:
    """One plate behind another, whose edges are well inside the first one's, takes nothing more."""
    vertices, faces = plate(0.06, 0.03)
    hidden = 0.6 * (vertices - vertices.mean(axis=0)) + vertices.mean(axis=0) - np.array([0.0, 0.0, 0.01])
    both = np.concatenate([vertices, hidden]), np.concatenate([faces, faces + len(vertices)])
    points = np.array([FOCUS])
    one, two = Behind(points, vertices, faces), Behind(points, *both)
    peak = one.square(1.0)[0]
    for x in (0.0, -0.01, -0.03):
        assert abs(one.square(x)[0] - two.square(x)[0]) < 0.02 * peak
    assert one.square(-0.03)[0] < 0.5 * peak


def test_points_among_nodes_take_what_is_computed_at_each(strip: Behind) -> None:
    grid = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, 15), np.linspace(-0.02, 0.02, 15)), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.full(len(grid), FOCUS[2])])
    behind = Behind(points, *plate(0.016, 0.0))
    assert len(behind.nodes.numbers) < len(points) // 2
    spread = behind.weights(0.005)
    some = [0, 40, 112, 118, 200]
    for i in some:
        alone = Behind(points[[i]], *plate(0.016, 0.0))
        assert np.abs(spread[i] - alone.weights(0.005)[0]).max() < 0.12
        assert abs(np.vdot(behind.drive, spread[i] - alone.weights(0.005)[0])) < 0.03 * len(behind.drive)
