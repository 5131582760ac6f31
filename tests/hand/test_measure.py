"""Measures taken from the mesh, against those that the hand was made for, and a tape around shapes that are known."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.hand.measure import measures, tape
from palmfield.hand.preset import load_preset, mirrored, preset_names, sized
from palmfield.hand.surface import HandSurface, hand_surface
from palmfield.types import Surface


def around(mesh, point, normal):
    surface = Surface(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32), np.array(mesh.vertex_normals))
    return tape(HandSurface(surface, np.zeros(len(surface.vertices)), {}), np.array(point), np.array(normal))


HAND_CIRCUMFERENCE_m = {"men": (0.2123, 0.0102), "women": (0.1866, 0.0088)}
"""Mean and standard deviation in ANSUR II (Gordon et al. 2014): no preset has this measure, the mesh has to show it."""
DEVIATIONS = {"p05": -1.645, "p50": 0.0, "p95": 1.645}


@pytest.mark.parametrize("name", preset_names())
def test_presets_have_the_measures_of_people(name):
    preset = load_preset(name)
    found = measures(hand_surface(preset, 0.003))
    _, group, percentile = name.removesuffix("_left").split("_")
    mean, deviation = HAND_CIRCUMFERENCE_m[group]
    around_knuckles = mean + DEVIATIONS[percentile] * deviation
    assert found["hand_circumference"] == pytest.approx(around_knuckles, rel=0.03)
    assert found["length"] == pytest.approx(preset.length_m, rel=0.03)
    assert found["breadth"] == pytest.approx(preset.breadth_m, rel=0.03)
    assert found["wrist_circumference"] == pytest.approx(preset.wrist_circumference_m, rel=0.03)


@settings(max_examples=3, deadline=None)
@given(st.floats(0.15, 0.215), st.floats(0.44, 0.47))
def test_sized_hands_have_their_length_and_breadth(length, ratio):
    preset = sized(load_preset("open_men_p50"), length, ratio * length)
    found = measures(hand_surface(preset, 0.0025))
    assert found["length"] == pytest.approx(length, rel=0.03)
    assert found["breadth"] == pytest.approx(ratio * length, rel=0.03)


def test_a_longer_hand_has_longer_bones_and_fingers_as_broad():
    own = load_preset("open_men_p50")
    long = sized(own, 1.1 * own.length_m)
    for name, digit in own.digits.items():
        assert long.digits[name].bones_m == pytest.approx([1.1 * bone for bone in digit.bones_m])
        assert long.digits[name].breadth_m == pytest.approx(digit.breadth_m)
    assert long.palm_length_m == pytest.approx(1.1 * own.palm_length_m)
    assert long.thickness_m == pytest.approx(own.thickness_m)


def test_a_left_hand_is_the_mirror_image():
    preset = load_preset("open_women_p50")
    right, left = hand_surface(preset, 0.004), hand_surface(mirrored(preset), 0.004)
    assert mirrored(mirrored(preset)) == preset
    assert measures(left) == pytest.approx(measures(right), rel=1e-9)
    assert np.array_equal(left.surface.vertices, right.surface.vertices * [-1.0, 1.0, 1.0])
    assert left.landmarks["thumb_tip"][0] > 0.05
    whole = trimesh.Trimesh(left.surface.vertices, left.surface.faces, process=False)
    assert whole.volume > 0.0 and whole.is_watertight
    np.testing.assert_allclose(left.depth_to_bone, right.depth_to_bone, atol=1e-12)


def test_a_tape_bridges_hollows_and_takes_the_part_it_was_put_around():
    rod = trimesh.creation.cylinder(radius=0.02, height=0.1, sections=256)
    assert around(rod, [0.0, 0.0, 0.01], [0.0, 0.0, 1.0]) == pytest.approx(2 * np.pi * 0.02, rel=1e-3)
    tilted = np.array([0.0, np.sin(0.5), np.cos(0.5)])
    semi = np.array([0.02, 0.02 / np.cos(0.5)])
    h = ((semi[0] - semi[1]) / semi.sum()) ** 2
    # Ramanujan 1914, good to 1e-5 here
    ellipse = np.pi * semi.sum() * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h)))
    assert around(rod, [0.0, 0.0, 0.0], tilted) == pytest.approx(ellipse, rel=1e-3)
    two = trimesh.util.concatenate([rod, rod.copy().apply_translation([0.1, 0.0, 0.0])])
    assert around(two, [0.1, 0.0, 0.01], [0.0, 0.0, 1.0]) == pytest.approx(2 * np.pi * 0.02, rel=1e-3)
    with pytest.raises(SceneError, match="is not closed"):
        around(two, [0.05, 0.0, 0.01], [0.0, 0.0, 1.0])


@pytest.mark.parametrize(("measure", "value"), [("length_m", 0.3), ("breadth_m", 0.2), ("length_m", float("nan"))])
def test_sizes_out_of_range(measure, value):
    with pytest.raises(SceneError, match=f"{measure} is"):
        sized(load_preset("open_men_p50"), **{measure: value})


def test_a_file_that_builds_on_another(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\nbased_on = "open_women_p50"\nlength_m = 0.17\nside = "left"\n')
    mine, base = load_preset(file), load_preset("open_women_p50")
    assert (mine.name, mine.side, mine.length_m, mine.breadth_m) == ("mine", "left", 0.17, base.breadth_m)
    assert mine.digits["index"].bones_m[0] == pytest.approx(base.digits["index"].bones_m[0] * 0.17 / 0.1811)
    file.write_text('name = "mine"\nbased_on = "nobody"\n')
    with pytest.raises(SceneError, match="based_on is 'nobody'; use one of: open_men_p05"):
        load_preset(file)
    file.write_text('name = "mine"\nbased_on = "open_women_p50"\nlengthm = 0.17\n')
    with pytest.raises(SceneError, match="lengthm"):
        load_preset(file)
