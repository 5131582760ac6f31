"""Energy of an unloaded body: each scheme's own never grows.

Spectral elements: test_energy_never_grows (spectral_elements/test_steps.py). Wedges: test_unloaded_energy_never_grows
and test_every_mode_is_stable (test_solver.py). Reduced: test_energy_never_grows (test_reduced.py). Lateral waves:
test_residues_sum_to_nothing_and_nothing_grows (lateral_waves/test_depth.py). Here the particles' and the disc's.
"""

import dataclasses

import numpy as np
import warp as wp

from palmfield.skin.materials.material import Branch, Material, Sheet
from palmfield.skin.problem import Slab, spread
from palmfield.skin.reduction.reducer import reduce
from palmfield.skin.solvers.axisymmetric.element import DiscGrid, Line, graded
from palmfield.skin.solvers.particles.cloud import build_cloud
from palmfield.skin.solvers.particles.run import BLOCK, SAFETY, Particles, Reader, branch_table, stable_step

SOLID = Material("branched", 1000.0, 1e4, (Branch(1e4, 1e-3), Branch(5e3, 2e-5)), 1e5, "")


def energies(material, steps):
    """E of each step of a ringing box, as `spectral_elements.run.Stepper` derives it.

    With y = u - q the branch's law q1 = e q0 + a u0 + b u1 is y1 = e y0 + c (u1 - u0), c = 1 - b, so
    E = v M v / 2 + u0 K u1 / 2 + sum g / (2 c) [y0 K_d y1 + (1 - e) / 2 y0 K_d y0], K_d the shear and pair stiffness.
    """
    body = Slab((Sheet(material, 4e-3),), "box", "bonded", "free", size_m=(6e-3, 6e-3))
    cloud = build_cloud(body, 1e-3)
    step_s = SAFETY * stable_step(cloud)
    particles = Particles(cloud, "cpu", step_s)
    # Strains of 1e-5: the law is linear, and float32 has all its digits.
    kick = 1e-5 * np.random.default_rng(4).standard_normal(cloud.points.shape)
    particles.velocity.assign(np.einsum("nij,nj->ni", cloud.free, kick).astype(np.float32))
    plain = dataclasses.replace(material, branches=())
    stiff, relaxing = (
        Particles(dataclasses.replace(cloud, materials=(m,)), "cpu")
        for m in (plain, dataclasses.replace(plain, bulk_Pa=1e-6))
    )

    def product(of, a, b):
        of.displacement.assign(b.astype(np.float32))
        return -float((a * of.net_forces()).sum())

    g, e, _, b = (row[0] for row in branch_table((material,), len(material.branches), step_s, instant=False))
    table = wp.zeros((BLOCK, len(cloud.face_area)), dtype=wp.float32, device="cpu")
    reader = Reader(np.zeros((1, 1), dtype=np.int32), np.ones((1, 1)), "cpu")
    u0 = particles.displacement.numpy().astype(float)
    y0 = np.zeros((len(g), *u0.shape))
    found = []
    for _ in range(steps):
        particles.steps(1, table, False, reader)
        u1, v = (a.numpy().astype(float) for a in (particles.displacement, particles.velocity))
        total = 0.5 * float((cloud.mass[:, None] * v * v).sum()) + 0.5 * product(stiff, u0, u1)
        for n in range(len(g)):
            y1 = e[n] * y0[n] + (1.0 - b[n]) * (u1 - u0)
            both = product(relaxing, y0[n], y1) + 0.5 * (1.0 - e[n]) * product(relaxing, y0[n], y0[n])
            total += 0.5 * g[n] / (1.0 - b[n]) * both
            y0[n] = y1
        found.append(total)
        u0 = u1
    return np.array(found)


def test_particles_without_branches_keep_their_energy():
    found = energies(dataclasses.replace(SOLID, branches=()), 200)
    print(np.ptp(found) / found[0])
    assert np.ptp(found) < 2e-5 * found[0]


def test_particles_with_branches_lose_energy_at_every_step():
    found = energies(SOLID, 200)
    print(np.diff(found).max() / found[0], found[-1] / found[0])
    assert (found > 0.0).all()
    assert np.diff(found).max() < 2e-6 * found[0]
    assert found[-1] < 0.3 * found[0]


def test_disc_of_two_sheets_loses_energy():
    """x' = A x of a harmonic's model, |x|^2 / 2 its energy: A + A^T has no positive eigenvalue."""
    hard = Material("hard", 1000.0, 1e7, (), 1e8, "", viscosity_Pa_s=1.0)
    body = Slab((Sheet(hard, 2e-3), Sheet(SOLID, 4e-3)), "disc", "bonded", "free", 0.02)
    s = spread(0.01)
    radial = Line(graded(0.02, lambda x: 2.0 * s + 0.0 * x), 5)
    depth = Line(np.array([-6e-3, -2e-3, 0.0]), 5)
    for m in (0, 1):
        grid = DiscGrid(body, radial, depth, np.array([1, 0]))
        system = grid.system(m)
        force = system.spread.T @ grid.pressure_force(lambda x: np.exp(-0.5 * (x / s) ** 2)[:, None])
        read = grid.face_reader(np.array([0.0, 5e-3])) @ system.spread
        model = reduce(system, force, read, (0.0, 600.0), 0.01)
        growth = np.linalg.eigvalsh(model.rates + model.rates.T)
        print(m, model.order, growth[-1] / np.abs(growth).max())
        assert growth[-1] < 1e-9 * np.abs(growth).max()
