from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.hand.holes import boundary_loops, cap, least_area_faces
from palmfield.hand.preset import load_preset
from palmfield.hand.repair import repair
from palmfield.hand.selfcross import crossings
from palmfield.hand.split_edges import split_long_edges
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import unique_edges


@cache
def hand():
    surface = hand_surface(load_preset("open_men_p50"), 0.004).surface
    return surface.vertices, surface.faces


def ball(subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


def checked(mesh, vertices, faces, rel=1e-9):
    """Trimesh's own judgement of what was mended, against the sound mesh."""
    assert not mesh.refused, mesh.refused
    sound, got = (trimesh.Trimesh(*both, process=False) for both in ((vertices, faces), (mesh.vertices, mesh.faces)))
    assert got.is_watertight and got.is_winding_consistent and got.euler_number == 2
    assert got.volume == pytest.approx(sound.volume, rel=rel)
    assert got.area == pytest.approx(sound.area, rel=rel)


def only(mesh, name):
    assert [finding.name for finding in mesh.findings] == [name]
    return mesh.findings[0]


def test_a_sound_hand_has_no_findings():
    vertices, faces = hand()
    mesh = repair(vertices, faces)
    assert mesh.findings == []
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.carry @ vertices, mesh.vertices)


def test_seams_are_merged_even_where_rounded():
    vertices, faces = hand()
    soup = vertices[faces].reshape(-1, 3) + np.random.default_rng(1).normal(0.0, 1e-8, (3 * len(faces), 3))
    mesh = repair(soup, np.arange(3 * len(faces)).reshape(-1, 3))
    found = only(mesh, "split vertices")
    assert found.outcome == "repaired" and found.count == 3 * len(faces) - len(vertices)
    checked(mesh, vertices, faces, rel=1e-5)


def test_duplicate_and_degenerate_faces():
    vertices, faces = hand()
    mesh = repair(vertices, np.concatenate([faces, faces[:5], faces[5:7, ::-1]]))
    assert only(mesh, "duplicate faces").count == 7
    checked(mesh, vertices, faces)
    mesh = repair(vertices, np.concatenate([faces, np.stack([faces[:4, 0], faces[:4, 1], faces[:4, 1]], axis=1)]))
    assert only(mesh, "degenerate faces").count == 4
    checked(mesh, vertices, faces)


def test_a_needle_is_turned_and_leaves_no_gap():
    vertices, faces = ball()
    a, b, c = faces[100]
    middle = 0.5 * (vertices[a] + vertices[b])
    tip = len(vertices)
    # Face 100 is cut at the middle of its side a-b, whose other face is not: a needle fills the crack.
    cut = np.concatenate([np.delete(faces, 100, axis=0), [[a, tip, c], [tip, b, c], [a, b, tip]]])
    mesh = repair(np.concatenate([vertices, [middle]]), cut)
    assert only(mesh, "degenerate faces").count == 1
    checked(mesh, vertices, faces)


@pytest.mark.parametrize("doubled", [False, True])
def test_a_fin_is_removed(doubled):
    vertices, faces = hand()
    a, b = faces[200][:2]
    tip = vertices[a] + [0.0, 0.0, -0.01]
    fin = [[a, b, len(vertices)]] + ([[b, a, len(vertices)]] if doubled else [])
    mesh = repair(np.concatenate([vertices, [tip]]), np.concatenate([faces, fin]))
    found = mesh.findings[-1]
    assert found.name == "non-manifold edges" and found.outcome == "repaired"
    np.testing.assert_allclose(found.places, [0.5 * (vertices[a] + vertices[b])])
    checked(mesh, vertices, faces)


def test_a_wall_inside_is_refused():
    vertices, faces = ball()
    n = len(vertices)
    half = vertices[:, 2] >= -1e-9
    inner = [f for f in faces if half[f].all()]
    loop = boundary_loops(np.array(inner))[0]
    fan = [[loop[i], loop[(i + 1) % len(loop)], n] for i in range(len(loop))]
    mesh = repair(np.concatenate([vertices, np.zeros((1, 3))]), np.concatenate([faces, fan]))
    assert [f.name for f in mesh.refused] == ["non-manifold edges"]
    assert mesh.refused[0].count == len(loop)
    assert np.abs(mesh.refused[0].places[:, 2]).max() < 0.1


def test_vertices_of_no_face_and_not_finite_ones():
    vertices, faces = hand()
    mesh = repair(np.concatenate([vertices, [[9.0, 9.0, 9.0]]]), faces)
    assert only(mesh, "unused vertices").count == 1
    checked(mesh, vertices, faces)
    lost = vertices.copy()
    lost[7, 1] = np.nan
    found = only(repair(lost, faces), "not finite vertices")
    assert found.outcome == "refused" and found.count == 1
    assert np.linalg.norm(found.places - vertices[7], axis=1).max() < 0.01


@pytest.mark.parametrize("share, name", [(1.0, "inside out"), (0.1, "flipped faces")])
def test_winding(share, name):
    vertices, faces = hand()
    turned = np.random.default_rng(2).random(len(faces)) < share
    wrong = faces.copy()
    wrong[turned] = wrong[turned][:, ::-1]
    mesh = repair(vertices, wrong)
    assert only(mesh, name).count == (1 if share == 1.0 else turned.sum())
    checked(mesh, vertices, faces)


def test_open_wrist_is_closed_by_good_triangles():
    vertices, faces = hand()
    above = vertices[faces].mean(axis=1)[:, 1] > vertices[:, 1].min() + 0.02
    mesh = repair(vertices, faces[above])
    found = mesh.findings[-1]
    assert found.name == "open wrist" and found.outcome == "repaired" and found.count == 1
    closed = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert closed.is_watertight and closed.is_winding_consistent and closed.volume > 0.0
    # A membrane lies between the lowest and the highest place of its rim, and so does the volume: the sound hand's
    # beyond a height y0, by the divergence theorem (the field max(y - y0, 0) along y has divergence 1 there, else 0).
    fine = trimesh.Trimesh(vertices, faces, process=False).subdivide().subdivide()
    rim = vertices[boundary_loops(faces[above])[0], 1]
    beyond = [
        (np.maximum(fine.triangles_center[:, 1] - y0, 0.0) * fine.face_normals[:, 1] * fine.area_faces).sum()
        for y0 in (rim.max(), rim.min())
    ]
    assert beyond[0] < closed.volume < beyond[1]
    cap_angles = closed.face_angles[above.sum() :]
    assert np.rad2deg(cap_angles.min()) > 15.0


def test_small_holes_are_filled_and_others_refused():
    vertices, faces = hand()
    near = np.linalg.norm(vertices, axis=1).argmin()
    mesh = repair(vertices, faces[(faces != near).all(axis=1)])
    filled = mesh.findings[-1]
    assert (filled.name, filled.outcome, filled.count) == ("small holes", "repaired", 1)
    closed = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert closed.is_watertight and closed.is_winding_consistent
    centre = vertices[faces].mean(axis=1)
    palm, back = (np.linalg.norm(centre - vertices[v], axis=1) < 0.012 for v in (near, vertices[:, 2].argmax()))
    mesh = repair(vertices, faces[~palm & ~back])
    holes = mesh.refused[0]
    assert (holes.name, holes.count) == ("holes", 2)
    assert np.linalg.norm(holes.places - vertices[near], axis=1).min() < 0.002


def test_crumbs_are_dropped_and_bodies_refused():
    vertices, faces = hand()
    small, triangles = ball(1)
    mesh = repair(np.concatenate([vertices, 0.003 * small + 0.2]), np.concatenate([faces, triangles + len(vertices)]))
    assert only(mesh, "crumbs").count == 1
    checked(mesh, vertices, faces)
    mesh = repair(np.concatenate([vertices, 0.1 * small + 0.4]), np.concatenate([faces, triangles + len(vertices)]))
    assert [(f.name, f.count) for f in mesh.refused] == [("several bodies", 2)]


def test_bodies_that_touch_in_a_vertex_are_told_apart():
    vertices, faces = ball(1)
    top = int(vertices[:, 0].argmax())
    other = vertices + 2.0 * vertices[top]
    mesh = repair(np.concatenate([vertices, other]), np.concatenate([faces, faces + len(vertices)]))
    assert {f.name for f in mesh.findings} == {"split vertices", "pinched vertices", "several bodies"}


def test_a_one_sided_surface_is_refused():
    # Moebius band whose edge is closed by a cone: a projective plane.
    angle = np.linspace(0.0, 2.0 * np.pi, 30, endpoint=False)
    side = np.stack([np.cos(angle / 2), np.sin(angle / 2)], axis=1)
    rings = [
        np.stack([(1 + s * side[:, 0]) * np.cos(angle), (1 + s * side[:, 0]) * np.sin(angle), s * side[:, 1]], axis=1)
        for s in (-0.3, 0.3)
    ]
    faces = []
    for i in range(30):
        j = (i + 1) % 30
        a, b, c, d = i, 30 + i, (j if j else 30), (30 + j if j else 0)
        faces += [[a, b, c], [b, d, c]]
    loop = boundary_loops(np.array(faces))
    assert len(loop) == 1
    fan = [[loop[0][k], loop[0][(k + 1) % 60], 60] for k in range(60)]
    mesh = repair(np.concatenate([*rings, [[0.0, 0.0, 2.0]]]), np.array(faces + fan))
    assert [f.name for f in mesh.refused] == ["one-sided surface"]


def test_a_hole_whose_filling_would_double_an_edge_is_refused():
    """Two faces bent along their common edge: the least area is that of the faces themselves."""
    corners = np.array([[0.0, 0.0, 0.0], [4.0, 0.5, 1.0], [0.0, 1.0, 0.0], [-4.0, 0.5, 1.0]]) / 20.0
    mesh = repair(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    assert [finding.name for finding in mesh.refused] == ["holes"]


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.sampled_from(["drop", "double", "flip", "weld", "mix", "noise"]), st.integers(1, 12)
)
def test_what_is_not_refused_is_sound(seed, kind, number):
    """Meshes broken at random: nothing is raised; what is not refused is closed, manifold and looks outwards."""
    random = np.random.default_rng(seed)
    vertices, faces = ball(2)
    chosen = random.choice(len(faces), number, replace=False)
    if kind in ("drop", "mix"):
        faces = np.delete(faces, chosen, axis=0)
    if kind in ("double", "mix"):
        faces = np.concatenate([faces, faces[random.choice(len(faces), number)][:, ::-1]])
    if kind in ("flip", "mix"):
        turned = random.choice(len(faces), number)
        faces[turned] = faces[turned][:, [1, 0, 2]]
    if kind in ("weld", "mix"):
        faces = np.where(np.isin(faces, random.choice(len(vertices), 2)), faces[0, 0], faces)
    if kind == "noise":
        faces = np.concatenate([faces, random.integers(0, len(vertices), (number, 3))])
    mesh = repair(vertices, faces.astype(np.int32))
    np.testing.assert_allclose(mesh.carry.sum(axis=1), 1.0)
    if not mesh.refused:
        got = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        assert got.is_watertight and got.is_winding_consistent and got.volume > 0.0
        assert got.area_faces.min() > 0.0 or kind == "weld" or kind == "mix"


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 6), st.integers(0, 1000))
def test_least_area_is_least(number, seed):
    points = np.random.default_rng(seed).normal(size=(number, 3))
    faces = least_area_faces(points)
    assert len(faces) == number - 2

    def area(f):
        return 0.5 * np.linalg.norm(
            np.cross(points[f[:, 1]] - points[f[:, 0]], points[f[:, 2]] - points[f[:, 0]]), axis=1
        )

    for apex in range(number):
        fan = np.array([[apex, (apex + k) % number, (apex + k + 1) % number] for k in range(1, number - 1)])
        assert area(faces).sum() <= area(fan).sum() * (1 + 1e-12)


def test_cap_of_a_disc_has_its_area_and_lies_in_its_plane():
    angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    loop = np.stack([0.03 * np.cos(angle), np.full(64, 0.01), 0.02 * np.sin(angle)], axis=1)
    inner, faces = cap(loop)
    points = np.concatenate([loop, inner])
    assert np.abs(inner[:, 1] - 0.01).max() < 1e-12
    corners = points[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    polygon = 0.5 * 64 * np.sin(2.0 * np.pi / 64) * 0.03 * 0.02
    assert area == pytest.approx(polygon, rel=1e-12)


def shoelace(loop):
    x, y = loop.T
    return 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def test_a_loop_with_a_slit_gets_a_cap_of_its_area():
    # One bank of the slit is a single edge, closer to the vertices of the other bank than to its own side's.
    bank = [(2.05, y) for y in np.linspace(0.5, 3.0, 12)]
    left = [(0.0, y) for y in np.linspace(3.0, 0.0, 12)]
    loop = np.array([(2.0, 0.5), *bank, (4.0, 3.0), (4.0, 0.0), *left[::-1], (2.0, 3.0)])
    inner, faces = cap(np.column_stack([loop, np.zeros(len(loop))]))
    points = np.concatenate([loop, inner[:, :2]])
    edges, count = unique_edges(faces)
    ring = np.stack([np.arange(len(loop)), np.roll(np.arange(len(loop)), -1)], axis=1)
    np.testing.assert_array_equal(edges[count == 1], np.unique(np.sort(ring, axis=1), axis=0))
    first, second = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    area = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    assert area.sum() == pytest.approx(shoelace(loop), rel=1e-9) and area.min() > 0.0


def jagged(teeth, height):
    """A hand cut across the wrist along a line that goes up and down by `height` [m] so often; the faces kept."""
    vertices, faces = hand()
    middle = vertices[faces].mean(axis=1)
    around = np.arctan2(middle[:, 2] - 0.015, middle[:, 0])
    line = vertices[:, 1].min() + 0.03 + 0.5 * height * np.sign(np.sin(teeth * around))
    return vertices, faces[middle[:, 1] > line]


@pytest.mark.parametrize("teeth, height", [(3, 0.014), (6, 0.014), (9, 0.020), (12, 0.014)])
def test_a_jagged_wrist_is_closed(teeth, height):
    vertices, faces = jagged(teeth, height)
    mesh = repair(vertices, faces)
    assert not mesh.refused and mesh.findings[-1].name == "open wrist"
    rim = vertices[max(boundary_loops(faces), key=len), 1]
    assert np.ptp(rim) > height
    got = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert got.is_watertight and got.is_winding_consistent and got.euler_number == 2
    assert len(crossings(mesh.vertices, mesh.faces)) == 0
    assert np.rad2deg(got.face_angles.min()) > 10.0
    # Within the hull of the hand without its cap: nothing bulges out of the wrist.
    assert mesh.vertices[:, 1].min() >= rim.min() - 1e-9
    whole = trimesh.Trimesh(vertices, hand()[1], process=False)
    deepest, highest = (slice_volume(whole, y) for y in (rim.min(), rim.max()))
    assert highest < got.volume < deepest


def slice_volume(mesh, y0):
    """Volume of a closed mesh beyond a height, by the divergence theorem on its faces cut fine."""
    fine = mesh.subdivide().subdivide()
    return float((np.maximum(fine.triangles_center[:, 1] - y0, 0.0) * fine.face_normals[:, 1] * fine.area_faces).sum())


def test_barred_edges_are_left_out():
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.3], [0.0, 1.0, 0.0]])
    free = {tuple(edge) for edge in unique_edges(least_area_faces(corners))[0].tolist()}
    (chord,) = free & {(0, 2), (1, 3)}
    other = {tuple(edge) for edge in unique_edges(least_area_faces(corners, {chord}))[0].tolist()}
    assert other & {(0, 2), (1, 3)} == {(0, 2), (1, 3)} - {chord}
    assert len(least_area_faces(corners, {(0, 2), (1, 3)})) == 0


def test_long_edges_are_halved_without_gaps():
    box = trimesh.creation.box(extents=[0.08, 0.19, 0.03])
    vertices, faces = np.array(box.vertices), np.array(box.faces, dtype=np.int32)
    carry, finer = split_long_edges(vertices, faces, 0.02)
    got = trimesh.Trimesh(carry @ vertices, finer, process=False)
    assert got.is_watertight and got.is_winding_consistent
    assert got.volume == pytest.approx(box.volume) and got.area == pytest.approx(box.area)
    assert got.edges_unique_length.max() <= 0.02
    np.testing.assert_allclose(carry.sum(axis=1), 1.0)
