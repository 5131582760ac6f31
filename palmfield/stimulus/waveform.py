"""Waveforms w of amplitude modulation, -1..1 over time: sine, rectangle, Hann pulses, bursts, files."""

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.config import StimulusConfig
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.stimulus.am_table import AmTable

EDGE_S = 1e-9
"""Time before a jump [s] that counts as after it, so that t = k / rate is in period k with any rounding."""
SAMPLES, A_CYCLE = 4096, 16
"""Smallest number of samples of a waveform in `samples`, and of each period of the sine in a burst."""


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
