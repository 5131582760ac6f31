import math

import numpy as np
import pytest
from observed import OBSERVATIONS, misfits, predicted
from scipy.optimize import least_squares

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.extreme_sheets import scaled, varied
from palmfield.skin.materials.catalogue import CATALOGUE, DEPTH_M, GEL_STORAGE_PA, PRESETS, hand_skin, preset
from palmfield.skin.materials.dispersion import describe
from palmfield.skin.materials.material import bulk_from_poisson, complex_shear, shear_wave
from palmfield.skin.materials.prony_fit import fractional_kelvin_voigt

NAMES = ["ecoflex_00-10", "finger_pad", "forearm", "gelatin_2", *sorted(GEL_STORAGE_PA), "palm"]


def test_catalogue():
    assert set(NAMES) <= set(PRESETS)
    for name, entry in CATALOGUE.items():
        assert preset(name) is entry.material
        assert entry.material.name == name
        assert entry.material.source
        for known in entry.ranges:
            assert known.low < known.high
            assert known.source
            value = 1.0 if known.parameter == "shear" else getattr(entry.material, known.parameter)
            assert known.low <= value <= known.high


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


def test_palm_keeps_what_its_source_says():
    palm = preset("palm")
    near, far = abs(centre_response(200.0, palm, 0.012, 0.010, at=[0.005, 0.040]))
    assert far / near == pytest.approx(0.085, abs=0.001)
    for f, speed in [(50, 4.5), (100, 5.0), (200, 5.4), (400, 5.5)]:
        assert 0.9553 * shear_wave(palm, f)[0] == pytest.approx(speed, abs=0.05)
    assert palm.bulk_Pa == pytest.approx(bulk_from_poisson(0.4999, palm.shear_instant_Pa), rel=1e-9)


def test_palm_decays_as_a_default_must_and_finger_pad_does_not():
    decays = {name: predicted(PRESETS[name], OBSERVATIONS[name][-1]) for name in ("palm", "finger_pad")}
    assert 0.05 < decays["palm"] < 0.15
    assert decays["finger_pad"] < 0.05


def test_finger_pad_has_the_speeds_that_it_was_fitted_to():
    entry = CATALOGUE["finger_pad"]
    assert np.abs(misfits(entry)[:4]).max() < 0.005


def test_gelatin_has_the_printed_speed_and_absorption():
    """alpha = 3e5 dB/(MHz^2 cm) in nepers per metre at f is w^2 eta / (2 rho c^3), as the shear wave's 1/e length."""
    material = preset("gelatin_2")
    f = 200.0
    speed, length = shear_wave(material, f)
    assert speed == pytest.approx(5.0, rel=1e-4)
    decibel_m = 3e5 * (f / 1e6) ** 2 * 100.0
    assert 1.0 / length == pytest.approx(decibel_m * math.log(10.0) / 20.0, rel=2e-3)


def test_gelatin_range_is_what_its_words_say():
    _, damped = varied(CATALOGUE["gelatin_2"])
    assert damped.viscosity_Pa_s == 1.0
    assert shear_wave(damped, 400.0)[1] * math.log(10.0) == pytest.approx(0.08, abs=0.005)


@pytest.mark.parametrize("name", sorted(GEL_STORAGE_PA))
def test_gels_follow_the_fractional_law(name):
    """E' at 10 Hz as printed; loss tangent rising to 100 Hz, then flat, as the paper says of its figure."""
    material = preset(name)
    assert 3.0 * complex_shear(material, 10.0).real == pytest.approx(GEL_STORAGE_PA[name], rel=0.02)
    tangents = [-complex_shear(material, f).imag / complex_shear(material, f).real for f in (1, 10, 100, 1000)]
    assert tangents[0] < tangents[1] < tangents[2]
    assert tangents[3] == pytest.approx(tangents[2], rel=0.1)
    pot = complex(fractional_kelvin_voigt(np.array([10.0]), 0.0, 1.0, 0.2)[0])
    part = complex_shear(material, 10.0).imag / pot.imag
    f = np.array([2.0, 10.0, 50.0, 100.0, 500.0])
    spring = (complex_shear(material, 10.0) - part * pot).real
    law = fractional_kelvin_voigt(f, spring, part, 0.2)
    assert np.abs([complex_shear(material, x) for x in f] / law - 1.0).max() < 0.05


def test_forearm_meets_the_speed_measured_with_it():
    entry = CATALOGUE["forearm"]
    (seen,) = OBSERVATIONS["forearm"]
    assert abs(predicted(entry.material, seen) - seen.value) < 2.0 * seen.spread
    assert misfits(entry) == [predicted(entry.material, seen) / seen.value - 1.0]


def test_models_are_those_of_waves():
    seen = OBSERVATIONS["gelatin_2"][0]
    assert predicted(preset("palm"), seen) == describe(preset("palm"), 200.0).shear_speed_m_s


def test_varied_and_scaled():
    soft, hard = varied(CATALOGUE["ecoflex_00-10"])
    assert complex_shear(soft, 200.0) == pytest.approx(0.5 * complex_shear(preset("ecoflex_00-10"), 200.0))
    assert hard.bulk_Pa == preset("ecoflex_00-10").bulk_Pa
    assert len(varied(CATALOGUE["forearm"])) == 4
    assert scaled(preset("forearm"), 2.0, "x").viscosity_Pa_s == 2.0 * 5.03


@pytest.mark.parametrize("site", sorted(DEPTH_M))
def test_hand_skin(site):
    sheets = hand_skin(site)
    assert [sheet.material.name.split(", ")[1] for sheet in sheets] == [
        "stratum corneum",
        "epidermis",
        "dermis",
        "subcutis",
    ]
    assert sum(sheet.thickness_m for sheet in sheets) == pytest.approx(DEPTH_M[site])
    stiffness = [sheet.material.shear_relaxed_Pa for sheet in sheets]
    assert stiffness == sorted(stiffness, reverse=True)
    for sheet in sheets:
        assert np.array(sheet.material.relaxation.branches) == pytest.approx(np.array(preset(site).relaxation.branches))
    assert hand_skin(site, 0.02)[3].thickness_m == pytest.approx(0.02 - DEPTH_M[site] + sheets[3].thickness_m)


def test_errors():
    with pytest.raises(SceneError, match=", ".join(sorted(PRESETS))):
        preset("jelly")
    with pytest.raises(SceneError, match="finger_pad"):
        hand_skin("elbow")
    with pytest.raises(SceneError, match=r"0\.0017 m"):
        hand_skin("palm", 0.001)


def test_no_passive_solid_has_the_palms_speeds_and_its_decay():
    """Kramers-Kronig: whatever a relaxation spectrum is, speeds that rise so fast go with more loss than the palm's."""
    omega, rho = 2.0 * np.pi * np.array([50.0, 100.0, 200.0, 400.0]), 1100.0
    aim, taus = np.array([3.6, 4.6, 6.0, 7.1]) / 0.9553, np.geomspace(1e-5, 0.1, 25)
    branches = 1j * omega[:, None] * taus / (1.0 + 1j * omega[:, None] * taus)

    def wave(logs):
        moduli = np.exp(logs)
        wavenumber = omega / np.sqrt((moduli[0] + branches @ moduli[1:]) / rho)
        return omega / wavenumber.real / aim, -1.0 / wavenumber.imag[2]

    def misfit(logs, length_m):
        speed, decay = wave(logs)
        return np.append(np.log(speed), 50.0 * max(0.0, np.log(length_m / decay)))

    start = np.log(np.r_[1e4, np.full(len(taus), 1e3)])
    fits = [least_squares(misfit, start, args=(length,), max_nfev=300).x for length in (0.0011, 0.043)]
    free, damped_as_palm = (wave(fit) for fit in fits)
    assert np.abs(free[0] - 1.0).max() < 0.02 and free[1] == pytest.approx(0.011, rel=0.1)
    assert damped_as_palm[0].max() > 1.2 and damped_as_palm[0].min() < 0.85
