"""Case 5, aspect ratios to 1000, on edge and lying flat."""

import dataclasses

import numpy as np
import pytest
from spectral_states import element_forces

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.problem import Layer, Slab, Spot
from palmfield.skin.solvers.particles.cloud import build_cloud
from palmfield.skin.solvers.particles.run import Particles
from palmfield.skin.solvers.spectral_elements.model import Model
from palmfield.skin.solvers.spectral_elements.solid import extrude, patch_quads
from palmfield.skin.solvers.wedges import static_wedges

GEL = Material("gel", 1030.0, 12.5e3, (Branch(25e3, 2e-4),), bulk_from_poisson(0.45, 12.5e3), "", bulk_relaxes=True)
EVEN = Spot(1e3, np.array([0.0, 5e-4]), np.array([0.0, 5.0]))
COLUMN = 5.0 / (GEL.bulk_Pa + 4.0 / 3.0 * GEL.shear_relaxed_Pa)
"""Strain of a column that cannot widen under 5 Pa."""


def slivers(flat):
    """A square face of 4 mm in triangles: columns of width 4 mm / 3, with one of that width times `flat` between."""
    from palmfield.types import Patch

    width = 4e-3 / 3.0
    x = np.array([0.0, width, width * (1.0 + flat), 2.0 * width, 4e-3]) - 2e-3
    y = np.linspace(-2e-3, 2e-3, 4)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(len(x) - 1), np.arange(3), indexing="ij"))
    a, b = 4 * i + j, 4 * (i + 1) + j
    faces = np.concatenate([np.column_stack([a, b, b + 1]), np.column_stack([a, b + 1, a + 1])]).astype(np.int32)
    count = len(grid)
    return Patch(
        vertices=np.column_stack([grid, np.zeros(count)]),
        faces=faces,
        inward=np.tile([0.0, 0.0, -1.0], (count, 1)),
        depth=np.full(count, 4e-3),
        rim=np.asarray((np.abs(grid) > 2e-3 - 1e-12).any(axis=1)),
        axis=np.array([0.0, 0.0, 1.0]),
    )


def layer(flat):
    return Layer(slivers(flat), (Sheet(GEL, 1.0),), "bonded", "roller")


def test_implicit_column_through_slivers():
    """Even pressure between rollers is a uniform strain: a patch test, exact to round-off times the ratio."""
    found = static_wedges(layer(1e-3), EVEN, np.array([[-2e-3 / 3, 0.0, 0.0], [1e-3, 0.0, 0.0]]))
    push = -found.displacement_m[0, :, 2]
    print(push / (COLUMN * 4e-3) - 1)
    np.testing.assert_allclose(push, COLUMN * 4e-3, rtol=1e-7, atol=0.0)


@pytest.mark.parametrize("order", [2, 4])
def test_explicit_elements_patch_test_on_slivers(order):
    """Forces of a uniform strain vanish inside, to float64's round-off times the ratio of 1000."""
    quads = patch_quads(slivers(1e-3), order)
    solid = extrude(quads, (Sheet(GEL, 1.0),), (2,))
    model = Model(solid, (Sheet(GEL, 1.0),), "cpu", "float64")
    slope = 1e-3 * np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3))
    u = solid.nodes @ slope.T
    force = element_forces(model, u, u)
    x, y, z = solid.nodes.T
    inside = (np.abs(x) < 1.999e-3) & (np.abs(y) < 1.999e-3) & (z < -1e-6) & (z > -3.999e-3)
    assert inside.sum() > 50
    assert np.abs(force[inside]).max() < 1e-9 * np.abs(force).max()


@pytest.mark.parametrize("flat", [0.3, 0.03])
def test_explicit_column_through_slivers(flat, solve_by):
    """The step falls with the ratio: at 1000 the price is told before the run, see below."""
    motion = solve_by(
        "spectral_elements", layer(flat), EVEN, np.array([5e-3]), np.zeros((1, 3)), order=2, estimate=False
    )
    print(flat, -motion.displacement_m[0, 0, 2] / (COLUMN * 4e-3) - 1, motion.solver)
    assert -motion.displacement_m[0, 0, 2] == pytest.approx(COLUMN * 4e-3, rel=1e-3, abs=0.0)


@pytest.mark.parametrize("flat", [0.5, 1e-3])
def test_particles_patch_test_on_slivers(flat):
    """Forces of a uniform strain vanish inside to float32's round-off."""
    cloud = build_cloud(Layer(slivers(flat), (Sheet(GEL, 1.0),), "free", "free"), 1e-3)
    slope = 1e-2 * np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3))
    body = Particles(cloud, "cpu")
    body.displacement.assign((cloud.points @ slope.T).astype(np.float32))
    force = body.net_forces()
    x, y, z = cloud.points.T
    inside = (np.abs(x) < 1.999e-3) & (np.abs(y) < 1.999e-3) & (z < -1e-6) & (z > -3.999e-3)
    print(flat, np.abs(force[inside]).max() / np.abs(force).max())
    assert np.abs(force[inside]).max() < 2e-4 * np.abs(force).max()


@pytest.mark.parametrize("name", ["lateral_waves", "axisymmetric", "wedges", "reduced"])
def test_a_sheet_a_thousandth_as_thick_changes_nothing(name, solve_by, miss, burst):
    """8 um of the same material at the face, 8 mm below: the one sheet's motion."""
    times, at = np.linspace(5e-4, 6e-3, 8), np.array([[0.0, 0.0], [0.005, 0.0]])
    whole = Slab((Sheet(GEL, 0.008),), "disc", "bonded", "roller", 0.02)
    thin = dataclasses.replace(whole, sheets=(Sheet(GEL, 8e-6), Sheet(GEL, 0.008 - 8e-6)))
    found, exact = (
        solve_by(n, b, burst, times, at).displacement_m for n, b in ((name, thin), ("lateral_waves", whole))
    )
    print(name, miss(found, exact))
    assert miss(found, exact) < {"lateral_waves": 2e-3, "axisymmetric": 4e-3}.get(name, 0.03)


def test_particles_with_such_a_sheet_say_what_it_would_take(solve_by, burst):
    """8 um beside 8 mm, 3 s: refused at once, with the place and the time."""
    thin = Slab((Sheet(GEL, 8e-6), Sheet(GEL, 0.008)), "disc", "bonded", "roller", 0.02)
    with pytest.raises(SceneError, match=r"would take .* s.*near"):
        solve_by("particles", thin, burst, np.array([3.0]), np.zeros((1, 2)))


def test_disc_rows_of_a_flat_patch():
    """A disc 1000 times as wide as thick, in elements as wide as 300 times their height: confined compression."""
    patch = disc_patch(0.02, 2e-5, 0.006, 0.006, 0.02)
    found = static_wedges(
        Layer(patch, (Sheet(GEL, 1.0),), "bonded", "roller"), EVEN, np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    )
    np.testing.assert_allclose(-found.displacement_m[0, :, 2], COLUMN * 2e-5, rtol=1e-7, atol=0.0)
