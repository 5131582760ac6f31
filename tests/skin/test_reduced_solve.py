"""Reduced models behind the common call: the converged answer of another method, without a step in time."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.problem import Layer, SkinProblem, Slab, Spot, Traction
from palmfield.skin.solvers.axisymmetric.solve import solve_axisymmetric
from palmfield.skin.solvers.reduced import course, patterns, refusal_reduced, solve_reduced

pytestmark = pytest.mark.numerics

PAD = preset("finger_pad")
THICK, RADIUS, WIDTH = 0.003, 0.015, 0.008
DISC = Slab((Sheet(PAD, THICK),), "disc", "bonded", "fixed", radius_m=RADIUS)
TIMES = np.arange(1, 101) * 2e-4
AT = np.array([[0.0, 0.0], [0.004, 0.0]])
KNOTS = np.arange(0.0, 0.0201, 1e-4)
AM = Spot(WIDTH, KNOTS, 0.5 * (1.0 - np.cos(2.0 * np.pi * 150.0 * KNOTS)))


def gap(found: np.ndarray, wanted: np.ndarray) -> float:
    return float((np.linalg.norm(found - wanted, axis=(0, 2)) / np.linalg.norm(wanted, axis=(0, 2))).max())


@pytest.fixture(scope="module")
def found():
    return solve_reduced(SkinProblem(DISC, AM, TIMES, AT, accuracy=0.1))


def test_the_error_is_within_what_is_said(found):
    wanted = solve_axisymmetric(SkinProblem(DISC, AM, TIMES, AT, accuracy=0.01))
    assert found.error < 0.1
    assert gap(found.displacement_m, wanted.displacement_m) < found.error
    assert gap(found.velocity_m_s, wanted.velocity_m_s) < 0.1


def test_too_few_vectors_are_an_answer_with_its_error(monkeypatch):
    """They were refused once all had been computed."""
    from palmfield.skin.solvers import reduced as module

    wanted = solve_axisymmetric(SkinProblem(DISC, AM, TIMES, AT, accuracy=0.01))
    monkeypatch.setattr(module, "MOST_VECTORS", 4)
    monkeypatch.setattr(module, "SHARE", 1e-5)
    motion = solve_reduced(SkinProblem(DISC, AM, TIMES, AT, accuracy=0.1))
    reduction = float(motion.error_source.split(" vectors ")[1].split(",")[0])
    assert reduction > 1e-6
    assert gap(motion.displacement_m, wanted.displacement_m) < motion.error


def test_a_fine_patch_gets_coarser_triangles_and_moves_like_the_disc(found):
    patch = disc_patch(RADIUS, THICK, 0.0012, 0.0012, RADIUS)
    layer = Layer(patch, DISC.sheets)
    motion = solve_reduced(SkinProblem(layer, AM, TIMES, np.column_stack([AT, np.zeros(2)]), accuracy=0.1))
    unknowns = int(motion.solver.split(", ")[1].split()[0])
    # As the patch has it, quadratic wedges in two rows or more would have at least this many
    assert unknowns < 3 * 4 * len(patch.faces)
    assert gap(motion.displacement_m, found.displacement_m) < motion.error + found.error


def test_pressures_of_one_pattern_are_the_spot_they_sample(found):
    grid = np.linspace(-0.012, 0.012, 49)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    bell = np.exp(-4.0 * np.log(2.0) * (x**2 + y**2) / WIDTH**2)
    points = np.column_stack([x, y, np.zeros_like(x)])
    load = Traction(points, np.full(len(x), (grid[1] - grid[0]) ** 2), KNOTS, np.outer(AM.peak_Pa, bell))
    assert len(patterns(load)[0]) == 1
    motion = solve_reduced(SkinProblem(DISC, load, TIMES, AT, accuracy=0.1))
    assert gap(motion.displacement_m, found.displacement_m) < motion.error + found.error


def test_repeats_are_identical_and_a_stronger_load_moves_in_proportion(found):
    again = solve_reduced(SkinProblem(DISC, AM, TIMES, AT, accuracy=0.1))
    assert np.array_equal(again.displacement_m, found.displacement_m)
    strong = solve_reduced(SkinProblem(DISC, replace(AM, peak_Pa=1000.0 * AM.peak_Pa), TIMES, AT, accuracy=0.1))
    assert gap(strong.displacement_m, 1000.0 * found.displacement_m) < 1e-9


@pytest.mark.parametrize("law", ["linear", "held"])
def test_course_of_a_load_that_begins_late_and_stays(law):
    load = Spot(WIDTH, [0.01, 0.02, 0.03], [1.0, 3.0, 2.0], law=law)
    asked = np.array([0.005, 0.015, 0.02, 0.05])
    clock, forces, rows = course(load, load.peak_Pa[:, None], asked)
    assert np.allclose(clock, [0.01, 0.015, 0.02, 0.03, 0.05])
    assert np.allclose(forces[:, 0], [1.0, 2.0 if law == "linear" else 1.0, 3.0, 2.0, 2.0])
    assert np.allclose(clock[rows[1:]], asked[1:])


def test_what_it_cannot_take():
    moving = Spot(WIDTH, [0.0, 0.01], [1.0, 1.0], [[0.0, 0.0], [0.005, 0.0]])
    assert "this spot moves" in str(refusal_reduced(DISC, moving))
    with pytest.raises(SceneError, match="solver 'reduced': a reduced model needs loads of constant shape"):
        solve_reduced(SkinProblem(DISC, moving, TIMES, AT))
    assert "a finite body" in str(refusal_reduced(Slab(DISC.sheets), AM))
    noise = np.random.default_rng(1).standard_normal((20, 30))
    scattered = Traction(np.zeros((30, 3)), np.ones(30), np.arange(20.0), noise)
    assert "at most 8 patterns" in str(refusal_reduced(DISC, scattered))
    assert refusal_reduced(DISC, AM) is None
