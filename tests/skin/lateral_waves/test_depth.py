"""Modes in depth against the exact plane-wave layer, which shares no code with them."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.base import Springs
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Slab
from palmfield.skin.solvers.lateral_waves.modes import depth_problem, face_modes, still_modes

pytestmark = pytest.mark.numerics

ECOFLEX = PRESETS["ecoflex_00-10"]
SHEAR = 23087.5
PRONY = dataclasses.replace(ECOFLEX, branches=(Branch(20e3, 1.7e-4), Branch(6e3, 2e-3), Branch(3e3, 3e-2)))
MATERIALS = {
    "elastic": dataclasses.replace(ECOFLEX, branches=()),
    "standard": ECOFLEX,
    "prony": PRONY,
    "voigt": Material("voigt", 923.5, SHEAR, (), bulk_from_poisson(0.495, SHEAR), "", 0.5, False),
    "voigt on both": Material("both", 923.5, SHEAR, (), bulk_from_poisson(0.495, SHEAR), "", 0.5, True),
    "incompressible": Material("hard", 923.5, SHEAR, (), 1e6 * SHEAR, "", 0.0202, False),
}


def modes(slab, k, extra=0, tolerance=1e-8):
    degrees = tuple(24 + extra + round(k * sheet.thickness_m) for sheet in slab.sheets)
    return face_modes(depth_problem(slab, k, degrees), 0.2, tolerance)


def compliance(found, s):
    """u_z per unit of pressure [m/Pa] at rate s [1/s]; negative where a static pressure pushes in."""
    return complex(np.sum(found.normal / (s - found.poles)))


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("base", ["bonded", "free_slip", "free"])
def test_compliance_is_that_of_plane_waves(name, base):
    """12 wavenumbers and frequencies a case, the whole complex number."""
    material, thickness = MATERIALS[name], 0.012
    slab = Slab((Sheet(material, thickness),), base=base)
    for k in (5.0, 200.0, 900.0):
        found = modes(slab, k)
        for f in (10.0, 70.0, 200.0, 900.0):
            exact = layer_compliance(k, f, material, thickness, base)
            # e^{-iwt} is s = -iw; pushed in is positive there, u_z here
            assert -compliance(found, -2j * np.pi * f) == pytest.approx(complex(exact), rel=2e-4)


@pytest.mark.parametrize("base", ["bonded", "free_slip"])
@pytest.mark.parametrize("k", [1.0, 5.0, 30.0])
def test_soft_modes_of_a_stiff_sheet_keep_their_digits(base, k):
    """K / G = 1e6: from the eigenvalues of its stiffness the motion at 5 rad/m was off by 1e-4 to 5e-4, by chance."""
    material, thickness = MATERIALS["incompressible"], 0.012
    found = modes(Slab((Sheet(material, thickness),), base=base), k, tolerance=1e-13)
    for f in (10.0, 70.0, 200.0):
        error = abs(-compliance(found, -2j * np.pi * f) / layer_compliance(k, f, material, thickness, base) - 1.0)
        print(base, k, f, error)
        assert error < 1e-9


@pytest.mark.parametrize("base", ["bonded", "free_slip"])
def test_static_limit(base):
    slab = Slab((Sheet(PRONY, 0.02),), base=base)
    for k in (20.0, 300.0, 1500.0):
        exact = layer_compliance(k, 0.0, PRONY, 0.02, base).real
        still, moving = still_modes(depth_problem(slab, k, (50,))), modes(slab, k)
        assert -compliance(still, 0.0).real == pytest.approx(exact, rel=1e-7)
        assert -moving.static()[0] == pytest.approx(exact, rel=1e-6)


def test_error_falls_faster_than_any_power_of_the_degree():
    """Each four degrees more take off at least a factor of 20, until round-off."""
    k, thickness, f = 700.0, 0.02, 300.0
    slab = Slab((Sheet(ECOFLEX, thickness),))
    exact = complex(layer_compliance(k, f, ECOFLEX, thickness))
    errors = []
    for degree in (8, 12, 16, 20):
        found = face_modes(depth_problem(slab, k, (degree,)), 0.2, 1e-12)
        errors.append(abs(-compliance(found, -2j * np.pi * f) / exact - 1))
    print(errors)
    assert all(later < max(earlier / 20, 1e-10) for earlier, later in pairwise(errors))


def test_sheets_of_one_material_are_one_sheet():
    whole = Slab((Sheet(ECOFLEX, 0.02),))
    cut = Slab((Sheet(ECOFLEX, 0.004), Sheet(ECOFLEX, 0.007), Sheet(ECOFLEX, 0.009)))
    for k in (30.0, 500.0):
        for s in (0.0, -2j * np.pi * 150.0):
            assert compliance(modes(cut, k), s) == pytest.approx(compliance(modes(whole, k), s), rel=1e-6)


def test_springs_between_free_and_bonded():
    """Springs of no stiffness are a free base, very stiff ones a bonded one, stiff along the normal alone a slippery
    one."""
    k, s = 150.0, -2j * np.pi * 120.0
    cases = [(0.0, 0.0, "free"), (1e13, 1e13, "bonded"), (1e13, 0.0, "free_slip")]
    for normal, tangential, base in cases:
        sprung = Slab((Sheet(ECOFLEX, 0.01),), base=Springs(normal, tangential))
        plain = Slab((Sheet(ECOFLEX, 0.01),), base=base)
        assert compliance(modes(sprung, k), s) == pytest.approx(compliance(modes(plain, k), s), rel=1e-4)


def test_a_column_on_a_dashpot_is_a_line_with_a_load():
    """At k = 0 the face's impedance is Z (Z_L + Z T) / (Z + Z_L T), T = tanh(s h / c_p), for a dashpot Z_L below."""
    material = MATERIALS["elastic"]
    modulus = material.bulk_Pa + 4.0 / 3.0 * material.shear_relaxed_Pa
    impedance = np.sqrt(material.density_kg_m3 * modulus)
    load = 0.4 * impedance
    slab = Slab((Sheet(material, 0.02),), base=Springs(0.0, 0.0, load, 0.0))
    found = face_modes(depth_problem(slab, 0.0, (24,)), 0.2, 1e-10)
    for f in (50.0, 400.0, 1000.0):
        s = -2j * np.pi * f
        t = np.tanh(s * 0.02 * material.density_kg_m3 / impedance)
        expected = impedance * (load + impedance * t) / (impedance + load * t)
        assert -1.0 / (s * compliance(found, s)) == pytest.approx(expected, rel=1e-6)


def test_residues_sum_to_nothing_and_nothing_grows():
    """A mass can't move at once, so the residues sum to 0; no pole of a passive body has a growing motion."""
    for material in MATERIALS.values():
        for base in ("bonded", "free"):
            found = modes(Slab((Sheet(material, 0.01),), base=base), 400.0, tolerance=1e-12)
            assert abs(found.normal.sum()) < 1e-7 * np.abs(found.normal).sum()
            assert found.poles.real.max() < 1e-9 * np.abs(found.poles).max()
