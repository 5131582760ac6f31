"""Errors from changes that fall irregularly: of reduced models by more vectors, and of meshes."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.skin import Sheet, Slab, Spot, preset
from palmfield.skin.approximation.refine import Discretisation, MeshSolution, refine_until_converged
from palmfield.skin.problem import SkinProblem
from palmfield.skin.reduction.krylov import SAFETY, steady_change
from palmfield.skin.solvers.axisymmetric.solve import solve_axisymmetric
from palmfield.skin.solvers.wedges import first_sizes


def test_a_small_change_after_a_large_one_does_not_count_alone() -> None:
    """Changes of a velocity by 8 vectors each, and the error after the third by a model of 300 vectors."""
    changes, true = [0.23, 0.37, 0.052], 0.16
    assert SAFETY * changes[-1] < true < SAFETY * float(steady_change(changes)) < 2.0 * true


@pytest.mark.parametrize("count", [1, 2, 4])
def test_changes_that_fall_evenly_are_taken_as_they_are(count: int) -> None:
    changes = [np.array([0.3, 0.1]) * 0.2**k for k in range(count)]
    np.testing.assert_allclose(steady_change(changes), changes[-1])
    np.testing.assert_array_equal(steady_change([np.zeros(2)] * count), 0.0)


def test_two_meshes_that_agree_by_chance_do_not_hide_what_a_third_showed() -> None:
    """Edges of 1, 0.79 and 0.5: the second differs much from the first, the third hardly from the second."""
    body = Slab((Sheet(preset("palm"), 0.01),), shape="disc", base="bonded", side="fixed", radius_m=0.03)
    load = Spot(0.0103, [0.0], [1.0], law="held")
    now = Discretisation(first_sizes(body, load, np.zeros((1, 3)), 0.05), 1e-3, 0.8)
    moved = iter([(1.0, 100, 1), (1.2, 160, 2), (1.201, 400, 2), (1.201, 400, 2)])

    def run(*_: object) -> MeshSolution:
        size, triangles, rows = next(moved)
        values = np.full((2, 1, 3), size)
        return MeshSolution(values, values, 10 * triangles, triangles, rows, np.array([[0.0, 0.0, 1.0]]))

    found = refine_until_converged(body, now, run, run(), 0.15, False)
    first = 0.2 / 1.2 / (1.6**0.75 - 1.0)
    assert found.mesh_error[0] == pytest.approx(first * (160.0 / 400.0) ** 1.5, rel=1e-6)


@pytest.mark.parametrize(("side", "factor"), [("free", 3.0), ("roller", 2.0)])
def test_a_singular_corner_leaves_more_to_higher_degrees(side: str, factor: float) -> None:
    """Against degree 9; a degree more leaves about half of the error of a corner."""
    soft = preset("palm")
    hard = replace(
        soft,
        shear_relaxed_Pa=30.0 * soft.shear_relaxed_Pa,
        bulk_Pa=30.0 * soft.bulk_Pa,
        branches=tuple(replace(one, shear_Pa=30.0 * one.shear_Pa) for one in soft.branches),
        viscosity_Pa_s=30.0,
    )
    sheets = Sheet(replace(soft, viscosity_Pa_s=1.0), 0.003), Sheet(hard, 0.003)
    body = Slab(sheets, shape="disc", base="bonded", side=side, radius_m=0.012)
    load = Spot(0.0097, [0.0, 1e-3], [0.0, 1.0])
    problem = SkinProblem(body, load, 4e-3 * np.arange(1, 17) / 16, np.array([[0.0, 0.0, 0.0], [9e-3, 0.0, 0.0]]), 0.05)
    found, exact = (solve_axisymmetric(problem, degree=degree) for degree in (5, 9))
    size = np.linalg.norm(exact.displacement_m, axis=(0, 2))
    true = float((np.linalg.norm(found.displacement_m - exact.displacement_m, axis=(0, 2)) / size).max())
    assert found.error_source.startswith(f"{factor:g} times")
    assert true <= found.displacement_error < 6.0 * true
