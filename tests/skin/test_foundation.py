"""Springs, dashpots and foundations below a layer; sheets of several materials: against polynomials in depth.

`depth` shares no code with the wedges; it is itself held against layer_oracle's plane waves here.
"""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.skin.assembly import assemble
from palmfield.skin.body_mesh import Sizes, box_patch
from palmfield.skin.depth import condensed, surface_compliance
from palmfield.skin.disc import disc_patch
from palmfield.skin.foundation import Form, Foundation, fit_foundation
from palmfield.skin.layer_oracle import layer_compliance
from palmfield.skin.load import SurfaceQuadrature
from palmfield.skin.material import Branch, Material, bulk_from_poisson
from palmfield.skin.presets import preset
from palmfield.skin.problem import Sheet, Springs
from palmfield.skin.solver import harmonic, static
from palmfield.skin.wedges import extrude

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
        np.testing.assert_allclose(surface_compliance(k, f, halves, base), exact, rtol=1e-7)


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
    return force @ u, square * surface_compliance(np.array([K]), f, sheets, base)[0]


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


FITS: dict = {}


def fitted(material, total, kept):
    key = (material.name, total, kept)
    if key not in FITS:
        FITS[key] = fit_foundation([Sheet(material, kept)], [Sheet(material, total - kept)], 0.0103)
    return FITS[key]


@pytest.mark.parametrize(("name", "total", "kept"), [("ecoflex_00-10", 0.012, 0.006)])
def test_foundation_meets_ten_percent_on_half_the_depth(name, total, kept):
    found = fitted(preset(name), total, kept)
    print(name, np.round(found.misfit, 3))
    assert max(found.misfit) <= 0.105
    assert found.holds


def test_meshed_on_a_foundation_moves_as_the_foundation_says():
    """The base's matrices are the forms that were fitted: wedges on them against the impedance below half the depth."""
    found = fitted(ECOFLEX, 0.024, 0.012)
    body = strip(np.linspace(0.0, 1.0, 5), ECOFLEX, found)
    for f in (100.0, 200.0, 400.0):
        stiffness = condensed(np.array([K]), f, [Sheet(ECOFLEX, 0.012)])
        stiffness[:, 2:, 2:] += found.impedance(np.array([K]), f)
        exact = body[2] * np.linalg.inv(stiffness[0])[1, 1]
        moved, _ = works(f, *body, [Sheet(ECOFLEX, 0.024)], "bonded")
        print(f, abs(moved / exact - 1))
        assert abs(moved / exact - 1) < 3e-3


@settings(max_examples=50, deadline=None)
@given(
    sizes=st.tuples(*[st.floats(0.0, 1e3)] * 4), reaches=st.tuples(*[st.floats(-3.0, 3.0)] * 2), k=st.floats(0.0, 1e3)
)
def test_forms_are_passive(sizes, reaches, k):
    matrix = Form(*sizes, *reaches).at(np.array([k]))[0]
    assert np.linalg.eigvalsh(matrix)[0] >= -1e-9 * np.abs(matrix).max()


def test_bad_input():
    with pytest.raises(SceneError, match="shear is -1"):
        Form(shear=-1.0)
    with pytest.raises(SceneError, match="need a law"):
        Foundation(relaxing=Form(1.0))
    with pytest.raises(SceneError, match="1 sheets above, 0 below"):
        fit_foundation([Sheet(ECOFLEX, 0.01)], [], 0.01)
