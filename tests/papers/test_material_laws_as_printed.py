import math

import pytest

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import complex_shear, elastic, standard_linear
from palmfield_papers.chilles2019.ecoflex import (
    ecoflex_bulk_corrected,
    ecoflex_rate_law_as_printed,
    ecoflex_rate_law_mixed,
    ecoflex_time_as_printed,
)
from palmfield_papers.mizushima2024.as_printed import (
    equivalent_modulus_as_printed,
    law_as_printed,
    sls_modulus,
    uniaxial_displacement,
    vibration_modulus_as_printed,
)

SOLID = (4e4, 6e4, 30.0)
"""E1, E2 [Pa], eta3 [Pa s]: transition at E2 / (2 pi eta3) = 318 Hz."""


def test_complex_modulus_is_equations_1_and_2():
    e1, e2, eta = SOLID
    for f in (1.0, 100.0, 3e3):
        w = 2.0 * math.pi * f
        storage = (e1 * e2**2 + (w * eta) ** 2 * (e1 + e2)) / (e2**2 + (w * eta) ** 2)
        loss = w * eta * e2**2 / (e2**2 + (w * eta) ** 2)
        assert sls_modulus(f, *SOLID) == pytest.approx(storage - 1j * loss)
    # a standard linear solid in shear has the same law
    shear = complex_shear(standard_linear("s", 1000.0, e1, e2, eta / e2), 100.0)
    assert sls_modulus(100.0, *SOLID) == pytest.approx(shear)


def test_equation_4_takes_f_for_the_angular_frequency_and_no_phase():
    e1, e2, eta = SOLID
    middle = e2 / (2.0 * math.pi * eta)
    assert sls_modulus(middle, *SOLID).real == pytest.approx(e1 + e2 / 2.0)
    assert equivalent_modulus_as_printed(2.0 * math.pi * middle, *SOLID) == pytest.approx(e1 + e2 / 2.0)
    assert equivalent_modulus_as_printed(1e9, *SOLID) == pytest.approx(e1 + e2, rel=1e-5)
    # far below the transition the storage modulus rises with f^2, the printed one with f
    rise = [sls_modulus(f, *SOLID).real - e1 for f in (1.0, 2.0)]
    printed = [equivalent_modulus_as_printed(f, *SOLID) - e1 for f in (1.0, 2.0)]
    assert rise[1] / rise[0] == pytest.approx(4.0, rel=1e-3)
    assert printed[1] / printed[0] == pytest.approx(2.0, rel=1e-2)


def test_equation_5_adds_the_branch_twice():
    e1, e2, _ = SOLID
    assert law_as_printed(1e9, *SOLID).real == pytest.approx(e1 + 2.0 * e2, rel=1e-4)
    assert sls_modulus(1e9, *SOLID).real == pytest.approx(e1 + e2, rel=1e-4)
    assert law_as_printed(1e-6, *SOLID).real == pytest.approx(e1, rel=1e-6)


def test_equation_6_counts_the_second_spring_twice():
    e1, e2, _ = SOLID
    for f, printed, right in [(1e-6, e1 + e2, e1), (1e9, e1 + 2.0 * e2, e1 + e2)]:
        assert vibration_modulus_as_printed(f, *SOLID) == pytest.approx(printed, rel=1e-4)
        assert abs(sls_modulus(f, *SOLID)) == pytest.approx(right, rel=1e-4)


def test_uniaxial_formula_overstates_a_bonded_layer():
    """1 mm bonded to metal under 4 kPa on a spot of 6 mm: several times less than P h / E."""
    young = 23.5e3
    free = uniaxial_displacement(4000.0, 1e-3, young)
    bonded = 4000.0 * float(centre_response(0.0, elastic("e", 1000.0, young / 3.0), 1e-3, 0.006).real)
    assert free == pytest.approx(170e-6, rel=0.01)
    assert 5.0 < free / bonded < 19.0


def test_printed_time_of_ecoflex_hides_its_loss():
    right, printed = preset("ecoflex_00-10"), ecoflex_time_as_printed()
    assert right.branches[0].time_s == pytest.approx(1000.0 * printed.branches[0].time_s)
    assert complex_shear(printed, 200.0).imag == pytest.approx(complex_shear(right, 200.0).imag / 1000.0, rel=0.1)
    assert complex_shear(printed, 200.0).real == pytest.approx(12.5e3, rel=1e-5)


def test_printed_rate_laws_of_ecoflex():
    right = preset("ecoflex_00-10")
    assert ecoflex_rate_law_as_printed() == pytest.approx(12.5e3 + 3.42 * (1.0 - 12.5 / 20.0))
    mixed = ecoflex_rate_law_mixed(200.0)
    assert mixed.real == 12.5e3
    assert mixed.imag == pytest.approx(-2.0 * math.pi * 200.0 * 1.2825)
    # slow enough, the right law is a dashpot of the whole eta: the mixed one has 3/8 of it
    slow = complex_shear(right, 1.0).imag
    assert ecoflex_rate_law_mixed(1.0).imag / slow == pytest.approx(0.375, rel=1e-3)
    assert abs(ecoflex_rate_law_mixed(1e5)) > 10.0 * abs(complex_shear(right, 1e5))


def test_ecoflex_bulk():
    right, printed = ecoflex_bulk_corrected(), preset("ecoflex_00-10")
    assert right.bulk_Pa / printed.bulk_Pa == pytest.approx(32.5 / 12.5)
    nu = (3.0 * printed.bulk_Pa - 2.0 * 32.5e3) / (2.0 * (3.0 * printed.bulk_Pa + 32.5e3))
    assert nu == pytest.approx(0.487, abs=5e-4)
