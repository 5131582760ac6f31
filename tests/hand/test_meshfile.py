import json

import foreign_hands
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.hand.meshfile import examine, load_mesh
from palmfield.hand.units import METRES, Unit, choose_unit


def ball(size=180.0):
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale([0.45 * size, 0.5 * size, 0.2 * size])
    return mesh


def fails(path, unit, says):
    with pytest.raises(SceneError, match=says) as caught:
        load_mesh(path, unit)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.smoke
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
@pytest.mark.parametrize("unit, size", [("mm", 180.0), ("cm", 18.0), ("in", 7.0), ("m", 0.18)])
def test_formats_and_units(tmp_path, suffix, unit, size):
    path = tmp_path / f"hand.{suffix}"
    ball(size).export(path)
    surface = load_mesh(path, unit)
    metres = size * {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "m": 1.0}[unit]
    assert np.ptp(surface.vertices[:, 1]) == pytest.approx(metres, rel=1e-5)
    assert len(surface.vertices) == len(ball().vertices), "an STL's corners are merged"
    assert (np.einsum("ij,ij->i", surface.normals, surface.vertices) > 0).all()


def test_uv_seam_is_merged(tmp_path):
    box = trimesh.creation.box(extents=[80, 190, 30])
    split = trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    path = tmp_path / "seam.obj"
    split.export(path)
    assert len(load_mesh(path, "mm").vertices) == 8


@pytest.mark.parametrize("flip", [slice(None), slice(0, 300), slice(0, None, 2)])
def test_winding_is_turned_outward(tmp_path, flip):
    mesh = ball()
    faces = np.array(mesh.faces)
    faces[flip] = faces[flip][:, ::-1]
    path = tmp_path / "hand.ply"
    trimesh.Trimesh(mesh.vertices, faces, process=False).export(path)
    surface = load_mesh(path, "mm")
    mended = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mended.is_winding_consistent
    assert mended.volume == pytest.approx(mesh.volume * 1e-9, rel=1e-5)


def test_unit_is_never_guessed(tmp_path):
    path = tmp_path / "hand.ply"
    ball().export(path)
    fails(path, "furlong", "unit 'furlong' is unknown; use one of m, dm, cm, mm, in or auto")
    fails(path, "m", "1.8e[+]05 mm long in unit m; .* 180 mm in unit mm")
    fails(path, "cm", "180 mm in unit mm")


def test_missing_unreadable_and_empty(tmp_path):
    fails(tmp_path / "none.obj", "mm", "does not exist")
    odd = tmp_path / "hand.doc"
    odd.write_text("hand")
    fails(odd, "mm", "format '.doc' is not supported")
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 900\n")
    fails(broken, "mm", "cannot be read|is empty")
    for suffix in ("obj", "stl", "ply"):
        empty = tmp_path / f"empty.{suffix}"
        empty.write_text("")
        fails(empty, "mm", "cannot be read|is empty")
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\nv 1 0 0\nv 0 90 0\n")
    fails(points, "mm", "cannot be read|is empty")


def test_no_size_and_not_finite(tmp_path):
    point = tmp_path / "point.obj"
    point.write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    fails(point, "mm", "lie in one point|empty")
    line = tmp_path / "line.obj"
    line.write_text("v 0 0 0\nv 50 0 0\nv 100 0 0\nf 1 2 3\n")
    fails(line, "mm", "no area")
    mesh = ball()
    vertices = np.array(mesh.vertices)
    vertices[7, 1] = np.nan
    lost = tmp_path / "nan.ply"
    trimesh.Trimesh(vertices, mesh.faces, process=False).export(lost)
    fails(lost, "mm", "1 of 642 vertices are not finite")


def test_holes_are_counted_and_placed(tmp_path):
    """The end across the length passes for a wrist and is closed; what is open beside it is not."""
    mesh = ball()
    centre = mesh.triangles_center
    keep = (centre[:, 1] > -80) & (centre[:, 2] < 33)
    path = tmp_path / "open.ply"
    trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False).export(path)
    fails(path, "mm", r"1 x holes, at \(-?0\.0, -?0\.0, 3\d\.\d\) mm: it is not watertight")


def test_flat_doubled_and_several(tmp_path):
    sheet = tmp_path / "sheet.obj"
    sheet.write_text("v 0 0 0\nv 90 0 0\nv 0 90 0\nf 1 2 3\nf 1 3 2\n")
    fails(sheet, "mm", "encloses no volume")
    two = tmp_path / "two.ply"
    other = ball(60.0)
    other.apply_translation([200, 0, 0])
    trimesh.util.concatenate([ball(), other]).export(two)
    fails(two, "mm", "2 separate bodies")
    mesh = ball()
    doubled = tmp_path / "doubled.ply"
    trimesh.Trimesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:1]]), process=False).export(doubled)
    assert len(load_mesh(doubled, "mm").faces) == len(mesh.faces)


# A hand's and a forearm's length and breadth [m].
HAND, FOREARM = (0.19, 0.10), (0.47, 0.13)


@pytest.mark.parametrize("part", [HAND, FOREARM])
@pytest.mark.parametrize("name", METRES)
def test_the_only_unit_that_fits_is_inferred(part, name):
    length, breadth = (size / METRES[name] for size in part)
    unit = choose_unit("auto", None, length, breadth, "mesh")
    assert unit.name == name and unit.source.startswith("inferred: a ")


@given(st.floats(0.01, 1000.0), st.floats(0.05, 1.0))
def test_what_is_inferred_is_the_one_choice(length, slender):
    breadth = slender * length
    # What a length and a breadth say of it: at the very limit rounding decides
    slender = breadth / length

    def fits(metres):
        size = length * metres
        return (0.13 <= size <= 0.26 and slender >= 0.3) or (0.36 <= size <= 0.56 and slender <= 0.4)

    choices = [name for name, metres in METRES.items() if fits(metres)]
    if len(choices) == 1:
        assert choose_unit("auto", None, length, breadth, "mesh").name == choices[0]
        return
    with pytest.raises(SceneError, match="has no unit") as caught:
        choose_unit("auto", None, length, breadth, "mesh")
    assert all(f"mm with {name}" in str(caught.value) for name in METRES)


def test_hand_in_cm_or_slender_forearm_in_inches_is_asked_for():
    with pytest.raises(
        SceneError, match=r"cm and in both give the size of a hand or forearm: 1.9e[+]04 mm with m, .* give the unit"
    ):
        choose_unit("auto", None, 19.0, 0.35 * 19.0, "mesh")


def test_a_format_with_units_and_the_user_go_before(tmp_path):
    assert choose_unit("auto", "m", 0.05, 0.05, "mesh").source == "set by the file format"
    assert choose_unit("cm", "m", 19.0, 9.0, "mesh") == Unit("cm", 0.01, "given by the user")
    path = tmp_path / "hand.obj"
    vertices, faces = foreign_hands.plain_hand()
    trimesh.Trimesh(100.0 * vertices, faces, process=False).export(path)
    assert examine(path).unit == Unit("cm", 0.01, "inferred: a hand of 208.1 mm")


def test_a_crumb_beyond_a_fingertip_is_no_part_of_the_length(tmp_path):
    vertices, faces = foreign_hands.plain_hand()
    tip = vertices[np.argmax(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1))]
    away = tip - vertices.mean(axis=0)
    crumb = trimesh.creation.icosphere(subdivisions=2, radius=0.004)
    crumb.apply_translation(tip + 0.015 * away / np.linalg.norm(away))
    path = tmp_path / "hand.stl"
    both = [trimesh.Trimesh(vertices, faces, process=False), crumb]
    trimesh.Trimesh(*trimesh.util.append_faces([m.vertices for m in both], [m.faces for m in both])).apply_scale(
        1e3
    ).export(path)
    examined = examine(path)
    assert examined.unit == Unit("mm", 0.001, "inferred: a hand of 208.1 mm")
    assert [finding.count for finding in examined.findings if finding.name == "crumbs"] == [1]


def test_no_unit_is_guessed_without_five_fingertips(tmp_path):
    path = tmp_path / "ball.obj"
    ball(180.0).export(path)
    fails(
        path,
        "auto",
        "1 fingertips were found instead of 5, so it may not be a hand and the unit is not guessed; "
        "give the unit, one of m, dm, cm, mm",
    )
    fist = tmp_path / "open.obj"
    vertices, faces = foreign_hands.plain_hand()
    # What has holes is refused for them; its unit is known all the same
    trimesh.Trimesh(1e3 * vertices, faces[np.linalg.norm(vertices[faces[:, 0]], axis=1) > 0.015], process=False).export(
        fist
    )
    assert examine(fist).unit.name == "mm"


CLAIMED = 3_000_000


def claiming(path):
    """A file that says that it has CLAIMED faces, of which few are there: whoever reads them fails."""
    if path.suffix == ".ply":
        path.write_text(f"ply\nformat ascii 1.0\nelement vertex 9\nelement face {CLAIMED}\nend_header\n")
    elif path.suffix == ".stl":
        path.write_bytes(b" " * 80 + CLAIMED.to_bytes(4, "little"))
        with path.open("r+b") as stream:
            stream.truncate(84 + 50 * CLAIMED)
    elif path.suffix == ".obj":
        path.write_text("v 0 0 0\n" + "f 1 2\n" * CLAIMED)
    else:
        accessor = {"componentType": 5125, "count": 3 * CLAIMED, "type": "SCALAR"}
        scene = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 0}]}],
            "accessors": [accessor],
        }
        path.write_text(json.dumps(scene))


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "gltf"])
def test_above_a_million_faces_are_refused_before_they_are_read(tmp_path, suffix):
    path = tmp_path / f"scan.{suffix}"
    claiming(path)
    fails(path, "mm", f"has {CLAIMED} faces; allowed: at most 1000000; .* make it coarser .* Decimate")
