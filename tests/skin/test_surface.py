import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trimesh import Trimesh

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe, surface_motion
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude, output_triangles

pytestmark = pytest.mark.numerics

FRACTIONS = np.array([0.0, 0.4, 1.0])


def system_of(patch):
    mesh = extrude(patch, FRACTIONS)
    return assemble(mesh, PRESETS["ecoflex_00-10"], base="free", side="free")


def bowl():
    patch = disc_patch(0.02, 0.005, 0.004, 0.006, 0.01)
    vertices = patch.vertices.copy()
    vertices[:, 2] = 8.0 * (vertices[:, :2] ** 2).sum(axis=1)
    return dataclasses.replace(patch, vertices=vertices)


def test_quadratic_motion_is_read_exactly():
    system = system_of(disc_patch(0.02, 0.005, 0.004, 0.006, 0.01))
    points = np.random.default_rng(0).uniform(-0.012, 0.012, (50, 3)) * [1, 1, 0]
    x, y, _ = system.mesh.nodes.T
    u = np.zeros((len(x), 3))
    u[:, 2] = 3 * x**2 - x * y + 2 * y + 1
    probe = SurfaceProbe(system.mesh, points, system)
    px, py, _ = points.T
    np.testing.assert_allclose(probe.operator @ u.ravel(), 3 * px**2 - px * py + 2 * py + 1, rtol=1e-12)
    motion = surface_motion(system.mesh, system) @ u.ravel()
    np.testing.assert_allclose(motion, u[: system.mesh.surface_nodes, 2], rtol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_closest_points_match_a_search_of_all_triangles(seed):
    system = system_of(bowl())
    mesh = system.mesh
    points = np.random.default_rng(seed).uniform(-0.03, 0.03, (20, 3))
    probe = SurfaceProbe(mesh, points, system)
    surface = Trimesh(mesh.nodes[: mesh.surface_nodes], mesh.surface_triangles6[:, :3], process=False)
    # A fine cloud on the surface gives an upper bound of the distance that closes in on it.
    steps = [(i / 12, j / 12) for i in range(13) for j in range(13 - i)]
    cloud = np.concatenate(
        [
            surface.triangles[:, 0] * (1 - a - b) + surface.triangles[:, 1] * a + surface.triangles[:, 2] * b
            for a, b in steps
        ]
    )
    nearest = np.linalg.norm(points[:, None] - cloud[None], axis=2).min(axis=1)
    assert np.all(probe.distance <= nearest + 1e-12)
    assert np.all(probe.distance >= nearest - 0.006 / 12)


def test_rigid_shift_reads_as_its_normal_part():
    system = system_of(bowl())
    mesh = system.mesh
    shift = np.array([0.3, -0.2, 0.9])
    u = np.tile(shift, len(mesh.nodes))
    np.testing.assert_allclose(surface_motion(mesh, system) @ u, mesh.surface_normals() @ shift, rtol=1e-12)
    probe = SurfaceProbe(mesh, mesh.nodes[:30], system)
    np.testing.assert_allclose(probe.operator @ u, probe.normals @ shift, rtol=1e-12)
    assert np.all(probe.normals[:, 2] > 0.5)


def test_output_triangles_tile_the_surface():
    system = system_of(bowl())
    mesh = system.mesh
    small = Trimesh(mesh.nodes[: mesh.surface_nodes], output_triangles(mesh), process=False)
    assert small.area == pytest.approx(SurfaceQuadrature(mesh, system).weights.sum(), rel=1e-12)
    assert np.all(small.face_normals[:, 2] > 0)
    assert set(np.unique(small.faces)) == set(range(mesh.surface_nodes))
    assert len(small.faces) == 4 * len(mesh.surface_triangles6)


def test_bad_points():
    system = system_of(bowl())
    for points in (np.zeros(3), np.full((1, 3), np.nan)):
        with pytest.raises(SceneError, match="skin points"):
            SurfaceProbe(system.mesh, points, system)
