"""AM by quantity, waveform and normalisation: against Fourier series in closed form and courses computed plainly."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.special import j1

from palmfield.config import StimulusConfig, parse
from palmfield.errors import SceneError
from palmfield.stimulus.am_table import AmTable
from palmfield.stimulus.modulation import arp_lines, peak_amplitude, period_s, sharpest_s
from palmfield.stimulus.resolved import resolved
from palmfield.stimulus.schedule import (
    arp_factors,
    envelope_of,
    frame_at,
    jumps,
    main_frequencies,
    mean_arp_factor,
    repeats,
    substep_moments,
)

PERIOD = AmTable("period", (0.0, 0.2, 0.6), (-0.5, 0.8, 0.1))
COURSE = AmTable("course", (0.01, 0.03, 0.05), (-0.4, 1.0, 0.2))


def am(quantity="amplitude", waveform="sine", depth=1.0, frequency=200.0, exponent=2.0, table=None, **more):
    keys = {"modulation": "am", "am_quantity": quantity, "am_waveform": waveform, "am_depth": depth}
    if table is None or table.of == "period":
        keys["am_frequency_Hz"] = frequency
    if table is not None:
        keys["am_file"] = "table.csv"
    return resolved(StimulusConfig(**keys, **more), am_table=table, duty_exponent=exponent)


# -- lines against closed forms ------------------------------------------------------------------------------------


def test_a_full_sine_of_the_amplitude_is_three_eighths_a_half_and_an_eighth():
    """(1 + sin)^2 / 4 = 3/8 + sin/2 - cos(2wt)/8"""
    assert arp_lines(am()) == pytest.approx((3 / 8, 1 / 2, 1 / 8), rel=1e-12)


@pytest.mark.parametrize("depth", [0.2, 0.7])
def test_a_sine_of_the_amplitude_and_of_the_arp(depth):
    peak = (1 + depth) ** 2
    expected = (1 + depth**2 / 2) / peak, 2 * depth / peak, depth**2 / 2 / peak
    assert arp_lines(am(depth=depth)) == pytest.approx(expected, rel=1e-12)
    assert arp_lines(am("arp", depth=depth)) == pytest.approx((1 / (1 + depth), depth / (1 + depth), 0.0), abs=1e-12)


def test_full_modulation_of_the_duty_has_bessels_lines():
    """sin^2(pi/4 (1 + sin x)) = (1 + sin(pi/2 sin x)) / 2, and sin(z sin x) = 2 J_1(z) sin x + 2 J_3(z) sin 3x + ..."""
    lines = arp_lines(am("duty"))
    assert lines == pytest.approx((0.5, j1(math.pi / 2), 0.0), abs=1e-12)


@pytest.mark.parametrize("duty", [0.1, 0.5, 0.8])
@pytest.mark.parametrize(("quantity", "power"), [("arp", 1), ("amplitude", 2)])
def test_a_rectangle_of_part_depth(quantity, power, duty):
    low = (0.4 / 1.6) ** power
    lines = [2 * (1 - low) * abs(math.sin(math.pi * n * duty)) / (math.pi * n) for n in (1, 2)]
    config = am(quantity, "rectangle", 0.6, am_waveform_duty=duty)
    assert arp_lines(config) == pytest.approx((low + (1 - low) * duty, *lines), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("share", [0.3, 0.75, 1.0])
def test_hann_pulses_of_the_arp(share):
    """The transform of a Hann window of length s at n / period: s/2 sinc(n s) / (1 - (n s)^2)."""
    lines = [share * abs(np.sinc(n * share) / (1 - (n * share) ** 2)) if n * share != 1 else share / 2 for n in (1, 2)]
    config = am("arp", "hann", **({} if share == 1.0 else {"am_waveform_duty": share}))
    assert arp_lines(config) == pytest.approx((share / 2, *lines), rel=1e-5, abs=1e-9)


def test_bursts_of_the_arp_leave_its_mean_and_have_half_a_line_while_they_last():
    config = am("arp", "burst", 0.4, am_burst_length_s=0.1, am_burst_period_s=0.4)
    t = np.linspace(0.0, 0.1, 2_000_001)
    highest = (np.sin(np.pi * t / 0.1) ** 2 * np.sin(2 * np.pi * 200 * t)).max()
    peak = 1 + 0.4 * highest
    assert arp_lines(config) == pytest.approx((1 / peak, 0.4 / peak / 2 / 4, 0.0), rel=1e-9, abs=1e-9)


def test_hasegawas_stimulus_has_the_lines_of_its_closed_form():
    """(1 + h sin)/2 under a Hann window h of t0 = 1 s, every 3 s: a half, and the window's own transform beside f.

    A line n/T of h sin is t0/T |W((f - n/T) t0)| with W(x) = sinc(x)/(2 (1 - x^2)); the mirror image lies 400 Hz away.
    """
    length, period, frequency = 1.0, 3.0, 200.0
    bursts = {"am_burst_length_s": length, "am_burst_period_s": period}
    config = am("arp", "burst", 1.0, frequency, am_normalisation="carrier", drive_amplitude=0.5**0.5, **bursts)
    t = (np.arange(24_000) + 0.5) * (period / 24_000)
    # Relative to full drive, whose ARP is 1: the loudest moment's is drive^2
    course = arp_factors(envelope_of(config), t) * peak_amplitude(config) ** 2
    lines = 2.0 * np.abs(np.fft.rfft(course)) / len(t)
    assert lines[0] / 2.0 == pytest.approx(0.5, rel=1e-9)
    at = np.arange(590, 611)
    x = (at / period - frequency) * length
    window = np.where(np.abs(np.abs(x) - 1.0) < 1e-9, 0.25, np.sinc(x) / (2.0 - 2.0 * x**2 + 1e-30))
    np.testing.assert_allclose(lines[at], 0.5 * length / period * np.abs(window), atol=1e-6)
    # What the plan prints is the same, over the loudest moment's ARP
    told = arp_lines(config)
    assert told.mean * peak_amplitude(config) ** 2 == pytest.approx(0.5, rel=1e-9)
    assert told.first * peak_amplitude(config) ** 2 == pytest.approx(1.0 / 12.0, rel=1e-9)
    assert told.second == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("frequency", [5.0, 30.0, 200.0])
def test_a_burst_with_a_crest_in_its_middle_is_eq_8_of_hasegawa(frequency):
    """F/F_M = h(t) cos(2 pi f (t - t0/2))/2 + 1/2 with the Hann window h of t0 = 1 s, by the paper's own words."""
    bursts = {"am_burst_length_s": 1.0, "am_burst_period_s": 1.0, "am_burst_phase_deg": 90.0}
    config = am("arp", "burst", 1.0, frequency, am_normalisation="carrier", drive_amplitude=0.5**0.5, **bursts)
    t = (np.arange(5000) + 0.5) / 5000
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * t)
    exact = 0.5 * window * np.cos(2.0 * np.pi * frequency * (t - 0.5)) + 0.5
    assert arp_factors(envelope_of(config), t) * peak_amplitude(config) ** 2 == pytest.approx(exact, abs=1e-9)
    # in the middle of the window the force reaches F_M
    assert peak_amplitude(config) == pytest.approx(1.0, abs=1e-9)


def test_a_phase_belongs_to_bursts():
    with pytest.raises(ValueError, match=r"am_burst_phase_deg does not apply to am_waveform 'sine'"):
        am("arp", "sine", am_burst_phase_deg=90.0)


def test_a_course_has_a_mean_and_no_lines():
    lines = arp_lines(am("arp", "file", 0.5, table=COURSE))
    # From the start: held for 10 ms, then two straight pieces of 20 ms
    mean = (10 * -0.4 + 20 * 0.3 + 20 * 0.6) / 50
    assert lines.mean == pytest.approx((1 + 0.5 * mean) / 1.5, rel=1e-6)
    assert lines.first is None and lines.second is None


def test_without_modulation_there_are_no_lines():
    assert arp_lines(StimulusConfig()) is None and peak_amplitude(StimulusConfig(drive_amplitude=0.3)) == 0.3


# -- the course over time ------------------------------------------------------------------------------------------


def plain_wave(config, table, t):
    """The waveform at one time, written out."""
    f = config.am_frequency_Hz
    if config.am_waveform == "sine":
        return math.sin(2 * math.pi * f * t)
    if config.am_waveform == "rectangle":
        return 1.0 if (t * f) % 1.0 < config.am_waveform_duty else -1.0
    if config.am_waveform == "hann":
        into = (t * f) % 1.0 / (config.am_waveform_duty or 1.0)
        return 2.0 * math.sin(math.pi * into) ** 2 - 1.0 if into < 1.0 else -1.0
    if config.am_waveform == "burst":
        into = t % config.am_burst_period_s
        inside = into < config.am_burst_length_s
        window = math.sin(math.pi * into / config.am_burst_length_s) ** 2
        middle = config.am_burst_phase_deg
        phase = 0.0 if middle is None else math.radians(middle) - math.pi * f * config.am_burst_length_s
        return window * math.sin(2 * math.pi * f * into + phase) if inside else 0.0
    moments, values = list(table.moments), list(table.values)
    if table.of == "period":
        t = (t * f) % 1.0
        moments, values = [moments[-1] - 1.0, *moments, moments[0] + 1.0], [values[-1], *values, values[0]]
    if t <= moments[0]:
        return values[0]
    for (a, x), (b, y) in zip(zip(moments, values, strict=True), list(zip(moments, values, strict=True))[1:],
                              strict=False):  # fmt: skip
        if a <= t <= b:
            return x + (y - x) * (t - a) / (b - a)
    return values[-1]


FORMS = {
    "sine": ({}, None),
    "rectangle": ({"am_waveform_duty": 0.3}, None),
    "hann": ({"am_waveform_duty": 0.6}, None),
    "burst": ({"am_burst_length_s": 0.02, "am_burst_period_s": 0.03, "am_burst_phase_deg": -60.0}, None),
    "period": ({}, PERIOD),
    "course": ({}, COURSE),
}
HIGHEST = {"period": 0.8, "course": 1.0}
forms = st.sampled_from(sorted(FORMS))
quantities = st.sampled_from(["duty", "amplitude", "arp"])


def made(form, quantity, depth, exponent=1.5, **more):
    keys, table = FORMS[form]
    return am(quantity, form if table is None else "file", depth, exponent=exponent, table=table, **keys, **more)


@given(form=forms, quantity=quantities, depth=st.floats(0, 1), t=st.floats(0, 0.1))
@settings(deadline=None)
def test_the_level_is_that_of_the_plain_course(form, quantity, depth, t):
    config = made(form, quantity, depth, start_s=0.0)
    f = config.am_frequency_Hz
    if form == "rectangle":
        assume(min(abs((t * f - x + 0.5) % 1.0 - 0.5) for x in (0.0, 0.3)) > 1e-5)
    if form == "burst":
        fine = np.linspace(0.0, 0.02, 200_001)
        # -60 degrees in the middle of the burst
        sine = np.sin(2 * np.pi * f * (fine - 0.01) - np.pi / 3)
        highest = float((np.sin(np.pi * fine / 0.02) ** 2 * sine).max())
    else:
        highest = HIGHEST.get(form, 1.0)
    share = (1 + depth * plain_wave(config, FORMS[form][1], t)) / (1 + depth * highest)
    expected = {"amplitude": share**2, "arp": share, "duty": math.sin(math.pi / 2 * share) ** 1.5}[quantity]
    assert frame_at(config, t).arp_factor == pytest.approx(expected, abs=1e-7)


@given(form=forms, quantity=quantities, depth=st.floats(0, 1), t=st.floats(0, 2), start=st.floats(0, 1))
@settings(deadline=None)
def test_the_level_stays_between_silence_and_the_loudest_moment(form, quantity, depth, t, start):
    factor = frame_at(made(form, quantity, depth, start_s=start), t).arp_factor
    assert 0.0 <= factor <= 1.0 + 1e-9


@pytest.mark.parametrize("form", sorted(FORMS))
def test_the_loudest_moment_is_one(form):
    config = made(form, "amplitude", 0.7)
    period = period_s(config) or 0.05
    factors = arp_factors(envelope_of(config), np.linspace(0.0, period, 200_001))
    assert factors.max() == pytest.approx(1.0, abs=1e-6)


# -- what drive_amplitude sets -------------------------------------------------------------------------------------


def plain_levels(config, form, exponent):
    """A function: from duty, amplitude or ARP of the carrier to the ARP over a period, over that of full drive."""
    duration = {"burst": 0.03, "course": 0.05}.get(form, 0.005)
    times = duration * (np.arange(20_000) + 0.5) / 20_000
    growth = 1 + config.am_depth * np.array([plain_wave(config, FORMS[form][1], t) for t in times])

    def arp(carrier):
        if config.am_quantity == "duty":
            return np.sin(np.pi * carrier * growth) ** exponent
        return (carrier * growth) ** (2 if config.am_quantity == "amplitude" else 1)

    return arp


@pytest.mark.parametrize("form", sorted(FORMS))
@pytest.mark.parametrize("quantity", ["duty", "amplitude", "arp"])
@pytest.mark.parametrize(("depth", "amplitude"), [(0.3, 0.25), (1.0, 0.25), (0.7, 1e-4)])
def test_carrier_and_mean_are_what_drive_amplitude_says(form, quantity, depth, amplitude):
    exponent = 1.5
    for normalisation in ("carrier", "mean"):
        more = {"drive_amplitude": amplitude, "am_normalisation": normalisation}
        config = made(form, quantity, depth, exponent, **more)
        arp = plain_levels(config, form, exponent)
        peak = peak_amplitude(config)
        if normalisation == "carrier":
            # The carrier alone sounds at the asked amplitude; its duty by the law's inverse
            duty = math.asin(amplitude ** (2 / exponent)) / math.pi
            carrier = {"duty": duty, "amplitude": amplitude, "arp": amplitude**2}[quantity]
            assert peak**2 == pytest.approx(arp(carrier).max(), rel=2e-4)
        else:
            factors = arp_factors(envelope_of(config), np.linspace(0.0, period_s(config) or 0.05, 100_001)[:-1])
            assert peak**2 * factors.mean() == pytest.approx(amplitude**2, rel=1e-4)


@given(
    form=forms,
    quantity=quantities,
    depth=st.floats(0, 1),
    amplitude=st.floats(0, 1),
    normalisation=st.sampled_from(["peak", "carrier", "mean"]),
    exponent=st.floats(0.5, 4),
)
@settings(deadline=None)
def test_a_level_is_in_range_or_refused_with_the_way_out(form, quantity, depth, amplitude, normalisation, exponent):
    more = {"drive_amplitude": amplitude, "am_normalisation": normalisation}
    try:
        config = made(form, quantity, depth, exponent, **more)
        peak = peak_amplitude(config)
    except SceneError as error:
        text = str(error)
        assert normalisation != "peak" and depth > 0
        assert f"drive_amplitude {amplitude:g}" in text and f"am_depth {depth:g}" in text
        advised = float(text.split("set drive_amplitude to ")[1].split(" or less")[0])
        assert advised < amplitude
        peak_amplitude(made(form, quantity, depth, exponent, **more | {"drive_amplitude": advised}))
    else:
        assert amplitude * (1 - 1e-9) <= peak <= 1.0
        if normalisation == "peak":
            assert peak == amplitude


def test_more_than_full_drive_is_told():
    with pytest.raises(SceneError, match=r"drive_amplitude 0\.6 is the carrier's .* needs 1\.2 of full drive; allowed: "
                       r"at most 1; set drive_amplitude to 0\.5 or less"):  # fmt: skip
        peak_amplitude(am(drive_amplitude=0.6, am_normalisation="carrier"))
    with pytest.raises(SceneError, match=r"needs pulses of duty 1; allowed: at most 0\.5"):
        peak_amplitude(am("duty", am_normalisation="carrier"))
    with pytest.raises(SceneError, match=r"needs pulses with duty above 0\.5"):
        peak_amplitude(am("duty", am_normalisation="mean"))


def test_silence_stays_silent():
    for quantity in ("duty", "amplitude", "arp"):
        assert peak_amplitude(am(quantity, drive_amplitude=0.0, am_normalisation="mean")) == 0.0


# -- jumps, periods, frequencies -----------------------------------------------------------------------------------


def test_a_rectangle_jumps_twice_a_period_and_cuts_steps_there():
    config = am("arp", "rectangle", am_waveform_duty=0.3, start_s=0.001)
    found = sorted(t for t in jumps(config, 0.0, 0.0119) if 0.001 < t < 0.0119)
    assert found == pytest.approx([0.0025, 0.006, 0.0075, 0.011])
    moments = substep_moments((config,), 0.002, 0.001, 1)
    assert moments.first[0] == pytest.approx([0.5, 0.5])
    assert [frame_at(config, t).arp_factor for t in moments.times] == [1.0, 0.0]
    # The impulse is right whatever the steps
    for end in (0.0021, 0.0033, 0.0064, 0.0201):
        on = np.arange(0.001, 0.03, 0.005)
        up = sum(max(0.0, min(end, a + 0.0015) - a) for a in on)
        assert mean_arp_factor(config, 0.0, end, 3) == pytest.approx(up / end, rel=1e-6)


def test_periods():
    assert period_s(am()) == period_s(am("arp", "rectangle", am_waveform_duty=0.5)) == 0.005
    assert period_s(am("arp", "burst", am_burst_length_s=0.1, am_burst_period_s=0.5)) == 0.5
    assert period_s(am("arp", "file", table=COURSE)) is None and period_s(StimulusConfig()) is None
    assert repeats(am()) and not repeats(am("arp", "file", table=COURSE))


def test_frequencies_are_those_whose_lines_are_loud():
    assert main_frequencies(am()) == main_frequencies(am("duty")) == [200, 400]
    assert main_frequencies(am("arp")) == [200]
    # A rectangle of a half has odd harmonics as 1 / n, of which skin follows 1 / n^2; a quarter has sin(pi n / 4) / n
    assert main_frequencies(am("arp", "rectangle", am_waveform_duty=0.5)) == [200, 600]
    quarter = am("arp", "rectangle", frequency=50, am_waveform_duty=0.25)
    assert main_frequencies(quarter) == [50, 100, 150]
    assert main_frequencies(am("arp", "hann")) == [200]
    bursts = {"am_burst_length_s": 0.1, "am_burst_period_s": 0.5}
    assert main_frequencies(am("arp", "burst", **bursts)) == [200]
    assert main_frequencies(am("amplitude", "burst", **bursts)) == [2, 200, 400]


def test_the_frequencies_of_a_course_are_its_strongest_and_its_highest():
    times = np.arange(2000) / 2000
    wave = 0.8 * np.sin(2 * np.pi * 30 * times) + 0.2 * np.sin(2 * np.pi * 170 * times)
    config = am("arp", "file", 1.0, table=AmTable("course", tuple(times), tuple(wave)))
    assert main_frequencies(config) == pytest.approx([30, 170], rel=1e-2)
    assert main_frequencies(am("arp", "file", table=AmTable("course", (0.0, 1.0), (0.3, 0.3)))) == []


def test_the_most_sudden_moment():
    assert sharpest_s(am()) == pytest.approx(0.75 / 200)
    assert sharpest_s(am("arp", "rectangle", am_waveform_duty=0.3)) == pytest.approx(0.3 / 200)
    assert sharpest_s(am("arp", "file", table=COURSE)) <= 0.01 and sharpest_s(StimulusConfig()) is None
    hann = am("arp", "hann", am_waveform_duty=0.5)
    assert sharpest_s(hann) * 200 >= 0.5


# -- keys ----------------------------------------------------------------------------------------------------------

GOOD = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": "200", "am_depth": "1"}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"am_of": "arp"}, "key 'am_of' is renamed: use am_quantity"),
        ({"am_of": "pressure"}, "key 'am_of' is renamed: use am_quantity with value 'amplitude'"),
        ({"am_quantity": "pressure"}, "key 'am_quantity' has value 'pressure', which is renamed: use amplitude"),
        ({"am_quantity": "arps"}, r"'arps' \(did you mean 'arp'\?\); allowed: duty | amplitude | arp"),
        ({"am_waveform": "rectangle"}, "modulation 'am' of am_waveform 'rectangle' needs am_waveform_duty"),
        ({"am_waveform": "rectangle", "am_waveform_duty": "1"}, "am_waveform_duty is 1, so the rectangle is always"),
        ({"am_waveform_duty": "0.5"}, "am_waveform_duty does not apply to am_waveform 'sine', which takes no such"),
        (
            {"am_waveform": "hann", "am_file": "a.csv"},
            "am_file does not apply to am_waveform 'hann', which takes am_w",
        ),
        ({"am_waveform": "burst", "am_burst_length_s": "0.1"}, "needs am_burst_period_s"),
        ({"am_waveform": "burst", "am_burst_length_s": "0.2", "am_burst_period_s": "0.1"}, "longer than am_burst_per"),
        ({"am_waveform": "burst", "am_burst_length_s": "0.001", "am_burst_period_s": "0.1"}, "holds 0.2 periods"),
        ({"am_waveform": "file"}, "modulation 'am' of am_waveform 'file' needs am_file"),
        (
            {"am_normalisation": "mean", "arp_peak_Pa": "5"},
            "am_normalisation is 'mean', but arp_peak_Pa 5 sets the lou",
        ),
        (
            {"am_quantity": "duty", "arp_peak_Pa": "5"},
            "am_quantity is 'duty', for which .* arp_peak_Pa 5 cannot set it",
        ),
        ({"am_depth": "1.5"}, "key 'am_depth' has value '1.5'"),
    ],
)
def test_keys_that_do_not_fit_are_named(keys, words):
    with pytest.raises(SceneError, match=words):
        parse(StimulusConfig, GOOD | keys, "the stimulus")
