import json
import re
from functools import cache

import foreign_hands
import numpy as np
import pytest
import trimesh
from matplotlib.image import imread
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.config.skin import SkinConfig
from palmfield.errors import OutputError, SceneError
from palmfield.hand.chirality import chirality
from palmfield.hand.meshfile import load_mesh
from palmfield.hand.preset import load_preset
from palmfield.hand.reportcard import as_text, fault_faces, palmar_layers, refused_facts, report_card, write_card
from palmfield.hand.scene_layers import scene_layers
from palmfield.hand.surface import hand_surface
from palmfield.skin.scene_layer import LayerDemand, SceneLayer


@cache
def hand():
    surface = hand_surface(load_preset("open_men_p50"), 0.004).surface
    return surface.vertices, surface.faces


def near(place, radius):
    vertices, faces = hand()
    return np.linalg.norm(vertices[faces].mean(axis=1) - place, axis=1) < radius


def index_tip():
    vertices, _ = hand()
    return vertices[np.argmax(vertices[:, 1])]


def hole():
    vertices, faces = hand()
    return vertices, faces[~near([0.0, 0.0, 0.0], 0.012)], [0.0, 0.0, 0.0]


def open_wrist():
    vertices, faces = hand()
    low = vertices[:, 1].min() + 0.02
    return vertices, faces[vertices[faces].mean(axis=1)[:, 1] > low], [0.0, low, 0.015]


def flipped():
    vertices, faces = hand()
    faces = faces.copy()
    chosen = near(index_tip(), 0.01)
    faces[chosen] = faces[chosen][:, ::-1]
    return vertices, faces, index_tip()


def inside_out():
    vertices, faces = hand()
    return vertices, faces[:, ::-1], None


def duplicate():
    vertices, faces = hand()
    return vertices, np.concatenate([faces, faces[near(index_tip(), 0.008)]]), index_tip()


def degenerate():
    vertices, faces = hand()
    a, b, _ = faces[near(index_tip(), 0.008)][0]
    return vertices, np.concatenate([faces, [[a, b, b]]]), index_tip()


def fin():
    vertices, faces = hand()
    a, b, _ = faces[near(index_tip(), 0.008)][0]
    added = np.concatenate([vertices, [vertices[a] + [0.0, 0.0, -0.01]]])
    return added, np.concatenate([faces, [[a, b, len(vertices)]]]), index_tip()


def not_finite():
    vertices, faces = hand()
    vertices = vertices.copy()
    place = index_tip()
    vertices[np.argmax(vertices[:, 1])] = np.nan
    return vertices, faces, place


def self_intersection():
    """A dent in the palm that goes out through the back of the hand."""
    vertices, faces = hand()
    vertices = vertices.copy()
    distance = np.linalg.norm(vertices, axis=1)
    vertices[:, 2] += np.where(distance < 0.015, 0.05 * (1.0 - distance / 0.015), 0.0)
    return vertices, faces, [0.0, 0.0, 0.032]


def two_bodies():
    vertices, faces = hand()
    shifted = 0.4 * vertices + [0.2, 0.0, 0.0]
    return np.concatenate([vertices, shifted]), np.concatenate([faces, faces + len(vertices)]), [0.2, 0.0, 0.0]


def seams():
    vertices, faces = hand()
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3), None


def small_hole():
    vertices, faces = hand()
    return vertices, faces[(faces != np.argmax(vertices[:, 1])).all(axis=1)], index_tip()


FAULTS = {
    "holes": (hole, "refused"),
    "open wrist": (open_wrist, "repaired"),
    "flipped faces": (flipped, "repaired"),
    "inside out": (inside_out, "repaired"),
    "duplicate faces": (duplicate, "repaired"),
    "degenerate faces": (degenerate, "repaired"),
    "non-manifold edges": (fin, "repaired"),
    "not finite vertices": (not_finite, "refused"),
    "self-intersections": (self_intersection, "noted"),
    "several bodies": (two_bodies, "refused"),
    "split vertices": (seams, "repaired"),
    "small holes": (small_hole, "repaired"),
}


def written(path, vertices, faces, scale=1e3):
    trimesh.Trimesh(scale * vertices, faces, process=False).export(path)
    return path


@pytest.mark.parametrize("name", FAULTS)
def test_each_injected_fault_is_named_and_placed(tmp_path, name):
    build, outcome = FAULTS[name]
    vertices, faces, place = build()
    card = report_card(written(tmp_path / "hand.ply", vertices, faces), "mm")
    named = {finding["name"]: finding for finding in card.facts["findings"]}
    assert named[name]["outcome"] == outcome
    assert set(named) <= {name, "long edges", "unused vertices"}, "no other fault is claimed"
    assert card.facts["accepted"] == (outcome != "refused")
    if place is not None:
        away = np.linalg.norm(np.array(named[name]["places_mm"]) - 1e3 * np.array(place), axis=1)
        assert away.min() < 15.0
    assert f"{named[name]['count']} x {name}" in as_text(card.facts)
    json.dumps(card.facts, allow_nan=False)


def test_a_sound_hand(tmp_path):
    vertices, faces = hand()
    card = report_card(written(tmp_path / "hand.ply", vertices, faces))
    facts = card.facts
    assert facts["unit"] == "mm" and facts["unit_source"].startswith("inferred: a hand of 22")
    np.testing.assert_allclose(facts["size_mm"], 1e3 * np.ptp(vertices, axis=0), atol=0.01)
    sound = trimesh.Trimesh(vertices, faces, process=False)
    assert facts["volume_cm3"] == pytest.approx(1e6 * sound.volume, rel=1e-4)
    assert facts["edges_mm"][2] <= 4.3 and facts["self_intersections"] == 0
    assert facts["side"] == "right" and facts["side_sureness"] > 0.9
    assert [layer["asked_mm"] for layer in facts["layers"]] == [1.0, 2.0, 3.0, 5.0]
    for layer in facts["layers"]:
        assert layer["p10_share"] >= 0.6 and layer["thinned_share"] <= 0.15 and layer["least_quality"] > 0.0


def test_layer_of_a_ball_is_as_thick_and_large_as_geometry_has_it():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces, dtype=np.int32)
    for layer in palmar_layers(vertices, faces, chirality(vertices, faces)):
        assert layer["volume_share"] == pytest.approx(1.0, abs=2e-3)
        assert layer["p10_share"] == 1.0 and layer["thinned_share"] == 0.0


@cache
def plain():
    return foreign_hands.plain_hand()


@pytest.mark.parametrize("depth_m", [0.02, 0.004])
def test_a_scene_gets_the_layers_that_the_card_foretells(tmp_path, depth_m):
    path = written(tmp_path / "hand.ply", *plain())
    surface = load_mesh(path, "mm")
    layers = scene_layers(surface, chirality(surface.vertices, surface.faces), depth_m)
    assert [layer["place"].split()[0] for layer in layers] == ["palm", "thumb", "index", "middle", "ring", "little"]
    keys = {"shape": "mesh", "mesh": str(path), "mesh_unit": "mm", "patch_site": "site"}
    # The default may be deeper than a finger is thick; who asks for that is refused
    keys |= {} if depth_m == SkinConfig.model_fields["depth_m"].default else {"depth_m": depth_m}
    demand = LayerDemand(0.0103, 200.0, 200.0, (0.0, 0.0), 1e-3)
    for told in layers:
        config = SkinConfig(**keys, patch_radius_m=1e-3 * told["radius_mm"])
        got = SceneLayer(config, surface, depth_m, 1e-3 * np.array(told["centre_mm"]), demand).patch.report
        # Under the palm the scene's elements are a little finer
        assert told["mean_mm"] == pytest.approx(1e3 * got["depth_got_mean_m"], rel=0.02)
        assert told["p10_mm"] == pytest.approx(1e3 * got["depth_got_p10_m"], rel=0.02)
        assert told["least_mm"] == pytest.approx(1e3 * got["depth_got_min_m"], rel=0.05)


def test_scene_layer_places_are_the_palm_and_the_pads():
    hand = hand_surface(load_preset("open_men_p50"), 0.004)
    side = chirality(hand.surface.vertices, hand.surface.faces)
    for layer in scene_layers(hand.surface, side):
        digit, at = layer["place"].split()[0], 1e-3 * np.array(layer["centre_mm"])
        assert np.abs(hand.surface.vertices - at).max(axis=1).min() < 0.004
        if digit in ("index", "middle", "ring", "little"):
            assert np.linalg.norm(at - hand.landmarks[f"{digit}_pad"]) < 0.006
        elif digit == "palm":
            assert abs(at[0]) < 0.012 and abs(at[1]) < 0.025 and at[2] < 0.004


@pytest.mark.parametrize("asked, code", [("bottle", 3), ("hand", 0)])
def test_doubts_have_an_exit_code_of_their_own(tmp_path, asked, code):
    mesh = tmp_path / f"{asked}.ply"
    if asked == "bottle":
        foreign_hands.bottle(mesh)
    else:
        written(mesh, *plain())
    result = CliRunner().invoke(app, ["hand", str(mesh), "--units", "mm", "--json", str(tmp_path / "card.json")])
    assert result.exit_code == code
    facts = json.loads((tmp_path / "card.json").read_text())
    assert facts["verdict"] == ("accepted with doubts" if code else "accepted") and facts["accepted"] is True
    assert bool(facts["doubts"]) == bool(code) and result.stdout.rstrip().split("\n")[-2].endswith(facts["verdict"])


def test_a_size_that_no_hand_has_is_doubted(tmp_path):
    card = report_card(written(tmp_path / "doll.ply", *plain(), scale=300.0), "mm")
    assert card.facts["verdict"] == "accepted with doubts"
    assert any(re.match(r"it is 62 x \d+ mm long and broad; hands are 130 to 260", doubt) for doubt in card.doubts)


def glove(wall_m):
    """The skin beyond the wrist with a wall of even thickness below it, joined at the wrist."""
    vertices, faces = hand()
    outer = trimesh.Trimesh(vertices, faces[vertices[faces][:, :, 1].mean(axis=1) > vertices[:, 1].min() + 0.02])
    count = len(outer.vertices)
    edges, times = np.unique(np.sort(outer.edges, axis=1), axis=0, return_counts=True)
    rim = set(map(tuple, edges[times == 1].tolist()))
    joined = [(a, b) for a, b in outer.edges.tolist() if (min(a, b), max(a, b)) in rim]
    strip = [face for a, b in joined for face in ((b, a, a + count), (b, a + count, b + count))]
    points = np.concatenate([outer.vertices, outer.vertices - wall_m * outer.vertex_normals])
    return points, np.concatenate([outer.faces, outer.faces[:, ::-1] + count, strip])


def test_a_double_wall_is_doubted(tmp_path):
    card = report_card(written(tmp_path / "glove.ply", *glove(0.002)), "mm")
    assert card.facts["verdict"] == "accepted with doubts"
    (doubt,) = [doubt for doubt in card.doubts if "inner wall" in doubt]
    told = float(re.match(r"half of its skin is (\d+\.\d) mm thick or less", doubt)[1])
    assert told == pytest.approx(2.0, abs=0.2)


def test_a_solid_hand_has_no_double_wall(tmp_path):
    assert not [doubt for doubt in report_card(written(tmp_path / "hand.ply", *plain())).doubts if "wall" in doubt]


def test_marked_faces_are_those_at_the_places():
    vertices, faces = hand()
    marked = fault_faces(vertices, faces, index_tip()[None], 0.005)
    assert 0 < marked.sum() < 100
    assert np.linalg.norm(vertices[faces[marked]].mean(axis=1) - index_tip(), axis=1).max() < 0.005


def test_command_writes_card_and_picture(tmp_path):
    mesh = written(tmp_path / "hole.ply", *hole()[:2])
    out, png = tmp_path / "card.json", tmp_path / "card.png"
    result = CliRunner().invoke(app, ["hand", str(mesh), "--units", "mm", "--json", str(out), "--png", str(png)])
    assert isinstance(result.exception, SceneError) and "1 x holes, at (" in str(result.exception)
    assert re.search(r"unit +mm \(given by the user\)", result.stdout) and "verdict     refused" in result.stdout
    facts = json.loads(out.read_text())
    assert facts["findings"][-1]["name"] == "holes" and facts["refusal"] == str(result.exception)
    picture = (255 * imread(png)[..., :3]).astype(int)
    # The red of what is refused: the rim of the hole in the view of the palm, and its ring and key.
    red = np.abs(picture - [0xDC, 0x26, 0x26]).max(axis=2) < 8
    assert red[100:600].sum() > 100


def test_wrong_unit_is_named_and_nothing_is_guessed(tmp_path):
    vertices, faces = hand()
    mesh = written(tmp_path / "hand.stl", vertices, faces, scale=1e3)
    with pytest.raises(SceneError, match=r"2.2e\+04 mm long in unit dm|long in unit m; .*2\d\d.* mm in unit mm"):
        report_card(mesh, "m")
    odd = written(tmp_path / "odd.stl", vertices, faces, scale=1.7)
    with pytest.raises(SceneError, match=r"has no unit, and no unit gives .* mm with m, .* mm with in; give the unit"):
        report_card(odd)


@pytest.mark.parametrize("kind", ["wrong unit", "unreadable", "missing"])
def test_what_cannot_be_examined_gets_a_card_with_the_refusal(tmp_path, kind):
    mesh, out = tmp_path / "hand.ply", tmp_path / "card.json"
    if kind == "wrong unit":
        written(mesh, *hand())
    elif kind == "unreadable":
        mesh.write_bytes(b"ply\nnothing else")
    with pytest.raises(SceneError) as caught:
        report_card(mesh, "m")
    facts = refused_facts(mesh, "m", caught.value)
    write_card(out, facts)
    read = json.loads(out.read_text())
    assert read["refusal"] == str(caught.value) and read["accepted"] is False and read["file"] == str(mesh)
    assert [(f["name"], f["outcome"], f["text"]) for f in read["findings"]] == [
        ("not examined", "refused", str(caught.value))
    ]
    says = {
        "wrong unit": "in unit m; allowed: 20 to 600 mm",
        "unreadable": "cannot be read",
        "missing": "does not exist",
    }
    assert says[kind] in as_text(read) and as_text(read).endswith("verdict     refused\n")


def test_a_card_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(OutputError, match="cannot write"):
        write_card(tmp_path / "no" / "card.json", {})
