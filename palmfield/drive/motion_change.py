"""Change of the motion of a skin under a stationary focus by ring-up and flight times, from samples of the drive."""

import math

import numpy as np

from palmfield.config import StimulusConfig
from palmfield.drive.response_error import SAMPLES_A_DELAY, SHORTEST_S, later, recursion, rung, windows
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Float

LOSS, FORGOTTEN = 0.1, 8
"""Damping ratio of the oscillator that models a skin, and time in which its initial state decays, in periods."""
SLOWEST_Hz = 5.0
"""Lowest frequency of the oscillator: slower ones respond less to a ring-up, and their initial state decays slowly."""


def changes_of_motion(
    stimulus: StimulusConfig, rate: complex, spread_s: float, frequency_Hz: float
) -> tuple[float, float]:
    """Return the relative change of the largest displacement under a stationary focus due to ring-up and flight times.

    The skin is modelled as a weakly damped oscillator. A steady load that starts late or gradually gives the same
    displacement as a sudden load, except for changes as fast as the oscillator.

    rate: rate of the pole of the transducers [1/s]
    spread_s: time between the first and the last arrival of sound [s]; arrivals are uniform in between
    frequency_Hz: frequency of the oscillator, at which the skin has most of its response
    """
    delay = (1.0 / rate).real
    step = max(delay / SAMPLES_A_DELAY, SHORTEST_S)
    lag, spread = max(1, round(delay / step)), max(1, round(spread_s / step))
    frequency_Hz = max(frequency_Hz, SLOWEST_Hz)
    w = 2.0 * math.pi * frequency_Hz
    before = math.ceil(FORGOTTEN / (frequency_Hz * step))
    changes = []
    for begin, end in windows(stimulus, delay):
        last = max(end, begin + 1.0 / frequency_Hz)
        cells = np.arange(-before, math.ceil((last - begin) / step))
        levels = np.sqrt(frames_at(stimulus, np.asarray(begin + (cells + 0.5) * step))[1])
        late = np.convolve(np.pad(levels, (spread - 1, 0), mode="edge"), np.full(spread, 1.0 / spread), mode="valid")
        emitted = np.abs(rung(levels.astype(complex), rate * step)) ** 2
        # Each load is compared with an equally delayed load, because a pure delay only shifts the motion
        pairs = (emitted, np.abs(later(levels, lag)) ** 2), (late**2, np.abs(later(levels, max(1, spread // 2))) ** 2)
        sizes = [[float(np.abs(_oscillation(load, w * step))[before:].max()) for load in pair] for pair in pairs]
        if all(own > 0.0 for _, own in sizes):
            changes.append([changed / own - 1.0 for changed, own in sizes])
    ring_up, flight_time = zip(*changes, strict=True) if changes else ((0.0,), (0.0,))
    return max(ring_up, key=abs), max(flight_time, key=abs)


def _oscillation(load: Float, angle: float) -> Float:
    """Return the displacement of an oscillator, initially at rest, over that under a steady load of 1 (bilinear rule).

    angle: phase advance of the oscillator per sample [rad]
    """
    c = 2.0 / angle
    end = c**2 + 2.0 * LOSS * c + 1.0
    rows = [1.0, 2.0 * (1.0 - c**2) / end, (c**2 - 2.0 * LOSS * c + 1.0) / end]
    return np.asarray(recursion(rows, np.convolve(load, [1.0, 2.0, 1.0])[: len(load)] / end))
