"""The kernel against things known without it: a sphere's outline, a wall's half sky, a shadow's edge."""

import numpy as np
import pytest
import trimesh
import warp as wp

from palmfield.device import resolve
from warp_kernels import raycast

DEVICE = resolve("cpu")
BACKDROP_AT_LEAST = 0.7


@wp.kernel
def _open_sky(mesh: wp.uint64, points: wp.array[wp.vec3], normal: wp.vec3, rays: int, share: wp.array[float]):
    i = wp.tid()
    share[i] = raycast.openness(mesh, points[i], normal, 1.0e6, rays, 0, 1, i)


def _mesh(shape):
    corners = wp.array(shape.faces.ravel(), dtype=wp.int32, device=DEVICE)
    return wp.Mesh(points=wp.array(shape.vertices, dtype=wp.vec3, device=DEVICE), indices=corners), corners


def _image(shape, eye, size, level=-1.0, key=(0.0, 0.0, 1.0), sky_share=-1.0):
    """Look along -z from `eye`, 90 degrees wide; grey 0.5 unless `level` picks the colour map (red to blue)."""
    mesh, corners = _mesh(shape)
    count = len(shape.vertices)
    lut = np.column_stack([np.linspace(1, 0, 256), np.zeros(256), np.linspace(0, 1, 256)])
    image = wp.zeros(size * size, dtype=wp.vec3, device=DEVICE)
    wp.launch(
        raycast.render,
        dim=size * size,
        inputs=[
            mesh.id,
            mesh.id,
            corners,
            wp.array(shape.vertex_normals, dtype=wp.vec3, device=DEVICE),
            wp.array(np.full((count, 3), 0.5), dtype=wp.vec3, device=DEVICE),
            wp.array(np.broadcast_to(level, count), dtype=float, device=DEVICE),
            wp.zeros(count, dtype=float, device=DEVICE),
            wp.array(np.ones(len(shape.faces)), dtype=float, device=DEVICE),
            wp.array(np.broadcast_to(sky_share, count), dtype=float, device=DEVICE),
            wp.array(lut, dtype=wp.vec3, device=DEVICE),
            wp.vec3(*eye),
            wp.vec3(-1.0, 1.0, -1.0),
            wp.vec3(2.0 / size, 0.0, 0.0),
            wp.vec3(0.0, -2.0 / size, 0.0),
            wp.vec3(*key),
            wp.vec3(0.0, 0.0, 1.0),
            wp.vec3(0.0, 0.0, 1.0),
            0.01,
            size,
            size,
            1,
            4,
            wp.array(np.arange(size * size), dtype=wp.int32, device=DEVICE),
        ],
        outputs=[image],
        device=DEVICE,
    )
    return image.numpy().reshape(size, size, 3)


def _directions(size):
    across = (np.arange(size) + 0.5) * 2.0 / size - 1.0
    return np.meshgrid(across, -across)


def test_a_sphere_s_outline():
    size, away = 200, 2.0
    image = _image(trimesh.creation.icosphere(subdivisions=5), (0, 0, away), size)
    x, y = _directions(size)
    # A ray (x, y, -1) from (0, 0, a) meets the unit sphere where x^2 + y^2 < 1 / (a^2 - 1).
    expected = x**2 + y**2 < 1.0 / (away**2 - 1.0)
    hit = image[:, :, 2] < BACKDROP_AT_LEAST
    # Facets lie up to 5e-4 inside the sphere, so pixels may differ in a rim of that width only.
    assert (hit != expected).sum() <= 4
    assert 20_000 > expected.sum() > 8_000


@pytest.mark.parametrize("level", [0.0, 0.3, 1.0])
def test_the_colour_map_is_looked_up_at_the_hit(level):
    image = _image(trimesh.creation.box([8, 8, 1]), (0, 0, 2), 20, level)
    red, green, blue = image[10, 10]
    assert green == 0.0
    assert blue / (red + blue) == pytest.approx(level, abs=1 / 255)


def test_levels_are_interpolated_between_vertices():
    """On a square whose level grows along x from 0 to 1, a pixel's colour is its own x."""
    square = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    image = _image(square, (0, 0, 1), 50, np.array([0.0, 1.0, 1.0, 0.0]))
    x, _ = _directions(50)
    np.testing.assert_allclose(image[:, :, 2] / image.sum(axis=2), 0.5 * (x + 1.0), atol=1 / 255)


@pytest.mark.parametrize("elevation_deg", [30.0, 45.0, 89.99])
def test_a_wall_hides_its_share_of_the_sky(elevation_deg):
    """A wall of endless length, whose top is seen at elevation t, hides (1 - cos t) / 2 of a cosine-weighted sky."""
    wall = trimesh.creation.box([0.2, 2e5, 1.0])
    wall.apply_translation([-0.1, 0.0, 0.5])
    mesh, _ = _mesh(wall)
    rays = 20_000
    elevation = np.radians(elevation_deg)
    points = wp.array([[1.0 / np.tan(elevation), 0, 0]], dtype=wp.vec3, device=DEVICE)
    share = wp.zeros(1, dtype=float, device=DEVICE)
    wp.launch(_open_sky, dim=1, inputs=[mesh.id, points, wp.vec3(0, 0, 1), rays], outputs=[share], device=DEVICE)
    # Four standard deviations of the mean of so many yes-or-no rays, at most.
    assert share.numpy()[0] == pytest.approx(0.5 * (1.0 + np.cos(elevation)), abs=4 * 0.5 / np.sqrt(rays))


def test_a_shadow_ends_where_the_light_passes_the_edge():
    """A plate 1 m above the floor over x < 0, lit at 45 degrees from -x: its shadow reaches to x = 1."""
    floor = trimesh.creation.box([40, 40, 0.1])
    floor.apply_translation([0, 0, -0.05])
    plate = trimesh.creation.box([4, 40, 0.01])
    plate.apply_translation([-2, 0, 1.0])
    size = 400
    light = (-np.sqrt(0.5), 0.0, np.sqrt(0.5))
    image = _image(trimesh.util.concatenate([floor, plate]), (1.5, 0, 4.0), size, key=light)
    row = image[size // 2, :, 0]
    x = 1.5 + 4.0 * _directions(size)[0][0]
    # Seen from there the plate covers the floor up to x = -0.5.
    edge = x[:-1][(row[:-1] < 0.7 * row[1:]) & (x[:-1] > 0.0)]
    assert edge == pytest.approx([1.0], abs=2 * 8.0 / size)


def test_the_share_of_sky_at_vertices_replaces_rays():
    """Light that is half ambient grows with the share of sky of the vertices, which is interpolated between them."""
    square = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    open_here = np.array([0.0, 1.0, 1.0, 0.0])
    image = _image(square, (0, 0, 1), 50, key=(0.0, 0.0, -1.0), sky_share=open_here)[:, :, 0]
    x, _ = _directions(50)
    share = 0.5 * (x + 1.0)
    # Of paint 0.5: ambient light (0.27 + 0.11) by the share, and soft light 0.2 by 0.4 + 0.6 of it
    np.testing.assert_allclose(image, 0.5 * (0.38 * share + 0.2 * (0.4 + 0.6 * share)), rtol=1e-4)
    rays = _image(square, (0, 0, 1), 50, key=(0.0, 0.0, -1.0))[:, :, 0]
    np.testing.assert_allclose(rays, 0.5 * (0.38 + 0.2), rtol=1e-4)


def test_vertices_in_a_corner_see_less_sky():
    """At the foot of an endless wall half of the sky is free, and all of it far away from a wall of 1 m."""
    wall = trimesh.creation.box([0.2, 2e5, 1e5])
    wall.apply_translation([-0.1, 0.0, 5e4])
    mesh, _ = _mesh(wall)
    points = wp.array([[1e-3, 0, 0], [0.5, 0, 0], [2.0, 0, 0]], dtype=wp.vec3, device=DEVICE)
    normals = wp.array([[0, 0, 1]] * 3, dtype=wp.vec3, device=DEVICE)
    share = wp.full(3, -1.0, dtype=float, device=DEVICE)
    some = wp.array([0, 2], dtype=wp.int32, device=DEVICE)
    wp.launch(
        raycast.open_sky, dim=2, inputs=[mesh.id, points, normals, 1.0, 4096, some], outputs=[share], device=DEVICE
    )
    np.testing.assert_allclose(share.numpy(), [0.5, -1.0, 1.0], atol=0.02)
