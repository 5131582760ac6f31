"""Elements and matrices: patch test, rigid motion, symmetry, boundary conditions."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse.linalg import splu
from trimesh.creation import icosphere

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem import assembly
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import surface_motion
from palmfield.skin.fem.solver import static
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Branch, Material, bulk_from_poisson
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.types import Patch

pytestmark = pytest.mark.numerics

THIRDS = np.array([0.0, 0.35, 1.0])


def solid(nu=0.4999, shear=1e4):
    return Material("solid", 1000.0, shear, (Branch(2e4, 1e-3),), bulk_from_poisson(nu, shear), "")


def crooked_mesh(stretch=1.0):
    """A curved shell of varying depth, its inward directions not parallel, its surface nodes shaken."""
    rng = np.random.default_rng(3)
    flat = disc_patch(0.02, 0.008, 0.006, 0.008, 0.01)
    vertices = flat.vertices.copy()
    inside = ~flat.rim
    vertices[inside, :2] += rng.uniform(-1e-3, 1e-3, (inside.sum(), 2))
    vertices[:, 2] = -10.0 * (vertices[:, :2] ** 2).sum(axis=1) + rng.uniform(-5e-4, 5e-4, len(vertices))
    inward = flat.inward + rng.uniform(-0.15, 0.15, vertices.shape)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    depth = flat.depth + rng.uniform(0.0, 0.002, len(vertices))
    vertices[:, 0] *= stretch
    return extrude(dataclasses.replace(flat, vertices=vertices, inward=inward, depth=depth, axis=None), THIRDS)


@pytest.mark.parametrize("nu", [0.0, 0.495, 0.499999])
@pytest.mark.parametrize("stretch", [1.0, 1000.0])
def test_patch_test(nu, stretch):
    """A linear displacement on the boundary gives that displacement inside, whatever the shape of the elements."""
    mesh = crooked_mesh(stretch)
    system = assemble(mesh, solid(nu), base="free", side="free")
    gradient = np.random.default_rng(5).normal(size=(3, 3))
    linear = (mesh.nodes @ gradient.T).ravel()
    stiffness = (system.parts[0].stiffness + system.elastic).tocsc()
    boundary = np.unique(np.concatenate([mesh.base, mesh.side, np.arange(mesh.surface_nodes)]))
    held = np.zeros(len(mesh.nodes), dtype=bool)
    held[boundary] = True
    held = np.repeat(held, 3)
    assert 30 < np.sum(~held) < len(held)
    # Without a pressure field, round-off grows with K/G and with the stretch: hold the residual against its own terms.
    residual = (stiffness @ linear)[~held]
    terms = (abs(stiffness) @ abs(linear))[~held]
    assert np.abs(residual / terms).max() < 1e-13
    inside = splu(stiffness[~held][:, ~held]).solve(-(stiffness[~held][:, held] @ linear[held]))
    if stretch == 1.0:
        scale = np.abs(linear).max()
        np.testing.assert_allclose(inside, linear[~held], atol=scale * (1e-11 if nu < 0.4999 else 1e-8))


def test_rigid_motion_is_free_and_matrices_are_symmetric():
    mesh = crooked_mesh()
    system = assemble(mesh, solid(), base="free", side="free")
    x, y, z = mesh.nodes.T
    zero = np.zeros_like(x)
    for turn in ([-y, x, zero], [zero, -z, y], [z, zero, -x], [zero + 1, zero, zero]):
        motion = np.column_stack(turn).ravel()
        for matrix in (system.parts[0].stiffness, system.elastic):
            assert np.abs(matrix @ motion).max() < 1e-12 * abs(matrix).max() * np.abs(motion).max()
    for matrix in (system.parts[0].stiffness, system.elastic, system.mass):
        assert abs(matrix - matrix.T).max() < 1e-14 * abs(matrix).max()


def test_free_body_has_exactly_six_motions_without_energy():
    mesh = extrude(disc_patch(0.02, 0.01, 0.012, 0.012, 0.01), np.array([0.0, 1.0]))
    system = assemble(mesh, solid(0.495), base="free", side="free")
    values = np.linalg.eigvalsh((system.parts[0].stiffness + system.elastic).toarray())
    assert np.sum(values < 1e-10 * values[-1]) == 6


def test_uniform_strain_has_its_exact_energy():
    mesh = crooked_mesh()
    material = solid(0.4)
    system = assemble(mesh, material, base="free", side="free")
    gradient = np.array([[0.1, 0.3, -0.2], [0.0, -0.4, 0.1], [0.2, 0.2, 0.25]])
    linear = (mesh.nodes @ gradient.T).ravel()
    strain = 0.5 * (gradient + gradient.T)
    deviator = strain - np.trace(strain) / 3 * np.eye(3)
    ones = np.tile([1.0, 0.0, 0.0], len(mesh.nodes))
    volume = ones @ system.mass @ ones / material.density_kg_m3
    shear_energy = 2 * material.shear_relaxed_Pa * np.sum(deviator**2) * volume
    assert linear @ system.parts[0].stiffness @ linear == pytest.approx(shear_energy, rel=1e-12)
    assert linear @ system.elastic @ linear == pytest.approx(
        material.bulk_Pa * np.trace(strain) ** 2 * volume, rel=1e-12
    )


def test_load_of_uniform_pressure_is_area_times_pressure():
    mesh = crooked_mesh()
    system = assemble(mesh, solid(), base="free", side="free")
    quadrature = SurfaceQuadrature(mesh, system)
    force = quadrature.assemble(np.full(len(quadrature.weights), 7.0)).reshape(-1, 3)
    a, b, c = mesh.nodes[mesh.surface_triangles6[:, :3]].transpose(1, 0, 2)
    push = -7.0 * 0.5 * np.cross(b - a, c - a)  # of each plane triangle, at its centroid
    np.testing.assert_allclose(force.sum(axis=0), push.sum(axis=0), rtol=1e-12)
    moment = np.cross(mesh.nodes, force).sum(axis=0)
    np.testing.assert_allclose(moment, np.cross((a + b + c) / 3.0, push).sum(axis=0), atol=1e-15)
    with pytest.raises(SceneError, match="one value"):
        quadrature.assemble(np.ones(3))


def test_uniform_pressure_on_a_roller_disc_is_exactly_confined_compression():
    """Roller sides on a polygon are planes: u = z p / (K + 4 G / 3), no error but round-off."""
    material = solid(0.495)
    mesh = extrude(disc_patch(0.03, 0.02, 0.01, 0.015, 0.01), THIRDS)
    for base in ("bonded", "free_slip"):
        system = assemble(mesh, material, base=base, side="roller")
        quadrature = SurfaceQuadrature(mesh, system)
        u = system.dof_map @ static(system, quadrature.assemble(np.ones(len(quadrature.weights))))
        modulus = material.bulk_Pa + 4 / 3 * material.shear_relaxed_Pa
        expected = np.zeros_like(mesh.nodes)
        expected[:, 2] = -(mesh.nodes[:, 2] + 0.02) / modulus
        # A slippery base lets the disc spin about its axis; its push is defined all the same.
        compared = slice(0, 3) if base == "bonded" else slice(2, 3)
        np.testing.assert_allclose(u.reshape(-1, 3)[:, compared], expected[:, compared], atol=1e-9 * 0.02 / modulus)


def test_pressed_sphere_on_a_rigid_core():
    """Closed curved patch, inward directions all different: u = A r + B / r^2 (Lame), zero at the core, -p outside.

    The flat facets leave an error of second order in the edge length.
    """
    material, outer, core = solid(0.495), 0.03, 0.018
    # 3 K A - 4 G B / r^3 = -1 at the outside and A + B / r^3 = 0 at the core.
    a = -1.0 / (3 * material.bulk_Pa + 4 * material.shear_relaxed_Pa * (core / outer) ** 3)
    exact = a * outer * (1 - (core / outer) ** 3)
    errors = []
    for subdivisions in (1, 2, 3):
        ball = icosphere(subdivisions=subdivisions, radius=outer)
        count = len(ball.vertices)
        patch = Patch(
            vertices=np.array(ball.vertices),
            faces=np.array(ball.faces, dtype=np.int32),
            inward=-ball.vertices / outer,
            depth=np.full(count, outer - core),
            rim=np.zeros(count, dtype=bool),
        )
        mesh = extrude(patch, np.array([0.0, 1.0]))
        system = assemble(mesh, material)
        quadrature = SurfaceQuadrature(mesh, system)
        force = quadrature.assemble(np.ones(len(quadrature.weights)))
        u = static(system, force)
        # The load's work by area is the mean push over the surface, vertices and sunken middles of facets alike.
        errors.append(abs(-(force @ u) / quadrature.weights.sum() / exact - 1))
        assert np.ptp((surface_motion(mesh, system) @ u)[:count]) < 0.01 * abs(exact)
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    print("sphere errors", errors, "rates", rates)
    assert errors[2] < 0.005
    np.testing.assert_allclose(rates, 2.0, atol=0.1)


def test_foundation_replaces_the_missing_half_of_a_column():
    """Half the depth on the normal stiffness of the other half moves like the whole column."""
    material = solid(0.495)
    modulus = material.bulk_Pa + 4 / 3 * material.shear_relaxed_Pa
    mesh = extrude(disc_patch(0.03, 0.01, 0.01, 0.015, 0.01), THIRDS)
    system = assemble(mesh, material, side="roller", foundation_Pa_m=(modulus / 0.01, 1e4 / 0.01))
    quadrature = SurfaceQuadrature(mesh, system)
    u = (system.dof_map @ static(system, quadrature.assemble(np.ones(len(quadrature.weights))))).reshape(-1, 3)
    np.testing.assert_allclose(u[: mesh.surface_nodes, 2], -0.02 / modulus, rtol=1e-9)


def test_tangential_foundation_carries_shear():
    material = solid(0.495)
    mesh = extrude(disc_patch(0.03, 0.01, 0.01, 0.015, 0.01), THIRDS)
    system = assemble(mesh, material, side="free", foundation_Pa_m=(0.0, 3e5))
    sideways = np.tile([1e-3, 0.0, 0.0], len(mesh.nodes))
    area = SurfaceQuadrature(mesh, system).weights.sum()
    assert (system.parts[0].stiffness @ sideways)[::3].sum() == pytest.approx(3e5 * area * 1e-3, rel=1e-9)


def test_side_conditions_and_their_spread(make_spot):
    """Roller must match its series; the two others stay within a percent of it at 60 mm, being 6 widths away."""
    pushes = {}
    for side in ("fixed", "roller", "free"):
        spot = make_spot(0.008, 2, side=side)
        pushes[side] = spot.push(static(spot.system, spot.force))
    exact = centre_response(0.0, spot.system.material, 0.02, 0.0103, 0.06).real
    print({side: f"{push / exact - 1:+.4f}" for side, push in pushes.items()})
    assert pushes["roller"] == pytest.approx(exact, rel=0.01)
    assert pushes["fixed"] < pushes["free"]
    assert pushes["fixed"] == pytest.approx(pushes["roller"], rel=0.01)
    assert pushes["free"] == pytest.approx(pushes["roller"], rel=0.01)


def test_dissection_is_a_permutation_with_columns_together(coarse_spot):
    system = coarse_spot.system
    order = system.elimination_order()
    np.testing.assert_array_equal(np.sort(order), np.arange(system.ndof))
    owner = system.surface_node[order]
    assert np.sum(np.diff(owner) != 0) + 1 == len(np.unique(owner))


def test_bad_conditions():
    mesh = crooked_mesh()
    with pytest.raises(SceneError, match="need a patch with an axis"):
        assemble(mesh, solid(), side="roller")
    with pytest.raises(SceneError, match="glued"):
        assemble(mesh, solid(), base="glued")
    with pytest.raises(SceneError, match="foundation"):
        assemble(mesh, solid(), foundation_Pa_m=(-1.0, 0.0))


def test_matrices_are_assembled_when_they_are_asked_for_and_their_materials_are_known_before(monkeypatch):
    """Two sheets on springs: two relaxation laws are not mixed up, and no element is integrated early."""
    calls = []
    whole = assembly.element_matrices
    monkeypatch.setattr(assembly, "element_matrices", lambda mesh: calls.append(mesh) or whole(mesh))
    mesh = extrude(disc_patch(0.01, 0.004, 0.004, 0.004, 0.004), np.linspace(0.0, 1.0, 3))
    rows = [preset("palm"), preset("ecoflex_00-10")]
    system = assemble(mesh, rows, foundation_Pa_m=(1e5, 1e5))
    assert system.ndof == system.dof_map.shape[1] and system.materials == tuple(rows) and not calls
    assert tuple(part.material for part in system.parts) == system.materials and len(calls) == 1
    assert system.mass.shape == (system.ndof, system.ndof) and len(calls) == 1
