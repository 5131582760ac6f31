"""The new acoustics and hand give what the old middle gave. To be deleted with emitter, chain, obstacle and posed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield import chain, emitter, obstacle
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.surface_load import distance_to_arrays
from palmfield.config import ArrayConfig, StimulusConfig
from palmfield.drive.device import DEVICES
from palmfield.hand.articulated import bone_poses
from palmfield.hand.blend import blended, bone_shifts
from palmfield.hand.posed_surface import SkinBinding, blend
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.posed import Bound
from palmfield.transforms import IDENTITY, Placement, Transform

TILTED = Transform(np.array([0.25, 0.0, 0.05]), Rotation.from_euler("yx", [-40, 10], degrees=True).as_matrix())


@pytest.fixture(scope="module", params=[{}, {"directivity": "t4010a1"}])
def both(request: pytest.FixtureRequest) -> tuple[emitter.Emitter, PhasedArray]:
    configs = [ArrayConfig(compute="cpu"), ArrayConfig(compute="cpu", layout="sonicsurface", **request.param)]
    places = [Placement.of(IDENTITY), Placement.of(TILTED)]
    olds = [emitter.Placement(*place) for place in places]
    boards = [emitter.Board(config, place) for config, place in zip(configs, olds, strict=True)]
    old = emitter.Emitter(boards, olds, StimulusConfig(), DEVICES["ideal"])
    return old, PhasedArray([ArrayInstance(c, p) for c, p in zip(configs, places, strict=True)], places, "cpu")


def test_field_and_distance(both: tuple[emitter.Emitter, PhasedArray]) -> None:
    old, new = both
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.05, 0.05, (300, 3)) - [0.0, 0.0, -0.2]
    drive = np.exp(2j * np.pi * rng.uniform(size=len(new)))
    np.testing.assert_array_equal(new.array.positions, old.array.positions)
    np.testing.assert_array_equal(new.pressure64(points, drive), old.pressure64(points, drive))
    field, before = new.field.pressure(points, drive, True), old.evaluator.pressure(points, drive, True)
    np.testing.assert_array_equal(field.pressure, before.pressure)
    np.testing.assert_array_equal(field.gradient, before.gradient)
    flux = obstacle.energy_flux(field)
    np.testing.assert_allclose(
        distance_to_arrays(points, flux, new), chain.to_boards(points, flux, old), rtol=1e-9, atol=1e-12
    )
    for part, board in zip(new.parts, new.boards, strict=True):
        for shift in (0.0, 0.19, 0.5):
            assert board.clearance(points - [0.0, 0.0, shift]) == chain.clearance(part, points - [0.0, 0.0, shift])


def test_bound_points() -> None:
    hand = SkinnedHand(load_preset("open_men_p50"), 0.004)
    points, normals = hand.surface.vertices[::11] + 1e-4, hand.surface.normals[::11]
    old, new = Bound.to(hand, points), SkinBinding.to(hand, points)
    np.testing.assert_array_equal(new.bones, old.bones)
    positions, rotations = bone_poses(hand.hand, {"index_mcp_flexion": 50.0, "wrist_flexion": 30.0})
    shift, turn = blended(old.bones, old.shares, bone_shifts(hand.origins, positions, rotations), rotations)
    turned = np.einsum("nij,nj->ni", turn, normals)
    moved = blend(new, hand, positions, rotations, points, normals)
    np.testing.assert_allclose(moved[0], np.einsum("nij,nj->ni", turn, points) + shift, atol=1e-15)
    np.testing.assert_allclose(moved[1], turned / np.linalg.norm(turned, axis=1, keepdims=True), atol=1e-14)
