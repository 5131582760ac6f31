import math
import re

import numpy as np
import pytest
import trimesh
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import unique_edges, vertex_normals
from palmfield.stimulus.curves import circle, letters, line, polyline, square, z_shape
from palmfield.stimulus.surface_path import drawn, through, zigzag_through
from palmfield.types import Surface

pytestmark = pytest.mark.numerics

RADIUS_m = 0.05
X = [1.0, 0.0, 0.0]


def surface_of(vertices, faces):
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def sphere(subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions, RADIUS_m)
    return surface_of(mesh.vertices, mesh.faces)


def on_sphere(latitude, longitude):
    a, b = math.radians(latitude), math.radians(longitude)
    return RADIUS_m * np.array([math.cos(a) * math.cos(b), math.cos(a) * math.sin(b), math.sin(a)])


def plate():
    """A flat square of 100 mm in z = 0 that looks along +z, of irregular triangles."""
    points = np.random.default_rng(3).uniform(-0.05, 0.05, (600, 2))
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * 0.05
    points = np.vstack([points, corners])
    faces = Delaunay(points).simplices
    u, v = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    turned = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0
    faces[turned] = faces[turned][:, ::-1]
    return surface_of(np.column_stack([points, np.zeros(len(points))]), faces)


def tube(sides=64, rings=21, height=0.1):
    """An open cylinder of radius 50 mm round z, and the radius of the circle that its sides' length makes."""
    angle = 2 * math.pi * np.arange(sides) / sides
    z = np.linspace(-0.5 * height, 0.5 * height, rings)
    ring = RADIUS_m * np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = np.array([[*point, level] for level in z for point in ring])
    faces = []
    for r in range(rings - 1):
        for s in range(sides):
            a, b = r * sides + s, r * sides + (s + 1) % sides
            faces += [[a, b, b + sides], [a, b + sides, a + sides]]
    around = 2 * sides * math.sin(math.pi / sides) * RADIUS_m
    return surface_of(vertices, faces), around / (2 * math.pi)


@pytest.fixture(scope="module")
def hand():
    return hand_surface(load_preset("open_men_p50"))


def lies_on_its_triangles(path, surface):
    """Both ends of each piece lie in the piece's triangle, and the pieces' lengths are the arc's."""
    points = np.einsum("ni,nij->nj", path.barycentric, surface.vertices[surface.faces[path.faces]])
    assert path.barycentric.min() > -1e-9
    assert np.allclose(path.barycentric.sum(axis=1), 1.0, atol=1e-12)
    corners = surface.vertices[surface.faces[path.faces[:-1]]]
    weights = trimesh.triangles.points_to_barycentric(corners, points[1:])
    assert weights.min() > -1e-5
    foot = np.einsum("ni,nij->nj", weights, corners)
    assert np.linalg.norm(foot - points[1:], axis=1).max() < 1e-8
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    scale = steps.sum() / path.length_m
    assert np.allclose(np.cumsum(steps), path.arc_m[1:] * scale, atol=1e-9)
    return scale


@pytest.mark.parametrize("shape", [letters("Z4", 0.03), square(0.03), polyline([[0, 0], [0.02, 0.01], [0, 0.04]])])
def test_on_a_plate_a_path_is_the_plane_path_itself(shape):
    surface = plate()
    angle = 0.4
    path = drawn(surface, [0.004, -0.003, 0.01], [math.cos(angle), math.sin(angle), 5.0], shape)
    arcs = np.linspace(-0.1, 0.3, 500)
    positions, normals = path.at(arcs, surface.vertices, surface.faces)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    assert np.abs(positions[:, :2] - (shape.at(arcs) @ turn + [0.004, -0.003])).max() < 1e-8
    assert np.allclose(positions[:, 2], 0.0) and np.allclose(normals, [0.0, 0.0, 1.0])
    assert lies_on_its_triangles(path, surface) == pytest.approx(1.0, abs=1e-9)


def test_lines_along_edges_and_through_vertices_come_out_right():
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(-0.05, 0.05, 21))
    a = (21 * np.arange(20)[:, None] + np.arange(20)).ravel()
    faces = np.vstack([np.column_stack([a, a + 1, a + 22]), np.column_stack([a, a + 22, a + 21])])
    surface = surface_of(np.column_stack([x.ravel(), y.ravel(), np.zeros(441)]), faces)
    for angle in np.radians(45.0 * np.arange(8)):
        way = np.array([math.cos(angle), math.sin(angle), 0.0])
        path = drawn(surface, [0.005, 0.01, 0.0], way, polyline([[-0.03, 0.0], [0.03, 0.0]]))
        positions, _ = path.at([0.0, 0.03, 0.06], surface.vertices, surface.faces)
        assert np.abs(positions - (np.array([0.005, 0.01, 0.0]) + [[-0.03], [0.0], [0.03]] * way)).max() < 1e-9
        assert through(surface, positions[[0, 2]]).length_m == pytest.approx(0.06, rel=1e-6)


def test_a_line_on_a_cylinder_is_a_helix():
    surface, radius = tube()
    slope = math.radians(25.0)
    # In the middle of a side; seen from outside, the azimuth grows to the right and z up
    middle = math.pi / 64
    start = np.array([RADIUS_m * math.cos(middle), RADIUS_m * math.sin(middle), -0.02])
    ahead = [-math.sin(middle) * math.cos(slope), math.cos(middle) * math.cos(slope), math.sin(slope)]
    path = drawn(surface, start, ahead, line(0.08))
    arcs = np.linspace(0.0, 0.08, 300)
    positions, normals = path.at(arcs, surface.vertices, surface.faces)
    assert np.abs(positions[:, 2] - (-0.02 + (arcs - 0.04) * math.sin(slope))).max() < 1e-9
    azimuth = np.arctan2(positions[:, 1], positions[:, 0])
    # Along a side the azimuth goes as a tangent: at most 0.13 (pi / 64)^3 off an even one
    assert np.abs(azimuth - middle - (arcs - 0.04) * math.cos(slope) / radius).max() < 0.13 * middle**3
    outward = positions[:, :2] / np.linalg.norm(positions[:, :2], axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", outward, normals[:, :2]).min() > math.cos(math.pi / 64)


def test_a_line_on_a_sphere_tends_to_the_great_circle():
    errors = []
    for subdivisions in (3, 5):
        surface = sphere(subdivisions)
        worst = 0.0
        for longitude in (11.0, 47.0, 83.0, 140.0):
            start = on_sphere(20.0, longitude)
            north = np.cross(start, np.cross([0, 0, 1.0], start))
            # Centred on its start, the line reaches half its length either way
            path = drawn(surface, start, north, line(0.08))
            positions, normals = path.at([0.0, 0.08], surface.vertices, surface.faces)
            wanted = [on_sphere(20.0 + side * math.degrees(0.04 / RADIUS_m), longitude) for side in (-1, 1)]
            worst = max(worst, np.linalg.norm(positions - wanted, axis=1).max())
            assert np.einsum("ij,ij->i", normals, positions).min() > 0.99 * RADIUS_m
        errors.append(worst)
    assert errors[1] < 0.4 * errors[0]
    assert errors[1] < 0.02 * 0.08


def test_a_circle_on_a_sphere_is_closed_round_and_as_long_as_in_the_plane():
    surface = sphere(4)
    path = drawn(surface, on_sphere(20.0, 30.0), [0.0, 0.0, 1.0], circle(0.04))
    positions, _ = path.at(np.linspace(0.0, path.length_m, 400), surface.vertices, surface.faces)
    assert np.linalg.norm(positions[0] - positions[-1]) < 1e-9
    assert path.length_m == pytest.approx(math.pi * 0.04, rel=1e-4)
    assert lies_on_its_triangles(path, surface) == pytest.approx(1.0, abs=0.01)
    # A circle of this length on the sphere lies in a plane, and has this radius there
    middle = positions[:-1].mean(axis=0)
    assert np.linalg.norm(positions - middle, axis=1) == pytest.approx(0.02, rel=0.02)
    axis = middle / np.linalg.norm(middle)
    assert np.ptp(positions @ axis) < 0.02 * 0.04


def test_parallel_transport_turns_by_the_area_enclosed():
    # Three quarter great circles with right angles between them close on a sphere; a plane square's fourth is extra
    surface = sphere(5)
    quarter = 0.5 * math.pi * RADIUS_m
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * quarter
    shape = polyline(corners)
    path = drawn(surface, on_sphere(13.0, 21.0), [0.3, 1.0, 0.4], shape)
    positions, _ = path.at([0.0, 3 * quarter], surface.vertices, surface.faces)
    assert np.linalg.norm(positions[1] - positions[0]) < 0.03 * quarter


@pytest.mark.parametrize("ends", [((10, 20), (50, 120)), ((0, 0), (0, 90)), ((-40, 10), (70, 30))])
def test_the_shortest_way_on_a_sphere_is_a_great_circle_arc(ends):
    surface = sphere(4)
    a, b = (on_sphere(*end) for end in ends)
    path = through(surface, [a, b])
    geodesic = RADIUS_m * math.acos(a @ b / RADIUS_m**2)
    assert path.length_m == pytest.approx(geodesic, rel=0.005)
    positions, _ = path.at(np.linspace(0.0, path.length_m, 100), surface.vertices, surface.faces)
    axis = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
    assert np.abs(positions @ axis).max() < 0.05 * geodesic
    lies_on_its_triangles(path, surface)


@pytest.mark.smoke
def test_the_shortest_way_on_a_cylinder_is_that_of_the_unrolled_sheet():
    surface, radius = tube()
    for azimuth, low, high in ((1.0, -0.03, 0.04), (2.9, -0.01, 0.012), (-0.7, -0.045, 0.045)):
        a = np.array([RADIUS_m, 0.0, low])
        turns = round(azimuth / (2 * math.pi / 64)) * 2 * math.pi / 64
        b = np.array([RADIUS_m * math.cos(turns), RADIUS_m * math.sin(turns), high])
        assert through(surface, [a, b]).length_m == pytest.approx(math.hypot(radius * turns, high - low), rel=1e-9)


def test_on_a_plate_the_way_through_points_is_straight_between_them():
    surface = plate()
    points = np.array([[-0.03, -0.02, 0.0], [0.03, 0.01, 0.0], [-0.01, 0.04, 0.0]])
    path = through(surface, points)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert path.length_m == pytest.approx(length.sum(), rel=1e-4)
    assert not path.closed
    positions, _ = path.at([0.0, length[0], length.sum()], surface.vertices, surface.faces)
    assert np.abs(positions - points).max() < 2e-5


def test_on_a_plate_the_way_between_any_two_points_is_the_straight_line():
    """Places inside triangles, on their edges but for rounding, and at their corners; its triangles are irregular."""
    surface, rng = plate(), np.random.default_rng(2)
    # And a vertex of no face
    surface = surface_of(np.vstack([[[1.0, 1.0, 1.0]], surface.vertices]), surface.faces + 1)
    for least in (0.2, 1e-5, 1e-7, 1e-9, 0.0):
        for _ in range(12):
            corners = surface.vertices[surface.faces[rng.integers(0, len(surface.faces), 2)]]
            weights = rng.dirichlet([1.0, 1.0, 1.0], 2)
            weights[:, rng.integers(3)] = least
            if rng.random() < 0.3:
                weights = np.array([[1.0, least, least], [least, 1.0, least]])
            ends = np.einsum("ni,nij->nj", weights / weights.sum(axis=1, keepdims=True), corners)
            path = through(surface, ends)
            assert path.length_m == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=3e-6)
            lies_on_its_triangles(path, surface)


@pytest.mark.parametrize("fault", ["fin", "winding"])
def test_on_a_mesh_that_is_no_surface_no_way_is_found(fault):
    surface = plate()
    vertices = np.vstack([surface.vertices, [[0.0, 0.0, 0.02]]])
    faces = surface.faces.copy()
    if fault == "fin":
        faces = np.vstack([faces, [[*faces[5, :2], len(vertices) - 1]]])
    else:
        faces[7] = faces[7, ::-1]
    with pytest.raises(SceneError, match="more than two faces, or neighbours of opposite winding"):
        through(surface_of(vertices, faces), [[0.0, 0.0, 0.0], [0.02, 0.01, 0.0]])


def test_on_a_cylinder_a_zigzag_is_that_of_the_unrolled_sheet():
    surface, radius = tube(sides=256, rings=81)
    turn = round(1.2 / (2 * math.pi / 256)) * 2 * math.pi / 256
    ends = np.array([[RADIUS_m * math.cos(a), RADIUS_m * math.sin(a), 0.0] for a in (0.0, turn)])
    path = zigzag_through(surface, ends, 0.02, 0.016)
    along = radius * turn
    positions, _ = path.at(np.linspace(0.0, path.length_m, 2001), surface.vertices, surface.faces)
    unrolled = RADIUS_m * np.arctan2(positions[:, 1], positions[:, 0])
    # Round the axis towards +y, seen from outside with z up, +z is to the left
    inside = np.arange(2001) * (path.length_m / 2000) / math.hypot(0.016, 0.02)
    left = 0.02 * np.abs(inside - 2.0 * np.round(0.5 * inside)) - 0.01
    assert positions[:, 2] == pytest.approx(left, abs=2e-4)
    assert unrolled == pytest.approx(inside * 0.016, abs=2e-4)
    assert path.length_m == pytest.approx(along / 0.016 * math.hypot(0.016, 0.02), rel=2e-3)
    lies_on_its_triangles(path, surface)


def test_a_zigzag_wider_than_an_open_surface_is_refused():
    with pytest.raises(SceneError, match="edge"):
        zigzag_through(plate(), [[-0.03, 0.0, 0.0], [0.03, 0.0, 0.0]], 0.12, 0.01)


def test_on_the_hand_a_zigzag_stays_its_width_about_the_way(hand):
    """Thenar to the index finger's pad, 1 cm wide: narrower than the finger."""
    ends = [hand.landmarks["thenar"], hand.landmarks["index_pad"]]
    way = through(hand.surface, ends)
    path = zigzag_through(hand.surface, ends, 0.01, 0.016)
    on_way, _ = way.at(np.linspace(0.0, way.length_m, 2000), hand.surface.vertices, hand.surface.faces)
    on_path, _ = path.at(np.linspace(0.0, path.length_m, 2000), hand.surface.vertices, hand.surface.faces)
    apart = np.linalg.norm(on_path[:, None] - on_way[None], axis=2).min(axis=1)
    assert 0.0048 < apart.max() < 0.0055
    flat = way.length_m / 0.016 * math.hypot(0.016, 0.01)
    assert path.length_m == pytest.approx(flat, rel=0.03)
    lies_on_its_triangles(path, hand.surface)


def test_on_the_hand_no_way_is_longer_than_along_the_edges(hand):
    surface = hand.surface
    edges, _ = unique_edges(surface.faces)
    length = np.linalg.norm(surface.vertices[edges[:, 0]] - surface.vertices[edges[:, 1]], axis=1)
    count = len(surface.vertices)
    graph = sparse.csr_array((length, (edges[:, 0], edges[:, 1])), shape=(count, count))
    rng = np.random.default_rng(5)
    for a, b in rng.choice(count, (6, 2), replace=False):
        path = through(surface, surface.vertices[[a, b]])
        along_edges = dijkstra(graph, directed=False, indices=a)[b]
        assert np.linalg.norm(surface.vertices[a] - surface.vertices[b]) <= path.length_m <= along_edges
        # Straight across triangles is shorter than along the edges by some per cent at least
        assert path.length_m < 0.99 * along_edges
        lies_on_its_triangles(path, surface)


def test_letters_on_the_palm_keep_their_length_and_their_height(hand):
    text = letters("PALM", 0.012)
    path = drawn(hand.surface, hand.landmarks["palm_centre"], [-1.0, 0.0, 0.0], text)
    assert path.length_m == pytest.approx(text.length_m, rel=1e-9)
    assert lies_on_its_triangles(path, hand.surface) == pytest.approx(1.0, abs=1e-9)
    arcs = np.linspace(0.0, path.length_m, 2000)
    positions, normals = path.at(arcs, hand.surface.vertices, hand.surface.faces)
    # The palm is nearly flat: the letters look much as in the plane. Seen from outside, x goes to -x here.
    seen = positions[:, :2] * [-1.0, 1.0]
    assert np.abs(seen - text.at(arcs)).max() < 0.004
    assert normals[:, 2].max() < -0.5


def test_a_path_follows_the_mesh_when_it_moves(hand):
    surface = hand.surface
    path = through(surface, [[-0.027, -0.022, 0.0], hand.landmarks["index_tip"]])
    arcs = np.linspace(0.0, path.length_m, 50)
    positions, normals = path.at(arcs, surface.vertices, surface.faces)
    turn = Rotation.from_euler("xyz", [20.0, -50.0, 130.0], degrees=True)
    away = np.array([0.1, 0.2, 0.3])
    moved, turned = path.at(arcs, turn.apply(surface.vertices) + away, surface.faces)
    assert np.allclose(moved, turn.apply(positions) + away, atol=1e-12)
    assert np.allclose(turned, turn.apply(normals), atol=1e-12)
    bent = surface.vertices + np.column_stack([np.zeros((len(surface.vertices), 2)), 3.0 * surface.vertices[:, 1] ** 2])
    moved, _ = path.at(arcs, bent, surface.faces)
    # In millimetres: trimesh's tolerance is absolute
    corners = 1e3 * bent[surface.faces[np.unique(path.faces)]]
    for point in 1e3 * moved:
        feet = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        assert np.linalg.norm(feet - point, axis=1).min() < 1e-9


def test_a_start_within_a_small_triangle_stays_where_it_is():
    surface = plate()
    small = surface_of(0.02 * surface.vertices, surface.faces)
    rng = np.random.default_rng(9)
    for x, y in rng.uniform(-0.0004, 0.0004, (10, 2)):
        path = drawn(small, [x, y, 0.001], X, polyline([[-1e-5, 0.0], [1e-5, 0.0]]))
        positions, _ = path.at([1e-5], small.vertices, small.faces)
        assert np.abs(positions - [x, y, 0.0]).max() < 1e-9


def test_running_off_an_open_mesh_names_the_arc_length():
    surface = plate()
    with pytest.raises(SceneError, match="leaves the mesh") as error:
        drawn(surface, [0.02, 0.0, 0.0], X, polyline([[-0.01, 0.0], [0.05, 0.0]]))
    # From the path's start at x = -10 mm to the edge at x = 50 mm
    found = re.search(r"after ([\d.]+) mm", str(error.value))
    assert found and float(found[1]) == pytest.approx(60.0, abs=0.1)


@pytest.mark.parametrize("seed", range(20))
def test_rounding_does_not_decide_whether_a_path_reaches_the_edge(seed):
    """A plate turned and shifted at random, so that each case rounds in its own way."""
    rng = np.random.default_rng(seed)
    flat, turn, away = plate(), Rotation.random(rng=rng), rng.uniform(-0.3, 0.3, 3)
    surface = surface_of(turn.apply(flat.vertices) + away, flat.faces)
    y, angle = rng.uniform(-0.02, 0.02), rng.uniform(-0.6, 0.6)
    # From the point (0, y) to the edge x = 50 mm, at an angle to x
    ahead, reach = np.array([math.cos(angle), math.sin(angle), 0.0]), 0.05 / math.cos(angle)

    def to(length):
        middle = np.array([0.0, y, 0.0]) + 0.5 * length * ahead
        return drawn(surface, turn.apply(middle) + away, turn.apply(ahead), line(length))

    for beyond in (0.0, 1e-6, 0.01):
        with pytest.raises(SceneError, match="leaves the mesh") as error:
            to(reach + beyond)
        found = re.search(r"after ([\d.]+) mm", str(error.value))
        assert found and float(found[1]) == pytest.approx(1e3 * reach, abs=0.051)
    path = to(reach - 1e-8)
    assert lies_on_its_triangles(path, surface) == pytest.approx(1.0, abs=1e-9)
    end, _ = path.at([path.length_m], surface.vertices, surface.faces)
    assert np.linalg.norm(turn.inv().apply(end - away) - ([0.0, y, 0.0] + (reach - 1e-8) * ahead)) < 1e-9


@pytest.mark.parametrize("seed", range(10))
def test_a_path_may_run_along_the_edge(seed):
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(-0.05, 0.05, 21))
    a = (21 * np.arange(20)[:, None] + np.arange(20)).ravel()
    faces = np.vstack([np.column_stack([a, a + 1, a + 22]), np.column_stack([a, a + 22, a + 21])])
    turn, away = Rotation.random(rng=rng), rng.uniform(-0.3, 0.3, 3)
    surface = surface_of(turn.apply(np.column_stack([x.ravel(), y.ravel(), np.zeros(441)])) + away, faces)
    for angle in np.radians([0.0, 90.0, 180.0, 270.0]):
        way, aside = np.array([math.cos(angle), math.sin(angle), 0.0]), [math.sin(angle), -math.cos(angle), 0.0]
        path = drawn(surface, turn.apply(0.05 * np.array(aside)) + away, turn.apply(way), line(0.0823))
        assert lies_on_its_triangles(path, surface) == pytest.approx(1.0, abs=1e-9)
        ends, _ = path.at([0.0, 0.0823], surface.vertices, surface.faces)
        expected = 0.05 * np.array(aside) + [[-0.04115], [0.04115]] * way
        assert np.abs(turn.inv().apply(ends - away) - expected).max() < 1e-9


def test_what_cannot_be_drawn_is_named():
    surface = plate()
    with pytest.raises(SceneError, match=r"21\.0 mm from the surface"):
        drawn(surface, [0.0, 0.0, 0.021], X, line(0.01))
    with pytest.raises(SceneError, match=r"waypoint 1 .*30\.0 mm from the surface"):
        through(surface, [[0.0, 0.0, 0.0], [0.08, 0.0, 0.0]])
    with pytest.raises(SceneError, match="no component along the skin"):
        drawn(surface, [0.0, 0.0, 0.0], [0.0, 0.0, 2.0], line(0.01))
    with pytest.raises(SceneError, match="three finite numbers"):
        drawn(surface, [0.0, 0.0, math.nan], X, line(0.01))
    with pytest.raises(SceneError, match=r"\(1, 3\)"):
        through(surface, [[0.0, 0.0, 0.0]])
    with pytest.raises(SceneError, match="waypoints 0 and 1 are the same"):
        through(surface, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]])
    apart = surface_of(
        np.vstack([surface.vertices, surface.vertices + np.array([0.2, 0.0, 0.0])]),
        np.vstack([surface.faces, surface.faces + len(surface.vertices)]),
    )
    with pytest.raises(SceneError, match="waypoints 0 and 1 lie on unconnected parts"):
        through(apart, [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])


def test_triangles_without_area_are_named():
    surface = plate()
    flat = surface_of(surface.vertices, np.vstack([surface.faces, [[0, 1, 1]]]))
    for make in (
        lambda: drawn(flat, [0.0, 0.0, 0.0], X, line(0.01)),
        lambda: through(flat, [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]),
    ):
        with pytest.raises(SceneError, match="1 triangles without area"):
            make()


def test_a_circle_round_a_finger_is_refused(hand):
    with pytest.raises(SceneError, match="misses its start"):
        drawn(hand.surface, hand.landmarks["index_tip"], X, circle(0.03))


def test_paths_take_little_time(hand, yardsticks):
    surface, centre, tip = hand.surface, hand.landmarks["palm_centre"], hand.landmarks["index_tip"]
    path = drawn(surface, centre, X, z_shape(0.03, 0.025))
    assert path.length_m > 0.095
    assert yardsticks(lambda: drawn(surface, centre, X, z_shape(0.03, 0.025))) < 100.0
    assert yardsticks(lambda: through(surface, [[-0.027, -0.022, 0.0], tip])) < 200.0
    arcs = np.random.default_rng(0).uniform(0.0, 0.2, 10000)
    assert min(yardsticks(lambda: path.at(arcs, surface.vertices, surface.faces)) for _ in range(5)) < 1.0
