"""Forces between particles: momentum, rotations, patch test, the law of the material, no modes that cost nothing."""

import hyperelastic
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.skin.materials.material import Branch, Material, Sheet
from palmfield.skin.problem import Slab
from palmfield.skin.solvers.particles.cloud import build_cloud
from palmfield.skin.solvers.particles.run import HOURGLASS, Particles, stable_step

ELASTIC = Material("elastic", 1000.0, 1e4, (), 1e5, "")
BRANCHED = Material("branched", 1000.0, 1e4, (Branch(2e4, 2e-4), Branch(5e3, 1e-2), Branch(1e3, 0.0)), 1e5, "")
VISCOUS = Material("viscous", 1000.0, 1e4, (), 1e5, "", viscosity_Pa_s=3.0)


def free_box(*materials, size=5e-3, depth=4e-3):
    sheets = tuple(Sheet(m, depth / len(materials)) for m in materials)
    return build_cloud(Slab(sheets, "box", "free", "free", size_m=(size, 0.8 * size)), 1e-3)


def put(body, displacement, velocity=None):
    body.displacement.assign(np.asarray(displacement, dtype=np.float32))
    if velocity is not None:
        body.velocity.assign(np.asarray(velocity, dtype=np.float32))


def rough(cloud, size, seed=0):
    return size * np.random.default_rng(seed).standard_normal(cloud.points.shape)


def test_pair_forces_sum_to_nothing():
    """Linear momentum to round-off; angular momentum to the round-off of forces times lever arms."""
    cloud = free_box(ELASTIC)
    body = Particles(cloud, "cpu")
    u = rough(cloud, 1e-4)
    put(body, u)
    force = body.net_forces()
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() <= 1e-7 * size
    place = cloud.points + u
    arms = np.linalg.norm(place - place.mean(axis=0), axis=1).max()
    assert np.abs(np.cross(place, force).sum(axis=0)).max() <= 3e-7 * size * arms


def test_forces_are_the_derivative_of_the_energy():
    """The energy in NumPy float64, from the law of hyperelastic.py and the pairs; its slope by central differences."""
    cloud = free_box(ELASTIC)
    u, direction = rough(cloud, 5e-5), rough(cloud, 1.0, seed=1)

    def energy(u):
        step = u[cloud.neighbour] - u[cloud.owner][:, None]
        h = np.einsum("skc,skd->scd", step, cloud.area) / cloud.volume[:, None, None]
        strain = hyperelastic.energy(np.eye(3) + h, ELASTIC.shear_relaxed_Pa, ELASTIC.bulk_Pa)
        strays = step - np.einsum("scd,skd->skc", h, cloud.offset)
        pairs = 0.5 * HOURGLASS * ELASTIC.shear_relaxed_Pa * np.einsum("sk,skc,skc->", cloud.spring, strays, strays)
        return (strain * cloud.volume).sum() + pairs

    slope = (energy(u + 1e-8 * direction) - energy(u - 1e-8 * direction)) / 2e-8
    body = Particles(cloud, "cpu")
    put(body, u)
    assert -(body.net_forces() * direction).sum() == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("angle", [0.3, 2.0])
def test_rotation_makes_no_force(angle):
    cloud = free_box(ELASTIC)
    turn = Rotation.from_rotvec(angle * np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])).as_matrix()
    body = Particles(cloud, "cpu")
    put(body, cloud.points @ (turn - np.eye(3)).T)
    turned = np.abs(body.net_forces()).max()
    put(body, 0.01 * cloud.points)
    assert turned <= 2e-4 * np.abs(body.net_forces()).max()


def test_rotated_body_has_rotated_forces():
    cloud = free_box(ELASTIC)
    u = rough(cloud, 1e-4)
    turn = Rotation.from_rotvec([0.4, 0.9, -0.3]).as_matrix()
    body = Particles(cloud, "cpu")
    put(body, u)
    force = body.net_forces()
    put(body, (cloud.points + u) @ turn.T - cloud.points)
    np.testing.assert_allclose(body.net_forces(), force @ turn.T, atol=2e-5 * np.abs(force).max())


@pytest.mark.parametrize("materials", [(ELASTIC,), (BRANCHED,)])
def test_patch_test(materials):
    """Uniform strain: no force inside, and on the faces the stress of the law times the area."""
    cloud = free_box(*materials)
    gradient = 0.2 * np.random.default_rng(3).uniform(-1, 1, (3, 3))
    step_s = 1e-4
    body = Particles(cloud, "cpu", step_s)
    put(body, cloud.points @ gradient.T)
    force = body.net_forces()
    law = materials[0]
    deformation = np.eye(3) + gradient
    stress, _ = hyperelastic.advance(law, hyperelastic.at_rest(law, ()), deformation, 0 * gradient, step_s)
    inside = (np.abs(cloud.points[:, 0]) < 2.4e-3) & (np.abs(cloud.points[:, 1]) < 1.9e-3)
    inside &= (cloud.points[:, 2] < -0.1e-3) & (cloud.points[:, 2] > -3.9e-3)
    size = np.abs(stress).max() * 1e-6
    assert np.abs(force[inside]).max() <= 1e-5 * size
    face = (np.abs(cloud.points[:, 0]) < 2.4e-3) & (np.abs(cloud.points[:, 1]) < 1.9e-3) & (cloud.points[:, 2] == 0.0)
    expected = -cloud.face_area[cloud.surface[face]] @ stress.T
    np.testing.assert_allclose(force[face], expected, atol=1e-5 * size)


def test_stress_between_sheets():
    """A thousandfold stiffness ratio, both sheets under one stress: the particles between them feel none."""
    hard = Material("hard", 1000.0, 1e7, (), 1e8, "")
    cloud = free_box(hard, ELASTIC)
    modulus = {m.name: m.bulk_Pa + 4 / 3 * m.shear_relaxed_Pa for m in (hard, ELASTIC)}
    z = cloud.points[:, 2]
    small = 1e-4
    lower = np.minimum(z + 2e-3, 0.0) * small
    upper = np.maximum(z + 2e-3, 0.0) * small * modulus["elastic"] / modulus["hard"]
    body = Particles(cloud, "cpu")
    put(body, np.column_stack([0 * z, 0 * z, lower + upper]))
    force = body.net_forces()
    inner = (np.abs(cloud.points[:, 0]) < 2.4e-3) & (np.abs(cloud.points[:, 1]) < 1.9e-3)
    between = inner & np.isclose(z, -2e-3)
    # float32 of displacements in the soft sheet, read by the hard one: eps x thickness x hard modulus.
    limit = 1e-3 * modulus["elastic"] * small * 1e-6
    assert np.abs(force[between, 2]).max() <= limit


def test_branches_follow_the_law_in_time():
    """A box stretched and sheared by a history: force on its face against hyperelastic.advance, step by step."""
    cloud = free_box(BRANCHED)
    step_s = 1e-4
    body = Particles(cloud, "cpu", step_s)
    memory = hyperelastic.at_rest(BRANCHED, ())
    centre = int(np.argmin(np.linalg.norm(cloud.columns.face, axis=1)))
    shape = np.random.default_rng(5).uniform(-1, 1, (3, 3))
    largest = 0.0
    for n in range(1, 30):
        gradient = 0.2 * np.sin(0.2 * n) * shape
        put(body, cloud.points @ gradient.T)
        force = body.net_forces()[centre]
        stress, memory = hyperelastic.advance(BRANCHED, memory, np.eye(3) + gradient, 0 * gradient, step_s)
        expected = -stress @ cloud.face_area[centre]
        largest = max(largest, np.abs(expected).max())
        np.testing.assert_allclose(force, expected, atol=3e-5 * largest)


def test_dashpot():
    cloud = free_box(VISCOUS)
    body = Particles(cloud, "cpu", 1e-5)
    rng = np.random.default_rng(6)
    gradient, rate = 0.2 * rng.uniform(-1, 1, (3, 3)), 100.0 * rng.uniform(-1, 1, (3, 3))
    put(body, cloud.points @ gradient.T, cloud.points @ rate.T)
    centre = int(np.argmin(np.linalg.norm(cloud.columns.face, axis=1)))
    deformation = np.eye(3) + gradient
    stress = hyperelastic.piola(deformation, VISCOUS.shear_relaxed_Pa, VISCOUS.bulk_Pa)
    stress = stress + hyperelastic.viscous_piola(deformation, rate, VISCOUS.viscosity_Pa_s)
    expected = -stress @ cloud.face_area[centre]
    np.testing.assert_allclose(body.net_forces()[centre], expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def stiffness(cloud, hourglass):
    """Dense symmetric matrix of M^-1 K by columns."""
    body = Particles(cloud, "cpu", None, hourglass)
    count = cloud.points.size
    columns = np.empty((count, count))
    size = 1e-10
    for column in range(count):
        u = np.zeros(count)
        u[column] = size
        put(body, u.reshape(-1, 3))
        columns[:, column] = -body.net_forces().ravel() / size
    root = np.repeat(1.0 / np.sqrt(cloud.mass), 3)
    return root[:, None] * columns * root


def test_only_rigid_motions_cost_nothing():
    cloud = build_cloud(Slab((Sheet(ELASTIC, 3e-3),), "box", "free", "free", size_m=(4e-3, 4e-3)), 1e-3)
    matrix = stiffness(cloud, HOURGLASS)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-5 * np.abs(matrix).max())
    values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    assert np.sum(np.abs(values) < 1e-6 * values[-1]) == 6
    # The slowest true mode of a block of length L has a rate near pi c_s / L.
    slow = (np.pi / 4e-3) ** 2 * ELASTIC.shear_relaxed_Pa / ELASTIC.density_kg_m3
    assert values[6] > 0.2 * slow
    assert stable_step(cloud) == pytest.approx(2.0 / np.sqrt(values[-1]), rel=0.02)


def test_pattern_of_one_spacing_is_held():
    """Displacements that change sign from particle to particle: sites don't see them, pairs do.

    4/3 of the pairs' G (6/h^2)(1 - (1 - 2/3 sin^2(k h / 2))) at k h = pi along one axis.
    """
    cloud = build_cloud(Slab((Sheet(ELASTIC, 6e-3),), "box", "free", "free", size_m=(6e-3, 6e-3)), 1e-3)
    pattern = (-1.0) ** np.rint(cloud.points[:, 0] / 1e-3)
    middle = int(np.argmin(np.linalg.norm(cloud.points - [0, 0, -3e-3], axis=1)))
    forces = []
    for hourglass in (0.0, HOURGLASS):
        body = Particles(cloud, "cpu", None, hourglass)
        put(body, 1e-9 * pattern[:, None] * [0.0, 1.0, 0.0])
        forces.append(-body.net_forces()[middle, 1] / pattern[middle] / 1e-9)
    held = 4.0 / 3.0 * 4.0 / 1e-6 * ELASTIC.shear_relaxed_Pa * 1e-9
    assert abs(forces[0]) < 1e-6 * held
    assert forces[1] == pytest.approx(held, rel=1e-5)


def test_same_bits_again():
    cloud = free_box(BRANCHED)
    forces = []
    for _ in range(2):
        body = Particles(cloud, "cpu", 1e-4)
        put(body, rough(cloud, 1e-4))
        forces.append(body.net_forces())
    np.testing.assert_array_equal(*forces)


def test_shear_waves_have_no_second_order_error_on_a_lattice():
    """Force of a transverse wave inside a lattice against G k^2: the error falls sixteenfold where h halves."""
    cloud = build_cloud(Slab((Sheet(ELASTIC, 12e-3),), "box", "free", "free", size_m=(12e-3, 12e-3)), 1e-3)
    body = Particles(cloud, "cpu")
    errors = []
    along = np.array([1.0, 0.6, 0.3]) / np.linalg.norm([1.0, 0.6, 0.3])
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    middle = int(np.argmin(np.linalg.norm(cloud.points - [0, 0, -6e-3], axis=1)))
    for k in (400.0, 800.0):
        wave = np.cos((cloud.points - cloud.points[middle]) @ (k * along))
        put(body, 1e-9 * wave[:, None] * across)
        force = body.net_forces()[middle] @ across / 1e-9
        errors.append(abs(-force / (ELASTIC.shear_relaxed_Pa * k**2 * 1e-9) - 1.0))
    assert errors[1] < 0.05
    assert errors[1] / errors[0] > 10.0
