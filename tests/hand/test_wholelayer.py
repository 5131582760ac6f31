import importlib.util
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bisection import bisected

from palmfield.errors import SceneError
from palmfield.hand.layer import (
    fit_thickness,
    inward_directions,
    most_visible_normals,
    unfolded,
    wedge_quality,
)
from palmfield.hand.layer_volume import curvature_integrals, layer_volume, thickness_integral
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import unique_edges, vertex_normals
from palmfield.hand.wholelayer import facing_faces, hand_layer
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.body import build
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import static
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.body_mesh import Sizes
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import Layer
from palmfield.types import Surface

ROOT = Path(__file__).resolve().parents[2]


@cache
def shapes():
    spec = importlib.util.spec_from_file_location("bench_layers", ROOT / "scripts" / "bench_layers.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


BODIES = {
    "men": lambda: hand_surface(load_preset("open_men_p50"), 0.003).surface,
    "women": lambda: hand_surface(load_preset("open_women_p50"), 0.003).surface,
    "mitten": lambda: shapes().mitten(),
    "coarse": lambda: shapes().coarse_hand(),
    "scan 0.1 mm": lambda: shapes().noisy_scan("open_men_p50", 0.0001, seed=3),
    "scan 0.2 mm": lambda: shapes().noisy_scan("open_women_p50", 0.0002, seed=4),
}
body = cache(lambda name: BODIES[name]())


def as_surface(mesh):
    vertices, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int32)
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def closed_volume(patch):
    """Volume between skin and base of a layer without a rim, by trimesh."""
    outer = trimesh.Trimesh(patch.vertices, patch.faces, process=False)
    base = trimesh.Trimesh(patch.vertices + patch.depth[:, None] * patch.inward, patch.faces, process=False)
    return outer.volume - base.volume


@pytest.mark.parametrize("depth", [0.001, 0.002, 0.003, 0.005])
@pytest.mark.parametrize("part", ["whole", "palmar"])
@pytest.mark.parametrize("name", BODIES)
def test_layers_of_hands_are_sound_thick_and_as_large_as_they_should_be(name, part, depth):
    surface = body(name)
    patch = hand_layer(surface, depth, facing_faces(surface) if part == "palmar" else None, sheets=(0.2, 0.8))
    report = patch.report
    assert wedge_quality(patch.vertices, patch.faces, patch.inward, patch.depth).min() > 0.0
    assert report["quality_min"] > 0.0 and report["sheet_1_quality_min"] > 0.0 and report["sheet_2_quality_min"] > 0.0
    assert report["p10_share"] >= 0.6
    assert report["area_thinned"] <= 0.15
    assert report["volume_share"] == pytest.approx(1.0, abs=0.05)
    assert report["sheet_1_volume_m3"] + report["sheet_2_volume_m3"] == pytest.approx(
        report["volume_m3"], rel=1e-9 if part == "whole" else 1e-3
    ), "at a rim the cuts through twisted side faces differ"
    assert patch.rim.any() == (part == "palmar")
    if part == "whole":
        # Side faces of neighbours are cut alike, so only skin and base count.
        assert closed_volume(patch) == pytest.approx(report["volume_m3"], rel=1e-9)


def test_layer_meets_the_solver_s_own_check():
    """The raw marching cubes have triangles of 0.002 degrees; the quadratic wedges under them are accepted."""
    mesh = extrude(hand_layer(body("mitten"), 0.005), np.array([0.0, 0.4, 1.0]))
    assert mesh.levels == 5 and len(mesh.side) == 0


@pytest.mark.parametrize("subdivisions, error", [(3, 0.02), (4, 0.005), (5, 0.0013)])
def test_volume_under_a_ball_converges_to_the_exact_one(subdivisions, error):
    radius, depth = 0.012, 0.005
    ball = as_surface(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))
    exact = 4.0 / 3.0 * np.pi * (radius**3 - (radius - depth) ** 3)
    report = hand_layer(ball, depth).report
    assert report["volume_m3"] == pytest.approx(exact, rel=error)
    assert report["thickness_integral_m3"] == pytest.approx(exact, rel=error)
    assert report["area_thinned"] == 0.0 and report["p10_share"] == pytest.approx(1.0)


def test_volume_under_a_cylinder_has_mean_curvature_and_no_gaussian():
    """An open tube: pi (R^2 - (R - t)^2) L, with a thickness that varies along the axis as well."""
    radius, half, around, along = 0.012, 0.04, 120, 40
    angle = np.tile(2.0 * np.pi * np.arange(around) / around, along + 1)
    z = np.repeat(np.linspace(-half / 2, half / 2, along + 1), around)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    a = np.arange(around * along)
    b = a - a % around + (a + 1) % around
    quads = np.concatenate([np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)])
    faces = quads.astype(np.int32)
    mean, gauss = curvature_integrals(vertices, faces)
    assert mean.sum() == pytest.approx(np.pi * half, rel=0.02)
    assert abs(gauss.sum()) < 1e-9
    for depth in (np.full(len(vertices), 0.005), 0.003 + 0.05 * vertices[:, 2]):
        # Middle of (R^2 - (R - t)^2) over the length; t is linear in z
        t = 0.003 + 0.05 * np.linspace(-half / 2, half / 2, 2001) if np.ptp(depth) > 0.0 else depth
        exact = np.pi * half * np.mean(radius**2 - (radius - t) ** 2)
        assert thickness_integral(vertices, faces, depth) == pytest.approx(exact, rel=2e-3)
        inward = -vertices * [1.0, 1.0, 0.0] / radius
        assert layer_volume(vertices, faces, inward, depth) == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize("name", ["men", "coarse"])
def test_gaussian_curvature_sums_to_four_pi(name):
    surface = body(name)
    _, gauss = curvature_integrals(surface.vertices, surface.faces)
    assert gauss.sum() == pytest.approx(4.0 * np.pi, rel=1e-9)


def test_volume_of_one_wedge_keeps_its_sign():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    for face in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        assert layer_volume(corners, np.array([face]), down, np.full(3, 0.5)) == pytest.approx(0.25)
    assert layer_volume(corners, np.array([[0, 2, 1]]), down, np.full(3, 0.5)) == pytest.approx(-0.25)
    assert layer_volume(corners, np.array([[0, 1, 2]]), down, np.array([0.3, 0.6, 0.9])) == pytest.approx(0.3)


def test_where_the_body_is_too_thin_the_report_says_so():
    """A plate 8 mm thick: 5 mm from both sides cannot be; 0.45 of the way is 3.6 mm."""
    plate = trimesh.creation.box(extents=[0.08, 0.08, 0.008]).subdivide_to_size(0.005)
    plate.merge_vertices()
    surface = as_surface(plate)
    report = hand_layer(surface, 0.005, facing_faces(surface), max_fraction=0.45).report
    assert report["area_limited"] > 0.8 and report["area_thinned"] >= report["area_limited"]
    assert report["depth_got_p10_m"] <= 0.0036 * 1.001


def test_thickness_by_vertex():
    surface = body("women")
    asked = np.where(surface.normals[:, 2] < 0.0, 0.002, 0.001)
    patch = hand_layer(surface, asked)
    assert patch.report["depth_asked_min_m"] == 0.001 and patch.report["depth_asked_mean_m"] < 0.002
    palmar = np.mean(patch.depth[surface.normals[:, 2] < -0.9])
    assert palmar == pytest.approx(0.002, rel=0.02)


def test_a_palmar_layer_has_one_rim_and_no_holes():
    patch = hand_layer(body("men"), 0.002, facing_faces(body("men")))
    edges, uses = unique_edges(patch.faces)
    assert len(patch.vertices) - len(edges) + len(patch.faces) == 1
    assert set(np.unique(uses)) == {1, 2}
    assert (patch.inward @ [0.0, 0.0, 1.0]).min() > -0.4


def test_a_vertex_that_no_direction_sees_is_moved_and_nothing_else():
    """A vertex of a ball that lies beyond its neighbours, so that two faces are turned over."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces, dtype=np.int32)
    top = int(np.argmax(vertices[:, 2]))
    near = np.linalg.norm(vertices - vertices[top], axis=1)
    vertices[top] += [0.0025, 0.0, -0.0002]
    assert most_visible_normals(vertices, faces)[1].min() < 0.0
    mended = unfolded(vertices, faces)
    assert most_visible_normals(mended, faces)[1].min() >= 0.1
    moved = np.linalg.norm(mended - vertices, axis=1) > 0.0
    assert moved.any() and near[moved].max() < 0.006
    folded = Surface(vertices, faces, vertex_normals(vertices, faces))
    assert hand_layer(folded, 0.001).report["vertices_moved"] == moved.sum()


def test_smoothing_gives_vertices_that_nearly_coincide_the_same_direction():
    surface = body("mitten")
    edges, _ = unique_edges(surface.faces)
    length = np.linalg.norm(surface.vertices[edges[:, 0]] - surface.vertices[edges[:, 1]], axis=1)
    close = edges[length < 1e-5]
    apart = [
        np.linalg.norm(d[close[:, 0]] - d[close[:, 1]], axis=1).max()
        for d in (inward_directions(surface.vertices, surface.faces, rounds) for rounds in (0, 5))
    ]
    assert len(close) > 0 and apart[1] < 1e-3 * apart[0]


def test_a_fold_is_refused_with_its_place():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces, dtype=np.int32)
    outward = vertices / 0.01
    with pytest.raises(SceneError, match=r"skin layer folds at \(.*\) mm \(element quality -"):
        fit_thickness(vertices, faces, outward, np.full(len(vertices), 0.002), np.full(len(vertices), np.inf))


@pytest.mark.parametrize(
    "change, says",
    [
        ({"depth": np.ones(3)}, "skin depth has shape"),
        ({"depth": -0.001}, "skin depth is -0.001 m at vertex 0"),
        ({"depth": np.nan}, "skin depth is nan m"),
        ({"faces": [-1]}, "faces name -1 to -1; the surface has"),
        ({"faces": []}, r"faces of shape \(0,\)"),
        ({"faces": [0.5]}, "type float64"),
        ({"sheets": (0.5, 0.0)}, r"sheets are \[0.5, 0.0\]"),
        ({"max_fraction": 1.5}, "max_fraction is 1.5"),
        ({"inward": np.zeros((2, 3))}, r"inward has shape \(2, 3\)"),
    ],
)
def test_errors(change, says):
    with pytest.raises(SceneError, match=says) as caught:
        hand_layer(**({"surface": body("men"), "depth": 0.002} | change))
    assert "\n" not in str(caught.value)


def test_an_open_surface_and_a_side_that_nothing_faces_are_refused():
    surface = body("men")
    with pytest.raises(SceneError, match="3 edges of the surface do not have two faces"):
        hand_layer(Surface(surface.vertices, surface.faces[1:], surface.normals), 0.002)
    with pytest.raises(SceneError, match="no face has a normal along"):
        facing_faces(surface, least_cosine=1.1)


def test_solvers_take_whole_and_palmar_layers_and_agree_with_a_height_field():
    """A static push on a finger pulp: the closed layer, the palmar one with its rim, and a patch cut for itself."""
    depth, width, finger_pad = 0.0025, 0.006, preset("finger_pad")
    balls, blend = shapes().splayed_hand(), shapes().SPLAYED_BLEND_m

    def onto_the_smooth_hand(points):
        for _ in range(4):
            level = shapes().soft_distance(balls, blend, points)
            steps = [shapes().soft_distance(balls, blend, points + d) - level for d in 1e-6 * np.eye(3)]
            slope = np.stack(steps, axis=1) / 1e-6
            points = points - (level / (slope**2).sum(axis=1))[:, None] * slope
        return points

    at = onto_the_smooth_hand(np.array([[-0.0555, 0.102, 0.002]]))[0]
    surface = shapes().coarse_hand(subdivided=False)
    for _ in range(2):
        vertices, faces = bisected(
            surface.vertices,
            surface.faces,
            lambda p: 0.0015 + 0.8 * np.maximum(np.linalg.norm(p - at, axis=1) - 0.004, 0.0),
        )
        points = onto_the_smooth_hand(vertices)
        surface = Surface(points, faces, vertex_normals(points, faces))

    def pushed(patch, rows):
        layer = Layer(patch, (Sheet(finger_pad, depth),), "bonded", "free")
        if rows == 1:
            system = assemble(extrude(layer.patch, np.array([0.0, 1.0])), finger_pad, base="bonded", side="free")
        else:
            system = build(layer, Sizes((0.0, 0.0), 1.0, 1.0, 1.0, 1.0, 1.0, 0, 0.0, 0.0, 100.0))
        quadrature = SurfaceQuadrature(system.mesh, system)
        distance = np.linalg.norm(quadrature.points - at, axis=1)
        force = quadrature.assemble(500.0 * np.exp(-4.0 * np.log(2.0) * (distance / width) ** 2))
        probe = SurfaceProbe(system.mesh, at[None], system)
        return (probe.vectors @ static(system, force))[2]

    palmar = hand_layer(surface, depth, facing_faces(surface))
    field = surface_patch(surface, depth, at, 0.011, 0.0012, 0.002, 0.004, max_depth_m=0.02, facing=(0, 0, -1))
    whole = pushed(hand_layer(surface, depth), 1)
    assert whole > 0.0 and pushed(field, 1) == pytest.approx(whole, rel=0.03)
    assert pushed(palmar, 2) == pytest.approx(pushed(field, 2), rel=0.03)
