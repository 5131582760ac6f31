"""Regions of the skin, against the bones' lengths and the digits' breadths that the hand was made of."""

import numpy as np
import pytest
import trimesh

from palmfield.hand.articulated import articulate
from palmfield.hand.labels import PALM_AREAS, WEBS, depth_by_region, region_labels
from palmfield.hand.preset import DIGITS, load_preset, mirrored
from palmfield.hand.surface import hand_surface

HANDS = [("open_men_p50", 0.003), ("open_women_p50", 0.003), ("open_women_p05", 0.0025), ("open_men_p95", 0.004)]


@pytest.fixture(scope="module", params=HANDS, ids=[f"{name}-{1e3 * edge:g}mm" for name, edge in HANDS])
def labelled(request):
    name, edge = request.param
    hand, skin = articulate(load_preset(name)), hand_surface(load_preset(name), edge)
    return hand, skin, *region_labels(hand, skin.surface)


def areas(surface, names, labels):
    """Area of each region [m2]: a third of each triangle for each of its corners."""
    faces = trimesh.Trimesh(surface.vertices, surface.faces, process=False).area_faces
    share = np.bincount(labels[surface.faces].ravel(), np.repeat(faces / 3.0, 3), minlength=len(names))
    return dict(zip(names, share, strict=True))


def half_around(breadth, depth):
    """Half the circumference of an ellipse (Ramanujan 1914)."""
    a, b = 0.5 * breadth, 0.5 * depth
    return 0.5 * np.pi * (3 * (a + b) - np.sqrt((3 * a + b) * (a + 3 * b)))


def test_every_vertex_has_one_label_and_every_region_is_one_piece(labelled):
    _, skin, names, labels = labelled
    assert len(set(names)) == len(names) == 40
    assert labels.shape == (len(skin.surface.vertices),) and labels.dtype == np.int32
    assert np.array_equal(np.unique(labels), np.arange(len(names)))
    edges = trimesh.Trimesh(skin.surface.vertices, skin.surface.faces, process=False).edges_unique
    for number, name in enumerate(names):
        inside = (labels[edges] == number).all(axis=1)
        pieces = trimesh.graph.connected_components(edges[inside], nodes=np.flatnonzero(labels == number))
        assert len(pieces) == 1, name


def test_landmarks_lie_in_their_regions(labelled):
    _, skin, names, labels = labelled
    vertices, marks = skin.surface.vertices, skin.landmarks

    def at(point):
        return names[labels[np.argmin(np.linalg.norm(vertices - point, axis=1))]]

    assert at(np.zeros(3)) == "palm_centre"
    for digit in DIGITS:
        assert at(marks[f"{digit}_pad"]) == f"{digit}_pulp"
    for digit in DIGITS[1:]:
        back = marks[f"{digit}_knuckle"] + [0.0, 0.0, 0.02]
        assert at(back) == "dorsum"
    assert at(vertices[np.argmin(vertices[:, 1])]) == "forearm"


def test_phalanges_have_the_area_of_their_bones(labelled):
    hand, skin, names, labels = labelled
    found = areas(skin.surface, names, labels)
    ratio = hand.preset.finger_depth_ratio
    for name in DIGITS[1:]:
        digit = hand.preset.digits[name]
        across = [half_around(breadth, ratio * breadth) for breadth in digit.breadth_m]
        middle = digit.bones_m[2] * (across[1] + across[2]) / 2
        # A round end has the area of a cylinder of its length (Archimedes).
        distal = (digit.bones_m[3] + digit.tip_m) * (across[2] + across[3]) / 2
        assert found[f"{name}_middle_palmar"] == pytest.approx(middle, rel=0.2)
        assert found[f"{name}_middle_back"] == pytest.approx(middle, rel=0.2)
        assert found[f"{name}_pulp"] + found[f"{name}_distal_back"] == pytest.approx(2 * distal, rel=0.15)


def test_palm_and_back_have_the_area_of_the_hand_without_its_fingers(labelled):
    hand, skin, names, labels = labelled
    found = areas(skin.surface, names, labels)
    whole = trimesh.Trimesh(skin.surface.vertices, skin.surface.faces, process=False)
    assert sum(found.values()) == pytest.approx(whole.area, rel=1e-9)
    flat = hand.preset.palm_length_m * hand.preset.breadth_m
    assert 0.9 * flat < sum(found[area] for area in PALM_AREAS) < 1.2 * flat
    # The back of the thumb's metacarpal and the hand's own rounding come with it.
    assert 1.0 * flat < found["dorsum"] < 1.4 * flat
    assert 0.05 * flat < found["thumb_web"] < 0.12 * flat
    for web in WEBS[1:]:
        assert 0.01 * flat < found[web] < 0.03 * flat


def test_a_left_hand_has_the_labels_of_the_right_one():
    preset = load_preset("open_women_p50")
    found = [region_labels(articulate(p), hand_surface(p, 0.003).surface) for p in (preset, mirrored(preset))]
    assert found[0][0] == found[1][0]
    assert np.array_equal(found[0][1], found[1][1])


def test_depth_from_skin_to_bone(labelled):
    hand, skin, names, labels = labelled
    depth = depth_by_region(hand, skin)
    assert tuple(depth) == names
    for number, (least, low, middle) in enumerate(depth.values()):
        inside = np.sort(skin.depth_to_bone[labels == number])
        assert least == inside[0]
        assert abs(np.searchsorted(inside, low) - 0.1 * len(inside)) <= 1
        assert abs(np.searchsorted(inside, middle) - 0.5 * len(inside)) <= 1
    # Palm 8 to 20 mm and pulp 4 to 6 mm from skin to bone; a large thumb's is more, a small little finger's less.
    for area in PALM_AREAS:
        assert 0.008 < depth[area][2] < 0.020, area
    for digit in DIGITS[1:4]:
        assert 0.004 < depth[f"{digit}_pulp"][2] < 0.006, digit
