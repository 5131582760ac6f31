"""Particles, their pairs and the two conditions that make gradients and forces exact."""

import math

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material, Sheet
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.problem import Layer, Slab
from palmfield.skin.solvers.particles.cloud import build_cloud
from palmfield.skin.solvers.particles.solve import point_weights
from palmfield.types import Patch

SOFT = Material("soft", 1000.0, 1e4, (), 1e5, "")
HARD = Material("hard", 2000.0, 1e7, (), 1e8, "")
BOX = Slab((Sheet(SOFT, 4e-3),), "box", "free", "free", size_m=(9e-3, 7e-3))
DISC = Slab((Sheet(SOFT, 4e-3),), "disc", "free", "free", radius_m=6e-3)
TWO = Slab((Sheet(HARD, 1e-3), Sheet(SOFT, 4e-3)), "box", "free", "free", size_m=(8e-3, 8e-3))


def cap(shift=0.0) -> Patch:
    """A disc bent onto a sphere of 20 mm, moved by `shift` along x."""
    flat = disc_patch(6e-3, 2e-3, 1.5e-3, 1.5e-3, 6e-3)
    x, y = flat.vertices[:, :2].T
    z = np.sqrt(20e-3**2 - x**2 - y**2)
    inward = -np.column_stack([x, y, z]) / 20e-3
    vertices = np.column_stack([x + shift, y, z - 20e-3])
    return Patch(vertices, flat.faces, inward, flat.depth, flat.rim)


CAP = Layer(cap(), (Sheet(HARD, 1e-3), Sheet(SOFT, 2e-3)), "free", "free")
BODIES = {"box": BOX, "disc": DISC, "two sheets": TWO, "cap of two sheets": CAP}


@pytest.fixture(params=BODIES, scope="module")
def cloud(request):
    return build_cloud(BODIES[request.param], 1e-3)


def own_area(cloud):
    return -cloud.area.sum(axis=1)


def test_gradients_of_linear_fields_are_exact(cloud):
    found = np.einsum("skc,skd->scd", cloud.area, cloud.offset) / cloud.volume[:, None, None]
    np.testing.assert_allclose(found, np.broadcast_to(np.eye(3), found.shape), atol=1e-12)


def test_area_vectors_close_inside_and_make_up_the_faces(cloud):
    """Over all sites of a particle they sum to the area vector of the body's boundary there: 0 inside."""
    total = np.zeros_like(cloud.points)
    np.add.at(total, cloud.neighbour, cloud.area)
    np.add.at(total, cloud.owner, own_area(cloud))
    per_level, levels = len(cloud.columns.face), len(cloud.columns.shares)
    inner = np.setdiff1d(np.arange(per_level), cloud.columns.rim)
    size = np.abs(cloud.face_area).max()
    middle = (np.arange(1, levels - 1)[:, None] * per_level + inner).ravel()
    np.testing.assert_allclose(total[middle] / size, 0.0, atol=1e-12)
    np.testing.assert_allclose(total[inner] / size, cloud.face_area[inner] / size, atol=1e-12)


def test_volume_and_mass():
    cloud = build_cloud(TWO, 1e-3)
    assert cloud.volume.sum() == pytest.approx(8e-3 * 8e-3 * 5e-3, rel=1e-12)
    assert cloud.mass.sum() == pytest.approx(8e-3 * 8e-3 * (1e-3 * 2000.0 + 4e-3 * 1000.0), rel=1e-12)
    assert cloud.face_area.sum(axis=0) == pytest.approx([0.0, 0.0, 8e-3 * 8e-3], abs=1e-18)


def test_a_disc_has_the_volume_of_its_rim_polygon():
    cloud = build_cloud(DISC, 1e-3)
    count = len(cloud.columns.rim)
    polygon = 0.5 * count * 6e-3**2 * math.sin(2 * math.pi / count)
    assert cloud.volume.sum() == pytest.approx(polygon * 4e-3, rel=1e-12)


def test_curved_layer_has_the_volume_of_its_shell():
    """Spherical cap of 20 mm, depth 2 mm, half angle from its rim; flat cells lie within it by O(h^2)."""
    cloud = build_cloud(CAP, 1e-3)
    share = 1.0 - math.sqrt(1.0 - (6 / 20) ** 2)
    shell = 2.0 * math.pi / 3.0 * share * (20e-3**3 - 18e-3**3)
    assert cloud.volume.sum() == pytest.approx(shell, rel=0.02)


def test_lattice_is_a_corrected_kernel_gradient():
    """Inside a cubic lattice, area vectors are those of moving least squares with weights 2/9, 1/18, 1/72."""
    cloud = build_cloud(Slab((Sheet(SOFT, 4e-3),), "box", "free", "free", size_m=(4e-3, 4e-3)), 1e-3)
    middle = int(np.argmin(np.linalg.norm(cloud.points - [0, 0, -2e-3], axis=1)))
    steps = np.rint(cloud.offset[middle] / 1e-3)
    weights = np.array([0.0, 2 / 9, 1 / 18, 1 / 72])[np.abs(steps).sum(axis=1).astype(int)]
    moment = np.einsum("k,kc,kd->cd", weights, steps, steps)
    kernel = weights[:, None] * steps @ np.linalg.inv(moment)
    np.testing.assert_allclose(cloud.area[middle] / 1e-6, kernel, atol=1e-12)
    np.testing.assert_allclose(cloud.moment[middle] / 1e-9, np.eye(3), atol=1e-12)


def test_every_pair_comes_in_once():
    cloud = build_cloud(TWO, 1e-3)
    width = cloud.neighbour.shape[1]
    listed = [cloud.incoming[i, : cloud.incoming_count[i]] for i in range(len(cloud.points))]
    places = np.sort(np.concatenate(listed))
    expected = [s * width + k for s in range(len(cloud.owner)) for k in range(cloud.count[s])]
    np.testing.assert_array_equal(places, expected)
    for i in (0, 40, len(listed) - 1):
        assert np.all(cloud.neighbour.ravel()[listed[i]] == i)


def test_particles_between_materials_have_a_site_in_each():
    cloud = build_cloud(TWO, 1e-3)
    sites = np.diff(cloud.site_start)
    between = np.isclose(cloud.points[:, 2], -1e-3)
    assert np.all(sites[between] == 2) and np.all(sites[~between] == 1)


def test_held_directions():
    body = Slab((Sheet(SOFT, 4e-3),), "box", "free_slip", "roller", size_m=(4e-3, 4e-3))
    cloud = build_cloud(body, 1e-3)
    ranks = np.rint(np.trace(cloud.free, axis1=1, axis2=2)).astype(int)
    side = (np.abs(np.abs(cloud.points[:, :2]) - 2e-3) < 1e-9).sum(axis=1)
    base = np.isclose(cloud.points[:, 2], -4e-3).astype(int)
    np.testing.assert_array_equal(ranks, 3 - side - base)


def test_points_of_the_face():
    cloud = build_cloud(BOX, 1e-3)
    at = np.array([[0.3e-3, 0.45e-3], [4.5e-3, 3.5e-3], [0.0, 0.0]])
    _, near, weights = point_weights(cloud.columns, cloud.face_area, at)
    x, y = cloud.points[:, 0], cloud.points[:, 1]
    p, q = at.T
    for field, exact in (
        (x**0, p**0), (x, p), (y, q), (x**2, p**2), (x * y, p * q), (y**2, q**2)
    ):  # fmt: skip
        np.testing.assert_allclose((weights * field[near]).sum(axis=1), exact, rtol=1e-9, atol=1e-14)
    anything = np.random.default_rng(1).standard_normal(len(x))
    middle = int(np.argmin(np.linalg.norm(cloud.columns.face, axis=1)))
    assert (weights[2] * anything[near[2]]).sum() == pytest.approx(anything[middle], abs=1e-4)


def test_errors():
    with pytest.raises(SceneError, match="spacing_m is 0"):
        build_cloud(BOX, 0.0)
    with pytest.raises(SceneError, match="wide"):
        build_cloud(BOX, 5e-3)
    cloud = build_cloud(BOX, 1e-3)
    with pytest.raises(SceneError, match="from the face"):
        point_weights(cloud.columns, cloud.face_area, np.array([[0.1, 0.0]]))
    with pytest.raises(SceneError, match="shape"):
        point_weights(cloud.columns, cloud.face_area, np.zeros(3))
    deep = cap()
    folded = Patch(deep.vertices, deep.faces, deep.inward, np.full(len(deep.depth), 30e-3), deep.rim)
    with pytest.raises(SceneError, match="near"):
        build_cloud(Layer(folded, (Sheet(SOFT, 1.0),), "free", "free"), 1e-3)
