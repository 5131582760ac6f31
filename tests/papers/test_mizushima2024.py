"""Answers of Mizushima & Sato 2024 against exact solutions that they do not use."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.metrics import half_width
from palmfield.skin import Spot, preset, static
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.material import Sheet
from palmfield.skin.problem import Slab
from palmfield_papers.answer import Setting
from palmfield_papers.entries import book
from palmfield_papers.mizushima2024 import PAPER, bows, drive, field, gel

ENTRIES = {entry.id: entry for entry in book().of_paper("Mizushima 2024")}


def answer(name, **readings):
    base = tuple((axis, readings.get(axis, value)) for axis, value in book().base(ENTRIES[name]))
    return PAPER.answers[name](Setting(readings=base, quick=True))


def test_every_claim_has_an_answer_and_every_answer_an_entry():
    assert set(PAPER.answers) <= set(ENTRIES)
    assert {name for name, entry in ENTRIES.items() if entry.counts} <= set(PAPER.answers)
    assert set(PAPER.causes) <= set(PAPER.answers)


def test_two_far_bows_make_the_fringes_of_two_plane_waves():
    """Half the wavelength over the sine of 30 degrees; near bows spread them, as their rays are no longer parallel."""
    far = bows.Bows(focal_length_m=0.5, receiver_m=0.0)
    at, square = field.scan(far, "x")
    wave = 345.0 / 40e3
    # the fringe in the middle ends in zeros a quarter of the wavelength over the sine away, and is half half-way there
    middle = np.abs(at) < 0.45 * wave
    assert half_width(at[middle], square[middle]) == pytest.approx(wave / 4.0, rel=0.01)


def test_incoherent_bows_are_the_mean_of_the_fringes():
    one = bows.Bows(receiver_m=0.0)
    middle = bows.focus_of(one)[None]
    assert bows.mean_square(one, middle)[0] == pytest.approx(
        2.0 * bows.mean_square(replace(one, coherent=False), middle)[0], rel=1e-6
    )


def test_exchanged_axes_are_held_against_what_the_conclusion_prints():
    assert answer("M7b").against == 10.0
    assert answer("M7b", mizushima_axes="conclusion: x 8, z 10").against == 8.0
    assert answer("M7c", mizushima_axes="conclusion: x 8, z 10").against == 10.0


@pytest.mark.parametrize("base", ["bonded", "free_slip"])
def test_a_round_ellipse_is_a_spot(base):
    """Against the Hankel integral of a Gaussian spot, whose code is another."""
    one = gel.Gel("C7", base, (0.004, 0.004))
    for frequency in (50.0, 500.0):
        exact = centre_response(frequency, preset("hitohada_c7"), 1e-3, 0.008, base=base, settled=1e-5)
        assert gel.compliance(one, frequency) == pytest.approx(complex(exact), rel=1e-3)


def test_a_bonded_gel_at_rest_is_as_finite_elements_have_it():
    spot = Spot(0.012, np.zeros(1), np.ones(1), law="held")
    motion = static(Slab((Sheet(preset("hitohada_c0"), 1e-3),)), spot, np.zeros((1, 2)), accuracy=0.01)
    ours = gel.compliance(gel.Gel("C0", "bonded", (0.006, 0.006)), 0.0).real
    assert ours == pytest.approx(-float(motion.displacement_m[0, 0, 2]), rel=0.01)


def test_a_sliding_gel_under_a_wide_load_may_widen_along_one_axis_only():
    """Wide along x and still far longer than thick along y: between plane strain, P h (1 - nu^2)/E, and a rod's."""
    one = gel.Gel("C7", "free_slip", (0.4, 0.05))
    modulus = gel.young_Pa(preset("hitohada_c7"), 0.0).real
    assert gel.compliance(one, 0.0, 400).real == pytest.approx(0.75 * 1e-3 / modulus, rel=0.02)


def test_loss_tangent_of_one_solid_over_a_decade():
    """(x + 1/x)/2 with x = sqrt(10) between the middle and the ends of the decade."""
    assert answer("M9e").value == pytest.approx(0.5 * (10**0.5 + 10**-0.5) - 1.0, abs=1e-3)


def test_pressures_and_lengths_by_hand():
    assert answer("M4-M5c").value == pytest.approx(1e-3 * np.sqrt(4000.0 / 2.0 * 1.4 * 101325.0), rel=2e-3)
    assert answer("M2-M3h").value == pytest.approx(np.pi * 40e3 / 343.0 * 25e-3, rel=1e-9)


def test_parts_of_a_modulated_pressure():
    """(1 + m sin)^2 by its mean and its lines over one period."""
    turns = 2.0 * np.pi * np.arange(4096) / 4096
    lines = np.abs(np.fft.rfft((1.0 + 0.6 * np.sin(turns)) ** 2)) / 4096
    found = drive.parts(0.6)
    assert [found[part] for part in drive.PARTS] == pytest.approx([lines[0], 2.0 * lines[1], 2.0 * lines[2]], rel=1e-6)


def test_the_speakers_resonance_takes_what_one_pole_takes():
    """On resonance both sidebands fall alike: 1/sqrt(1 + (2 Q f/f0)^2)."""
    f = np.array([10.0, 300.0, 1000.0])
    exact = 1.0 / np.sqrt(1.0 + (2.0 * 25.0 * f / 40e3) ** 2)
    assert drive.course_over_frequency(f, 25.0) == pytest.approx(exact, rel=1e-6)
