"""Where the focus is and how loud, as functions of time. A stimulus knows neither array nor hand."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palmfield.config import StimulusConfig
from palmfield.types import Float


@dataclass(frozen=True)
class Frame:
    """What is asked of the array at one moment.

    focus: position in the stimulus's frame [m], shape (3,)
    arp_factor: radiation pressure relative to the loudest moment, 0..1 (the pressure goes with its square root)
    """

    focus: Float
    arp_factor: float


def held_time(config: StimulusConfig, t: float) -> float:
    """Time [s] whose frame is playing at time t: the last control tick or path point, or t itself.

    A tick counts as passed when it is less than a nanosecond ahead, so that t = k / rate lands on frame k.
    """
    for rate in frame_rates(config):
        t = math.floor((t + 1e-9) * rate) / rate
    return t


def frame_rates(config: StimulusConfig) -> list[float]:
    """Rates [1/s] at which frames are held: points of a stepped path, and control ticks; none if smooth."""
    rates = []
    if config.path == "circle" and config.path_points > 0 and config.path_rate_Hz:
        rates.append(config.path_points * config.path_rate_Hz)
    if config.control_rate_Hz > 0:
        rates.append(config.control_rate_Hz)
    return rates


def frame_at(config: StimulusConfig, t: float) -> Frame:
    """Focus and level at time t [s], holds included."""
    t = held_time(config, t)
    return Frame(_focus(config, t), _arp_factor(config, t))


def _focus(config: StimulusConfig, t: float) -> Float:
    centre = np.array(config.focus_m, dtype=np.float64)
    if config.path == "circle":
        assert config.path_diameter_m and config.path_rate_Hz
        angle = 2 * math.pi * config.path_rate_Hz * (t - config.start_s)
        centre[:2] += 0.5 * config.path_diameter_m * np.array([math.cos(angle), math.sin(angle)])
    return centre


def _arp_factor(config: StimulusConfig, t: float) -> float:
    since = t - config.start_s
    if since < -1e-9 or (config.stop_s is not None and t >= config.stop_s - 1e-9):
        return 0.0
    level = 1.0
    if config.ramp_s > 0 and since < config.ramp_s:
        level = 0.5 - 0.5 * math.cos(math.pi * max(since, 0.0) / config.ramp_s)
    if config.modulation == "am":
        assert config.am_depth is not None and config.am_frequency_Hz
        wave = (1 + config.am_depth * math.sin(2 * math.pi * config.am_frequency_Hz * since)) / (1 + config.am_depth)
        level *= wave**2 if config.am_of == "pressure" else wave
    return level


def held_frames(config: StimulusConfig, start: float, end: float) -> list[tuple[float, float]]:
    """Frames that play between two times [s] as (time, share of the interval); one smooth stimulus has none.

    The shares add up to 1, so that a load held over each frame keeps its impulse over any step.
    """
    if not frame_rates(config) or end <= start:
        return []
    ticks = sorted(
        {start, end}
        | {
            k / rate
            for rate in frame_rates(config)
            for k in range(math.ceil(start * rate), math.floor(end * rate) + 1)
            if start < k / rate < end
        }
    )
    return [(a, (b - a) / (end - start)) for a, b in pairwise(ticks) if b - a > 1e-12]


def main_frequencies(config: StimulusConfig) -> list[float]:
    """Frequencies [Hz] in which most of the skin's response lies: AM and, for pressure AM, its octave; path harmonics.

    Empty for a load that does not repeat.
    """
    found = []
    if config.modulation == "am" and config.am_frequency_Hz:
        found.append(config.am_frequency_Hz)
        if config.am_of == "pressure":
            found.append(2 * config.am_frequency_Hz)
    if config.path == "circle" and config.path_rate_Hz:
        # A focus of width w on a circle of circumference L gives a pulse train with about L / w harmonics of weight.
        count = max(1, min(8, round(math.pi * (config.path_diameter_m or 0.0) / 0.0103)))
        found += [config.path_rate_Hz * n for n in range(1, count + 1)]
    return sorted(set(found))
