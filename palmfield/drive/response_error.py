"""Errors of ignoring ring-up and flight time, computed from samples of the drive of a scene.

The samples include every jump of the drive: start, stop, path points, control ticks, jumps of a modulation."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.config import StimulusConfig
from palmfield.stimulus.modulation import period_s, sharpest_s
from palmfield.stimulus.schedule import frames_at, silent_after_s, turn_rate_Hz
from palmfield.types import Complex, Float, Int

SAMPLES_A_DELAY = 16
"""Number of samples in the delay of a transducer with ring-up, 0.2 ms for Q = 25."""
SHORTEST_S = 2e-6
LEAST_WINDOW_S = 10e-3
MOST_WINDOW_S = 100e-3
SETTLED = 10
"""Time after which the initial state of a pole has decayed to 5e-5, in delays."""
VALUES = 100_000
"""Largest number of sampled drives; if a path needs more, only some of the transducers are sampled."""
FEWEST = 16


@dataclass(frozen=True)
class ResponseError:
    """Error of the pressure relative to the sound: rms over the worst window, and the worst moment."""

    rms: float
    peak: float

    def __str__(self) -> str:
        return f"{100 * self.rms:.2g} % rms, {100 * self.peak:.2g} % at worst"


def windows(stimulus: StimulusConfig, delay_s: float) -> list[tuple[float, float]]:
    """Return the time intervals [s] that contain all phases of a stimulus: start and ramp, one period, stop.

    delay_s: delay of the transducers; ring-up needs a window of several delays
    """
    least = max(LEAST_WINDOW_S, SETTLED * delay_s)
    start, steady = stimulus.start_s, stimulus.start_s + stimulus.ramp_s
    stretches = [(start, start + max(least, min(stimulus.ramp_s, MOST_WINDOW_S)))]
    burst = 1.0 / stimulus.burst_period_s if stimulus.burst_period_s else None
    wave, sharpest = period_s(stimulus), sharpest_s(stimulus)
    rates = [rate for rate in (1.0 / wave if wave else None, turn_rate_Hz(stimulus), burst) if rate]
    if rates or sharpest is not None:
        period = 1.0 / min(rates) if rates else least
        half = 0.5 * min(max(period, least), MOST_WINDOW_S)
        middle = steady + half
        if sharpest is not None and wave:
            turns = math.ceil((middle - start - sharpest) / wave)
            middle = start + turns * wave + sharpest
        elif sharpest is not None:
            middle = start + sharpest
        stretches.append((middle - half, middle + half))
    end = silent_after_s(stimulus)
    if end is not None:
        stretches.append((end - 0.5 * least, end + 0.5 * least))
    return stretches


def shares(emitted: Complex, gain: Complex | None, distances: Float) -> Float:
    """Return the share of each transducer in the pressure at a focus, shape (n,).

    emitted: emitted amplitudes, shape (n,); gain: see Array, of the same transducers; distances: to the focus [m]
    """
    parts = np.abs(emitted if gain is None else emitted * gain) / distances
    total = parts.sum()
    return np.asarray(parts / total if total > 0.0 else parts)


def response_errors(
    stimulus: StimulusConfig,
    along: Callable[[Float], Float],
    focusing: Callable[[Float, Int], Complex],
    weights: Float,
    rates: Complex,
    times_s: Float,
) -> tuple[ResponseError, ResponseError]:
    """Return the errors of ignoring ring-up, and of ignoring differences in flight time.

    The first error compares the emission of a pole with the drive, delayed by the mean delay of all transducers. The
    second error compares the emission of poles delayed by their flight times with that of equally delayed poles.

    along: function from points of the stimulus, shape (k, 3), to foci in the frame of the first array [m]; the middle
        of several foci counts as one focus
    focusing: function from foci, shape (k, 3), and the numbers of some transducers to their drives, shape (k, n)
    weights: shares of the transducers in the pressure at the first focus, see `shares`, shape (n,)
    rates: rates of their poles [1/s], shape (n,); times_s: flight times of their sound to this focus [s], shape (n,)
    """
    delay = float((1.0 / rates).real.mean())
    step = max(delay / SAMPLES_A_DELAY, SHORTEST_S)
    lag = max(1, round(delay / step))
    delays = (times_s - weights @ times_s) / step
    # Sound that arrives early needs samples after the window
    reach = math.ceil(np.abs(delays).max()) + 2
    inside = slice(SETTLED * lag, -reach)
    errors = []
    for begin, end in windows(stimulus, delay):
        cells = np.arange(-SETTLED * lag, math.ceil((end - begin) / step) + reach)
        points, factors = frames_at(stimulus, np.asarray(begin + (cells + 0.5) * step))
        levels = np.sqrt(factors)
        if stimulus.path == "point":
            pair = _still(levels, weights, rates * step, delays, lag)
        else:
            chosen = _some(delays, max(FEWEST, VALUES // len(cells)))
            drives = levels[:, None] * focusing(along(points), chosen)
            part = weights[chosen] / max(weights[chosen].sum(), 1e-300)
            pair = _moving(drives, part, (rates * step)[chosen], delays[chosen], lag)
        sound = levels[inside]
        if weights.any() and sound.any():
            errors.append([_relative(error[inside], sound) for error in pair])
    ring_up, flight_time = zip(*errors, strict=True) if errors else ((), ())
    return _worst(ring_up), _worst(flight_time)


def _still(levels: Float, weights: Float, z: Complex, delays: Float, lag: int) -> tuple[Float, Float]:
    """Return the errors of the pressure at a stationary focus over time, shapes (k,), relative to full level.

    At such a focus the transducers differ only by their poles, and their sound adds up.
    levels: levels of the drive, shape (k,); weights, z (rate times step), delays (in steps), shapes (n,)
    """
    ring_up, flight_time = np.zeros(len(levels)), np.zeros(len(levels), complex)
    reach = math.ceil(np.abs(delays).max()) + 2
    for one in np.unique(z):
        same = z == one
        emitted = rung(levels.astype(complex), one)
        ring_up += weights[same].sum() * np.abs(emitted - later(levels, lag)) ** 2
        # The share of the pressure at each flight time is distributed over the three nearest samples by a parabola
        whole = np.round(delays[same]).astype(int)
        rest = delays[same] - whole
        kernel = np.zeros(2 * reach + 1)
        for offset, part in ((-1, 0.5 * rest * (rest - 1.0)), (0, 1.0 - rest**2), (1, 0.5 * rest * (rest + 1.0))):
            np.add.at(kernel, whole + reach + offset, weights[same] * part)
        padded = np.pad(emitted, reach, mode="edge")
        flight_time += np.convolve(padded, kernel, mode="valid") - weights[same].sum() * emitted
    return np.sqrt(ring_up), np.abs(flight_time)


def _moving(drives: Complex, weights: Float, z: Complex, delays: Float, lag: int) -> tuple[Float, Float]:
    """Return the same errors as `_still` as the rms over the transducers, weighted by their shares.

    By Cauchy and Schwarz, this is at least the error of the pressure at the focus. drives: shape (k, n)"""
    moments = np.arange(len(drives))
    ring_up, flight_time = np.zeros(len(drives)), np.zeros(len(drives))
    for j, weight in enumerate(weights):
        emitted = rung(drives[:, j], z[j])
        ring_up += weight * np.abs(emitted - later(drives[:, j], lag)) ** 2
        flight_time += weight * np.abs(emitted - np.interp(moments - delays[j], moments, emitted)) ** 2
    return np.sqrt(ring_up), np.sqrt(flight_time)


def recursion(rows: Sequence[complex], loads: Complex | Float) -> Complex:
    """Return x of rows[0] x[n] + rows[1] x[n-1] + ... = loads[n], with zeros before, by a banded system."""
    bands = np.tile(np.array(rows)[:, None], len(loads))
    return np.asarray(scipy.linalg.solve_banded((len(rows) - 1, 0), bands, loads, check_finite=False))


def rung(drive: Complex, z: complex) -> Complex:
    """Return the exact emission of a pole, initially settled, in the middle of each sample of a held drive."""
    half = np.exp(-0.5 * z)
    loads = (1.0 - half**2) * drive
    loads[0] += half**2 * drive[0]
    ends = recursion([1.0, -(half**2)], loads)
    begins = np.concatenate([drive[:1], ends[:-1]])
    return np.asarray(half * begins + (1.0 - half) * drive)


def later(drive: Complex | Float, lag: int) -> Complex | Float:
    return np.concatenate([np.repeat(drive[:1], lag), drive[:-lag]])


def _some(delays: Float, most: int) -> Int:
    """Return the numbers of at most `most` transducers, evenly spaced from the nearest to the farthest."""
    order = np.argsort(delays)
    return order[np.linspace(0, len(order) - 1, min(most, len(order))).round().astype(int)].astype(np.int32)


def _relative(error: Float, sound: Float) -> ResponseError:
    return ResponseError(float(np.sqrt((error**2).mean() / (sound**2).mean())), float(error.max() / sound.max()))


def _worst(errors: Sequence[ResponseError]) -> ResponseError:
    return ResponseError(max((e.rms for e in errors), default=0.0), max((e.peak for e in errors), default=0.0))
