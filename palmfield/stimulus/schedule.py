"""Position and level of the focus as functions of time, independent of array and hand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from palmfield.config import StimulusConfig
from palmfield.stimulus.modulation import (
    COURSE_POWER,
    HARMONIC,
    HIGHEST_HZ,
    MOST_HARMONICS,
    Modulation,
    am_frequencies,
    arp_of_pulses,
    modulation_of,
    wave,
)
from palmfield.stimulus.modulation import period_s as am_period_s
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.stimulus.curves import PlanePath
    from palmfield.stimulus.focus_table import FocusTable

SPOT_M = 0.0103
"""Width of a typical focus [m], for the frequencies that a moving focus excites."""
TICK_S = 1e-12
"""Times closer to each other than this are equal."""
KEPT = 4096
"""Number of cached configurations, enough for many worlds with different ones."""
TABLE_SAMPLES, MOST_TABLE_SAMPLES, TABLE_PLACES = 1024, 1 << 16, 8
"""Least and largest number of times of a table of foci, and number of points on its paths, for its frequencies."""
MOST_TURNS = 1000
"""Largest number of turns of a path until its level repeats; longer repetitions are approximated by a shorter one."""
LM_SAMPLES = 512
"""Smallest number of samples in a turn of lateral modulation, for its harmonics."""


@dataclass(frozen=True)
class Frame:
    """Focus and level at one moment.

    focus: position in the frame of the stimulus [m]; for a path on the skin the arc length from its start, then 0, 0;
        for a table the time since its start [s], then 0, 0. Shape (3,)
    arp_factor: radiation pressure relative to the loudest moment, 0..1 (its square root is that of the pressure)
    """

    focus: Float
    arp_factor: float


@lru_cache(maxsize=64)
def plane_path(config: StimulusConfig) -> "PlanePath | None":
    """Return the shape of the path about its centre; None for a point, and for sites, whose path depends on the
    surface.

    Raises SceneError for invalid sizes.
    """
    if config.path in ("point", "sites", "file"):
        return None
    # Imported here: most stimuli are points
    from palmfield.stimulus import curves as shapes

    c = config
    match c.path:
        case "circle":
            return shapes.circle(_required(c.path_diameter_m))
        case "lm":
            return shapes.line(_required(c.path_width_m), c.path_direction_deg)
        case "zigzag":
            return shapes.zigzag(_required(c.path_width_m), _required(c.path_height_m), c.path_corners)
        case "square":
            return shapes.square(_required(c.path_width_m))
        case "z":
            return shapes.z_shape(_required(c.path_width_m), _required(c.path_height_m))
        case "lissajous":
            along_x, along_y = c.path_ratio
            size = _required(c.path_width_m), _required(c.path_height_m)
            return shapes.lissajous(*size, along_x, along_y, c.path_phase_deg)
        case "letters":
            return shapes.letters(c.path_text or "", _required(c.path_height_m))
    drawn = c.path_through_m
    path = shapes.polyline(np.reshape(drawn, (-1, 2))) if drawn else shapes.line(_required(c.path_width_m))
    stroke = zigzag_stroke_m(c)
    return path if stroke is None else shapes.zigzagged(path, _required(c.path_zigzag_width_m), stroke)


def zigzag_stroke_m(config: StimulusConfig) -> float | None:
    """Return the distance along the path of one stroke of its zigzag [m]; None without a zigzag."""
    if config.path_zigzag_width_m is None:
        return None
    return _required(config.path_speed_m_s) * config.path_zigzag_width_m / _required(config.path_zigzag_speed_m_s)


def _required(value: float | None) -> float:
    assert value is not None
    return value


def table_of(config: StimulusConfig) -> "FocusTable | None":
    """Return the table of a path from a file, None for all others."""
    return getattr(config, "focus_table", None) if config.path == "file" else None


def _end(config: StimulusConfig) -> str:
    """Return path_end, or stop for a table without this key."""
    return "stop" if config.path == "file" and config.path_end == "back" else config.path_end


def length_m(config: StimulusConfig) -> float:
    """Return the length of the path [m], one way if it is open; 0 for a point."""
    if (table := table_of(config)) is not None:
        return table.moved_m
    sites_length_m: float | None = getattr(config, "sites_length_m", None)
    if sites_length_m is not None:
        return sites_length_m
    path = plane_path(config)
    return 0.0 if path is None else path.length_m


def is_closed(config: StimulusConfig) -> bool:
    """Return whether the path is closed."""
    path = plane_path(config)
    return path is not None and path.closed


def turn_m(config: StimulusConfig) -> float:
    """Return the length of a turn [m]: there and back on an open path with path_end back."""
    return length_m(config) * (2.0 if not is_closed(config) and _end(config) == "back" else 1.0)


def turn_rate_Hz(config: StimulusConfig) -> float | None:
    """Return the turns of the path per second, for any path_end; None for a point."""
    if config.path == "point":
        return None
    if config.path == "file":
        table = table_of(config)
        return None if table is None else 1.0 / table.length_s
    if config.path_rate_Hz is not None:
        return config.path_rate_Hz
    return math.hypot(_required(config.path_speed_m_s), config.path_zigzag_speed_m_s or 0.0) / turn_m(config)


def points_a_turn(config: StimulusConfig) -> int:
    """Return the number of points at which the focus rests in a turn (lm: there and back); 0 for continuous motion."""
    if config.path == "lm" and config.path_step_m is not None:
        return 2 * round(_required(config.path_width_m) / config.path_step_m)
    if (table := table_of(config)) is not None:
        return table.length_samples if table.between == "held" else 0
    return config.path_points


def path_end_s(config: StimulusConfig) -> float | None:
    """Return the time [s] at which a path with path_end 'stop' ends, else None."""
    rate = turn_rate_Hz(config)
    return None if rate is None or _end(config) != "stop" else config.start_s + 1.0 / rate


def silent_after_s(config: StimulusConfig) -> float | None:
    """Return the time [s] at which the sound ends, or None."""
    ends = [config.stop_s, path_end_s(config)]
    if config.burst_count is not None:
        assert config.burst_length_s and config.burst_period_s
        ends.append(config.start_s + (config.burst_count - 1) * config.burst_period_s + config.burst_length_s)
    return min((end for end in ends if end is not None), default=None)


def steady_stretch_s(config: StimulusConfig) -> tuple[float, float]:
    """Return the interval [s] after the ramp and before the end of the sound.

    Its end is inf for sound without end, and before its beginning if there is no such interval.
    """
    begin, end = config.start_s + config.ramp_s, silent_after_s(config)
    if config.burst_count == 1 and config.burst_window != "rectangular":
        return begin, -math.inf
    return begin, math.inf if end is None else end


def repeats(config: StimulusConfig) -> bool:
    """Return whether the stimulus is periodic between its beginning and its end.

    Bursts, a path that is traversed once, and a course from a file are not periodic.
    """
    course = config.modulation == "am" and am_period_s(config) is None
    return config.burst_window == "none" and path_end_s(config) is None and not course


def level_jumps(config: StimulusConfig) -> bool:
    """Return whether the level jumps repeatedly, as with rectangular bursts or a rectangular modulation."""
    return config.burst_window == "rectangular" or _is_rectangle(config)


def _is_rectangle(config: StimulusConfig) -> bool:
    return config.modulation == "am" and config.am_waveform == "rectangle"


def frame_rates(config: StimulusConfig) -> list[float]:
    """Return the rates [1/s] of held values: points of a stepped path, and control ticks; empty if there are none."""
    return [rate for rate, _ in _grids(config)]


def frame_at(config: StimulusConfig, t: float) -> Frame:
    """Return focus and level at time t [s].

    Between control ticks both are constant; between path points only the focus is constant.
    """
    focus, factor = frames_at(config, np.array([t]))
    return Frame(focus[0], float(factor[0]))


def first_point(config: StimulusConfig) -> Float:
    """Return the point of the stimulus at the start of the sound, `Frame.focus` at start_s, shape (3,)."""
    if config.path != "point":
        return _first_on_path(config)
    _, timing = _timings.get(id(config)) or _timed(config)
    return timing.focus


@lru_cache(maxsize=KEPT)
def _first_on_path(config: StimulusConfig) -> Float:
    return _locked(frame_at(config, config.start_s).focus)


def frames_at(config: StimulusConfig, times: Float) -> tuple[Float, Float]:
    """Return foci [m], shape (n, 3), and ARP factors, shape (n,), at times [s], shape (n,); see `frame_at`."""
    _, timing = _timings.get(id(config)) or _timed(config)
    if timing.control_rate > 0.0:
        times = _floor(times, timing.control_rate, 0.0)
    foci = np.empty((len(times), 3))
    foci[:] = timing.focus
    factors = arp_factors(timing.envelope, times)
    if config.path == "point":
        return foci, factors
    if timing.table is not None:
        since = _since_table(timing, timing.table, times)
        foci[:, 0], foci[:, 1:] = since, 0.0
        factors *= np.maximum.reduce(timing.table.arp_of_each(since, timing.duty_exponent), axis=1)
        return foci, factors
    arcs = _arcs(timing, _floor(times, timing.point_rate, timing.start_s) if timing.point_rate > 0.0 else times)
    if timing.on_skin:
        foci[:, 0] = arcs
        foci[:, 1:] = 0.0
    elif config.path == "circle":
        # The circle is exact here; the polygon is for drawn paths
        angle = (2.0 * math.pi / timing.length_m) * arcs
        foci[:, 0] += timing.radius_m * np.cos(angle)
        foci[:, 1] += timing.radius_m * np.sin(angle)
    else:
        assert timing.path is not None
        foci[:, :2] += timing.path.at(arcs)
    if config.path == "letters":
        assert timing.path is not None
        factors *= timing.path.pen_down(arcs)
    return foci, factors


def factors_at(config: StimulusConfig, times: Float) -> Float:
    """Return only the ARP factors of `frames_at`, shape (n,)."""
    if config.path in ("letters", "file"):
        return frames_at(config, times)[1]
    _, timing = _timings.get(id(config)) or _timed(config)
    if timing.control_rate > 0.0:
        times = _floor(times, timing.control_rate, 0.0)
    return arp_factors(timing.envelope, times)


class Moments(NamedTuple):
    """Times at which a load is evaluated for equal steps, and the weights of these loads in each step.

    Without jumps and held values the load is linear in a step. The times are then the two ends of the step, shared with
    the neighbouring steps. A step in which focus or level jump or are held is divided at each jump and tick. The times
    are the middles of these parts, and the load is their mean, weighted by length, so that the impulse is exact.

    times: [s], rising, shape (m,)
    first, last: weights of the loads in the load at the beginning and the end of each step, shape (count, m)
    linear: for each time, whether the load is linear from the time before over a whole step
    held_s: for each time, length of its part [s]; 0 at the end of a linear step
    step_s: length of a step [s]
    """

    times: Float
    first: Float
    last: Float
    linear: tuple[bool, ...]
    held_s: tuple[float, ...]
    step_s: float


def substep_moments(
    stimuli: Sequence[StimulusConfig], t0: float, step_s: float, count: int, *, hold: bool = False
) -> Moments:
    """Return the common moments of several stimuli for `count` steps of `step_s` [s] from time t0 [s] on.

    hold: whether to treat every step as held, so that its mean is computed
    """
    end = t0 + count * step_s
    grids: list[tuple[float, float]] = []
    changes: list[float] = []
    for config in stimuli:
        _, timing = _timings.get(id(config)) or _timed(config)
        grids += timing.grids
        for t in timing.edges if timing.smooth else _jumps(config, timing, t0, end):
            if t0 + TICK_S < t <= end + TICK_S:
                changes.append(t)
    if not changes and not grids:
        unit = _middles(count) if hold else _straight(count)
        held_s = (step_s,) * count if hold else unit.held_s
        return Moments(t0 + step_s * unit.times, unit.first, unit.last, unit.linear, held_s, step_s)
    ticks: list[float] = []
    for rate, first_tick in grids:
        low, high = math.ceil((t0 - first_tick) * rate), math.floor((end - first_tick) * rate)
        for k in range(low, high + 1):
            ticks.append(first_tick + k / rate)
    return _cut(t0, step_s, count, changes, ticks, hold or bool(grids))


def _cut(t0: float, step_s: float, count: int, changes: list[float], ticks: list[float], hold: bool) -> Moments:
    """Return `substep_moments` for steps with jumps or held values."""
    times: list[float] = []
    linear: list[bool] = []
    held_s: list[float] = []
    weights: list[tuple[int, int, float, float]] = []
    for i in range(count):
        begin, end = t0 + i * step_s, t0 + (i + 1) * step_s
        edges, divided = [begin, end], hold
        for t in changes:
            if begin + TICK_S < t <= end + TICK_S:
                divided = True
                if t < end:
                    edges.append(t)
        for t in ticks:
            if begin < t < end:
                edges.append(t)
        if divided:
            edges.sort()
            for a, b in pairwise(edges):
                if b - a > TICK_S:
                    share = (b - a) / (end - begin)
                    weights.append((i, len(times), share, share))
                    times.append(0.5 * (a + b))
                    linear.append(False)
                    held_s.append(b - a)
            continue
        if not times or held_s[-1] > 0.0:
            times.append(begin)
            linear.append(False)
            held_s.append(0.0)
        weights.append((i, len(times) - 1, 1.0, 0.0))
        weights.append((i, len(times), 0.0, 1.0))
        times.append(end)
        linear.append(True)
        held_s.append(0.0)
    first, last = np.zeros((count, len(times))), np.zeros((count, len(times)))
    for i, j, at_first, at_last in weights:
        first[i, j] = at_first
        last[i, j] = at_last
    return Moments(np.array(times), first, last, tuple(linear), tuple(held_s), step_s)


@lru_cache(maxsize=64)
def _straight(count: int) -> Moments:
    """Return moments of steps of length 1 from time 0 on without jumps; the arrays are shared and read-only."""
    first, last = np.eye(count, count + 1), np.eye(count, count + 1, 1)
    linear = (False, *[True] * count)
    return Moments(_locked(np.arange(count + 1.0)), _locked(first), _locked(last), linear, (0.0,) * (count + 1), 1.0)


@lru_cache(maxsize=64)
def _middles(count: int) -> Moments:
    """Return moments like `_straight`, but with the middle of each step as its only time."""
    whole = _locked(np.eye(count))
    return Moments(_locked(0.5 + np.arange(float(count))), whole, whole, (False,) * count, (1.0,) * count, 1.0)


def _locked(values: Float) -> Float:
    values.flags.writeable = False
    return values


def jumps(config: StimulusConfig, start: float, end: float) -> set[float]:
    """Return the times about an interval [s] at which the sound begins or ends, or a path jumps to its start."""
    return set(_jumps(config, _timed(config)[1], start, end))


def _jumps(config: StimulusConfig, timing: "_Timing", start: float, end: float) -> Sequence[float]:
    if timing.smooth:
        return timing.edges
    times = [*timing.edges]
    trains: list[tuple[float | None, float | None, int | None]] = []
    if config.burst_window == "rectangular":
        trains.append((config.burst_length_s, config.burst_period_s, config.burst_count))
    if _is_rectangle(config):
        period = 1.0 / _required(config.am_frequency_Hz)
        trains.append((_required(config.am_waveform_duty) * period, period, None))
    if trains:
        from palmfield.stimulus.bursts import onsets
    for length, every, count in trains:
        ends = start - config.start_s - 1e-9, end - config.start_s + 1e-9
        at = onsets(*ends, length_s=_required(length), period_s=_required(every), count=count)
        times += (config.start_s + at).tolist()
    if timing.jump_rate > 0.0:
        rate = timing.jump_rate
        first, last = math.floor((start - config.start_s) * rate), math.ceil((end - config.start_s) * rate)
        for n in range(max(1, first), last + 1):
            times.append(config.start_s + n / rate)
    return times


def edges_of(config: StimulusConfig) -> tuple[float, ...] | None:
    """Return beginning and end of a stimulus [s] if it has no other jumps and no held values; else None."""
    _, timing = _timings.get(id(config)) or _timed(config)
    return timing.edges if timing.smooth and not timing.grids else None


def mean_arp_factor(config: StimulusConfig, start: float, end: float, count: int) -> float:
    """Return the mean of the ARP factor over an interval [s], from `count` midpoints between jumps."""
    _, timing = _timings.get(id(config)) or _timed(config)
    if timing.steady and config.start_s + config.ramp_s <= start and end <= min(timing.ends, default=math.inf):
        return 1.0
    moments = substep_moments((config,), start, (end - start) / count, count, hold=True)
    return float(np.add.reduce(moments.first @ factors_at(config, moments.times))) / count


class Envelope(NamedTuple):
    """Parameters of the level of a stimulus over time: numbers, or columns of shape (n, 1) for n stimuli.

    start_s: start of the sound [s]; ends: times at which the sound ends [s]; ramp_s: None without a ramp
    am: None without modulation; burst: arguments of `burst`, None without bursts
    """

    start_s: float | Float
    ends: tuple[float | Float, ...]
    ramp_s: float | Float | None
    am: Modulation | None
    burst: dict[str, Any] | None


def envelope_of(config: StimulusConfig) -> Envelope:
    """Return the envelope of the level of a stimulus."""
    bursts = None
    if config.burst_window != "none":
        assert config.burst_length_s and config.burst_period_s
        bursts = {
            "window": config.burst_window,
            "length_s": config.burst_length_s,
            "period_s": config.burst_period_s,
            "count": config.burst_count,
        }
    return Envelope(
        start_s=config.start_s,
        ends=tuple(t for t in (config.stop_s, path_end_s(config)) if t is not None),
        ramp_s=config.ramp_s if config.ramp_s > 0 else None,
        am=modulation_of(config),
        burst=bursts,
    )


@dataclass(frozen=True)
class _Timing:
    """Constants of a stimulus.

    focus: [m], shape (3,); start_s: start of the sound [s]; ends: times at which it ends [s]; edges: start and ends
    control_rate, point_rate: rates of ticks that hold focus and level, and only the focus [1/s]; 0 for none
    grids: (rate, time of the first tick) of held values
    path: shape in the plane, None for a point and for sites; on_skin: whether it is drawn on the surface
    length_m, turn_rate: length and turn rate of the path, 0 for a point; radius_m: radius of a circle
    runs: continuation of the arc: once, round (again from the start), or back and forth
    jump_rate: jumps of an open path to its start per second, 0 for none; smooth: whether there are jumps only at the
        edges; steady: whether the level is 1 from the end of the ramp to the first end
    table: foci over time; duty_exponent: duty exponent of the device
    """

    focus: Float
    start_s: float
    ends: tuple[float, ...]
    edges: tuple[float, ...]
    envelope: Envelope
    control_rate: float
    point_rate: float
    grids: tuple[tuple[float, float], ...]
    path: "PlanePath | None"
    on_skin: bool
    length_m: float
    turn_rate: float
    radius_m: float
    runs: Literal["once", "round", "back"]
    jump_rate: float
    smooth: bool
    steady: bool
    table: "FocusTable | None"
    duty_exponent: float


_timings: dict[int, tuple[StimulusConfig, _Timing]] = {}
"""Cache by the id of a configuration, because hashing its 40 keys takes longer than computing its moments. It also
stores the configuration, so that the id is not reused."""


def _timed(config: StimulusConfig) -> tuple[StimulusConfig, _Timing]:
    """Return the configuration and its constants, cached."""
    rate = turn_rate_Hz(config) or 0.0
    closed = is_closed(config)
    envelope = envelope_of(config)
    ends = tuple(t for t in (config.stop_s, path_end_s(config)) if t is not None)
    end, table = _end(config), table_of(config)
    jump_rate = rate if end == "jump" and not closed else 0.0
    timing = _Timing(
        focus=_locked(np.array(config.focus_m, dtype=np.float64)),
        start_s=config.start_s,
        ends=ends,
        edges=(config.start_s, *ends),
        envelope=envelope,
        control_rate=config.control_rate_Hz,
        point_rate=_point_rate(config),
        grids=tuple(_grids(config)),
        path=plane_path(config),
        on_skin=config.path_on == "skin",
        length_m=length_m(config),
        turn_rate=rate,
        radius_m=0.5 * (config.path_diameter_m or 0.0),
        runs="once" if end == "stop" else "round" if closed or end == "jump" else "back",
        jump_rate=jump_rate,
        smooth=not level_jumps(config) and jump_rate == 0.0,
        steady=config.modulation == config.burst_window == "none"
        and config.path not in ("letters", "file")
        and config.control_rate_Hz == 0.0,
        table=table,
        duty_exponent=getattr(config, "duty_exponent", 2.0),
    )
    if len(_timings) >= KEPT:
        _timings.clear()
    entry = _timings[id(config)] = config, timing
    return entry


def _point_rate(config: StimulusConfig) -> float:
    return points_a_turn(config) * (turn_rate_Hz(config) or 0.0)


def _grids(config: StimulusConfig) -> list[tuple[float, float]]:
    """Return (rate, time of the first tick) of held values."""
    grids = [(_point_rate(config), config.start_s), (config.control_rate_Hz, 0.0)]
    return [(rate, first) for rate, first in grids if rate > 0]


def _floor(times: Float, rate: float, first: float) -> Float:
    # A tick less than a nanosecond ahead is treated as passed, so that t = k / rate is in frame k
    return first + np.floor((times - first + 1e-9) * rate) / rate


def _since_table(timing: _Timing, table: "FocusTable", times: Float) -> Float:
    """Return times since the start of the table [s], 0 to its length, shape (n,)."""
    since = np.maximum(times - timing.start_s, 0.0)
    if timing.runs == "round":
        since -= np.floor((since + 1e-9) / table.length_s) * table.length_s
        since = np.maximum(since, 0.0)
    if table.between == "held":
        # From the sample number, so that a point has the same time in every repetition
        since = np.floor((since + 1e-9) * table.rate_Hz) / table.rate_Hz
    return np.minimum(since, table.length_s)


def _arcs(timing: _Timing, times: Float) -> Float:
    """Return arc lengths from the start of the path at times [s], 0 to its length [m], shape (n,)."""
    turns: Float = timing.turn_rate * (times - timing.start_s)
    if timing.runs == "once":
        return timing.length_m * np.minimum(np.maximum(turns, 0.0), 1.0)
    if timing.runs == "round":
        # Rounding must not exchange end and beginning of a turn, which may be different points
        return timing.length_m * np.mod(turns + 1e-12, 1.0)
    from palmfield.stimulus.curves import folded

    return folded(2.0 * timing.length_m * turns, timing.length_m, closed=False)


def arp_factors(envelope: Envelope, times: Float) -> Float:
    """Return the ARP relative to the loudest moment, 0..1, at times [s], shape (m,), or (n, m) for n stimuli."""
    since: Float = times - envelope.start_s
    level = (since >= -1e-9).astype(np.float64)
    for end in envelope.ends:
        level *= times < end - 1e-9
    if envelope.ramp_s is not None:
        level *= 0.5 - 0.5 * np.cos(math.pi * np.minimum(np.maximum(since / envelope.ramp_s, 0.0), 1.0))
    am = envelope.am
    if am is not None:
        # `wave` and `relative_arp` inlined for the modulation that most scenes evaluate in every step
        form = am.waveform
        values = np.sin(2 * math.pi * form.frequency_Hz * since) if form.name == "sine" else wave(form, since)
        share = (1 + am.depth * values) / (1 + am.depth * form.highest)
        level *= share**am.power if am.power else arp_of_pulses(am, share)
    if envelope.burst is not None:
        from palmfield.stimulus.bursts import burst

        level *= burst(since, **envelope.burst)
    return level


def _level_frequencies(config: StimulusConfig) -> list[float]:
    """Return the frequencies of the level [Hz], of AM and bursts, without the motion of the focus."""
    frequencies = list(am_frequencies(config))
    if config.burst_window != "none" and config.burst_period_s and config.burst_count != 1:
        frequencies.append(1.0 / config.burst_period_s)
    return frequencies


def repeat_rate_Hz(config: StimulusConfig) -> float | None:
    """Return the common repetition rate of a path and its level [1/s]; None for a point.

    The load of a point of the skin is the product of both, whose lines are sums and differences of their frequencies.
    The level of a course from a file, which is not periodic, is treated as constant.
    """
    rate = turn_rate_Hz(config)
    if rate is None or (config.am_frequency_Hz is None and am_frequencies(config)):
        return rate
    for frequency in _level_frequencies(config):
        rate /= Fraction(frequency / rate).limit_denominator(MOST_TURNS).denominator
    return rate


def main_frequencies(config: StimulusConfig) -> list[float]:
    """Return the frequencies [Hz] of most of the response of the skin: harmonics of AM in the ARP, and of the path.

    The list is empty for a load that does not repeat.
    """
    frequencies = _level_frequencies(config)
    rate = turn_rate_Hz(config)
    if rate is not None and config.path == "lm":
        frequencies += _lm_frequencies(config, rate)
    elif (table := table_of(config)) is not None:
        frequencies += _table_frequencies(table)
    elif rate is not None:
        # A focus of width w on a turn of length L gives a pulse train with about L / w harmonics of weight.
        count = max(1, round(turn_m(config) / SPOT_M))
        chosen = range(1, count + 1)
        if config.path == "circle":
            chosen = range(1, min(count, MOST_HARMONICS) + 1)
        elif count > MOST_HARMONICS:
            # On a long path each point of the skin is loaded by single passages, of duration w / v.
            chosen = range(count // 4, count + 1, count // 4)
        frequencies += [rate * n for n in chosen if rate * n <= HIGHEST_HZ] or [HIGHEST_HZ]
    return sorted(set(frequencies))


@lru_cache(maxsize=KEPT)
def _table_frequencies(table: "FocusTable") -> list[float]:
    """Return the strongest line of the load on the paths of the foci of a table, and the frequency with most power
    below.

    The load of a point is that of passing spots of SPOT_M with their present level [Hz]. The result is () for fixed
    foci.
    """
    count = int(min(max(TABLE_SAMPLES, 4 * table.length_s * HIGHEST_HZ), MOST_TABLE_SAMPLES))
    times: Float = np.asarray((np.arange(count) + 0.5) * (table.length_s / count), np.float64)
    foci, loud = table.positions_at(times), table.arp_of_each(times)
    # Without the ends, where a moving focus starts and stops abruptly
    rows = np.linspace(0, len(table.positions) - 1, TABLE_PLACES + 2)[1:-1]
    passed = table.positions[np.rint(rows).astype(int)].reshape(-1, 3)
    power = np.zeros(count // 2)
    for place in np.unique(passed, axis=0):
        distances = np.linalg.norm(foci - place, axis=2)
        course = np.add.reduce(loud * np.exp(-4.0 * math.log(2.0) * (distances / SPOT_M) ** 2), axis=1)
        power += np.abs(np.fft.rfft(course)[1 : len(power) + 1]) ** 2
    if power.sum() <= (1e-9 * count) ** 2:
        return []
    lines = np.arange(1, len(power) + 1) / table.length_s
    edge = lines[np.searchsorted(np.cumsum(power), COURSE_POWER * power.sum())]
    return [min(float(f), HIGHEST_HZ) for f in (lines[int(power.argmax())], edge)]


def _lm_frequencies(config: StimulusConfig, rate: float) -> list[float]:
    """Return the frequencies of lateral modulation [Hz]: those of the back-and-forth motion, and twice the turns.

    On a short line the ARP at a point is linear in the displacement of the focus. In the middle, which the focus passes
    twice per turn, it is quadratic.
    """
    from palmfield.stimulus.curves import folded

    points = points_a_turn(config)
    count = max(LM_SAMPLES, points * math.ceil(LM_SAMPLES / max(points, 1)))
    turns = (np.arange(count) + 0.5) / count
    stepped = np.floor(turns * points) / points if points else turns
    sizes = np.abs(np.fft.rfft(folded(2.0 * stepped, 1.0, closed=False)))[1:]
    sizes /= np.arange(1, len(sizes) + 1)
    most = max(1, math.floor(HIGHEST_HZ / rate))
    loud = [n for n in range(1, len(sizes) + 1) if sizes[n - 1] > HARMONIC * sizes.max() or n == 2]
    return [rate * n for n in loud if n <= most]
