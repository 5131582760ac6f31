import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.materials.dispersion import cutoff, describe, rayleigh_wavenumber
from palmfield.skin.materials.material import complex_bulk, complex_shear, elastic, kelvin_voigt, prony, shear_wave


@pytest.mark.parametrize(("nu", "ratio"), [(0.0, 0.8740), (0.25, 0.9194), (0.5, 0.9553)])
def test_elastic_rayleigh_speed(nu, ratio):
    """Roots that textbooks tabulate."""
    waves = describe(elastic("e", 1000.0, 1e4, nu), 100.0)
    assert waves.rayleigh_speed_m_s / waves.shear_speed_m_s == pytest.approx(ratio, abs=5e-5)
    assert waves.rayleigh_length_m > 1e6
    assert waves.shear_Pa.imag == 0.0


@pytest.mark.parametrize(
    "material",
    [
        prony("branch", 1100.0, 2e4, (3e3,), (1e-3,), 0.4),
        prony("compressible", 1000.0, 1e4, (8e2, 2e2), (1e-3, 1e-4), 0.2),
        kelvin_voigt("dashpot", 923.5, 2.3e4, 1.0, 0.4999),
        kelvin_voigt("both", 923.5, 2.3e4, 1.0, 0.45, bulk_relaxes=True),
    ],
    ids=lambda material: material.name,
)
def test_rayleigh_wavenumber_is_the_pole_of_a_deep_layer(material):
    """1/compliance of the exact layer, 20 wavelengths deep, has its zero there: by polynomials on the real axis."""
    f, width = 200.0, 0.02
    expected = rayleigh_wavenumber(material, f)
    depth = 20.0 * 2.0 * math.pi / expected.real
    x = np.cos(np.pi * (np.arange(25) + 0.5) / 25)
    inverse = 1.0 / layer_compliance(expected.real * (1.0 + width * x), f, material, depth)
    roots = np.roots(np.polyfit(x, inverse / np.abs(inverse).max(), 10))
    found = expected.real * (1.0 + width * roots[np.argmin(np.abs(roots))])
    assert abs(found - expected) < 1e-5 * abs(expected)
    assert expected.imag > 0.01 * expected.real


@settings(max_examples=60, deadline=None)
@given(
    nu=st.floats(0.0, 0.4999),
    branch=st.floats(0.0, 1e5),
    time_s=st.floats(1e-6, 1.0),
    viscosity=st.floats(0.0, 3.0),
    f=st.floats(1.0, 1000.0),
)
def test_surface_of_the_rayleigh_wave_carries_no_traction(nu, branch, time_s, viscosity, f):
    """Potentials phi e^{-a z}, psi e^{-b z}: both tractions at z = 0 vanish for one ratio of the two."""
    material = prony("m", 1000.0, 1e4, (branch,), (time_s,), nu, viscosity_Pa_s=viscosity)
    k = rayleigh_wavenumber(material, f)
    shear, bulk = complex_shear(material, f), complex_bulk(material, f)
    omega = 2.0 * math.pi * f
    pressure_modulus = bulk + 4.0 / 3.0 * shear
    a, b = (np.sqrt(k**2 - material.density_kg_m3 * omega**2 / m + 0j) for m in (pressure_modulus, shear))
    a, b = (-root if root.real < 0.0 else root for root in (a, b))
    # u = grad phi + curl psi: u_x = ik phi + b psi, u_z = -a phi + ik psi
    lame = bulk - 2.0 / 3.0 * shear
    normal = np.array([(lame + 2.0 * shear) * a**2 - lame * k**2, -2j * k * b * shear])
    tangential = np.array([-2j * k * a * shear, -(k**2 + b**2) * shear])
    matrix = np.array([normal / np.abs(normal).max(), tangential / np.abs(tangential).max()])
    assert abs(np.linalg.det(matrix)) < 1e-8
    assert k.real > 0.0
    assert k.imag >= -1e-12 * k.real


def test_nearly_incompressible_rayleigh_wave_follows_the_shear_wave():
    material = prony("m", 1100.0, 2e4, (1.7e4,), (1.5e-3,), 0.4999)
    waves = describe(material, 200.0)
    assert waves.rayleigh_speed_m_s / waves.shear_speed_m_s == pytest.approx(0.9553, abs=2e-4)
    assert waves.rayleigh_length_m / waves.shear_length_m == pytest.approx(0.9553, abs=2e-4)


def test_describe_agrees_with_its_parts():
    material = kelvin_voigt("m", 1000.0, 8e3, 5.0, 0.49)
    waves = describe(material, 150.0, 0.01)
    assert waves.shear_Pa == complex_shear(material, 150.0)
    assert (waves.shear_speed_m_s, waves.shear_length_m) == shear_wave(material, 150.0)
    assert -waves.shear_Pa.imag / waves.shear_Pa.real == pytest.approx(2 * math.pi * 150.0 * 5.0 / 8e3)
    assert waves.cutoff_Hz == cutoff(material, 0.01)
    assert describe(material, 150.0).cutoff_Hz is None
    modulus = material.bulk_Pa + 4.0 / 3.0 * waves.shear_Pa
    wavenumber = 2.0 * math.pi * 150.0 * np.sqrt(1000.0 / modulus)
    assert waves.pressure_speed_m_s == pytest.approx(2.0 * math.pi * 150.0 / wavenumber.real)
    assert waves.pressure_length_m == pytest.approx(1.0 / wavenumber.imag)


def test_cutoff_of_elastic_and_dispersive_layers():
    assert cutoff(elastic("e", 923.5, 23087.5), 0.010) == pytest.approx(125.0)
    soft = prony("m", 1000.0, 1e4, (4e4,), (1e-3,))
    f = cutoff(soft, 0.012)
    assert f == pytest.approx(shear_wave(soft, f)[0] / 0.048)
    assert f > math.sqrt(10.0) / 0.048


def test_a_bonded_layer_resonates_above_the_cutoff_only():
    """Largest answer of the exact layer over all wavenumbers, in units of h/G: modest below c_s/4h, a pole above."""
    material = kelvin_voigt("m", 1000.0, 1e4, 1e-3, 0.4999)
    h = 0.01
    f_c = cutoff(material, h)
    k = np.linspace(1.0, 2000.0, 40001)

    def largest(f):
        return np.abs(layer_compliance(k, f, material, h)).max() * 1e4 / h

    assert largest(0.8 * f_c) < 3.0
    assert largest(1.2 * f_c) > 30.0


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_bad_frequency_and_thickness(value):
    material = elastic("e", 1000.0, 1e4)
    with pytest.raises(SceneError, match="frequency"):
        describe(material, value)
    with pytest.raises(SceneError, match="frequency"):
        rayleigh_wavenumber(material, value)
    with pytest.raises(SceneError, match="thickness"):
        describe(material, 100.0, value)
