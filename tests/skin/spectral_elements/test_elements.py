"""Spectral hexahedra: geometry, patch test, dispersion, locking, the largest rate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, cg
from spectral_states import element_forces

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import GAUSSIAN
from palmfield.skin.solvers.spectral_elements.model import Model, hold
from palmfield.skin.solvers.spectral_elements.places import find
from palmfield.skin.solvers.spectral_elements.solid import (
    box_quads,
    disc_quads,
    extrude,
    face_areas,
    lagrange,
    patch_quads,
    rule,
)
from palmfield.types import Patch

pytestmark = pytest.mark.numerics


def gel(nu: float = 0.495, shear: float = 12.5e3, branches: tuple[Branch, ...] = ()) -> Material:
    return Material("gel", 1030.0, shear, branches, bulk_from_poisson(nu, shear), "test")


def bent_patch(rings: int = 3, place: float = 0.0) -> Patch:
    """A saddle of triangles with slanted inward directions and uneven depth."""
    line = np.linspace(-0.01, 0.01, rings + 1)
    x, y = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    grid = np.arange((rings + 1) ** 2).reshape(rings + 1, -1)
    a, b, c, d = (g.ravel() for g in (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]))
    vertices = np.column_stack([x, y, 8.0 * (x**2 - y**2)]) + place
    inward = np.column_stack([10.0 * x, -5.0 * y, -np.ones_like(x)])
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)
    rim = (np.abs(x) > 0.0099) | (np.abs(y) > 0.0099)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    return Patch(vertices, faces, inward, 0.004 * (1.0 + 10.0 * x), rim)


def inner_nodes(solid) -> np.ndarray:
    count = solid.surface_nodes
    inner = np.ones(len(solid.nodes), dtype=bool)
    inner[:count] = inner[-count:] = False
    inner[(np.flatnonzero(solid.quads.rim) + count * np.arange(solid.levels)[:, None]).ravel()] = False
    return inner


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_rule_integrates_and_differentiates_its_polynomials(order):
    gll = rule(order)
    for power in range(2 * order):
        exact = 0.0 if power % 2 else 2.0 / (power + 1)
        assert gll.weights @ gll.nodes**power == pytest.approx(exact, abs=1e-14)
    for power in range(order + 1):
        slope = power * gll.nodes ** max(power - 1, 0)
        assert gll.derivative @ gll.nodes**power == pytest.approx(slope, abs=1e-12)
        assert lagrange(order, np.array([0.3])) @ gll.nodes**power == pytest.approx(0.3**power, abs=1e-13)


@pytest.mark.parametrize("order, bent", [(1, False), (2, True), (3, True), (4, True)])
def test_patch_test(order, bent):
    """A linear displacement gives its constant stress: no force inside, and the exact work.

    Order 1 integrates at its corners, too coarsely for elements that are no prisms.
    """
    material = gel()
    patch = bent_patch()
    if not bent:
        count = len(patch.vertices)
        patch = replace(patch, inward=np.tile([0.3, -0.2, -0.9], (count, 1)), depth=np.full(count, 0.004))
    sheets = (Sheet(material, 0.001), Sheet(material, 0.003))
    solid = extrude(patch_quads(patch, order), sheets, (1, 2))
    model = Model(solid, sheets, "cpu", "float64")
    slope = np.random.default_rng(0).standard_normal((3, 3))
    u = solid.nodes @ slope.T
    force = element_forces(model, u, u)
    assert np.abs(force[inner_nodes(solid)]).max() < 1e-12 * np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-11 * np.abs(force).max()
    strain = 0.5 * (slope + slope.T)
    trace = np.trace(strain)
    deviator = strain - trace / 3.0 * np.eye(3)
    work = (2.0 * material.shear_relaxed_Pa * (deviator**2).sum() + material.bulk_Pa * trace**2) * model.volume.sum()
    assert (u * force).sum() == pytest.approx(work, rel=1e-12)


def test_a_turn_gives_no_force():
    sheets = (Sheet(gel(), 0.004),)
    solid = extrude(patch_quads(bent_patch(), 3), sheets, (1,))
    model = Model(solid, sheets, "cpu", "float64")
    turned = np.cross([0.3, -0.2, 0.9], solid.nodes)
    stretched = solid.nodes * np.array([1.0, 0.0, 0.0])
    assert (
        np.abs(element_forces(model, turned, turned)).max()
        < 1e-11 * np.abs(element_forces(model, stretched, stretched)).max()
    )


def test_disc_has_its_volume_and_area_to_the_order_of_its_curve():
    errors = []
    for order in (1, 2, 3):
        solid = extrude(disc_quads(0.02, 0.027, 6, np.array([0.045, 0.06]), order), (Sheet(gel(), 0.02),), (2,))
        model = Model(solid, (Sheet(gel(), 0.02),), "cpu", "float64")
        errors.append(abs(model.volume.sum() / (np.pi * 0.06**2 * 0.02) - 1.0))
        assert face_areas(solid).sum(axis=0) == pytest.approx([0.0, 0.0, np.pi * 0.06**2], rel=0.02, abs=1e-12)
        rim = solid.quads.rim_normals[solid.quads.rim, 0]
        outward = solid.quads.nodes[solid.quads.rim] / 0.06
        assert np.abs(rim - outward).max() < [0.02, 0.02, 1e-3][order - 1]
    assert errors[0] > 100.0 * errors[1] > 100.0 * errors[2]
    assert errors[2] < 1e-6


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("wave", ["pressure", "shear"])
def test_plane_waves_have_the_frequency_error_of_order_2n(order, wave):
    """The lowest mode of a column fixed below, omega = pi c / 2 L, from the elements' own stiffness and mass."""
    material, length = gel(0.45), 0.02
    modulus = material.shear_relaxed_Pa
    direction = np.array([1.0, 0.0, 0.0])
    if wave == "pressure":
        modulus = material.bulk_Pa + 4.0 / 3.0 * modulus
        direction = np.array([0.0, 0.0, 1.0])
    exact = 0.5 * np.pi / length * np.sqrt(modulus / material.density_kg_m3)
    errors = []
    for deep in (2, 4):
        sheets = (Sheet(material, length),)
        line = np.array([-0.005, 0.005])
        solid = extrude(box_quads(line, line, length, order), sheets, (deep,))
        model = Model(solid, sheets, "cpu", "float64")
        levels, count = solid.levels - 1, solid.surface_nodes
        stiffness = np.empty((levels, levels))
        for level in range(levels):
            u = np.zeros((solid.levels, count, 3))
            u[level] = direction
            u = u.reshape(-1, 3)
            force = (element_forces(model, u, u) @ direction).reshape(solid.levels, count)
            stiffness[:, level] = force.sum(axis=1)[:levels]
        mass = model.mass.reshape(solid.levels, count).sum(axis=1)[:levels]
        errors.append(abs(np.sqrt(eigh(stiffness, np.diag(mass), eigvals_only=True)[0]) / exact - 1.0))
    assert np.log2(errors[0] / errors[1]) > 2 * order - 0.3


def static(model: Model, force: np.ndarray, projector: np.ndarray) -> np.ndarray:
    """Displacement at rest by conjugate gradients on the elements' forces; projector: free motion, (nodes, 3, 3)."""

    def free(x):
        return np.einsum("ncd,nd->nc", projector, x.reshape(force.shape))

    def apply(x):
        u = free(x)
        return free(element_forces(model, u, u)).ravel()

    operator = LinearOperator((force.size, force.size), matvec=apply, dtype=np.float64)
    scale = LinearOperator(operator.shape, matvec=lambda x: x / np.repeat(model.mass, 3), dtype=np.float64)
    found, info = cg(operator, free(force).ravel(), rtol=1e-6, maxiter=6000, M=scale)
    assert info == 0
    return free(found)


@pytest.mark.parametrize("order, core, radii, deep, best", [(2, 6, (0.028, 0.04), 3, 0.1), (4, 4, (0.04,), 2, 0.01)])
def test_nearly_incompressible_layers_do_not_lock(order, core, radii, deep, best):
    """Centre of a bonded disc with roller sides under a spot, against the exact series: 0.4999 as good as 0.45."""
    spot = 0.0103
    errors = []
    for nu in (0.45, 0.495, 0.499, 0.4999):
        material = gel(nu)
        sheets = (Sheet(material, 0.02),)
        solid = extrude(disc_quads(0.02, 0.018, core, np.array(radii), order), sheets, (deep,))
        model = Model(solid, sheets, "cpu", "float64")
        count = solid.surface_nodes
        pressure = np.exp(-GAUSSIAN / spot**2 * (solid.nodes[:count, :2] ** 2).sum(axis=1))
        force = np.zeros_like(solid.nodes)
        force[:count] = -pressure[:, None] * face_areas(solid)
        holds = hold(model, "bonded", "roller")
        projector = np.tile(np.eye(3), (len(solid.nodes), 1, 1))
        projector[holds.rows] = holds.projector
        u = static(model, force, projector)
        nodes, shares = find(solid, np.zeros((1, 3)))
        exact = float(centre_response(0.0, material, 0.02, spot, 0.04).real)
        errors.append(abs(-(shares * u[nodes][..., 2]).sum() / exact - 1.0))
    assert max(errors) < best
    assert max(errors[1:]) < errors[0] + 0.02


def test_largest_rate_bounds_the_assembled_one_closely():
    material = gel(0.495, branches=(Branch(20e3, 1.71e-4),))
    sheets = (Sheet(material, 0.004),)
    solid = extrude(patch_quads(bent_patch(1), 2), sheets, (1,))
    model = Model(solid, sheets, "cpu", "float64")
    step = model.stable_step()
    half = 0.5 * step / 1.71e-4
    shear = [12.5e3 + 20e3 * np.tanh(half) / half]
    size = solid.nodes.size
    stiffness = np.empty((size, size))
    for column in range(size):
        u = np.zeros(size)
        u[column] = 1.0
        stiffness[:, column] = element_forces(model, u.reshape(-1, 3), u.reshape(-1, 3), shear).ravel()
    assert np.abs(stiffness - stiffness.T).max() < 1e-12 * np.abs(stiffness).max()
    largest = eigh(stiffness, np.diag(np.repeat(model.mass, 3)), eigvals_only=True)[-1]
    # 0.98: power iteration comes from below
    assert 0.98 * largest < 4.0 / step**2 < 1.6 * largest


def test_inverted_element_is_named_with_its_place():
    patch = bent_patch()
    inward = patch.inward.copy()
    inward[5] = -inward[5]
    sheets = (Sheet(gel(), 0.004),)
    with pytest.raises(SceneError, match=r"skin element \d+ near \(-0\.00.*\) m is flat or inverted"):
        Model(extrude(patch_quads(replace(patch, inward=inward), 2), sheets, (1,)), sheets, "cpu")


def test_column_through_a_point_is_found():
    patch = bent_patch(1)
    inward = np.array([0.0, 0.0, -0.02]) - patch.vertices
    inward = inward / np.linalg.norm(inward, axis=1, keepdims=True)
    sheets = (Sheet(gel(), 0.06),)
    with pytest.raises(SceneError, match="inverted"):
        extrude(patch_quads(replace(patch, inward=inward, depth=np.full(4, 0.06)), 2), sheets, (1,))
