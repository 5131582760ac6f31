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


def frame_rates(config: StimulusConfig) -> list[float]:
    """Rates [1/s] at which something is held: points of a stepped path, and control ticks; none if smooth."""
    return [rate for rate, _ in _grids(config)]


def frame_at(config: StimulusConfig, t: float) -> Frame:
    """Focus and level at time t [s].

    A control tick holds both; a path point holds the focus only, so that the level goes on between points.
    """
    focus, factor = frames_at(config, np.array([t]))
    return Frame(focus[0], float(factor[0]))


def frames_at(config: StimulusConfig, times: Float) -> tuple[Float, Float]:
    """Foci [m], shape (n, 3), and ARP factors, shape (n,), at times [s], shape (n,); see `frame_at`."""
    if config.control_rate_Hz > 0:
        times = _floor(times, config.control_rate_Hz, 0.0)
    on_path = times
    if _point_rate(config) > 0:
        on_path = _floor(times, _point_rate(config), config.start_s)
    return _foci(config, on_path), _arp_factors(config, times)


def held_frames(config: StimulusConfig, start: float, end: float) -> list[tuple[float, float]]:
    """Moments that stand for the parts of an interval of time [s] as (time, share of the interval).

    The parts lie between ticks, path points, start and end of the sound. The shares add up to 1, so that the load's
    impulse is right over any step. Empty where nothing jumps or is held: the load is then smooth over the interval.
    """
    grids = _grids(config)
    jumps = {t for t in (config.start_s, config.stop_s) if t is not None and start + 1e-12 < t <= end + 1e-12}
    if not grids and not jumps:
        return []
    ticks = {start, end} | {t for t in jumps if t < end}
    for rate, first in grids:
        low, high = math.ceil((start - first) * rate), math.floor((end - first) * rate)
        ticks |= {t for t in (first + k / rate for k in range(low, high + 1)) if start < t < end}
    parts = [(a, b) for a, b in pairwise(sorted(ticks)) if b - a > 1e-12]
    return [(0.5 * (a + b), (b - a) / (end - start)) for a, b in parts]


def mean_arp_factor(config: StimulusConfig, start: float, end: float, count: int) -> float:
    """Mean of the ARP factor over an interval [s], from `count` midpoints between jumps."""
    total = 0.0
    width = (end - start) / count
    for i in range(count):
        a, b = start + i * width, start + (i + 1) * width
        parts = held_frames(config, a, b) or [(0.5 * (a + b), 1.0)]
        total += sum(share * frame_at(config, t).arp_factor for t, share in parts)
    return total / count


def _point_rate(config: StimulusConfig) -> float:
    if config.path == "circle" and config.path_points > 0:
        return config.path_points * (config.path_rate_Hz or 0.0)
    return 0.0


def _grids(config: StimulusConfig) -> list[tuple[float, float]]:
    """(rate, time of the first tick) of what is held."""
    grids = [(_point_rate(config), config.start_s), (config.control_rate_Hz, 0.0)]
    return [(rate, first) for rate, first in grids if rate > 0]


def _floor(times: Float, rate: float, first: float) -> Float:
    # A tick less than a nanosecond ahead counts as passed, so that t = k / rate lands on frame k.
    return first + np.floor((times - first + 1e-9) * rate) / rate


def _foci(config: StimulusConfig, times: Float) -> Float:
    centre = np.tile(np.array(config.focus_m, dtype=np.float64), (len(times), 1))
    if config.path == "circle":
        assert config.path_diameter_m and config.path_rate_Hz
        angle = 2 * math.pi * config.path_rate_Hz * (times - config.start_s)
        centre[:, :2] += 0.5 * config.path_diameter_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centre


def _arp_factors(config: StimulusConfig, times: Float) -> Float:
    since = times - config.start_s
    level = np.where(since < -1e-9, 0.0, 1.0)
    if config.stop_s is not None:
        level[times >= config.stop_s - 1e-9] = 0.0
    if config.ramp_s > 0:
        level *= 0.5 - 0.5 * np.cos(math.pi * np.clip(since / config.ramp_s, 0.0, 1.0))
    if config.modulation == "am":
        assert config.am_depth is not None and config.am_frequency_Hz
        wave = (1 + config.am_depth * np.sin(2 * math.pi * config.am_frequency_Hz * since)) / (1 + config.am_depth)
        level *= wave**2 if config.am_of == "pressure" else wave
    return level


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
