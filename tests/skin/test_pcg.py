"""Conjugate gradients against the factorisation: same answers, few iterations, the same bits each time."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.solver import Scheme, SkinSolver
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import bulk_from_poisson
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.pcg import BlockMatrix, DeviceStepper, NodalForm, Pcg

ECOFLEX = preset("ecoflex_00-10")
THIRDS = np.array([0.0, 0.35, 1.0])


def small_disc(nu=0.495, radius=0.03, edge=0.006, **conditions):
    material = dataclasses.replace(ECOFLEX, bulk_Pa=bulk_from_poisson(nu, 12.5e3))
    mesh = extrude(disc_patch(radius, 0.01, edge, edge, radius), THIRDS)
    return assemble(mesh, material, **{"side": "roller", **conditions})


def test_block_product_is_the_sparse_product():
    """Rotated frames (roller sides) and held directions included."""
    system = small_disc(base="free_slip")
    form = NodalForm(system)
    u = np.random.default_rng(1).normal(size=system.ndof)
    for hold in (False, True):
        blocks = form.blocks(system.elastic, hold=hold)
        matrix = BlockMatrix(blocks, "cpu")
        x = wp.array(form.spread @ u, dtype=wp.float64, device="cpu")
        y = wp.zeros_like(x)
        matrix.multiply(x, y)
        matrix.multiply(x, y, add=True)
        np.testing.assert_allclose(
            form.spread.T @ y.numpy(), 2.0 * (system.elastic @ u), atol=1e-12 * abs(system.elastic @ u).max()
        )


@pytest.mark.parametrize("nu", [0.45, 0.495, 0.4999, 0.499999])
def test_solution_is_the_factorisations(nu):
    """To the tolerance. From K = 10 G to 5e5 G the iterations grow threefold, not as the square root of K."""
    system = small_disc(nu)
    solver = SkinSolver(system, 2.5e-4)
    pcg = Pcg(solver.scheme.effective, system, "cpu", tolerance=1e-9)
    right = np.random.default_rng(2).normal(size=system.ndof)
    exact = solver.factor.solve(right)
    found = pcg.solve(right)
    print(nu, "iterations", pcg.iterations, "MB", pcg.schwarz.bytes / 1e6)
    np.testing.assert_allclose(found, exact, atol=1e-6 * np.abs(exact).max())
    assert pcg.iterations <= 100
    np.testing.assert_array_equal(found, pcg.solve(right))


def test_steps_are_the_factorisations():
    """Twelve steps under a kicked and then released surface."""
    system = small_disc(0.4999, edge=0.01)
    solver = SkinSolver(system, 2.5e-4)
    stepper = DeviceStepper(Scheme(system, 2.5e-4, 0.8), system.mass, "cpu", tolerance=1e-10)
    force = np.random.default_rng(3).normal(size=system.ndof)
    rest = np.zeros_like(force)
    state = solver.new_state()
    for n in range(12):
        ends = (force, force) if n < 4 else (rest, rest)
        solver.step(state, *ends)
        seen = stepper.step(*ends)
    for row in (0, 1):
        expected = system.mass @ state[row]
        np.testing.assert_allclose(seen[:, row], expected, atol=1e-6 * np.abs(expected).max())


def test_a_matrix_that_nothing_holds_is_an_error():
    system = small_disc(base="free", side="free", edge=0.015)
    pcg = Pcg(system.elastic + system.parts[0].stiffness, system, "cpu", limit=40)
    with pytest.raises((SceneError, np.linalg.LinAlgError)):
        pcg.solve(np.random.default_rng(4).normal(size=system.ndof))
