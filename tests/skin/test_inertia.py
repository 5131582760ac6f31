"""Load of accelerating bones on a layer, against the mass matrix, shear of an infinite slab, and the wedge stepper."""

import math

import numpy as np
import pytest
from scipy import sparse

from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import complex_bulk, complex_shear
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.reduction.inertia import inertial_forces, inertial_model, rigid_fields
from palmfield.skin.stepper import SurfaceLoads

pytestmark = pytest.mark.numerics

PALM, DEPTH_m = preset("palm"), 0.005
PLACES = np.array([[0.0, 0.0, 0.0], [0.011, 0.004, 0.0], [-0.006, 0.009, 0.0]])


@pytest.fixture(scope="module")
def mesh():
    """So wide that the free sides hardly act on the places: their effect falls by e over 1.4 depths (static)."""
    return extrude(disc_patch(0.05, DEPTH_m, 0.003, 0.006, 0.012), [0.0, 0.3, 1.0])


@pytest.fixture(scope="module")
def layer(mesh):
    system = assemble(mesh, PALM, base="bonded", side="free")
    return system, SurfaceProbe(mesh, PLACES, system).vectors


@pytest.fixture(scope="module")
def model(layer, mesh):
    system, read = layer
    made = inertial_model(system, np.ones((1, mesh.surface_nodes)), read)
    print(f"{system.ndof} unknowns, {made.order} vectors, error {made.error:.2g}")
    return made


@pytest.fixture(scope="module")
def column(mesh):
    system = assemble(mesh, PALM, base="bonded", side="roller")
    return inertial_model(system, np.ones((1, mesh.surface_nodes)), SurfaceProbe(mesh, PLACES, system).vectors)


def infinite_layer(f_Hz, modulus_Pa):
    """Displacement of the face for an acceleration of 1 m/s^2 of the base, e^{-i w t} [m].

    In the frame of the base rho u_tt = (G u_z)_z - rho a, u = 0 at the base and u_z = 0 at the face. Along the layer G
    is the shear modulus, along its normal that of a column that cannot widen.
    """
    if f_Hz == 0.0:
        return -PALM.density_kg_m3 * DEPTH_m**2 / (2.0 * modulus_Pa)
    omega = 2.0 * math.pi * f_Hz
    wave = omega * np.sqrt(PALM.density_kg_m3 / modulus_Pa)
    return (1.0 - 1.0 / np.cos(wave * DEPTH_m)) / omega**2


def test_the_forces_are_those_of_the_mass_matrix(mesh):
    """That of a layer without any support, from kernels, times minus the acceleration of each node."""
    system = assemble(mesh, PALM, base="free", side="free")
    shares = np.random.default_rng(0).random((2, mesh.surface_nodes))
    forces = inertial_forces(system, shares)
    for number, own in enumerate(shares):
        fields = np.tile(own, mesh.levels)[:, None, None] * rigid_fields(mesh.nodes)
        expected = -(system.mass @ (system.dof_map.T @ fields.reshape(3 * len(fields), -1)))
        assert forces[:, 12 * number : 12 * number + 12] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_fields_are_those_of_a_rigid_body():
    rng = np.random.default_rng(1)
    points, (a, rate, spin) = rng.normal(size=(5, 3)), rng.normal(size=(3, 3))
    x, y, z = spin
    numbers = [*a, *rate, x * x, y * y, z * z, x * y, x * z, y * z]
    expected = a + np.cross(rate, points) + np.cross(spin, np.cross(spin, points))
    assert rigid_fields(points) @ numbers == pytest.approx(expected)


@pytest.mark.parametrize("f_Hz", [0.0, 5.0, 30.0, 100.0])
def test_acceleration_along_a_wide_layer_shears_it_as_an_infinite_one(model, f_Hz):
    expected = infinite_layer(f_Hz, complex_shear(PALM, f_Hz))
    for place in model.transfer(f_Hz).reshape(len(PLACES), 3, 12):
        for axis in (0, 1):
            assert abs(place[axis, axis] - expected) < 2e-3 * abs(expected)
            assert np.abs(np.delete(place[:, axis], axis)).max() < 1e-3 * abs(expected)


@pytest.mark.parametrize("f_Hz", [0.0, 30.0, 100.0])
def test_acceleration_along_the_normal_only_compresses_an_infinite_layer(column, f_Hz):
    """Rollers keep it from widening, as in an infinite layer. The bulk modulus is 1e4 times the shear modulus."""
    shear = complex_shear(PALM, f_Hz)
    expected = infinite_layer(f_Hz, complex_bulk(PALM, f_Hz) + 4.0 / 3.0 * shear)
    for place in column.transfer(f_Hz).reshape(len(PLACES), 3, 12):
        assert abs(place[2, 2] - expected) < 1e-2 * abs(expected)
        assert np.abs(place[:, 2]).max() < 1e-3 * abs(infinite_layer(f_Hz, shear))


def test_a_turn_about_the_normal_shears_each_place_by_its_distance(model):
    """The acceleration of a place is that of the turning rigid body, alpha x r."""
    for f_Hz in (0.0, 30.0, 100.0):
        moved = model.transfer(f_Hz).reshape(len(PLACES), 3, 12)[:, :, 5]
        expected = infinite_layer(f_Hz, complex_shear(PALM, f_Hz)) * np.cross([0.0, 0.0, 1.0], PLACES)
        assert np.abs(moved - expected).max() < 5e-3 * np.abs(expected).max()


def test_the_model_moves_as_the_full_wedges(layer, model, mesh):
    """Over a course with numbers of all kinds, within the errors of the model and of the steps, which halves show."""
    system, read = layer
    forces, step_s, count = inertial_forces(system, np.ones((1, mesh.surface_nodes))), 1e-3, 150
    rng = np.random.default_rng(2)
    size, phase = rng.normal(size=12) * ([1.0] * 3 + [50.0] * 9), rng.uniform(0.0, 6.0, 12)
    rate = 2.0 * math.pi * rng.uniform(2.0, 15.0, 12)

    def by_wedges(halvings):
        step = step_s / 2**halvings
        stepper = WedgeStepper(system, sparse.csr_matrix(forces), step)
        clock = step * np.arange(count * 2**halvings + 1)
        numbers = size * np.sin(np.outer(clock, rate) + phase) * np.minimum(clock / 0.02, 1.0)[:, None] ** 3
        loads = SurfaceLoads(np.eye(12)[None], numbers[None, :-1], numbers[None, 1:])
        state = np.zeros((1, stepper.state_size))
        moved = stepper.step(state, loads, 0.0, clock[-1], stepper.reader(read))[0, 2**halvings - 1 :: 2**halvings, 0]
        return moved, numbers[:: 2**halvings]

    coarse, numbers = by_wedges(0)
    fine, _ = by_wedges(1)
    moved = model.march(model.new_state(), numbers[:-1], numbers[1:], step_s) @ model.displaces.T
    scale = np.linalg.norm(fine)
    step_error = np.linalg.norm(fine - coarse) / scale
    print(f"difference {np.linalg.norm(moved - fine) / scale:.2g}, steps {step_error:.2g}, model {model.error:.2g}")
    assert np.linalg.norm(moved - fine) / scale < model.error + step_error
