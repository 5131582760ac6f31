import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.skin.materials.material import complex_shear, prony
from palmfield.skin.materials.prony_fit import fit_prony, fractional, fractional_kelvin_voigt

pytestmark = pytest.mark.numerics

F = np.geomspace(1.0, 1000.0, 40)


def moduli(material, f=F):
    shear = np.array([complex_shear(material, x) for x in f])
    return shear.real, -shear.imag


@settings(max_examples=15, deadline=None)
@given(
    relaxed=st.floats(1e3, 1e5),
    first=st.floats(0.2, 5.0),
    second=st.floats(0.2, 5.0),
    slow_s=st.floats(5e-3, 5e-2),
    fast_s=st.floats(2e-4, 1e-3),
)
def test_a_prony_series_is_found_again(relaxed, first, second, slow_s, fast_s):
    material = prony("m", 1000.0, relaxed, (first * relaxed, second * relaxed), (fast_s, slow_s))
    found = fit_prony(F, *moduli(material), branches=2)
    assert found.storage_misfit < 1e-4
    assert found.loss_misfit < 1e-4
    assert found.relaxed_Pa == pytest.approx(relaxed, rel=1e-2)
    assert found.times_s == pytest.approx((fast_s, slow_s), rel=1e-2)
    assert found.branches_Pa == pytest.approx((first * relaxed, second * relaxed), rel=1e-2)


def test_misfit_is_that_of_the_material():
    storage, loss = moduli(prony("m", 1000.0, 1e4, (1e4, 2e4, 5e3), (1e-2, 1e-3, 2e-4)))
    found = fit_prony(F, storage, loss, branches=1)
    fitted, lost = moduli(found.material("fit", 1000.0))
    assert found.storage_misfit == pytest.approx(math.sqrt(np.mean((fitted / storage - 1.0) ** 2)))
    assert found.loss_misfit == pytest.approx(math.sqrt(np.mean((lost / loss - 1.0) ** 2)))
    assert found.loss_misfit > 0.01
    assert found.band_Hz == (1.0, 1000.0)


def test_noise_is_not_fitted():
    """1 % noise on both moduli: the misfit is the noise, and the moduli are closer to the truth than the data are."""
    storage, loss = moduli(prony("m", 1000.0, 1e4, (1e4, 2e4), (1e-2, 5e-4)))
    noise = 1.0 + 0.01 * np.random.default_rng(0).standard_normal((2, len(F)))
    found = fit_prony(F, storage * noise[0], loss * noise[1], branches=2)
    assert found.storage_misfit == pytest.approx(0.01, rel=0.4)
    fitted, lost = moduli(found.material("fit", 1000.0))
    assert np.abs(fitted / storage - 1.0).max() < 0.01
    assert np.abs(lost / loss - 1.0).max() < 0.015


def test_more_branches_are_never_worse_on_a_fractional_law():
    """Misfit to a spring-pot falls geometrically with the number of branches."""
    shear = fractional_kelvin_voigt(F, 1e3, 2e3, 0.2)
    fits = [fit_prony(F, shear.real, -shear.imag, branches=n) for n in (1, 2, 3, 4, 5)]
    losses = [found.loss_misfit for found in fits]
    assert all(later < 0.6 * earlier for earlier, later in pairwise(losses))
    assert losses[-1] < 0.01
    assert fits[-1].storage_misfit < 0.01


@pytest.mark.parametrize("exponent", [0.1, 0.3, 0.5])
def test_fractional_material_is_within_its_misfit(exponent):
    def law(f):
        return fractional_kelvin_voigt(f, 2e3, 300.0, exponent)

    material, found = fractional("x", 1000.0, law, (5.0, 500.0), 4)
    f = np.geomspace(5.0, 500.0, 97)
    storage, loss = moduli(material, f)
    assert math.sqrt(np.mean((storage / law(f).real - 1.0) ** 2)) < 1.2 * found.storage_misfit + 1e-6
    assert math.sqrt(np.mean((loss / -law(f).imag - 1.0) ** 2)) < 1.2 * found.loss_misfit + 1e-6
    assert found.loss_misfit < 0.02


def test_fractional_laws_in_their_limits():
    """Exponent 1: Kelvin-Voigt; a spring-pot's loss tangent is tan(pi a / 2)."""
    voigt = fractional_kelvin_voigt(F, 1e4, 5.0, 1.0)
    np.testing.assert_allclose(voigt, 1e4 - 2j * math.pi * F * 5.0, rtol=1e-12)
    pot = fractional_kelvin_voigt(F, 0.0, 1.0, 0.3)
    np.testing.assert_allclose(-pot.imag / pot.real, math.tan(0.15 * math.pi), rtol=1e-12)


def test_bad_data_and_bands():
    storage, loss = moduli(prony("m", 1000.0, 1e4, (1e4,), (1e-3,)))
    with pytest.raises(SceneError, match="loss_Pa"):
        fit_prony(F, storage, 0.0 * loss, 1)
    with pytest.raises(SceneError, match="storage_Pa"):
        fit_prony(F, storage[1:], loss, 1)
    with pytest.raises(SceneError, match="f_Hz"):
        fit_prony(np.full(40, np.nan), storage, loss, 1)
    with pytest.raises(SceneError, match="40 branches"):
        fit_prony(F, storage, loss, 40)
    with pytest.raises(SceneError, match="0 branches"):
        fit_prony(F, storage, loss, 0)
    with pytest.raises(SceneError, match="band"):
        fractional("x", 1000.0, lambda f: fractional_kelvin_voigt(f, 1e3, 1e3, 0.2), (10.0, 10.0), 1)
