"""Amplitude modulation: waveforms, their radiation pressure (ARP), its spectral lines, and the drive.

A quantity varies as 1 + m w with depth m and waveform w. The quantity is the ARP, the amplitude of the sound (ARP is
its square), or the duty d of the pulses (ARP is sin(pi d)^g).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # loads its submodules at first use  # loads its submodules at first use

from palmfield.config import StimulusConfig
from palmfield.errors import SceneError
from palmfield.stimulus.duty_law import FULL_DUTY, duty_cycle, relative_pressure
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.stimulus.am_table import AmTable

EDGE_S = 1e-9
"""Time before a jump [s] that counts as after it, so that t = k / rate is in period k with any rounding."""
SAMPLES, A_CYCLE = 4096, 16
"""Smallest number of samples of a waveform in `samples`, and of each period of the sine in a burst."""
POWERS = {"duty": 0, "amplitude": 2, "arp": 1}
"""Exponent p with the ARP proportional to quantity^p; 0 if it is not a power law."""
ROUNDING = 1e-9
SILENT = 1e-9
"""Share of full drive below which an amplitude is treated as silence."""
HARMONIC = 0.1
"""Least size of a line of the ARP that is a main frequency, over the largest. Sizes are divided by the frequency, as
the response of the skin decreases with it. A square wave of 200 Hz needs 600 Hz; a layer for 1 kHz differs by 0.2 %."""
MOST_HARMONICS = 8
HIGHEST_HZ = 1000.0
"""Highest main frequency; above it the skin hardly responds, and there is no sensation."""
COURSE_POWER = 0.99
"""Share of the power of the course of a file below the highest of its main frequencies."""


class Waveform(NamedTuple):
    """A waveform: numbers, or columns of shape (n, 1) for n stimuli that differ only in numbers.

    name: value of key am_waveform; table: table from a file
    highest: largest value; duty: share of the period in which a rectangle is high or a Hann pulse lasts
    burst_length_s, burst_period_s: length and period of bursts, 1 for other waveforms
    burst_phase: phase of the sine at the beginning of a burst [rad]
    """

    name: str
    table: "AmTable | None"
    frequency_Hz: float | Float
    highest: float | Float
    duty: float | Float
    burst_length_s: float | Float
    burst_period_s: float | Float
    burst_phase: float | Float = 0.0


class Samples(NamedTuple):
    """A waveform over one period, or over the course in a file.

    times: [s], shape (n,); values: shape (n,); weights: shares of the time, shape (n,)
    """

    times: Float
    values: Float
    weights: Float


def waveform_of(config: StimulusConfig) -> Waveform:
    """Return the waveform of a modulated stimulus; a waveform from a file needs a ResolvedStimulus."""
    table: AmTable | None = getattr(config, "am_table", None)
    frequency = config.am_frequency_Hz or 1.0
    length, period = config.am_burst_length_s or 1.0, config.am_burst_period_s or 1.0
    highest, phase = 1.0, 0.0
    if config.am_waveform == "burst":
        if config.am_burst_phase_deg is not None:
            phase = math.radians(config.am_burst_phase_deg) - math.pi * frequency * length
        highest = _highest_of_burst(frequency * length, phase)
    elif config.am_waveform == "file":
        assert table is not None
        highest = max(table.values)
    return Waveform(
        config.am_waveform, table, frequency, highest, config.am_waveform_duty or 1.0, length, period, phase
    )


def wave(form: Waveform, since: Float) -> Float:
    """Return values at times since the start of the sound [s], shape (m,), or (n, m) for a waveform in columns."""
    match form.name:
        case "sine":
            return np.asarray(np.sin(2 * math.pi * form.frequency_Hz * since))
        case "rectangle":
            period = 1.0 / form.frequency_Hz
            into = since - np.floor((since + EDGE_S) / period) * period
            return np.where(into < form.duty * period - EDGE_S, 1.0, -1.0)
        case "hann":
            turns = since * form.frequency_Hz
            share = (turns - np.floor(turns)) / form.duty
            return np.where(share < 1.0, -np.cos(2 * math.pi * share), -1.0)
        case "burst":
            into = since - np.floor(since / form.burst_period_s) * form.burst_period_s
            window = 0.5 - 0.5 * np.cos(2 * math.pi * into / form.burst_length_s)
            sine = np.sin(2 * math.pi * form.frequency_Hz * into + form.burst_phase)
            return np.where(into < form.burst_length_s, window * sine, 0.0)
    assert form.table is not None
    if form.table.of == "period":
        return np.interp(since * form.frequency_Hz, form.table.moments, form.table.values, period=1.0)
    return np.interp(since, form.table.moments, form.table.values)


def period_s(config: StimulusConfig) -> float | None:
    """Return the period of the modulation [s]; None without modulation and for a course from a file."""
    if config.modulation == "none" or config.am_frequency_Hz is None:
        return None
    return config.am_burst_period_s if config.am_waveform == "burst" else 1.0 / config.am_frequency_Hz


def samples(form: Waveform) -> Samples:
    """Return one period, or a course, at the middles of equal parts; the pause between bursts is one part."""
    match form.name:
        case "rectangle":
            period, duty = 1.0 / float(form.frequency_Hz), float(form.duty)
            middles = (np.arange(SAMPLES) + 0.5) / SAMPLES
            times = period * np.concatenate([duty * middles, duty + (1.0 - duty) * middles])
            weights = np.repeat([duty / SAMPLES, (1.0 - duty) / SAMPLES], SAMPLES)
            return Samples(times, np.repeat([1.0, -1.0], SAMPLES), weights)
        case "burst":
            length, period = float(form.burst_length_s), float(form.burst_period_s)
            count = max(SAMPLES, math.ceil(A_CYCLE * float(form.frequency_Hz) * length))
            times = length * np.append((np.arange(count) + 0.5) / count, 1.0)
            weights = np.append(np.full(count, length / (period * count)), 1.0 - length / period)
            return Samples(times, np.append(wave(form, times[:-1]), 0.0), weights)
    length = 1.0 / float(form.frequency_Hz)
    if form.table is not None and form.table.of == "course":
        length = form.table.moments[-1]
    times = length * (np.arange(4 * SAMPLES) + 0.5) / (4 * SAMPLES)
    return Samples(times, wave(form, times), np.full(len(times), 1.0 / len(times)))


@lru_cache(maxsize=256)
def _highest_of_burst(cycles: float, phase: float) -> float:
    """Return the largest value of sin(2 pi cycles x + phase) under a Hann window over x = 0..1."""

    def negative(x: float | Float) -> float | Float:
        return -(0.5 - 0.5 * np.cos(2 * math.pi * x)) * np.sin(2 * math.pi * cycles * x + phase)

    # The highest crest is within a period of the middle of the window
    near = 0.5 + np.linspace(-1.0, 1.0, 257) * min(1.0 / cycles, 0.5)
    best, width = float(near[np.argmin(negative(near))]), float(near[1] - near[0])
    minimum = scipy.optimize.minimize_scalar(
        negative, bounds=(best - width, best + width), method="bounded", options={"xatol": 1e-12}
    )
    return float(-minimum.fun)


class Modulation(NamedTuple):
    """AM of a stimulus, as numbers, or columns of shape (n, 1) for n stimuli with one quantity and waveform.

    quantity: duty, amplitude or arp; depth: m; power: exponent of the ARP as a function of the quantity, 0 for duty
    peak_duty: duty at the loudest moment, for quantity duty; exponent: its exponent g
    """

    quantity: str
    power: int
    waveform: Waveform
    depth: float | Float
    peak_duty: float | Float
    exponent: float | Float


class ArpLines(NamedTuple):
    """Components of the ARP of a modulation, relative to the loudest moment; lines are peak amplitudes.

    mean: mean over a period or a course; first, second: lines at the modulation frequency and its double, None for a
    course. Values of bursts are means over the whole period.
    """

    mean: float
    first: float | None
    second: float | None


def relative_arp(am: Modulation, values: Float) -> Float:
    """Return the ARP relative to the loudest moment, 0..1, at values of the waveform, in their shape."""
    share: Float = (1 + am.depth * values) / (1 + am.depth * am.waveform.highest)
    return share**am.power if am.power else arp_of_pulses(am, share)


def arp_of_pulses(am: Modulation, share: Float) -> Float:
    """Return the ARP relative to the loudest moment for pulses with a share of the peak duty, in their shape."""
    return np.asarray((np.sin(np.pi * am.peak_duty * share) / np.sin(np.pi * am.peak_duty)) ** am.exponent)


@lru_cache(maxsize=256)
def modulation_of(config: StimulusConfig) -> Modulation | None:
    """Return the modulation of a stimulus, or None. For duty, raises SceneError like `peak_amplitude`."""
    if config.modulation == "none":
        return None
    assert config.am_quantity is not None and config.am_depth is not None
    form, exponent, duty = waveform_of(config), 2.0, FULL_DUTY
    if config.am_quantity == "duty":
        exponent = getattr(config, "duty_exponent", exponent)
        duty = _peak_duty(config, form, exponent)
    return Modulation(config.am_quantity, POWERS[config.am_quantity], form, config.am_depth, duty, exponent)


# -- the level -----------------------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def peak_amplitude(config: StimulusConfig) -> float:
    """Return the amplitude of each transducer at the loudest moment relative to full drive, set by drive_amplitude.

    Raises SceneError, with an allowed value, if am_normalisation needs more than full drive.
    """
    amplitude = _amplitude(config)
    am = modulation_of(config)
    if am is None or amplitude < SILENT or config.am_normalisation == "peak" or am.depth == 0.0:
        return amplitude
    if am.quantity == "duty":
        return float(relative_pressure(am.peak_duty, float(am.exponent)))
    if config.am_normalisation == "carrier":
        of_carrier = float(relative_arp(am, np.zeros(1))[0])
    else:
        of_carrier = _mean(am, samples(am.waveform))
    peak = amplitude / math.sqrt(of_carrier)
    if peak > 1.0 + ROUNDING:
        raise _too_loud(config, f"{peak:.4g} of full drive; allowed: at most 1", amplitude / peak)
    return min(peak, 1.0)


def _amplitude(config: StimulusConfig) -> float:
    return 1.0 if config.drive_amplitude is None else config.drive_amplitude


def _peak_duty(config: StimulusConfig, form: Waveform, exponent: float) -> float:
    """Return the duty at the loudest moment; full duty for silence. Raises SceneError above full duty."""
    amplitude, depth = _amplitude(config), config.am_depth or 0.0
    if amplitude < SILENT:
        return FULL_DUTY
    own = float(duty_cycle(amplitude, exponent))
    growth = 1.0 + depth * float(form.highest)
    if config.am_normalisation == "peak" or depth == 0.0:
        return own
    if config.am_normalisation == "carrier":
        if own * growth > FULL_DUTY * (1.0 + ROUNDING):
            limit = float(relative_pressure(FULL_DUTY / growth, exponent))
            raise _too_loud(config, f"pulses of duty {own * growth:.4g}; allowed: at most {FULL_DUTY:g}", limit)
        return min(own * growth, FULL_DUTY)
    period = samples(form)

    def mean_arp(peak: float) -> float:
        """Return the mean ARP of pulses with this amplitude at the loudest moment, relative to full drive."""
        duty = float(duty_cycle(peak, exponent))
        course = np.sin(np.pi * duty * (1.0 + depth * period.values) / growth) ** exponent
        return float(period.weights @ course)

    most = mean_arp(1.0)
    if amplitude**2 > most * (1.0 + ROUNDING):
        raise _too_loud(config, f"pulses with duty above {FULL_DUTY:g}, the maximum", math.sqrt(most))
    if amplitude**2 >= most:
        return FULL_DUTY
    # At half the amplitude, even the loudest moment has only a quarter of the target ARP
    peak = scipy.optimize.brentq(
        lambda peak: mean_arp(peak) - amplitude**2, 0.5 * amplitude, 1.0, xtol=ROUNDING * amplitude
    )
    return float(duty_cycle(peak, exponent))


def _too_loud(config: StimulusConfig, required: str, limit: float) -> SceneError:
    """Return the error for a level above full drive; limit: largest allowed drive_amplitude."""
    of = {"carrier": "the carrier's", "mean": "the amplitude of steady sound with the same mean ARP"}[
        config.am_normalisation
    ]
    # Rounded down, so that the advised value is accepted
    advice = math.floor(1e4 * limit) / 1e4
    return SceneError(
        f"drive_amplitude {_amplitude(config):g} is {of} (am_normalisation {config.am_normalisation}), so with "
        f"am_depth {config.am_depth:g} the loudest moment needs {required}; set drive_amplitude to {advice:g} or "
        "less, am_depth smaller, or am_normalisation to peak"
    )


# -- lines ---------------------------------------------------------------------------------------------------------


def arp_lines(config: StimulusConfig) -> ArpLines | None:
    """Return the components of the ARP of a modulation, without ramp, burst_window and ends; or None."""
    am = modulation_of(config)
    if am is None:
        return None
    period = samples(am.waveform)
    frequency = config.am_frequency_Hz
    if frequency is None:
        return ArpLines(_mean(am, period), None, None)
    first, second = _lines(am, period, (frequency, 2.0 * frequency)).tolist()
    return ArpLines(_mean(am, period), first, second)


def _mean(am: Modulation, period: Samples) -> float:
    return float(period.weights @ relative_arp(am, period.values))


def _lines(am: Modulation, period: Samples, frequencies: Sequence[float]) -> Float:
    """Return the peak amplitudes of lines relative to the ARP of the loudest moment, shape (k,)."""
    # Difference of the ARP from that of the carrier, so that the pause between bursts contributes 0
    course = period.weights * (relative_arp(am, period.values) - relative_arp(am, np.zeros(1)))
    return np.array([2.0 * abs(course @ np.exp(-2j * np.pi * f * period.times)) for f in frequencies])


@lru_cache(maxsize=256)
def am_frequencies(config: StimulusConfig) -> tuple[float, ...]:
    """Return the frequencies with most of the ARP of the modulation [Hz], the main one first; () without modulation."""
    am, frequency = modulation_of(config), config.am_frequency_Hz
    if am is None:
        return ()
    if frequency is None:
        return _of_course(am)
    if am.waveform.name in ("sine", "burst"):
        harmonics = (frequency,) if am.quantity == "arp" else (frequency, 2.0 * frequency)
        envelope = (1.0 / float(am.waveform.burst_period_s),) if len(harmonics) > 1 else ()
        return harmonics + (envelope if am.waveform.name == "burst" else ())
    most = min(MOST_HARMONICS, max(1, math.floor(HIGHEST_HZ / frequency)))
    multiples = [n * frequency for n in range(1, most + 1)]
    sizes = _lines(am, samples(am.waveform), multiples) / multiples
    return (frequency, *(f for f, size in zip(multiples[1:], sizes[1:], strict=True) if size > HARMONIC * sizes.max()))


def _of_course(am: Modulation) -> tuple[float, ...]:
    """Return the strongest line of a course, and the frequency with most of its power below [Hz]."""
    course = samples(am.waveform)
    power = np.abs(np.fft.rfft(relative_arp(am, course.values))[1:]) ** 2
    frequencies = np.arange(1, len(power) + 1) / (2.0 * course.times[0] * len(course.times))
    if power.sum() == 0.0:
        return ()
    edge = frequencies[np.searchsorted(np.cumsum(power), COURSE_POWER * power.sum())]
    strongest = frequencies[int(power.argmax())]
    return tuple(dict.fromkeys(min(float(f), HIGHEST_HZ) for f in (strongest, edge)))


def sharpest_s(config: StimulusConfig) -> float | None:
    """Return the time since the start of the sound or a period at which the ARP changes fastest [s], or None.

    It is the jump of a rectangle, and otherwise the quietest moment, where full modulation has a cusp in the pressure.
    """
    am = modulation_of(config)
    if am is None:
        return None
    period = period_s(config)
    match am.waveform.name:
        case "sine":
            assert period is not None
            return 0.75 * period
        case "rectangle":
            assert period is not None
            return float(am.waveform.duty) * period
    course = samples(am.waveform)
    return float(course.times[int(course.values.argmin())])
