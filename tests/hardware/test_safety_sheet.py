"""The safety sheet against one transducer's own law, a dose by hand, and closed forms of the audible by-product."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.exposure import a_weighting_dB, beam_share
from palmfield.cli.app import app
from palmfield.errors import OutputError
from palmfield.hardware.safety.byproduct import COUNT, RATE_HZ, byproduct, rung
from palmfield.hardware.safety.sheet import safety_sheet
from palmfield.hardware.safety.sheet_text import as_dict, as_markdown
from palmfield.session.preview import preview
from palmfield.types import Air

AIR = Air()
STILL = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}


def test_byproduct_of_a_sine_is_berktays_and_a_dipoles_by_hand():
    """200 Hz, half a watt up and down, 0.4 m away."""
    f, r, c, rho = 200.0, 0.4, sound_speed(AIR), density(AIR)
    power = 0.5 + 0.5 * np.sin(2 * np.pi * f * np.arange(COUNT) / RATE_HZ)
    sound = byproduct(power, r, AIR, 40e3)
    weight = float(a_weighting_dB(np.array(f)))
    alpha, w = absorption_Np_m(AIR, 40e3), 2 * math.pi * f
    # Berktay 1965, with P0^2 S = 2 rho c P
    in_air = 1.2 * 2 * rho * c * 0.5 * w**2 / (16 * math.pi * rho * c**4 * alpha * r)
    of_force = (2 * 0.5 / c) * math.hypot(w / c, 1 / r) / (4 * math.pi * r)
    for level, peak in ((sound.air_dBA, in_air), (sound.force_dBA, of_force)):
        assert level == pytest.approx(20 * math.log10(peak / math.sqrt(2) / 20e-6) + weight, abs=0.1)
    assert sound.strongest_Hz == pytest.approx(f, abs=RATE_HZ / COUNT)
    both = 10 * math.log10(10 ** (sound.air_dBA / 10) + 10 ** (sound.force_dBA / 10))
    assert sound.level_dBA == pytest.approx(both)
    assert byproduct(np.full(COUNT, 0.5), r, AIR, 40e3).level_dBA == -math.inf


def test_a_scenes_head_hears_its_drive_by_each_transducers_law(small_scene):
    """All transducers at the head's place, in float64; the dose by hand from its level."""
    path = small_scene(stimulus=STILL)
    view = preview(path, keys={"driver.head_m": "0 -0.3 0.6", "driver.head_radius_m": "0.005"})
    sheet = safety_sheet(view, 0.01)
    emission, posed = view.runtime.work.emission, view.runtime.posed
    drive = emission.commanded(posed, np.array([0.0]))[0]
    peak = abs(posed.arrays.pressure64(sheet.head.place[None], drive)[0])
    assert sheet.head.level_dB == pytest.approx(20 * math.log10(peak / math.sqrt(2) / 20e-6), abs=0.01)
    dose = sheet.head.level_dB + 10 * math.log10(sheet.sounding_share * 0.01 / 28800.0)
    assert sheet.head.dose_dB(0.01) == pytest.approx(dose, abs=0.01)
    # The band is that of p0, which pressures go with
    p0 = next(iter(sheet.p0.values()))
    for end, level in zip((p0.low, p0.high), sheet.head.band_dB, strict=True):
        assert level == pytest.approx(20 * math.log10(end / p0.value), abs=1e-6)
    hand = sheet.hands[0]
    # The Lagrangian is below |p|^2/(rho c^2), and near it where sound comes head on
    plane = hand.loudest.peak_Pa**2 / (density(AIR) * sound_speed(AIR) ** 2)
    assert 0.5 * plane < hand.arp_Pa <= plane * (1 + 1e-4)


def test_the_page_says_what_is_not_known(small_scene, tmp_path):
    path, page = small_scene(stimulus=STILL), tmp_path / "sheet.md"
    words = ["safety", str(path), "--board", "sonicsurface"]
    done = CliRunner().invoke(app, [*words, "--out", str(page), "--set", "driver.on_time_s=3"])
    assert done.exit_code == 0, done.output
    text = page.read_text()
    for said in ("not declared by the scene", "keeps emitting its last frame", "one play: 3 s", "p0", "sends no reply"):
        assert said in text, said
    assert " safe " not in text.lower() and len(text) < 6000
    again = CliRunner().invoke(app, [*words, "--out", str(page)])
    assert "already exists" in str(again.exception)
    numbers = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert numbers["head_declared"] is False and numbers["board"] == "sonicsurface"


def test_a_head_in_the_beam_gets_no_estimate_and_a_limit_is_said(small_scene):
    path = small_scene(stimulus=STILL)
    keys = {"driver.head_m": "0 0 0.05", "driver.head_radius_m": "0.02", "driver.head_limit_dB": "90"}
    sheet = safety_sheet(preview(path, keys=keys), 0.01)
    assert sheet.byproduct is None and "refuses" in sheet.head_warnings[0]
    assert "lies in the beam" in as_markdown(sheet)


def test_a_drive_in_steps_is_as_loud_as_one_resonance_lets_it_be():
    """A rectangle of 40 Hz, by Fourier coefficients of the exact rise and fall, on a grid fifty times as fine."""
    f, r, f0, quality = 40.0, 0.4, 40e3, 25.0
    times = (np.arange(COUNT) + 0.5) / RATE_HZ
    sent = (np.mod(times * f, 1.0) < 0.5).astype(complex)
    told = byproduct(np.abs(rung(sent, f0, quality)) ** 2, r, AIR, f0, 0.2)
    count = 51 * 410
    turn, tau = np.arange(count) / count / f, quality / (math.pi * f0)
    power = np.where(turn < 0.5 / f, 1.0 - np.exp(-turn / tau), np.exp(-(turn - 0.5 / f) / tau)) ** 2
    number = np.arange(1, int(0.5 * RATE_HZ / f))
    peaks = 2.0 * np.abs(np.fft.rfft(power)[number]) / count
    c, w = sound_speed(AIR), 2 * math.pi * f * number
    weights = 10 ** (a_weighting_dB(f * number) / 20)
    in_air = weights * peaks * 1.2 * w**2 / (4 * math.pi * c**3 * r) * 0.5 / absorption_Np_m(AIR, f0)
    in_air *= beam_share(f * number, 0.2, r, AIR, f0)
    of_force = weights * (2 * peaks / c) * np.hypot(w / c, 1 / r) / (4 * math.pi * r)
    for level, lines in ((told.air_dBA, in_air), (told.force_dBA, of_force)):
        # Between two samples a step is sharper than it is: up to 1.2 dB louder, never softer
        exact = 20 * math.log10(math.sqrt(0.5 * (lines**2).sum()) / 20e-6)
        assert exact - 0.2 < level < exact + 1.2


def test_the_sources_along_a_beam_are_westervelts():
    """Aside of an endless beam, far off: 1/sqrt(1 + (k/2 alpha)^2); long waves take it for a point."""
    frequencies, alpha = np.array([20.0, 200.0, 1000.0, 4000.0]), absorption_Np_m(AIR, 40e3)
    k = 2 * math.pi * frequencies / sound_speed(AIR)
    np.testing.assert_allclose(
        beam_share(frequencies, 0.0, 400.0, AIR, 40e3), 1 / np.sqrt(1 + (k / (2 * alpha)) ** 2), rtol=0.02
    )
    assert beam_share(np.array([0.01]), 0.2, 400.0, AIR, 40e3)[0] == pytest.approx(1.0, abs=0.01)


def test_the_figure_of_a_drive_in_steps_does_not_hang_on_the_samples(small_scene, monkeypatch):
    path = small_scene(stimulus={"am_waveform": "rectangle", "am_waveform_duty": 0.5})
    view = preview(path, keys={"driver.head_m": "0.4 0 0.1"})
    sheet = safety_sheet(view, 0.01)
    assert sheet.byproduct is not None and "Rough estimate" in as_markdown(sheet)
    assert as_dict(sheet)["audible_dBA"] == pytest.approx(sheet.byproduct.level_dBA)
    for module in ("byproduct", "sheet"):
        monkeypatch.setattr(f"palmfield.hardware.safety.{module}.RATE_HZ", 2 * RATE_HZ)
    monkeypatch.setattr("palmfield.hardware.safety.sheet.COUNT", 2 * COUNT)
    finer = safety_sheet(view, 0.01).byproduct
    assert finer is not None and finer.level_dBA == pytest.approx(sheet.byproduct.level_dBA, abs=1.0)


def test_maps_and_course_have_the_levels_of_the_sheet(small_scene, tmp_path):
    path, page = small_scene(stimulus=STILL), tmp_path / "sheet.md"
    keys = {"driver.head_m": "0 -0.3 0.5", "driver.head_limit_dB": "90"}
    sheet = safety_sheet(preview(path, keys=keys), 0.02)
    head, skin = sheet.maps
    assert head.limits_dB == {"public": 100.0, "at work": 110.0, "head_limit_dB": 90.0} and skin.limits_dB == {}
    # The plane goes through the loudest place, at which the picture's mark is
    nearest = np.linalg.norm(head.places_m - head.loudest_m, axis=1).argmin()
    assert head.levels_dB[nearest] == pytest.approx(sheet.head.level_dB, abs=0.5)
    assert head.levels_dB.max() <= sheet.head.level_dB + 0.05
    assert skin.levels_dB.max() == pytest.approx(sheet.hands[0].loudest.level_dB, abs=1e-3)
    nearest = np.linalg.norm(skin.places_m - skin.loudest_m, axis=1).argmin()
    assert nearest == skin.levels_dB.argmax()
    assert sheet.course.levels_dB["head"].max() == pytest.approx(sheet.head.level_dB, abs=1e-3)
    assert sheet.course.levels_dB["skin"].max() == pytest.approx(sheet.hands[0].loudest.level_dB, abs=1e-3)
    words = ["safety", str(path), "--out", str(page), "--set", "driver.head_m=0 -0.3 0.5"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "![levels at the head and the hand](sheet.png)" in page.read_text()
    assert "never with a mean" in page.read_text() and (tmp_path / "sheet.png").stat().st_size > 20_000
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, OutputError) and "already exists" in str(again.exception)
