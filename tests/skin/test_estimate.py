"""The rules must give what they promise, on the phantom they were read off and on another material."""

import dataclasses

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.approximation.estimate import choose_sizes, largest_change
from palmfield.skin.approximation.refine import Discretisation, MeshSolution, refine_until_converged
from palmfield.skin.approximation.richardson import error_of_finer
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Sheet, shear_wave
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import Slab, Spot
from palmfield.skin.solvers.wedges import first_sizes

pytestmark = pytest.mark.numerics


def centre(material, fwhm, depth, fine, coarse, fine_radius, fractions, step, radius, f):
    """Static, harmonic and stepped harmonic push of the centre."""
    mesh = extrude(disc_patch(radius, depth, fine, coarse, fine_radius), fractions)
    system = assemble(mesh, material, side="fixed")
    quadrature = SurfaceQuadrature(mesh, system)
    force = quadrature.assemble(np.exp(-4 * np.log(2) * (quadrature.points[:, :2] ** 2).sum(axis=1) / fwhm**2))
    read = -SurfaceProbe(mesh, np.zeros((1, 3)), system).operator
    fields = [static(system, force), harmonic(system, force, f), harmonic_discrete(system, force, f, step)]
    return np.array([(read @ u)[0] for u in fields])


@pytest.mark.parametrize(("name", "depth", "fwhm"), [("ecoflex_00-10", 0.02, 0.0103), ("palm", 0.012, 0.0085)])
def test_sizes_give_the_accuracy_asked_for(name, depth, fwhm):
    """Against the endless layer, so that mesh, step and patch radius all count. 5 % asked for."""
    material = PRESETS[name]
    sizes = choose_sizes(material, fwhm, 200.0, 0.05)
    answers = centre(material, fwhm, depth, *sizes, f=200.0)
    exact = [centre_response(f, material, depth, fwhm) for f in (0.0, 200.0, 200.0)]
    errors = np.abs(answers / exact - 1)
    print(name, "errors: static, 200 Hz, 200 Hz stepped", errors)
    assert errors.max() < 0.05


def test_sizes_shrink_with_accuracy_and_frequency():
    material = PRESETS["palm"]
    loose, tight = (choose_sizes(material, 0.01, 200.0, a) for a in (0.05, 0.005))
    assert tight[0] < loose[0]
    assert tight[4] < loose[4]
    assert len(tight[3]) > len(loose[3])
    assert tight[5] > loose[5]
    assert choose_sizes(material, 0.01, 800.0, 0.05)[0] < loose[0]
    elastic = dataclasses.replace(material, branches=())
    assert choose_sizes(elastic, 0.01, 200.0, 0.05)[5] == pytest.approx(4 * shear_wave(elastic, 200.0)[0] / 200.0)


def test_mesh_error_of_a_known_law():
    exact = np.array([2.0, 3.0 + 1j])
    fine, coarse = exact * (1 + 0.01), exact * (1 + 0.04)
    assert error_of_finer(largest_change(coarse, fine), 2.0, 2.0) == pytest.approx(0.01 / 1.01)


def test_mesh_error_is_of_the_size_of_the_true_error():
    """On the reference disc: estimate between a third and ten times the true error of the finer mesh."""
    material = PRESETS["ecoflex_00-10"]
    exact = np.array([complex(centre_response(f, material, 0.02, 0.0103, 0.06)) for f in (0.0, 200.0)])
    answers = []
    for scale, layers in ((2.0, 1), (1.0, 2)):
        fractions = np.linspace(0.0, 1.0, layers + 1)
        sizes = (0.007 * scale, 0.012 * scale, 0.012, fractions, 1e-4, 0.06)
        answers.append(centre(material, 0.0103, 0.02, *sizes, f=200.0)[:2])
    true = np.max(np.abs(answers[1] / exact - 1))
    estimate = error_of_finer(largest_change(*answers), 2.0, 2.0)
    print("true", true, "estimated", estimate)
    assert true / 3 < estimate < 10 * true


@pytest.mark.parametrize(("taken", "runs"), [(0.0, 1), (0.025, 2)])
def test_a_mesh_is_refined_where_its_error_and_what_is_taken_exceed_the_accuracy(taken, runs):
    """A law of order 1.5, with 3.7 % at the first mesh: enough for 5 %, not where others take 2.5 %."""
    body = Slab((Sheet(PRESETS["ecoflex_00-10"], 0.02),), "disc", "bonded", "roller", radius_m=0.06)
    load, meshes = Spot(0.0103, [0.0, 1e-3], [0.0, 1.0]), []
    first = first_sizes(body, load, np.zeros((1, 3)), 0.05)

    def run(now, factor=1.0, reach=1.0):
        ratio = now.sizes.fine_m * factor / first.fine_m
        meshes.append(ratio)
        moved = np.full((2, 1, 3), 1.0 + 0.037 * ratio**1.5)
        return MeshSolution(moved, moved, 1000, round(1e6 / ratio**2), 0, np.array([[0.0, 0.0, 1.0]]))

    now = Discretisation(first, 1e-3, 1.0)
    coarse = run(now, 4.0 / 3.0)
    meshes.clear()
    found = refine_until_converged(body, now, run, coarse, 0.05, False, taken=taken)
    assert len(meshes) == runs
    true = 0.037 * meshes[-1] ** 1.5
    assert found.errors[0] == pytest.approx(true, rel=0.1) and found.errors[0] + taken <= 0.05


def test_bad_input():
    with pytest.raises(SceneError, match="accuracy"):
        choose_sizes(PRESETS["palm"], 0.01, 200.0, 0.0)
