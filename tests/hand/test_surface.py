import numpy as np
import platformdirs
import pytest
import trimesh
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.preset import load_preset, mirrored
from palmfield.hand.skeleton import Bone
from palmfield.hand.surface import bone_distance, centred_skeleton, hand_surface, skin_distance
from palmfield.hand.triangles import corner_angles, unique_edges, vertex_normals

PRESETS = ("open_men_p50", "open_women_p50")


def as_trimesh(surface):
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def self_intersections(vertices, faces):
    """Number of (edge, face) pairs that cross and share no vertex: every edge near a face, tested by four volumes."""
    edges, _ = unique_edges(faces)
    middle = vertices[edges].mean(axis=1)
    centroid = vertices[faces].mean(axis=1)
    reach = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).max()
    near = cKDTree(middle).query_ball_point(centroid, 1.2 * reach)
    face = np.repeat(np.arange(len(faces)), [len(n) for n in near])
    edge = np.concatenate([np.array(n, dtype=int) for n in near])
    apart = ~(faces[face][:, :, None] == edges[edge][:, None, :]).any(axis=(1, 2))
    face, edge = face[apart], edge[apart]
    p, q = vertices[edges[edge, 0]], vertices[edges[edge, 1]]
    a, b, c = (vertices[faces[face, i]] for i in range(3))

    def side(u, v, w, x):
        return np.sign(np.einsum("ij,ij->i", np.cross(v - u, w - u), x - u))

    pierces = side(a, b, c, p) * side(a, b, c, q) < 0
    turns = np.stack([side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)])
    return int((pierces & (np.abs(turns.sum(axis=0)) == 3)).sum())


def test_a_left_hand_has_the_normals_of_its_triangles():
    left = hand_surface(mirrored(load_preset("open_men_p50"))).surface
    np.testing.assert_allclose(left.normals, vertex_normals(left.vertices, left.faces), atol=1e-12)


def test_the_intersection_counter_sees_two_crossing_spheres():
    ball = trimesh.creation.icosphere(subdivisions=2)
    moved = ball.vertices + np.array([0.7, 0.11, 0.05])
    vertices = np.concatenate([ball.vertices, moved])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    assert self_intersections(vertices, faces) > 20
    assert self_intersections(np.array(ball.vertices), np.array(ball.faces)) == 0


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("edge_m", [0.002, 0.003, 0.004])
def test_mesh_is_sound(name, edge_m):
    surface = hand_surface(load_preset(name), edge_m).surface
    mesh = as_trimesh(surface)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2 and mesh.volume > 0
    assert np.rad2deg(corner_angles(surface.vertices, surface.faces).min()) > 10
    assert self_intersections(surface.vertices, surface.faces) == 0
    edges, _ = unique_edges(surface.faces)
    lengths = np.linalg.norm(surface.vertices[edges[:, 0]] - surface.vertices[edges[:, 1]], axis=1)
    assert lengths.mean() == pytest.approx(edge_m, rel=0.1)


@pytest.mark.parametrize("name", PRESETS)
def test_measures_on_the_mesh(name):
    preset = load_preset(name)
    hand = hand_surface(preset)
    v, f, marks = hand.surface.vertices, hand.surface.faces, hand.landmarks
    length = v[:, 1].max() - marks["wrist"][1]
    assert length == pytest.approx(preset.length_m, rel=0.03)
    ends = np.stack([marks["index_knuckle"], marks["little_knuckle"]])
    to_sides = exit_distances(v, f, ends, np.array([[-1.0, 0, 0], [1.0, 0, 0]]), 0.3)
    assert to_sides.sum() + ends[1, 0] - ends[0, 0] == pytest.approx(preset.breadth_m, rel=0.03)
    cut = trimesh.intersections.mesh_plane(as_trimesh(hand.surface), [0, 1, 0], marks["wrist"])
    circumference = np.linalg.norm(cut[:, 0] - cut[:, 1], axis=1).sum()
    assert circumference == pytest.approx(preset.wrist_circumference_m, rel=0.05)
    assert np.linalg.norm(v - marks["middle_tip"], axis=1).min() < 0.004


@pytest.mark.parametrize("name", PRESETS)
def test_palm_is_at_the_origin_and_hollow(name):
    hand = hand_surface(load_preset(name))
    v, f = hand.surface.vertices, hand.surface.faces
    places = np.array([[0, 0], [-0.025, -0.025], [0.028, -0.015], [0.0, 0.03]]) * load_preset(name).breadth_m / 0.0883
    start = np.column_stack([places, np.full(4, 0.012)])
    height = start[:, 2] - exit_distances(v, f, start, np.tile([0.0, 0.0, -1.0], (4, 1)), 0.3)
    assert abs(height[0]) < 2e-4
    assert (height[1:3] < -1.5e-3).all(), "thenar and hypothenar pads stand out of the palm"
    nearest = np.argmin(np.linalg.norm(v, axis=1))
    assert hand.surface.normals[nearest, 2] < -0.97
    assert hand.landmarks["thumb_tip"][0] < hand.landmarks["little_tip"][0], "a right hand with its palm down"


@pytest.mark.parametrize("name", PRESETS)
def test_soft_tissue_depth(name):
    hand = hand_surface(load_preset(name))
    v, depth = hand.surface.vertices, hand.depth_to_bone
    assert depth.min() > 5e-4, "no bone comes through the skin"
    assert 0.008 < depth[np.argmin(np.linalg.norm(v, axis=1))] < 0.020
    for digit in ("index", "middle", "ring"):
        assert 0.003 < depth[np.argmin(np.linalg.norm(v - hand.landmarks[f"{digit}_pad"], axis=1))] < 0.006


def test_bone_distance_of_a_straight_capsule_is_exact():
    bone = Bone("rod", np.zeros(3), np.array([0.0, 0.03, 0.0]), 0.004, 0.004)
    points = np.array([[0.01, 0.01, 0.0], [0.0, 0.05, 0.0], [0.0, -0.003, 0.004], [0.0, 0.02, 0.001]])
    assert bone_distance(points, [bone]) == pytest.approx([0.006, 0.016, 0.001, -0.003], abs=1e-15)


def test_vertices_lie_on_the_zero_level():
    preset = load_preset("open_men_p50")
    surface = hand_surface(preset).surface
    assert np.abs(skin_distance(centred_skeleton(preset), surface.vertices)).max() < 1e-5


def test_edge_out_of_range():
    with pytest.raises(SceneError, match=r"edge length 0.02 m .* 0.001 to 0.004"):
        hand_surface(load_preset("open_men_p50"), 0.02)


def test_touching_digits_are_refused():
    preset = load_preset("open_men_p50")
    crossed = preset.digits["index"].model_copy(update={"spread_deg": 12.0})
    with pytest.raises(SceneError, match="digits touch"):
        hand_surface(preset.model_copy(update={"digits": preset.digits | {"index": crossed}}))


def test_cache_is_used_and_a_damaged_one_is_made_anew(tmp_path, monkeypatch, yardsticks):
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: str(tmp_path / name))
    preset = load_preset("open_women_p50")
    made = []
    assert yardsticks(lambda: made.append(hand_surface(preset, 0.004))) < 1200.0
    (first,) = made
    (kept,) = (tmp_path / "palmfield" / "hands").glob("*.npz")
    data = kept.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("palmfield.hand.surface._generate", None)
        again = hand_surface(preset, 0.004)
    assert np.array_equal(first.surface.vertices, again.surface.vertices)
    middle = len(data) // 2
    kept.write_bytes(data[:middle] + bytes([data[middle] ^ 0xFF]) + data[middle + 1 :])
    with pytest.warns(RuntimeWarning, match="is damaged"):
        mended = hand_surface(preset, 0.004)
    assert kept.read_bytes() == data
    assert np.array_equal(first.surface.vertices, mended.surface.vertices)
    assert np.array_equal(first.surface.faces, mended.surface.faces)


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: str(blocked))
    with pytest.warns(RuntimeWarning, match="continuing without a cache"):
        assert len(hand_surface(load_preset("open_women_p50"), 0.004).surface.vertices) > 1000
