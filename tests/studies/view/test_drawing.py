"""What is drawn: meshes as files, colours, and how things are turned and magnified."""

import io

import numpy as np
import pytest
import trimesh
from matplotlib import colormaps
from pygltflib import GLTF2

from palmfield.studies.view.glb import GlbMesh, linear
from palmfield.studies.view.page import motion_scale, phase_colours, rounded_up, size_scale
from palmfield.transforms import facing

page = pytest.importorskip("palmfield.studies.view.page", reason="the extra `view` is not installed")


def test_another_reader_finds_the_mesh_in_the_file():
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(7, 3)).astype(np.float32)
    faces = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6]])
    colours = rng.integers(0, 256, (7, 4)).astype(np.uint8)
    mesh = GlbMesh(faces, 7)
    mesh.file(np.zeros((7, 3), np.float32), colours)
    file = mesh.file(positions, colours)
    read = trimesh.load(io.BytesIO(file), file_type="glb", force="mesh", process=False)
    np.testing.assert_array_equal(read.vertices.astype(np.float32), positions)
    np.testing.assert_array_equal(read.faces, faces)
    told = GLTF2.load_from_bytes(file)
    accessor = told.accessors[told.meshes[0].primitives[0].attributes.COLOR_0]
    view = told.bufferViews[accessor.bufferView]
    held = np.frombuffer(told.binary_blob(), np.uint8)[view.byteOffset : view.byteOffset + view.byteLength]
    assert (accessor.componentType, accessor.type, accessor.normalized) == (5121, "VEC4", True)
    np.testing.assert_array_equal(held.reshape(-1, 4), linear(colours))


def test_linear_light_is_that_of_the_srgb_standard():
    """IEC 61966-2-1: half of full code is 0.2140 of full light; below 0.04045 it is a line."""
    codes = np.array([[0, 5, 10, 255], [128, 255, 188, 7]], np.uint8)
    light = linear(codes) / 255.0
    np.testing.assert_allclose(light[:, :3], [[0, 0.001518, 0.003035], [0.215861, 1, 0.502886]], atol=0.5 / 255)
    np.testing.assert_array_equal(linear(codes)[:, 3], [255, 7])


def test_a_scale_has_its_ends_and_zero_where_the_legend_says():
    scale = motion_scale("", 1.3e-6)
    assert (scale.low, scale.high, scale.unit) == (-2.0, 2.0, "um")
    own = 255.0 * colormaps["RdBu_r"](np.linspace(0.02, 0.98, 256))
    for value, place in ((-2e-6, 0), (2e-6, 255), (9.0, 255), (0.0, 128)):
        np.testing.assert_allclose(scale.colours(np.array([value])), own[place][None], atol=0.51)
    assert ">-2<" in scale.legend and ">2 um<" in scale.legend
    assert size_scale("", 180.0, "Pa", 1.0).high == 200.0


@pytest.mark.parametrize(
    ("value", "up"), [(1.0, 1.0), (1.01, 2.0), (3.0, 5.0), (70.0, 100.0), (2e-4, 2e-4), (0.0, 1.0)]
)
def test_limits_are_round(value, up):
    assert rounded_up(value) == pytest.approx(up)
    assert rounded_up(float("nan")) == 1.0


def test_phases_go_round_and_what_is_silent_is_grey():
    drive = np.exp(1j * np.array([0.0, np.pi, 2 * np.pi - 1e-3, 1.0])) * [1.0, 1.0, 1.0, 0.0]
    colours = phase_colours(drive).astype(int)
    assert np.abs(colours[0] - colours[2]).max() <= 3
    assert np.abs(colours[0] - colours[1]).max() > 100
    np.testing.assert_array_equal(colours[3, :3], [150, 150, 150])
    np.testing.assert_array_equal(phase_colours(np.zeros(2, complex))[:, :3], np.full((2, 3), 150))


def test_the_largest_motion_is_seen_as_some_millimetres():
    for largest in (3e-8, 7e-7, 1.1e-5, 4e-4):
        assert 1e-3 <= largest * page.magnified(largest) <= page.DISPLAYED_m
    assert page.magnified(0.0) == 1.0


def test_what_is_left_when_nothing_moves_any_more_is_neither_magnified_nor_coloured():
    assert page.magnified(4e-40) == 1.0
    scale = motion_scale("", 4e-40)
    assert scale.high == 1.0
    np.testing.assert_array_equal(scale.colours(np.array([-4e-40])), scale.colours(np.array([0.0])))


def test_discs_face_where_transducers_emit():
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:2] = [[0, 0, 1], [0, 0, -1]]
    w, x, y, z = facing(directions.astype(np.float32)).T
    turned = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    np.testing.assert_allclose(turned, directions, atol=1e-6)
    vertices, faces = page.disc(0.005)
    assert trimesh.Trimesh(vertices, faces).area == pytest.approx(np.pi * 0.005**2, rel=0.05)
    assert trimesh.Trimesh(vertices, faces).face_normals[:, 2].min() > 0.99
