"""Extent of a skin layer on the palmar side of a hand: of presets by their labels, of meshes by their shape."""

from functools import cache

import foreign_hands
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.chirality import chirality
from palmfield.hand.cover import covered_patch
from palmfield.hand.meshfile import load_mesh
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.palmar import labelled_cover, shaped_cover
from palmfield.hand.poses import named_pose, posed_surface
from palmfield.hand.preset import DIGITS, load_preset
from palmfield.hand.scene_layers import scene_layers
from palmfield.hand.skinning import SkinnedHand
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import face_normals, vertex_normals
from palmfield.types import Surface

EDGES = 0.006, 0.008, 0.03


def layer(surface, cover, centre, depth, share):
    return covered_patch(surface, depth, centre, cover, (cover.reach_m, *EDGES, 0.02, share), None)


@cache
def of_preset(name="open_men_p50"):
    hand = hand_surface(load_preset(name))
    cover = labelled_cover(hand.surface, name, np.zeros(3))
    return hand, layer(hand.surface, cover, np.zeros(3), hand.depth_to_bone, 0.6)


@cache
def of_mesh():
    """Return a mesh without labels, and the point of its skin below the middle of its palm."""
    vertices, faces = foreign_hands.plain_hand()
    surface = Surface(vertices, faces, vertex_normals(vertices, faces))
    hand = chirality(vertices, faces)
    way = exit_distances(vertices, faces, hand.middle[None], hand.palm[None], 1.0)[0]
    centre = hand.middle + way * hand.palm
    return surface, centre


def test_a_cover_of_a_preset_reaches_all_pads_and_neither_wrist_nor_back():
    hand, patch = of_preset()
    pads = np.array([hand.landmarks[f"{digit}_pad"] for digit in DIGITS])
    assert cKDTree(patch.vertices).query(pads)[0].max() < 0.006
    assert patch.vertices[:, 1].min() > hand.landmarks["wrist"][1] - 0.003
    unit, area = face_normals(patch.vertices, patch.faces)
    assert (unit[:, 2] < 0.0).all()
    assert 0.014 < area.sum() < 0.020
    assert patch.report["quality_min"] > 0.05


def test_its_depth_is_that_to_the_bone():
    hand, patch = of_preset()
    bone = np.minimum(hand.depth_to_bone[cKDTree(hand.surface.vertices).query(patch.vertices)[1]], 0.02)
    share = patch.depth / bone
    assert np.percentile(share, 10.0) > 0.9 and share.max() < 1.2
    pulp = np.linalg.norm(patch.vertices - hand.landmarks["index_pad"], axis=1) < 0.008
    assert 0.003 < patch.depth[pulp].min() < patch.depth[pulp].max() < 0.008


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.4, -1.1, 2.0], [3.0, 0.2, -0.5]])
def test_a_mesh_has_the_same_cover_wherever_it_lies(turn):
    surface, centre = of_mesh()
    plain = layer(surface, shaped_cover(surface, centre), centre, 0.005, 0.45).report
    by, shift = Rotation.from_rotvec(turn), np.array([0.3, -0.1, 0.2])
    moved = Surface(by.apply(surface.vertices) + shift, surface.faces, by.apply(surface.normals))
    there = by.apply(centre) + shift
    report = layer(moved, shaped_cover(moved, there), there, 0.005, 0.45).report
    for name, most in (("area_m2", 0.005), ("depth_got_mean_m", 0.01), ("depth_got_p10_m", 0.02)):
        assert report[name] == pytest.approx(plain[name], rel=most)


def test_a_mesh_with_a_forearm_is_covered_to_the_wrist_only(tmp_path):
    foreign_hands.forearm(tmp_path / "forearm.ply")
    longer, (plain, centre) = load_mesh(tmp_path / "forearm.ply", "mm"), of_mesh()
    areas = [shaped_cover(surface, centre).area_m2 for surface in (plain, longer)]
    assert np.ptp(longer.vertices, axis=0).max() > 1.8 * np.ptp(plain.vertices, axis=0).max()
    assert areas[1] == pytest.approx(areas[0], rel=0.05)


def test_bent_fingers_and_a_body_without_a_palm_are_refused():
    hand = SkinnedHand(load_preset("open_men_p50"))
    curled = posed_surface(hand, named_pose(hand.hand, "point"), 0.005)
    with pytest.raises(SceneError, match=r"the finger that ends at .* is bent.*set cover to patch|behind other skin"):
        layer(curled, shaped_cover(curled, np.zeros(3), "right"), np.zeros(3), 0.005, 0.45)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.08)
    surface = Surface(np.array(ball.vertices), np.array(ball.faces, np.int32), np.array(ball.vertex_normals))
    with pytest.raises(SceneError, match=r"the direction out of the palm is unknown \(found .* set cover to patch"):
        shaped_cover(surface, np.array([0.0, 0.0, 0.08]))


def test_fingers_that_hide_the_palm_are_refused():
    vertices, faces = foreign_hands.crossed_hand()
    surface = Surface(vertices, faces, vertex_normals(vertices, faces))
    with pytest.raises(SceneError, match=r"5 % of the palmar skin lies behind other skin.*so the layer would fold"):
        shaped_cover(surface, np.zeros(3))


@pytest.mark.parametrize("depth_m", [0.004, 0.005, 0.006])
def test_a_fingertip_of_a_mesh_gets_most_of_the_depth_that_is_asked_for(depth_m):
    surface, _ = of_mesh()
    layers = scene_layers(surface, chirality(surface.vertices, surface.faces), depth_m)
    assert min(each["p10_mm"] for each in layers) >= 0.6e3 * depth_m
