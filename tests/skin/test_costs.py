"""Predicted costs: how they grow with the size of a problem, measured in seconds of the process on this machine."""

import time

import numpy as np
import pytest

from palmfield.blas import one_blas_thread
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import SkinProblem, Slab, Spot
from palmfield.skin.solvers.lateral_waves import cost_lateral_waves, solve_lateral_waves
from palmfield.skin.solvers.wedges import cost_wedges, run_cost

ECOFLEX = preset("ecoflex_00-10")
TIMES = np.linspace(0.0, 0.1, 401)
SPOT = Spot(0.0103, TIMES, np.sin(2.0 * np.pi * 100.0 * TIMES) ** 2)
AT = np.array([[0.0, 0.0], [0.01, 0.0]])


def busy(call, times=2) -> float:
    """Seconds of the process, the least of some."""
    seconds = []
    with one_blas_thread:
        for _ in range(times):
            begin = time.process_time()
            call()
            seconds.append(time.process_time() - begin)
    return min(seconds)


def stepped(nodal_stepper, edge_m, steps):
    """Build, factorise and step a disc; its unknowns."""
    mesh = extrude(disc_patch(0.03, 0.012, edge_m, edge_m, 0.03), np.array([0.0, 0.4, 1.0]))
    system = assemble(mesh, ECOFLEX)
    solver = nodal_stepper(system, 2e-4)
    state, force = solver.new_state(), np.ones(system.ndof)
    for _ in range(steps):
        solver.step(state, force, force)
    return system.ndof


@pytest.mark.parametrize("steps", [5, 60])
def test_law_of_wedges_has_the_ratio_of_two_sizes(nodal_stepper, steps):
    """Four to five times the unknowns, with few and with many steps."""
    dofs = [stepped(nodal_stepper, edge, 1) for edge in (0.006, 0.003)]
    small, large = (busy(lambda h=edge: stepped(nodal_stepper, h, steps), times=3) for edge in (0.006, 0.003))
    measured = large / small
    predicted = run_cost(dofs[1], steps) / run_cost(dofs[0], steps)
    print(dofs, steps, measured, predicted)
    assert 0.5 < measured / predicted < 2.0


def test_law_of_lateral_waves_has_the_ratio_of_two_accuracies():
    body = Slab((Sheet(ECOFLEX, 0.02),))
    solve_lateral_waves(SkinProblem(body, SPOT, TIMES[:20], AT), tolerance=0.1, threads=1)
    measured = [
        busy(lambda a=a: solve_lateral_waves(SkinProblem(body, SPOT, TIMES, AT, accuracy=a), threads=1))
        for a in (0.05, 0.005)
    ]
    predicted = [cost_lateral_waves(SkinProblem(body, SPOT, TIMES, AT, a)) for a in (0.05, 0.005)]
    print(measured, predicted)
    assert 0.5 < measured[1] / measured[0] / (predicted[1] / predicted[0]) < 2.0


def test_cost_of_wedges_rises_with_what_is_asked():
    body = Slab((Sheet(ECOFLEX, 0.02),), shape="disc", side="roller", radius_m=0.06)
    rough = cost_wedges(SkinProblem(body, SPOT, TIMES, AT, 0.05))
    assert cost_wedges(SkinProblem(body, SPOT, TIMES, AT, 0.02)) > 2.0 * rough
    assert cost_wedges(SkinProblem(body, SPOT, TIMES[:201], AT, 0.05)) < 0.7 * rough
