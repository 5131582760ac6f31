"""Amplitude modulation: radiation pressure (ARP) of a waveform, its spectral lines, and the drive.

A quantity varies as 1 + m w with depth m and waveform w. The quantity is the ARP, the amplitude of the sound (ARP is
its square), or the duty d of the pulses (ARP is sin(pi d)^g).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.config import StimulusConfig
from palmfield.errors import SceneError
from palmfield.stimulus.duty_law import FULL_DUTY, duty_cycle, relative_pressure
from palmfield.stimulus.waveform import Samples, Waveform, period_s, samples, waveform_of
from palmfield.types import Float

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
    """Return the modulation of a stimulus, or None. For duty, raises SceneError as `peak_amplitude`."""
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
