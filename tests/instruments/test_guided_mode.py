"""The fitted wavenumber against modes of a layer of elements through its depth, which is another model than the fit's.

The scans: a fractional material, beams at 45 degrees that see motion along the surface too, a grid that is 1 mm off its
place, noise 20 dB below the motion outside the source.
"""

import re

import numpy as np
import pytest
from guided_layer import GuidedLayer, fractional
from scipy.special import hankel1

from palmfield.errors import MeasurementError
from palmfield.instruments import disc_grid, guided_mode_fit, line_amplitudes
from palmfield.skin import preset
from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.materials.material import complex_bulk, complex_shear

SPOT_M, NEAR_M = 0.0103, 0.016


def scan(f_Hz, thickness_m, pitch_m=0.005, seed=0, snr_dB=20.0, echo=0.0):
    """Places as they are told, amplitudes along beams at 45 degrees, and the layer's waves with their motion in it.

    echo: of the sound of an edge 70 mm off, over that of the edge of a free half
    """
    layer = GuidedLayer(f_Hz, fractional(f_Hz), thickness_m)
    told = disc_grid(0.06, pitch_m)
    true = told[:, :2] + np.array([0.7e-3, -0.7e-3])
    r = np.maximum(np.linalg.norm(true, axis=1), 1e-9)
    down, out = layer.under_spot(r, SPOT_M, 800)
    read = -down + out * true[:, 0] / r
    if echo:
        away = true - np.array([0.14, 0.0])
        read = read - echo * layer.under_spot(np.linalg.norm(away, axis=1), SPOT_M, 800)[0]
    rng = np.random.default_rng(seed)
    size = np.sqrt(np.mean(np.abs(read[r > NEAR_M]) ** 2)) * 10.0 ** (-snr_dB / 20.0)
    noise = rng.normal(size=(2, len(r))) * size / np.sqrt(2.0)
    far = np.linalg.norm(told[:, :2], axis=1) > NEAR_M
    k, fields = layer.seen(SPOT_M, true[far], 1.0)
    motion = np.sqrt(np.mean(np.abs(fields) ** 2, axis=1))
    travels = np.flatnonzero(k.real > k.imag)
    order = travels[np.argsort(-motion[travels])]
    return told, read + noise[0] + 1j * noise[1], k[order]


def fitted(told, read):
    return guided_mode_fit(read, told, [0.0, 0.0], NEAR_M, sights=np.tile([1.0, 0.0, 1.0], (len(told), 1)))


def test_the_layer_of_elements_agrees_with_plane_waves_and_with_its_own_modes():
    material = preset("ecoflex_00-10")
    shear, bulk = complex_shear(material, 200.0), complex_bulk(material, 200.0)
    layer = GuidedLayer(200.0, shear, 0.02, material.density_kg_m3, bulk / shear)
    for k in (50.0, 300.0, 900.0):
        own = layer.down @ np.linalg.solve(layer.stiffness(k), layer.down)
        assert own == pytest.approx(layer_compliance(k, 200.0, material, 0.02).item(), rel=1e-6)
    layer = GuidedLayer(200.0, fractional(200.0), 0.02)
    modes, parts = layer.modes(SPOT_M)
    far = layer.under_spot(np.array([0.05]), SPOT_M)[0][0]
    assert (parts * hankel1(0, modes * 0.05)).sum() == pytest.approx(far, rel=1e-5)


@pytest.mark.parametrize(
    ("thickness", "frequency"),
    [(0.004, 300.0), (0.006, 250.0), (0.008, 400.0), (0.01, 250.0), (0.01, 300.0), (0.01, 400.0), (0.015, 250.0)],
)
def test_the_wavenumber_is_within_3_percent(thickness, frequency):
    told, read, true = scan(frequency, thickness)
    found = fitted(told, read)
    assert found.reason == "" and found.wavenumber_rad_m is not None
    assert abs(found.wavenumber_rad_m - true[0]) < 0.03 * abs(true[0])
    assert found.error < 0.013
    assert found.waves > 2.0 and found.points_a_wave > 3.0
    # The grid is told 1 mm off its place: the source is found at minus that
    assert np.abs(found.source_m - np.array([-0.7e-3, 0.7e-3])).max() < 0.5e-3


@pytest.mark.parametrize(
    ("thickness", "frequency", "pitch", "snr_dB", "words"),
    [
        (0.006, 160.0, 0.005, 20.0, "wavelengths; needed: 2"),
        (0.004, 400.0, 0.009, 20.0, "points per wavelength; needed: 3"),
        (0.006, 400.0, 0.005, 20.0, r"decays by 9\d(\.\d)? % per wavelength"),
        (0.01, 200.0, 0.005, 20.0, r"noise .* uncertainty of .* next to 2 other waves; allowed: 1.3"),
        (0.006, 250.0, 0.005, -6.0, "."),
    ],
)
def test_what_can_not_be_told_is_not_resolved(thickness, frequency, pitch, snr_dB, words):
    told, read, _ = scan(frequency, thickness, pitch, snr_dB=snr_dB)
    found = fitted(told, read)
    assert found.wavenumber_rad_m is None
    assert re.search(words, found.reason), found.reason


def test_two_waves_of_comparable_motion_are_both_told():
    told, read, true = scan(200.0, 0.015)
    found = fitted(told, read)
    assert len(found.others) == 1 and found.others[0].motion > 0.8 * found.motion
    every = np.array([found.wavenumber_rad_m, found.others[0].wavenumber_rad_m], dtype=complex)
    for one in true[:2]:
        assert np.abs(every - one).min() < 0.03 * abs(one)


def test_what_noise_hides_less_noise_tells():
    told, read, true = scan(200.0, 0.01, snr_dB=40.0)
    assert fitted(told, read).wavenumber_rad_m == pytest.approx(true[0], rel=0.03)


def test_waves_from_elsewhere_and_a_source_elsewhere_are_noticed():
    told, read, _ = scan(250.0, 0.006, echo=12.0, snr_dB=30.0)
    assert "is more than noise" in fitted(told, read).reason
    told, read, _ = scan(250.0, 0.006)
    off = guided_mode_fit(read, told, [0.008, 0.0], NEAR_M, sights=np.tile([1.0, 0.0, 1.0], (len(told), 1)))
    assert "the fitted source is 4 mm or more from source_m" in off.reason


def test_a_lines_amplitude_is_that_of_the_last_whole_periods():
    times = np.arange(1000) / 8e3
    record = np.real((2.0 - 1.0j) * np.exp(-2j * np.pi * 90.0 * times))[:, None] + 0.3 + 2.0 * times[:, None]
    record[:300] += 5.0
    assert line_amplitudes(times, record, 90.0, periods=6) == pytest.approx(2.0 - 1.0j, abs=1e-9)
    with pytest.raises(MeasurementError, match="the record holds 11"):
        line_amplitudes(times, record, 90.0, periods=20)


def test_scans_that_don_t_serve_are_refused():
    told = disc_grid(0.06, 0.01)
    with pytest.raises(MeasurementError, match="silent"):
        guided_mode_fit(np.zeros(len(told)), told, [0, 0], 0.01)
    with pytest.raises(MeasurementError, match="points lie outside the radius"):
        guided_mode_fit(np.ones(len(told)), told, [0, 0], 0.058)
    with pytest.raises(MeasurementError, match="none along the surface"):
        guided_mode_fit(np.ones(len(told)), told, [0, 0], 0.01, sights=np.tile([1.0, 0, 0], (len(told), 1)))
    with pytest.raises(MeasurementError, match="amplitudes have shape"):
        guided_mode_fit(np.ones(3), told, [0, 0], 0.01)
    with pytest.raises(MeasurementError, match="source_m has shape"):
        guided_mode_fit(np.ones(len(told)), told, [0, 0, 0], 0.01)
