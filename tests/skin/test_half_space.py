"""Tissue without end below a layer, against plane waves in a half space (tests/oracles/half_space.py)."""

import math

import numpy as np
import pytest
from half_space import angle_wavenumbers, midpoint_sheets, reflection, surface_stiffness
from half_space import impedance as exact_impedance

from palmfield.estimate.numerics.base_band import responses
from palmfield.skin.endless import half_space
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.depth import condensed, impedance, on_impedance
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.dispersion import rayleigh_wavenumber
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.body_mesh import Sizes, box_patch
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import GAUSSIAN, SkinProblem, Slab, Spot, spread
from palmfield.skin.solvers.lateral_waves.modes import depth_problem
from palmfield.skin.solvers.lateral_waves.solve import solve_lateral_waves
from palmfield.skin.stepper import SurfaceLoads

pytestmark = pytest.mark.numerics

SKINS = ["palm", "forearm", "finger_pad", "hitohada_c0", "muscle"]
DEPTHS_M = (0.005, 0.012, 0.02)


def below(k, f_Hz, material):
    base = half_space(material)
    return impedance(k, f_Hz, base.sheets, base.base, base.degree)


def spot(fwhm_m):
    """Wavenumbers and weights of the displacement at the centre of a Gaussian spot of 1 Pa."""
    width = spread(fwhm_m)
    nodes, rule = np.polynomial.legendre.leggauss(12)
    edges = np.concatenate([[0.1], np.geomspace(2.0, 5.0 / width, 40)])
    half = 0.5 * np.diff(edges)[:, None]
    k = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes).ravel()
    return k, (half * rule).ravel() * k * width**2 * np.exp(-0.5 * (k * width) ** 2)


@pytest.mark.parametrize("name", SKINS)
def test_it_never_gives_energy(name):
    """At all wavenumbers and frequencies the work of a period is not negative: Im Z is negative semi-definite."""
    k = np.concatenate([np.geomspace(0.1, 20.0, 12), np.linspace(25.0, 2000.0, 120)])
    for f_Hz in np.geomspace(0.01, 1e5, 60):
        loss = -below(k, f_Hz, preset(name)).imag
        size = np.abs(below(k, f_Hz, preset(name))).max(axis=(1, 2))
        assert (np.linalg.eigvalsh(0.5 * (loss + np.swapaxes(loss, 1, 2)))[:, 0] > -1e-9 * size).all()


@pytest.mark.parametrize("name", SKINS)
@pytest.mark.parametrize("depth_m", DEPTHS_M)
def test_the_centre_of_a_spot_moves_as_on_a_half_space(name, depth_m):
    """20 to 1000 Hz, spots of 6 to 20 mm."""
    material, worst = preset(name), 0.0
    for fwhm_m in (0.006, 0.0103, 0.02):
        k, weights = spot(fwhm_m)
        for f_Hz in (20.0, 40.0, 60.0, 100.0, 200.0, 300.0, 500.0, 1000.0):
            upper = condensed(k, f_Hz, [Sheet(material, depth_m)])
            exact = weights @ on_impedance(upper, exact_impedance(k, f_Hz, material))
            worst = max(worst, abs(weights @ on_impedance(upper, below(k, f_Hz, material)) / exact - 1.0))
    print(name, depth_m, f"{100 * worst:.2g} %")
    assert worst < 0.02


@pytest.mark.parametrize("depth_m", DEPTHS_M)
def test_static_deflection_of_boussinesq(depth_m):
    """Gaussian pressure on an elastic half space: u = (1 - nu) / G s sqrt(pi / 2) at the centre."""
    palm = preset("palm")
    shear, bulk = palm.shear_relaxed_Pa, palm.bulk_Pa
    poisson = (3.0 * bulk - 2.0 * shear) / (6.0 * bulk + 2.0 * shear)
    for fwhm_m in (0.006, 0.0103, 0.02):
        k, weights = spot(fwhm_m)
        found = weights @ on_impedance(condensed(k, 0.0, [Sheet(palm, depth_m)]), below(k, 0.0, palm)).real
        exact = (1.0 - poisson) / shear * spread(fwhm_m) * math.sqrt(0.5 * math.pi)
        print(depth_m, fwhm_m, f"{100 * (found / exact - 1.0):.2g} %")
        assert abs(found / exact - 1.0) < 0.02


def test_reflection_of_plane_waves():
    """From the base right below palm: S waves, by amplitude. The exact impedance reflects nothing."""
    palm, angles = preset("palm"), np.array([0.5, 15.0, 30.0, 45.0, 60.0, 75.0])
    for f_Hz in (20.0, 40.0, 60.0, 100.0, 200.0, 500.0, 1000.0):
        k_p, k_s = angle_wavenumbers(f_Hz, palm, angles)
        assert np.abs(reflection(k_s, f_Hz, palm, exact_impedance(k_s, f_Hz, palm))).max() < 1e-5
        found = np.abs(reflection(k_s, f_Hz, palm, below(k_s, f_Hz, palm)))[:, 1, 1]
        pressure = np.abs(reflection(k_p, f_Hz, palm, below(k_p, f_Hz, palm)))[:, 0, 0]
        print(f"{f_Hz:g} Hz S", np.round(100 * found, 1), "P", np.round(100 * pressure, 1))


def free_wave(f_Hz, material, depth_m, base_of, start):
    """Complex wavenumber at which a layer moves without a load: Newton's method from `start` [rad/m]."""
    k = start
    for _ in range(40):
        step = 1e-5 * start
        ends = np.array([k, k + step])
        here, there = surface_stiffness(ends, f_Hz, material, depth_m, base_of(ends)) / ends
        move = here / (there - here) * step
        k -= move
        if abs(move) < 1e-9 * abs(k):
            break
    return k


@pytest.mark.parametrize("f_Hz", [20.0, 40.0, 60.0, 100.0, 200.0, 400.0, 1000.0])
def test_rayleigh_speed(f_Hz):
    """The free wave of palm 12 mm deep on the base has the phase speed of the Rayleigh wave of a half space."""
    palm = preset("palm")
    base, rayleigh = half_space(palm), rayleigh_wavenumber(palm, f_Hz)
    exact = free_wave(f_Hz, palm, 0.012, lambda k: exact_impedance(k, f_Hz, palm), 1.01 * rayleigh)
    assert exact == pytest.approx(rayleigh, rel=1e-4)
    sheets = [sheet.thickness_m for sheet in base.sheets]
    found = free_wave(f_Hz, palm, 0.012, lambda k: midpoint_sheets(k, f_Hz, palm, sheets, base.base), rayleigh)
    print(f"{f_Hz:g} Hz: {found.real / rayleigh.real - 1.0:.4f}, decay {found.imag / rayleigh.imag - 1.0:.3f}")
    assert abs(found.real / rayleigh.real - 1.0) < 0.02


def test_impedance_of_degree_0_is_that_of_the_oracle():
    palm, k = preset("palm"), np.geomspace(1.0, 2000.0, 30)
    base = half_space(palm)
    sheets = [sheet.thickness_m for sheet in base.sheets]
    for f_Hz in (0.0, 60.0, 1000.0):
        exact = midpoint_sheets(k, f_Hz, palm, sheets, base.base)
        error = np.abs(below(k, f_Hz, palm) - exact).max(axis=(1, 2))
        assert (error < 1e-8 * np.abs(exact).max(axis=(1, 2))).all()


LENGTH_M = 0.03


def strip(material, depth_m=0.012, rows=3):
    """A box of one half wave of one element with roller sides, in which cos(k x) is an exact mode; its force, and what
    the compliance of that mode is multiplied by."""
    sizes = Sizes((0.0, 0.0), 1.0, 0.004, 0.004, 1.0, 1.0, 0, 0.0, 0.0, 100.0)
    patch = box_patch(np.array([0.5 * LENGTH_M, 0.002]), depth_m, sizes)
    mesh = extrude(patch, np.linspace(0.0, 1.0, rows + 1))
    system = assemble(mesh, material, base=half_space(material), side="roller")
    quadrature = SurfaceQuadrature(system.mesh, system)
    pressure = np.sin(math.pi / LENGTH_M * quadrature.points[:, 0])
    return system, quadrature, quadrature.assemble(pressure), quadrature.weights @ pressure**2


@pytest.mark.parametrize("name", ["palm", "forearm"])
def test_elements_on_it_are_the_same_body(name):
    material, k = preset(name), np.array([math.pi / LENGTH_M])
    system, _, force, square = strip(material)
    for f_Hz in (0.0, 60.0, 200.0):
        moved = static(system, force) if f_Hz == 0.0 else harmonic(system, force, f_Hz)
        upper = condensed(k, f_Hz, [Sheet(material, 0.012)])
        found = force @ moved / square
        assert found == pytest.approx(on_impedance(upper, below(k, f_Hz, material))[0], rel=5e-3)


@pytest.mark.parametrize(
    ("side", "radius_m", "bounds"),
    [("absorbing", 0.03, (0.02, 0.06)), ("absorbing", 0.06, (0.02, 0.06)), ("fixed", 0.06, (0.15, 0.05))],
)
def test_a_disc_of_elements_moves_as_a_half_space(side, radius_m, bounds):
    """At rest and at 100 Hz, at the centre of a spot, against plane waves in a half space; fixed sides hold it."""
    material = preset("palm")
    mesh = extrude(disc_patch(radius_m, 0.01, 0.004, 0.02, 0.01), np.array([0.0, 0.3, 1.0]))
    system = assemble(mesh, material, base=half_space(material), side=side, absorbing_Hz=100.0)
    quadrature = SurfaceQuadrature(mesh, system)
    pressure = np.exp(-GAUSSIAN * (quadrature.points[:, :2] ** 2).sum(axis=1) / 0.0103**2)
    force, probe = quadrature.assemble(pressure), SurfaceProbe(mesh, np.zeros((1, 3)), system)
    k, weights = spot(0.0103)
    for f_Hz, bound in zip((0.0, 100.0), bounds, strict=True):
        u = static(system, force) if f_Hz == 0.0 else harmonic(system, force, f_Hz)
        upper = condensed(k, f_Hz, [Sheet(material, 0.01)])
        exact = weights @ on_impedance(upper, exact_impedance(k, max(f_Hz, 0.1), material))
        found = -(probe.operator @ u)[0]
        print(side, radius_m, f_Hz, abs(found / exact - 1.0))
        assert abs(found / exact - 1.0) < bound


def test_all_matrices_are_semi_definite():
    system = strip(preset("palm"))[0]
    assert len(system.parts) == 1 and system.supported
    for matrix in (system.mass, system.damping, system.elastic, system.parts[0].stiffness):
        values = np.linalg.eigvalsh(matrix.toarray())
        assert values[0] > -1e-12 * values[-1]
    assert np.linalg.eigvalsh(system.mass.toarray())[0] > 0.0


def test_under_a_mean_load_it_comes_to_rest():
    """2 s under a load that stays: within 0.1 % of the static answer from 0.5 s on, and no drift."""
    system, quadrature, force, _ = strip(preset("palm"), rows=2)
    pressure = np.sin(math.pi / LENGTH_M * quadrature.points[:, 0])
    stepper = WedgeStepper(system, quadrature.operator, 5e-4)
    state = np.zeros((1, stepper.state_size))
    rest, moved = float(force @ static(system, force)), []
    for end in (0.5, 1.0, 2.0):
        begin = [0.0, 0.5, 1.0][len(moved)]
        steps = round((end - begin) / stepper.step_s)
        loads = SurfaceLoads(pressure[None, None], np.ones((1, steps, 1)), np.ones((1, steps, 1)))
        stepper.step(state, loads, begin, end)
        moved.append(float(force @ state[0, : system.ndof]) / rest - 1.0)
    print(moved)
    assert max(map(abs, moved)) < 1e-3


@pytest.mark.parametrize("k", [20.0, 150.0, 600.0])
def test_matrices_of_lateral_waves_on_it_have_its_impedance(k):
    """Against the impedance of the sheets, at each frequency."""
    palm = preset("palm")
    slab = Slab((Sheet(palm, 0.0075),), base=half_space(palm))
    problem = depth_problem(slab, k, (12,))
    for f_Hz in (0.5, 50.0, 200.0, 800.0):
        rate = 2j * np.pi * f_Hz
        stiffness = rate**2 * problem.mass + problem.strain.T @ problem.strain
        stiffness = stiffness - rate * (problem.viscous.T @ problem.viscous)
        for part in problem.relaxing:
            for shear, tau in part.branches:
                stiffness -= shear * rate * tau / (1.0 - rate * tau) * (part.strain.T @ part.strain)
        found = np.linalg.inv(stiffness)[problem.normal, problem.normal]
        base = slab.base
        under = impedance(np.array([k]), f_Hz, base.sheets, base.base, base.degree)
        exact = on_impedance(condensed(np.array([k]), f_Hz, slab.sheets), under)[0]
        assert found == pytest.approx(exact, rel=1e-8)


def test_a_spot_on_lateral_waves_moves_as_its_sheets():
    """Amplitude under a sine of 100 Hz, after its onset."""
    palm, times = preset("palm"), np.linspace(0.0, 0.06, 601)
    slab = Slab((Sheet(palm, 0.0075),), base=half_space(palm))
    course = np.minimum(times / 0.01, 1.0) * np.sin(200.0 * np.pi * times)
    load = Spot(0.0103, times, course, np.zeros((601, 2)))
    moved = solve_lateral_waves(SkinProblem(slab, load, times[-100:], np.zeros((1, 3)), 0.02)).displacement_m[:, 0, 2]
    phase = 200.0 * np.pi * times[-100:]
    parts = np.linalg.lstsq(np.column_stack([np.cos(phase), np.sin(phase)]), moved, rcond=None)[0]
    assert np.hypot(*parts) == pytest.approx(responses(slab.sheets, 0.0103, 100.0, [slab.base])[0], rel=0.01)
