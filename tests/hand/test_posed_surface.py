"""Points and faces of a posed skin against the whole skin's kernel, rigid motion and plane geometry."""

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from rigid_sphere import geodesic
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import bone_poses
from palmfield.hand.posed_surface import FaceSampler, SkinBinding
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.hand.triangles import face_normals, face_samples

BENT = {"index_mcp_flexion": 50.0, "wrist_flexion": 30.0, "thumb_cmc_flexion": 10.0}


@pytest.fixture(scope="module")
def hand() -> SkinnedHand:
    return SkinnedHand(load_preset("open_men_p50"), 0.004)


def python_calls(function: Callable[[], object]) -> int:
    calls = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    function()
    sys.setprofile(count)
    function()
    sys.setprofile(None)
    return calls


def test_bound_vertices_go_with_the_skin(hand: SkinnedHand) -> None:
    points, normals = hand.surface.vertices[::7], hand.surface.normals[::7]
    binding = SkinBinding.to(hand, points)
    assert binding.bones.shape == binding.shares.shape == (len(points), 4)
    np.testing.assert_allclose(binding.weights.sum(axis=0), 1.0, atol=1e-12)
    for angles in ({}, BENT):
        pose = bone_poses(hand.hand, angles)
        moved, turned = binding.blend(hand, *pose, points, normals)
        np.testing.assert_allclose(moved, hand.posed(*pose)[::7], atol=2e-7)
        np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0, atol=1e-12)
        # A vertex's normal is that of its faces; where the skin is stretched by a joint the two differ
        assert np.median(np.einsum("ij,ij->i", turned, hand.posed_surface(*pose).normals[::7])) > 0.999


def test_points_within_faces_go_with_their_face(hand: SkinnedHand) -> None:
    corners = hand.surface.vertices[hand.surface.faces[::50]]
    points = np.einsum("k,nki->ni", [0.2, 0.3, 0.5], corners)
    normals, _ = face_normals(hand.surface.vertices, hand.surface.faces[::50])
    pose = bone_poses(hand.hand, BENT)
    moved, _ = SkinBinding.to(hand, points).blend(hand, *pose, points, normals)
    expected = np.einsum("k,nki->ni", [0.2, 0.3, 0.5], hand.posed(*pose)[hand.surface.faces[::50]])
    # Weights that are blended within a face turn its points a little apart from its plane
    assert np.linalg.norm(moved - expected, axis=1).max() < 3e-4


def test_rigid_motion(hand: SkinnedHand) -> None:
    points, normals = hand.surface.vertices[:50], hand.surface.normals[:50]
    positions, rotations = bone_poses(hand.hand, {})
    turn, shift = Rotation.from_euler("xyz", [20, -50, 130], degrees=True), np.array([0.3, -0.1, 0.2])
    binding = SkinBinding.to(hand, points)
    moved, turned = binding.blend(hand, turn.apply(positions) + shift, turn.as_matrix() @ rotations, points, normals)
    np.testing.assert_allclose(moved, turn.apply(points) + shift, atol=1e-12)
    np.testing.assert_allclose(turned, turn.apply(normals), atol=1e-12)


def test_a_point_far_from_the_skin_is_refused(hand: SkinnedHand) -> None:
    with pytest.raises(SceneError, match=r"point 1 at \[0\.5, 0\.0, 0\.0\] m is more than 50 mm"):
        SkinBinding.to(hand, np.array([hand.surface.vertices[0], [0.5, 0.0, 0.0]]))


def test_faces_of_a_sphere_that_moves_and_grows() -> None:
    vertices, faces = geodesic(0.02, 10)
    sampler = FaceSampler(faces, len(vertices))
    for scale, shift in ((1.0, 0.0), (1.5, 0.1)):
        samples = sampler.at(scale * vertices + shift)
        plain = face_samples(scale * vertices + shift, faces)
        for mine, other in zip(samples, plain, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-15)
        assert samples.areas.sum() == pytest.approx(4 * np.pi * (scale * 0.02) ** 2, rel=0.01)
        outward = (samples.centroids - shift) / np.linalg.norm(samples.centroids - shift, axis=1, keepdims=True)
        assert np.einsum("ij,ij->i", outward, samples.normals).min() > 0.99


def test_a_face_without_area_has_no_normal() -> None:
    samples = FaceSampler(np.array([[0, 1, 1], [0, 1, 2]], np.int32), 3).at(np.eye(3))
    np.testing.assert_array_equal(samples.normals[0], 0.0)
    assert samples.areas[0] == 0.0 and samples.areas[1] == pytest.approx(np.sqrt(3.0) / 2.0)


def test_several_threads_pose_one_hand(hand: SkinnedHand) -> None:
    poses = [bone_poses(hand.hand, {"index_mcp_flexion": angle}) for angle in (0.0, 20.0, 40.0, 60.0)] * 10
    expected = [hand.posed(*pose) for pose in poses]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(expected, pool.map(lambda pose: hand.posed(*pose), poses), strict=True):
            np.testing.assert_array_equal(one, other)


def test_python_calls(hand: SkinnedHand) -> None:
    pose = bone_poses(hand.hand, BENT)
    points, normals = hand.surface.vertices[:100], hand.surface.normals[:100]
    binding = SkinBinding.to(hand, points)
    sampler = FaceSampler(hand.surface.faces, len(hand.surface.vertices))
    vertices = hand.posed(*pose)
    assert python_calls(lambda: hand.posed(*pose)) <= 15
    assert python_calls(lambda: binding.blend(hand, *pose, points, normals)) <= 10
    assert python_calls(lambda: sampler.at(vertices)) <= 5
