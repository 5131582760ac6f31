"""Springs, dashpots and foundations below a layer; sheets of several materials: against polynomials in depth.

`depth` shares no code with the wedges; it is itself held against layer_oracle's plane waves here.
"""

import dataclasses
import math

import numpy as np
import pytest
from depth_compliance import depth_compliance
from hypothesis import example, given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.base import Springs
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.depth import impedance
from palmfield.skin.fem.foundation import Foundation, fit_foundation
from palmfield.skin.fem.generalised_alpha import branch_weights
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.mesh.body_mesh import Sizes, box_patch
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import GAUSSIAN, spread

pytestmark = pytest.mark.numerics

ECOFLEX, PALM = preset("ecoflex_00-10"), preset("palm")
LENGTH = 0.015
K = math.pi / LENGTH
THICKNESS = (0.002, 0.004, 0.006)
STIFF = Material("stiff", 1100.0, 6e4, (Branch(3e4, 5e-4), Branch(1e4, 5e-3)), bulk_from_poisson(0.499, 1e5), "")
VISCOUS = Material("viscous", 950.0, 8e3, (), bulk_from_poisson(0.49, 8e3), "", viscosity_Pa_s=3.0, bulk_relaxes=True)


@pytest.mark.parametrize("name", ["ecoflex_00-10", "palm"])
@pytest.mark.parametrize("base", ["bonded", "free_slip", "free"])
def test_depth_polynomials_are_the_plane_waves(name, base):
    k = np.array([5.0, 30.0, 100.0, 300.0, 600.0])
    halves = [Sheet(preset(name), 0.005), Sheet(preset(name), 0.015)]
    for f in (0.0, 100.0, 400.0)[base == "free" :]:
        exact = layer_compliance(k, f, preset(name), 0.02, base)
        np.testing.assert_allclose(depth_compliance(k, f, halves, base), exact, rtol=1e-7)
        # One polynomial a sheet: spectral convergence with its degree.
        errors = [
            np.abs(1.0 / np.linalg.inv(impedance(k, f, halves, base, degree))[:, 1, 1] * exact - 1.0)
            for degree in (4, 8, 12)
        ]
        assert errors[2][:3].max() < 1e-6
        assert (errors[1] < 0.2 * errors[0] + 1e-9).all()


def strip(fractions, materials, base, edge_m=0.003):
    """A box of one half wave by one element with roller sides, in which cos(k x) is an exact mode; its force."""
    sizes = Sizes((0.0, 0.0), 1.0, edge_m, edge_m, 1.0, 1.0, 0, 0.0, 0.0, 100.0)
    patch = box_patch(np.array([0.5 * LENGTH, 0.5 * edge_m]), sum(THICKNESS), sizes)
    system = assemble(extrude(patch, fractions), materials, base=base, side="roller")
    quadrature = SurfaceQuadrature(system.mesh, system)
    pressure = np.sin(K * quadrature.points[:, 0])
    return system, quadrature.assemble(pressure), quadrature.weights @ pressure**2


def works(f, system, force, square, sheets, base):
    """Work of the mode by wedges, and by the compliance of the sheets."""
    u = static(system, force) if f == 0.0 else harmonic(system, force, f)
    return force @ u, square * depth_compliance(np.array([K]), f, sheets, base)[0]


@pytest.mark.parametrize(
    "base", ["bonded", "free_slip", Springs(2e6, 1e6), Springs(3e6, 5e5, normal_Pa_s_m=2e3, tangential_Pa_s_m=500.0)]
)
def test_sheets_of_three_laws_on_any_base(base):
    """Two branches, Kelvin-Voigt with a relaxing bulk modulus, and one branch: three laws, three parts."""
    sheets = [Sheet(m, h) for m, h in zip((STIFF, VISCOUS, ECOFLEX), THICKNESS, strict=True)]
    fractions = np.array([0.0, 1.0, 2.0, 4.0, 6.0, 9.0, 12.0]) / 12.0
    body = strip(fractions, [STIFF, STIFF, VISCOUS, VISCOUS, ECOFLEX, ECOFLEX], base)
    for f in (0.0, 100.0, 300.0):
        found, exact = works(f, *body, sheets, base)
        print(base, f, abs(found / exact - 1))
        assert abs(found / exact - 1) < 2e-3


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_thousand_times_stiffer_sheet(order):
    """Hard case 9: stiffness ratio 1000, either on top."""
    soft = Material("soft", 1000.0, 1e3, (Branch(0.0, 1e-3),), bulk_from_poisson(0.4999, 1e3), "")
    hard = dataclasses.replace(soft, name="hard", shear_relaxed_Pa=1e6, bulk_Pa=bulk_from_poisson(0.4999, 1e6))
    pair = [(soft, hard)[i] for i in order]
    sheets = [Sheet(pair[0], 0.004), Sheet(pair[1], 0.008)]
    body = strip(np.array([0.0, 1.0, 2.0, 4.0, 6.0]) / 6.0, [pair[0]] * 2 + [pair[1]] * 2, "bonded")
    for f in (0.0, 50.0):
        found, exact = works(f, *body, sheets, "bonded")
        print(order, f, abs(found / exact - 1))
        assert abs(found / exact - 1) < 5e-3


def test_parts_by_law():
    sheets = np.array([0.0, 0.2, 0.5, 1.0])
    mesh = extrude(disc_patch(0.02, 0.01, 0.01, 0.01, 0.01), sheets)
    denser = dataclasses.replace(ECOFLEX, density_kg_m3=2000.0)
    assert len(assemble(mesh, [ECOFLEX, PALM, denser]).parts) == 2
    heavy = assemble(mesh, [ECOFLEX, PALM, denser], base="free", side="free")
    ones = np.tile([0.0, 0.0, 1.0], len(mesh.nodes))
    area = SurfaceQuadrature(mesh, heavy).weights.sum()
    assert ones @ heavy.mass @ ones == pytest.approx(area * 0.01 * (0.2 * 1030 + 0.3 * 1100 + 0.5 * 2000), rel=1e-12)
    with pytest.raises(SceneError, match="2 materials for 3 rows"):
        assemble(mesh, [ECOFLEX, PALM])


@pytest.mark.parametrize("side", ["fixed", "roller", "free", "absorbing"])
@pytest.mark.parametrize("base", ["bonded", "free_slip", "free", Springs(1e6, 2e5, 10.0, 20.0)])
def test_at_degree_two_a_foundation_is_a_row_of_wedges(base, side):
    """Two sheets of unlike laws meshed, or below the mesh: the same matrices to round-off, sponge and dashpots too."""
    whole = extrude(disc_patch(0.02, 0.012, 0.006, 0.008, 0.01), np.array([0.0, 0.25, 0.5, 1.0]))
    upper = extrude(disc_patch(0.02, 0.003, 0.006, 0.008, 0.01), np.array([0.0, 1.0]))
    conditions = {
        "side": side,
        "absorbing_Hz": 100.0 if side == "absorbing" else None,
        "sponge_1_s": np.linspace(0.0, 5.0, len(upper.surface_triangles6)),
    }
    meshed = assemble(whole, [PALM, PALM, VISCOUS], base=base, **conditions)
    below = Foundation((Sheet(PALM, 0.003), Sheet(VISCOUS, 0.006)), base, 2)
    found = assemble(upper, PALM, base=below, **conditions)
    pairs = [(meshed.mass, found.mass), (meshed.damping, found.damping), (meshed.elastic, found.elastic)]
    pairs += [(a.stiffness, b.stiffness) for a, b in zip(meshed.parts, found.parts, strict=True)]
    assert len(pairs) == 5
    for a, b in pairs:
        assert abs(a - b).max() <= 1e-14 * abs(a).max()
    assert abs(meshed.directions - found.directions).max() == 0.0
    np.testing.assert_array_equal(meshed.surface_node, found.surface_node)
    assert meshed.supported == found.supported


def spot_on_quarter_box(material, depth_m, share, fwhm_m, half_m=0.03):
    """A spot at the corner of a box with roller sides, all but its upper part on a foundation: complex misfits.

    Exact: the cosine series over the box, each mode by layer_oracle's plane waves. Shape (frequencies, places).
    """
    upper, below = Sheet(material, share * depth_m), Sheet(material, (1.0 - share) * depth_m)
    found = fit_foundation([upper], [below], fwhm_m)
    corner = np.array([-0.5 * half_m, -0.5 * half_m, 0.0])
    fine, coarse = min(0.45 * fwhm_m, 0.004), 0.004
    sizes = Sizes((corner[0], corner[1]), 1.2 * fwhm_m, fine, coarse, 1.0, 1.0, 0, 0.0, 0.0, 100.0)
    mesh = extrude(box_patch(-corner[:2], upper.thickness_m, sizes), np.array([0.0, 0.4, 1.0]))
    system = assemble(mesh, material, base=found, side="roller")
    quadrature = SurfaceQuadrature(mesh, system)
    force = quadrature.assemble(np.exp(-GAUSSIAN * ((quadrature.points - corner) ** 2).sum(axis=1) / fwhm_m**2))
    x = fwhm_m * np.array([0.0, 0.5, 1.0])
    read = SurfaceProbe(mesh, corner + np.column_stack([x, 0.0 * x, 0.0 * x]), system).operator

    order = np.arange(math.ceil(5.0 / spread(fwhm_m) * half_m / math.pi) + 2)
    points, rule = np.polynomial.legendre.leggauss(200)
    points, rule = 0.5 * half_m * (1.0 + points), 0.5 * half_m * rule
    waves = np.cos(np.outer(order, points) * math.pi / half_m)
    shares = waves @ (rule * np.exp(-GAUSSIAN * (points / fwhm_m) ** 2)) * np.where(order, 2.0, 1.0) / half_m
    k = math.pi / half_m * np.hypot(order[:, None], order)
    misfits = []
    for f in (50.0, 100.0, 200.0, 400.0):
        modes = layer_compliance(k, f, material, depth_m) * np.outer(shares, shares)
        exact = np.cos(np.outer(x, order) * math.pi / half_m) @ modes.sum(axis=1)
        misfits.append(np.abs(-(read @ harmonic(system, force, f)) / exact - 1.0))
    return found, np.array(misfits)


@pytest.mark.parametrize(
    ("name", "depth_m", "share", "fwhm_m"),
    [
        ("palm", 0.02, 0.25, 0.005),
        ("palm", 0.02, 0.25, 0.02),
        ("ecoflex_00-10", 0.012, 0.25, 0.005),
        ("ecoflex_00-10", 0.012, 0.25, 0.02),
        ("forearm", 0.012, 1 / 3, 0.02),
    ],
)
def test_surface_on_a_foundation_moves_as_the_whole_depth(name, depth_m, share, fwhm_m):
    """Within 10 % at 50 to 400 Hz at the centre, half a width and a width away, meshed to a quarter or a third."""
    found, misfits = spot_on_quarter_box(preset(name), depth_m, share, fwhm_m)
    print(name, depth_m, share, fwhm_m, found.degree, np.round(100.0 * misfits, 1).tolist())
    assert misfits.max() <= 0.10
    assert max(found.misfit) <= 0.05


def test_degree_is_the_lowest_that_holds():
    sheets = [Sheet(PALM, 0.005)], [Sheet(PALM, 0.015)]
    found = fit_foundation(*sheets)
    assert found.frequencies_Hz[0] == 50.0 and found.frequencies_Hz[-1] == 400.0
    assert max(found.misfit) <= 0.05
    coarser = fit_foundation(*sheets, target=0.5)
    assert coarser.degree < found.degree and max(coarser.misfit) > 0.05


def test_static_limit():
    """Three sheets of unlike laws, of which the upper one is meshed."""
    sheets = [Sheet(m, h) for m, h in zip((STIFF, VISCOUS, ECOFLEX), THICKNESS, strict=True)]
    below = fit_foundation(sheets[:1], sheets[1:])
    sizes = Sizes((0.0, 0.0), 1.0, 0.003, 0.003, 1.0, 1.0, 0, 0.0, 0.0, 100.0)
    mesh = extrude(box_patch(np.array([0.5 * LENGTH, 0.0015]), THICKNESS[0], sizes), np.array([0.0, 0.5, 1.0]))
    system = assemble(mesh, STIFF, base=below, side="roller")
    quadrature = SurfaceQuadrature(mesh, system)
    pressure = np.sin(K * quadrature.points[:, 0])
    body = system, quadrature.assemble(pressure), quadrature.weights @ pressure**2
    for f in (0.0, 200.0):
        found, exact = works(f, *body, sheets, "bonded")
        print(below.degree, f, abs(found / exact - 1))
        assert abs(found / exact - 1) < 0.01


@settings(max_examples=40, deadline=None)
@given(
    degree=st.integers(1, 8),
    heights=st.lists(st.floats(1e-4, 0.1), min_size=1, max_size=3),
    base=st.sampled_from(["bonded", "free_slip", "free", Springs(1e5, 1e4, 30.0, 0.0)]),
    k=st.floats(0.01, 2e3),
    f_Hz=st.floats(1e-3, 1e4),
)
# Thin free sheets under long slow waves: by moduli over heights their loss was -5e-7 and -2e-5 of Z, from rounding.
@example(degree=8, heights=[1e-3], base="free", k=2.0, f_Hz=3.0)
@example(degree=4, heights=[1e-3, 1e-3], base="free", k=1.0, f_Hz=1.0)
@example(degree=7, heights=[1.4e-4], base="free", k=0.33, f_Hz=0.6)
def test_foundations_are_passive(degree, heights, base, k, f_Hz):
    """Under e^{-i w t} what moves a foundation works on it: -Im Z has no negative eigenvalue."""
    sheets = tuple(Sheet(m, h) for m, h in zip((PALM, VISCOUS, ECOFLEX), heights, strict=False))
    z = impedance(np.array([k]), f_Hz, sheets, base, degree)[0]
    assert np.linalg.eigvalsh(-0.5 * (z.imag + z.imag.T))[0] >= -1e-15 * np.abs(z).max()


@pytest.mark.parametrize("f_Hz", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("degree", [1, 4, 8])
def test_thin_free_sheets_under_long_waves_are_their_mass(degree, f_Hz):
    """Across, they move as one: moduli over heights, 1e10 times their inertia and more, leave no rounding in it."""
    sheets = Sheet(PALM, 2e-4), Sheet(STIFF, 3e-4), Sheet(ECOFLEX, 5e-4)
    z = impedance(np.array([1e-3]), f_Hz, sheets, "free", degree)[0]
    inertia = (2.0 * math.pi * f_Hz) ** 2 * sum(s.material.density_kg_m3 * s.thickness_m for s in sheets)
    print(degree, f_Hz, abs(z[1, 1] / -inertia - 1.0))
    assert abs(z[1, 1] / -inertia - 1.0) < 1e-8


def shaken():
    """A small disc on a foundation, every unknown of it kicked."""
    mesh = extrude(disc_patch(0.02, 0.004, 0.008, 0.008, 0.01), np.array([0.0, 1.0]))
    system = assemble(mesh, PALM, base=Foundation((Sheet(PALM, 0.012),), "bonded", 4), side="free")
    return system, np.random.default_rng(2).normal(size=system.ndof)


@pytest.mark.parametrize("step_s", [2e-5, 2e-4, 1e-2])
def test_unloaded_energy_never_grows_on_a_foundation(step_s, nodal_stepper):
    """rho_inf = 1: a theorem at any step, what is lost in a step being a square.

    With w = u - q, w1 = (1 - b)(u1 - u0) + e w0: a branch works (w0 + w1)/2 (u1 - u0) = ((1 + e)/2 (w1^2 - w0^2) +
    (1 - e)/2 (w0 + w1)^2) / (2 (1 - b)), so its stored energy is weighted by (1 + e) / (2 (1 - b)).
    """
    system, kick = shaken()
    solver = nodal_stepper(system, step_s, rho_inf=1.0)
    state = solver.new_state()
    state[1] = kick
    stiffness, rest = system.parts[0].stiffness, np.zeros(system.ndof)
    e, _, b = branch_weights(step_s, PALM.relaxation.branches[0][1])
    weight = PALM.relaxation.branches[0][0] * (1.0 + e) / (2.0 * (1.0 - b))
    levels = []
    for _ in range(200):
        u, v, _, q = state
        stored = u @ (system.elastic @ u) + u @ (stiffness @ u) + weight * ((u - q) @ (stiffness @ (u - q)))
        levels.append(0.5 * (v @ (system.mass @ v) + stored))
        solver.step(state, rest, rest)
    assert np.all(np.diff(levels) <= 1e-12 * levels[0])
    assert levels[-1] < levels[0]


def test_bad_input():
    with pytest.raises(SceneError, match="degree is -1"):
        Foundation((Sheet(ECOFLEX, 0.01),), degree=-1)
    with pytest.raises(SceneError, match="base is 'glued'"):
        Foundation((Sheet(ECOFLEX, 0.01),), "glued")
    with pytest.raises(SceneError, match="1 sheets above, 0 below"):
        fit_foundation([Sheet(ECOFLEX, 0.01)], [], 0.01)
    with pytest.raises(SceneError, match=r"the error is still \d+\.?\d* % at 400 Hz; target 5 %: mesh more"):
        fit_foundation([Sheet(PALM, 0.005)], [Sheet(PALM, 0.1)])
