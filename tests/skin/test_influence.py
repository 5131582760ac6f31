"""What a pressure anywhere does to one point: the adjoint answers against plain solutions for each load."""

import numpy as np
import pytest

from palmfield import cache
from palmfield.skin.fem import influence, solver
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.influence import harmonic_influence, static_influence
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_both, harmonic_discrete, static
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude

pytestmark = pytest.mark.numerics

POINT, F_Hz, STEP_s = np.array([0.004, -0.002, 0.0]), 170.0, 2.5e-4


def layer(side):
    mesh = extrude(disc_patch(0.02, 0.004, 0.004, 0.006, 0.008), np.linspace(0.0, 1.0, 3))
    system = assemble(mesh, preset("palm"), side=side, absorbing_Hz=F_Hz if side == "absorbing" else None)
    return system, SurfaceQuadrature(mesh, system)


@pytest.mark.parametrize("side", ["fixed", "free", "absorbing"])
def test_they_give_what_a_solution_for_the_load_gives(side):
    system, quadrature = layer(side)
    read = SurfaceProbe(system.mesh, POINT[None], system).operator
    rest = static_influence(system, quadrature, POINT)
    exact, scheme = harmonic_influence(system, quadrature, POINT, F_Hz, STEP_s)
    alone, same = harmonic_influence(system, quadrature, POINT, F_Hz)
    np.testing.assert_array_equal(alone, same)
    for seed in range(3):
        pressure = np.random.default_rng(seed).random(len(quadrature.weights))
        force = quadrature.operator @ pressure
        expected = [
            (read @ static(system, force))[0],
            (read @ harmonic(system, force, F_Hz))[0],
            (read @ harmonic_discrete(system, force, F_Hz, STEP_s))[0],
        ]
        found = [influence @ pressure for influence in (rest, exact, scheme)]
        np.testing.assert_allclose(found, expected, rtol=1e-7)
        assert alone @ pressure == pytest.approx(expected[1], rel=1e-7)
    assert abs(expected[2] - expected[1]) > 1e-4 * abs(expected[1])


def test_a_pair_that_does_not_converge_is_factorised_twice(monkeypatch):
    system, quadrature = layer("fixed")
    force, calls = quadrature.operator @ np.ones(len(quadrature.weights)), []
    known = solver.factorise
    monkeypatch.setattr(solver, "factorise", lambda *given: calls.append(1) or known(*given))
    harmonic_both(system, force, F_Hz, STEP_s)
    assert len(calls) == 1
    monkeypatch.setattr(solver, "MOST_ITERATIONS", 1)
    _, scheme = harmonic_both(system, force, F_Hz, STEP_s)
    assert len(calls) == 3
    expected = harmonic_discrete(system, force, F_Hz, STEP_s)
    np.testing.assert_allclose(scheme, expected, atol=1e-9 * np.abs(expected).max())


def test_another_load_on_the_same_mesh_needs_no_factor(tmp_path, monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path))
    system, quadrature = layer("fixed")
    first = static_influence(system, quadrature, POINT), *harmonic_influence(system, quadrature, POINT, F_Hz)
    for name in ("static", "harmonic"):
        monkeypatch.setattr(influence, name, lambda *_: pytest.fail("solved again"))
    system, quadrature = layer("fixed")
    again = static_influence(system, quadrature, POINT), *harmonic_influence(system, quadrature, POINT, F_Hz)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    assert {entry.kind for entry in cache.entries()} == {"influence"}
    with pytest.raises(pytest.fail.Exception, match="solved again"):
        harmonic_influence(system, quadrature, POINT, 1.1 * F_Hz)
    with pytest.raises(pytest.fail.Exception, match="solved again"):
        static_influence(*layer("free"), POINT)
