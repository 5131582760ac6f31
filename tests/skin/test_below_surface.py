"""Motion below the skin: read from the elements, against polynomials and Boussinesq's half space."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.below_surface import below_surface
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.solver import static
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude

pytestmark = pytest.mark.numerics

SPOT_M = 0.0103


def places(mesh, count=40, seed=0):
    random = np.random.default_rng(seed)
    triangles = random.integers(0, len(mesh.surface_triangles6), count).astype(np.int32)
    local = random.random((count, 2))
    local = np.where(local.sum(axis=1, keepdims=True) > 1.0, 1.0 - local, local)
    shares = np.column_stack([1.0 - local.sum(axis=1), local])
    return triangles, local, np.einsum("pi,pic->pc", shares, mesh.nodes[mesh.surface_triangles6[triangles, :3]])


@pytest.mark.parametrize("depth_m", [0.0, 7e-4, 2e-3, 4.9e-3])
def test_quadratic_motion_and_its_slope_are_read_exactly(depth_m):
    mesh = extrude(disc_patch(0.02, 0.005, 0.004, 0.006, 0.01), np.array([0.0, 0.4, 1.0]))
    system = assemble(mesh, PRESETS["ecoflex_00-10"], base="free", side="free")
    triangles, local, points = places(mesh)
    moved, pressed = below_surface(mesh, system, triangles, local, depth_m)
    x, y, z = mesh.nodes.T
    u = np.column_stack([x * z, y**2, 3 * x**2 - x * z + 2 * z**2 + 5 * z + 1])
    px, _, pz = (points - [0.0, 0.0, depth_m]).T
    np.testing.assert_allclose(moved @ u.ravel(), -(3 * px**2 - px * pz + 2 * pz**2 + 5 * pz + 1), rtol=1e-11)
    np.testing.assert_allclose(pressed @ u.ravel(), -(-px + 4 * pz + 5), rtol=1e-9)


def test_depth_is_along_the_normal_of_a_tilted_skin():
    flat = extrude(disc_patch(0.02, 0.005, 0.004, 0.006, 0.01), np.array([0.0, 0.4, 1.0]))
    angle = 0.4
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    mesh = replace(flat, nodes=flat.nodes @ turn.T)
    system = assemble(mesh, PRESETS["ecoflex_00-10"], base="free", side="free")
    triangles, local, points = places(mesh)
    moved, pressed = below_surface(mesh, system, triangles, local, 1e-3)
    along = (mesh.nodes - 0.0) @ turn[:, 2]
    u = np.outer(along**2, turn[:, 2])
    depth = points @ turn[:, 2] - 1e-3
    np.testing.assert_allclose(moved @ u.ravel(), -(depth**2), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(pressed @ u.ravel(), -2.0 * depth, rtol=1e-9)


def test_a_layer_that_ends_above_the_point_is_refused():
    mesh = extrude(disc_patch(0.02, 0.001, 0.004, 0.006, 0.01), np.array([0.0, 1.0]))
    system = assemble(mesh, PRESETS["ecoflex_00-10"], base="free", side="free")
    with pytest.raises(SceneError, match="a point 2 mm below the skin lies outside the layer, which is 1 mm deep"):
        below_surface(mesh, system, *places(mesh)[:2], 2e-3)


@pytest.mark.parametrize("depth_m", [7e-4, 2e-3])
def test_motion_under_a_spot_is_that_of_a_half_space(depth_m):
    """A deep disc under a Gaussian spot: u = (phi - z phi') / (4 pi G), compression z phi'' / (4 pi G), at r."""
    material = PRESETS["palm"]
    mesh = extrude(disc_patch(0.05, 0.05, 0.003, 0.012, 0.012), np.array([0.0, 0.02, 0.06, 0.15, 0.4, 1.0]))
    system = assemble(mesh, material, side="roller")
    width, quadrature = SPOT_M / np.sqrt(8.0 * np.log(2.0)), SurfaceQuadrature(mesh, system)
    distance2 = (quadrature.points[:, :2] ** 2).sum(axis=1)
    u = static(system, quadrature.assemble(np.exp(-0.5 * distance2 / width**2)))
    middles = mesh.nodes[mesh.surface_triangles6[:, :3]].mean(axis=1)
    chosen = np.argsort(np.linalg.norm(middles, axis=1))[:20].astype(np.int32)
    (at_top, _), (moved, pressed) = (
        below_surface(mesh, system, chosen, np.full((20, 2), 1.0 / 3.0), depth) for depth in (0.0, depth_m)
    )

    def potential(power, r, depth):
        """Derivative of phi by depth, without its sign, over 4 pi G."""
        whole, _ = quad(lambda k: j0(k * r) * k**power * np.exp(-0.5 * (k * width) ** 2 - k * depth), 0.0, 12.0 / width)
        return width**2 * whole / (2.0 * material.shear_relaxed_Pa)

    def displacement(r, depth):
        return potential(0, r, depth) + depth * potential(1, r, depth)

    distances = np.linalg.norm(middles[chosen, :2], axis=1)
    compression = [depth_m * potential(2, r, depth_m) for r in distances]
    assert np.abs(pressed @ u - compression).max() < 0.03 * max(compression)
    # The base at 50 mm holds back the displacement as a whole, but hardly its change with depth
    change = [displacement(r, 0.0) - displacement(r, depth_m) for r in distances]
    assert np.abs((at_top - moved) @ u - change).max() < 0.1 * max(change)
