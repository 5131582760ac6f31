"""What a step takes gives on a GPU what it gives on the CPU. Runs where there is one."""

import numpy as np
import pytest
import warp as wp
from rigid_sphere import geodesic

from palmfield.acoustics.knife_edge import Emitters, KnifeEdges, shadow_nodes
from palmfield.acoustics.occlusion import Occlusion
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.surface_arp import MATRIX_FROM, SurfaceArp
from palmfield.config import ArrayConfig
from palmfield.hand.articulated import bone_poses
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.transforms import IDENTITY, Placement, Transform

pytestmark = pytest.mark.skipif(not wp.is_cuda_available(), reason="no GPU here")

HERE = Placement.of(IDENTITY)
BESIDE = Placement.of(Transform(np.array([0.2, 0.0, 0.0]), np.eye(3)))
GPU = "cuda:0"


@pytest.mark.parametrize(
    "keys", [[{}], [{"precision": "accurate"}], [{}, {"directivity": "point"}], [{"layout": "two_bow_corrected"}]]
)
def test_surface_arp(keys: list[dict[str, object]]) -> None:
    places = [HERE, BESIDE][: len(keys)]
    instances = [ArrayInstance(ArrayConfig.model_validate(one), place) for one, place in zip(keys, places, strict=True)]
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.03, 0.03, (1000, 3)) - [0.0, 0.0, -0.2]
    normals = rng.normal(size=(1000, 3)) * 0.5 - [0.0, 0.0, 1.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    here, there = (SurfaceArp(PhasedArray(instances, places, device).field, 1000) for device in ("cpu", GPU))
    drives = np.exp(2j * np.pi * rng.uniform(size=(MATRIX_FROM, here.field.count)))
    for drive in drives[:3]:
        one, other = here.evaluate(points, normals, drive, flux=True), there.evaluate(points, normals, drive, flux=True)
        for mine, theirs in zip(one, other, strict=True):
            assert (np.abs(theirs - mine) < 1e-4 * np.abs(mine).max()).mean() > 0.998  # the side of a grazing flow
    first = there.evaluate(points, normals, drives[0]).arp.copy()
    np.testing.assert_array_equal(there.evaluate(points, normals, drives[0]).arp, first)
    one, other = here.evaluate_many(points, normals, drives), there.evaluate_many(points, normals, drives)
    assert (np.abs(other - one) < 1e-4 * one.max()).mean() > 0.998


@pytest.mark.parametrize("keys", [{}, {"precision": "accurate"}, {"directivity": "point"}])
@pytest.mark.parametrize("count", [40, 22_000, 140_000])
def test_calls_of_the_field(keys: dict[str, object], count: int) -> None:
    places = [HERE, BESIDE]
    instances = [ArrayInstance(ArrayConfig.model_validate(one), at) for one, at in zip([keys, {}], places, strict=True)]
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.05, 0.05, (count, 3)) + np.array([0.1, 0.0, 0.2])
    normals = np.tile(np.array([0.6, 0.0, -0.8], np.float32), (count, 1))
    here, there = (PhasedArray(instances, places, device).field for device in ("cpu", GPU))
    drives = np.exp(2j * np.pi * rng.uniform(size=(3, here.count)))
    uploaded = there.upload(points)
    outward = wp.array(normals, dtype=wp.vec3, device=GPU)
    for own in ({}, {"gradient": True}, {"normals": normals}):
        names = ("pressure", "gradient")[: 1 + bool(own)]
        # Not waited for in between, so that no drive may come over the one before
        kept = [there.pressure(uploaded, drive, **own | {"normals": outward} if "normals" in own else own)
                for drive in drives]  # fmt: skip
        raw = there.pressure(uploaded.array, drives[0], **own | {"normals": outward} if "normals" in own else own)
        for drive, on_gpu in zip(drives, kept, strict=True):
            one, other = here.pressure(points, drive, **own), there.pressure(points, drive, **own)
            again = there.pressure(points, drive, **own)
            for name in names:
                mine, theirs = getattr(one, name), getattr(other, name)
                size = np.linalg.norm(mine)
                assert np.linalg.norm(theirs - mine) < 1e-4 * size
                assert np.linalg.norm(getattr(on_gpu, name).numpy().view(np.complex64)[..., 0] - mine) < 1e-4 * size
                np.testing.assert_array_equal(getattr(again, name), theirs)
        for name in names:
            mine = getattr(here.pressure(points, drives[0], **own), name)
            assert np.linalg.norm(getattr(raw, name).numpy().view(np.complex64)[..., 0] - mine) < 1e-4 * np.linalg.norm(
                mine
            )


def test_sums_of_few_drives() -> None:
    places = [HERE, BESIDE]
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.03, 0.03, (1000, 3)) - [0.0, 0.0, -0.2]
    normals = np.tile([0.0, 0.0, -1.0], (1000, 1))
    instances = [ArrayInstance(ArrayConfig(), place) for place in places]
    here, there = (SurfaceArp(PhasedArray(instances, places, device).field, 1000) for device in ("cpu", GPU))
    units = np.exp(2j * np.pi * rng.uniform(size=(2, here.field.count)))
    units[0, :256], units[1, 256:] = 0.0, 0.0
    levels = rng.standard_normal((7, 2)) + 1j * rng.standard_normal((7, 2))
    one, other = (at.evaluate_sums(points, normals, units, levels) for at in (here, there))
    assert one.max() > 0.0 and (np.abs(other - one) < 1e-4 * one.max()).mean() > 0.998


def test_occlusion_follows_its_vertices() -> None:
    vertices, faces = geodesic(0.02, 20)
    rng = np.random.default_rng(0)
    points, flux = rng.uniform(-0.05, 0.05, (2000, 3)), rng.normal(size=(2000, 3))
    here, there = (Occlusion(vertices, faces, device) for device in ("cpu", GPU))
    for shift in (0.0, 0.02, -0.03):
        here.move(vertices + shift)
        there.move(vertices + shift)
        assert (here.lit(points, flux, 0.05) != there.lit(points, flux, 0.05)).sum() <= 2  # rays along an edge


def test_a_posed_hand() -> None:
    preset = load_preset("open_men_p50")
    here, there = SkinnedHand(preset, 0.004), SkinnedHand(preset, 0.004, GPU)
    for angle in (0.0, 40.0):
        pose = bone_poses(here.hand, {"index_mcp_flexion": angle})
        one, other = here.posed_surface(*pose), there.posed_surface(*pose)
        np.testing.assert_allclose(other.vertices, one.vertices, atol=1e-7)
        np.testing.assert_allclose(there.posed(*pose), one.vertices, atol=1e-7)
        assert np.einsum("ij,ij->i", other.normals, one.normals).min() > 1.0 - 1e-5


def test_weights_of_shadows_are_those_of_the_cpu() -> None:
    vertices, faces = geodesic(0.02, 12)
    moved = vertices + np.array([0.015, 0.0, 0.1])
    grid = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, 21), np.linspace(-0.02, 0.02, 21)), axis=-1).reshape(-1, 2)
    points, normals = np.column_stack([grid, np.full(441, 0.2)]), np.tile([0.0, 0.0, -1.0], (441, 1))
    weights = []
    for device in ("cpu", GPU):
        arrays = PhasedArray([ArrayInstance(ArrayConfig(layout="uhev1"), HERE)], [HERE], device)
        occlusion = Occlusion(moved, faces, device)
        emitters = Emitters(arrays, np.arange(256, dtype=np.int32), device)
        nodes = shadow_nodes(points, normals, 0.008)
        edges = KnifeEdges(occlusion.outline, emitters, nodes, len(points))
        assert edges.evaluate(points[nodes.numbers], normals[nodes.numbers])
        weights.append(edges.shades.real.numpy() + 1j * edges.shades.imag.numpy())
    assert np.abs(weights[0] - 1.0).max() > 0.5
    # Where a ray grazes a facet, rounding decides whether a piece is hidden
    assert (np.abs(weights[1] - weights[0]) > 1e-3).mean() < 0.02
