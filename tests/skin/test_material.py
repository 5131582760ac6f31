import math

import pytest

from palmfield.errors import SceneError
from palmfield.skin.layer_oracle import centre_response
from palmfield.skin.material import PRESETS, Branch, Material, bulk_from_poisson, complex_shear, preset, shear_wave


def solid(**changes):
    values = {"density_kg_m3": 1000.0, "shear_relaxed_Pa": 1e4, "branches": (Branch(2e4, 1e-3),), "bulk_Pa": 1e6}
    return Material(name="t", source="", **values | changes)


def test_ecoflex_modulus_matches_hand_calculation():
    material = preset("ecoflex_00-10")
    for f, storage, loss, speed, length in [
        (70, 12612, 1496, 3.52, 0.135),
        (200, 13383, 4108, 3.73, 0.0198),
        (400, 15618, 7255, 4.19, 0.0075),
    ]:
        shear = complex_shear(material, f)
        assert shear.real == pytest.approx(storage, abs=1)
        assert -shear.imag == pytest.approx(loss, abs=1)
        c, decay = shear_wave(material, f)
        assert c == pytest.approx(speed, abs=0.006)
        assert decay == pytest.approx(length, rel=0.01)


def test_modulus_limits():
    material = solid()
    assert complex_shear(material, 0.0) == 1e4
    assert complex_shear(material, 1e9).real == pytest.approx(3e4, rel=1e-6)
    assert complex_shear(solid(branches=(Branch(2e4, 0.0),)), 1e3) == 1e4
    assert shear_wave(solid(branches=()), 100.0) == (pytest.approx(math.sqrt(10.0)), math.inf)


def test_poisson_round_trip():
    for nu in (0.0, 0.3, 0.4999):
        bulk = bulk_from_poisson(nu, 1e4)
        assert (3 * bulk - 2e4) / (2 * (3 * bulk + 1e4)) == pytest.approx(nu, abs=1e-9)


def test_palm_preset_keeps_what_its_source_says():
    palm = preset("palm")
    near, far = abs(centre_response(200.0, palm, 0.012, 0.010, at=[0.005, 0.040]))
    assert far / near == pytest.approx(0.085, abs=0.001)
    for f, speed in [(50, 4.5), (100, 5.0), (200, 5.4), (400, 5.5)]:
        assert 0.9553 * shear_wave(palm, f)[0] == pytest.approx(speed, abs=0.05)
    assert palm.bulk_Pa == pytest.approx(bulk_from_poisson(0.4999, palm.shear_instant_Pa), rel=1e-9)


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
@pytest.mark.parametrize("field", ["density_kg_m3", "shear_relaxed_Pa", "bulk_Pa", "viscosity_Pa_s"])
def test_bad_numbers_are_named(field, value):
    with pytest.raises(SceneError, match=field):
        solid(**{field: value})


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_bad_branches_are_named(value):
    with pytest.raises(SceneError, match=r"branches\[1\].time_s"):
        solid(branches=(Branch(1.0, 1.0), Branch(1.0, value)))
    with pytest.raises(SceneError, match=r"branches\[0\].shear_Pa"):
        solid(branches=(Branch(value, 1.0),))


@pytest.mark.parametrize("field", ["density_kg_m3", "shear_relaxed_Pa"])
def test_zero_is_refused_where_it_means_nothing(field):
    with pytest.raises(SceneError, match=field):
        solid(**{field: 0.0})


def test_bad_poisson_frequency_and_name():
    with pytest.raises(SceneError, match=r"0\.5"):
        bulk_from_poisson(0.5, 1e4)
    with pytest.raises(SceneError, match="shear modulus"):
        bulk_from_poisson(0.4, -1.0)
    with pytest.raises(SceneError, match="frequency"):
        shear_wave(solid(), 0.0)
    with pytest.raises(SceneError, match=", ".join(sorted(PRESETS))):
        preset("jelly")
