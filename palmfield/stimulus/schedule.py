"""Where the focus is and how loud, as functions of time. A stimulus knows neither array nor hand."""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from pydantic import Field

from palmfield.config import StimulusConfig
from palmfield.config.base import Positive
from palmfield.stimulus import curves as shapes
from palmfield.stimulus.bursts import burst, onsets
from palmfield.stimulus.curves import PlanePath, folded
from palmfield.types import Float

SPOT_M = 0.0103
"""Width of a usual focus, for the frequencies that a moving one excites."""
MOST_HARMONICS = 8
HIGHEST_HZ = 1000.0
"""Above this skin hardly answers, nor does anybody feel it: faster passages are resolved to here."""


class SitesStimulus(StimulusConfig):
    """A stimulus whose path runs through sites on the skin, with the length that it has there."""

    sites_length_m: Positive = Field(description="length of the path along the surface")


@dataclass(frozen=True)
class Frame:
    """What is asked of the array at one moment.

    focus: position in the stimulus's frame [m]; for a path on the skin the arc length from its start, then 0, 0. (3,)
    arp_factor: radiation pressure relative to the loudest moment, 0..1 (the pressure goes with its square root)
    """

    focus: Float
    arp_factor: float


@lru_cache(maxsize=64)
def plane_path(config: StimulusConfig) -> PlanePath | None:
    """The path's shape about its centre; None for a point, and for sites, whose path only the surface knows.

    Raises SceneError for sizes that make no shape.
    """
    c = config
    match c.path:
        case "circle":
            return shapes.circle(_given(c.path_diameter_m))
        case "line":
            return shapes.line(_given(c.path_width_m))
        case "zigzag":
            return shapes.zigzag(_given(c.path_width_m), _given(c.path_height_m), c.path_corners)
        case "square":
            return shapes.square(_given(c.path_width_m))
        case "z":
            return shapes.z_shape(_given(c.path_width_m), _given(c.path_height_m))
        case "lissajous":
            along_x, along_y = c.path_ratio
            size = _given(c.path_width_m), _given(c.path_height_m)
            return shapes.lissajous(*size, along_x, along_y, c.path_phase_deg)
        case "letters":
            return shapes.letters(c.path_text or "", _given(c.path_height_m))
        case "polyline":
            return shapes.polyline(np.reshape(c.path_through_m, (-1, 2)))
    return None


def _given(value: float | None) -> float:
    assert value is not None
    return value


def length_m(config: StimulusConfig) -> float:
    """Length of the path [m], one way if it is open; 0 for a point."""
    if isinstance(config, SitesStimulus):
        return config.sites_length_m
    path = plane_path(config)
    return 0.0 if path is None else path.length_m


def is_closed(config: StimulusConfig) -> bool:
    """Whether the path comes back to its start by itself."""
    path = plane_path(config)
    return path is not None and path.closed


def turn_m(config: StimulusConfig) -> float:
    """Length of a turn [m]: there and back on an open path, unless path_end says otherwise."""
    return length_m(config) * (2.0 if not is_closed(config) and config.path_end == "back" else 1.0)


def turn_rate_Hz(config: StimulusConfig) -> float | None:
    """How often a second the path comes round, or would but for path_end; None for a point."""
    if config.path == "point":
        return None
    if config.path_rate_Hz is not None:
        return config.path_rate_Hz
    return _given(config.path_speed_m_s) / turn_m(config)


def path_end_s(config: StimulusConfig) -> float | None:
    """Time [s] at which a path with path_end 'stop' is over, else None."""
    rate = turn_rate_Hz(config)
    return None if rate is None or config.path_end != "stop" else config.start_s + 1.0 / rate


def silent_after_s(config: StimulusConfig) -> float | None:
    """Time [s] after which there is no more sound, or None."""
    ends = [config.stop_s, path_end_s(config)]
    if config.burst_count is not None:
        assert config.burst_length_s and config.burst_period_s
        ends.append(config.start_s + (config.burst_count - 1) * config.burst_period_s + config.burst_length_s)
    return min((end for end in ends if end is not None), default=None)


def repeats(config: StimulusConfig) -> bool:
    """Whether the stimulus, once begun, comes round again until it stops: no bursts, no path that runs once."""
    return config.burst_window == "none" and path_end_s(config) is None


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
    if config.path == "point":
        return np.tile(np.array(config.focus_m, dtype=np.float64), (len(times), 1)), _arp_factors(config, times)
    arcs = _arcs(config, on_path)
    return _foci(config, arcs), _arp_factors(config, times) * _pen_down(config, arcs)


def held_frames(config: StimulusConfig, start: float, end: float) -> list[tuple[float, float]]:
    """Moments that stand for the parts of an interval of time [s] as (time, share of the interval).

    The parts lie between ticks, path points, start and end of the sound. The shares add up to 1, so that the load's
    impulse is right over any step. Empty where nothing jumps or is held: the load is then smooth over the interval.
    """
    grids = _grids(config)
    steps = {t for t in jumps(config, start, end) if start + 1e-12 < t <= end + 1e-12}
    if not grids and not steps:
        return []
    ticks = {start, end} | {t for t in steps if t < end}
    for rate, first in grids:
        low, high = math.ceil((start - first) * rate), math.floor((end - first) * rate)
        ticks |= {t for t in (first + k / rate for k in range(low, high + 1)) if start < t < end}
    parts = [(a, b) for a, b in pairwise(sorted(ticks)) if b - a > 1e-12]
    return [(0.5 * (a + b), (b - a) / (end - start)) for a, b in parts]


def jumps(config: StimulusConfig, start: float, end: float) -> set[float]:
    """Times about an interval [s] at which the sound begins or ends, or an open path jumps to its start."""
    found = {t for t in (config.start_s, config.stop_s, path_end_s(config)) if t is not None}
    if config.burst_window == "rectangular":
        assert config.burst_length_s and config.burst_period_s
        edge = 1e-9
        found |= {
            config.start_s + t
            for t in onsets(
                start - config.start_s - edge,
                end - config.start_s + edge,
                length_s=config.burst_length_s,
                period_s=config.burst_period_s,
                count=config.burst_count,
            ).tolist()
        }
    rate = turn_rate_Hz(config)
    if rate is not None and config.path_end == "jump" and not is_closed(config):
        turns = range(max(1, math.floor((start - config.start_s) * rate)), math.ceil((end - config.start_s) * rate) + 1)
        found |= {config.start_s + n / rate for n in turns}
    return found


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
    return config.path_points * (turn_rate_Hz(config) or 0.0)


def _grids(config: StimulusConfig) -> list[tuple[float, float]]:
    """(rate, time of the first tick) of what is held."""
    grids = [(_point_rate(config), config.start_s), (config.control_rate_Hz, 0.0)]
    return [(rate, first) for rate, first in grids if rate > 0]


def _floor(times: Float, rate: float, first: float) -> Float:
    # A tick less than a nanosecond ahead counts as passed, so that t = k / rate lands on frame k.
    return first + np.floor((times - first + 1e-9) * rate) / rate


def _arcs(config: StimulusConfig, times: Float) -> Float:
    """Arc length from the start of the path at times [s], 0 to its length [m], shape (n,)."""
    length, rate = length_m(config), turn_rate_Hz(config)
    assert rate is not None
    turns = rate * (times - config.start_s)
    if config.path_end == "stop":
        return length * np.clip(turns, 0.0, 1.0)
    if is_closed(config) or config.path_end == "jump":
        # Rounding must not take the end of a turn for its beginning, where the two are apart.
        return length * np.mod(turns + 1e-12, 1.0)
    return folded(2.0 * length * turns, length, closed=False)


def _foci(config: StimulusConfig, arcs: Float) -> Float:
    if config.path_on == "skin":
        return np.column_stack([arcs, np.zeros((len(arcs), 2))])
    centre = np.tile(np.array(config.focus_m, dtype=np.float64), (len(arcs), 1))
    if config.path == "circle":
        # Exactly round; the polygon is for paths that are drawn.
        angle = 2.0 * math.pi * arcs / length_m(config)
        centre[:, :2] += 0.5 * _given(config.path_diameter_m) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return centre
    path = plane_path(config)
    assert path is not None
    centre[:, :2] += path.at(arcs)
    return centre


def _pen_down(config: StimulusConfig, arcs: Float) -> Float:
    path = plane_path(config) if config.path == "letters" else None
    return np.ones(len(arcs)) if path is None else path.pen_down(arcs).astype(np.float64)


def _arp_factors(config: StimulusConfig, times: Float) -> Float:
    since = times - config.start_s
    level = np.where(since < -1e-9, 0.0, 1.0)
    for end in (config.stop_s, path_end_s(config)):
        if end is not None:
            level[times >= end - 1e-9] = 0.0
    if config.ramp_s > 0:
        level *= 0.5 - 0.5 * np.cos(math.pi * np.clip(since / config.ramp_s, 0.0, 1.0))
    if config.modulation == "am":
        assert config.am_depth is not None and config.am_frequency_Hz
        wave = (1 + config.am_depth * np.sin(2 * math.pi * config.am_frequency_Hz * since)) / (1 + config.am_depth)
        level *= wave**2 if config.am_of == "pressure" else wave
    if config.burst_window != "none":
        assert config.burst_length_s and config.burst_period_s
        level *= burst(
            since,
            window=config.burst_window,
            length_s=config.burst_length_s,
            period_s=config.burst_period_s,
            count=config.burst_count,
        )
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
    if config.burst_window != "none" and config.burst_period_s and config.burst_count != 1:
        found.append(1.0 / config.burst_period_s)
    rate = turn_rate_Hz(config)
    if rate is not None:
        # A focus of width w on a turn of length L gives a pulse train with about L / w harmonics of weight.
        count = max(1, round(turn_m(config) / SPOT_M))
        chosen = range(1, count + 1)
        if config.path == "circle":
            chosen = range(1, min(count, MOST_HARMONICS) + 1)
        elif count > MOST_HARMONICS:
            # Of a long path each place of the skin feels single passages, of w / v.
            chosen = range(count // 4, count + 1, count // 4)
        found += [rate * n for n in chosen if rate * n <= HIGHEST_HZ] or [HIGHEST_HZ]
    return sorted(set(found))
