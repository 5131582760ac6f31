"""What the transducers make of the drive over time: their resonance, and the spread of the sound's flight time.

The carrier is never stepped. Each transducer is one complex pole, stepped exactly under a held or linear drive; sound
that is longer under way starts from an earlier drive. A delay common to all is left out: it shifts results in time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.config import StimulusConfig
from palmfield.drive.response import Pole, delay_bound, flight_times, ring_bound
from palmfield.emitter import Board, Emitter
from palmfield.stimulus import frame_at
from palmfield.types import Complex, Float

DELAY_STEP_S = 20e-6
"""Flight times are rounded to this: 2 % of a turn of an envelope of 1 kHz."""


@dataclass(frozen=True)
class Response:
    """Whether ring-up and flight time are modelled, and what leaving them out would cost.

    envelope_Hz: fastest change of any transducer's drive; ring_bound, delay_bound: relative errors of the pressure
    pole: of the transducers; delays_s: of each transducer against the middle [s], shape (n,), zeros where left out
    """

    on: bool
    envelope_Hz: float
    ring_bound: float
    delay_bound: float
    spread_s: float
    pole: Pole
    delays_s: Float


def envelope_frequency(stimulus: StimulusConfig, emitter: Emitter, focus: Float) -> float:
    """Fastest modulation of a transducer's drive [Hz]: the AM, and the turning of its phase as the focus moves."""
    found = stimulus.am_frequency_Hz or 0.0 if stimulus.modulation == "am" else 0.0
    if stimulus.path == "circle":
        speed = math.pi * (stimulus.path_diameter_m or 0.0) * (stimulus.path_rate_Hz or 0.0)
        rays = focus - emitter.array.positions
        sideways = np.linalg.norm(rays[:, :2], axis=1) / np.linalg.norm(rays, axis=1)
        found += speed * float(sideways.max()) * emitter.array.frequency_Hz / sound_speed(emitter.air)
    return found


def late_at_focus(emitter: Emitter, times_s: Float, focus: Float, frequency_Hz: float) -> float:
    """Relative error of the pressure at a still focus if the sound of all transducers arrives at their mean time.

    Exact for an envelope of this frequency: |1 - sum of w exp(i 2 pi f (t - mean))| with w the shares of the pressure.
    """
    shares = emitter.array.p0_Pa_m / np.linalg.norm(focus - emitter.array.positions, axis=1)
    shares = shares * np.abs(emitter.unit_drive(focus)[0])
    total = shares.sum()
    if total == 0.0:
        return 0.0
    shares = shares / total
    turns = frequency_Hz * (times_s - shares @ times_s)
    return float(abs(1.0 - shares @ np.exp(2j * np.pi * turns)))


def response(
    boards: tuple[Board, ...],
    emitter: Emitter,
    stimulus: StimulusConfig,
    focus: Float,
    accuracy: float,
    *,
    spread: bool = True,
) -> Response:
    """Decide what to model. ARP goes with the square of the pressure, so `auto` allows a quarter of the accuracy.

    focus: where the sound goes in the reference pose, frame of the first array [m]; accuracy: wanted of the skin's
    displacement, relative; spread: whether flight times may differ
    """
    counts = [len(part) for part in emitter.parts]
    configs = [board.config for board in boards]
    f0 = np.concatenate([np.full(n, config.resonance_Hz) for n, config in zip(counts, configs, strict=True)])
    quality = np.concatenate([np.full(n, config.quality) for n, config in zip(counts, configs, strict=True)])
    pole = Pole(f0, quality, emitter.array.frequency_Hz)
    times = flight_times(emitter.array, focus, emitter.air)
    apart = float(np.ptp(times))
    fastest = envelope_frequency(stimulus, emitter, focus)
    ring = ring_bound(fastest, pole, remove_delay=True)
    still = stimulus.path == "point"
    late = late_at_focus(emitter, times, focus, fastest) if still else delay_bound(fastest, apart)
    wanted = {config.response for config in configs}
    on = "on" in wanted or ("auto" in wanted and ring + late > 0.25 * accuracy)
    delays = np.zeros(len(times))
    if on and spread and late > 0.05 * accuracy:
        delays = np.round((times - 0.5 * (times.max() + times.min())) / DELAY_STEP_S) * DELAY_STEP_S
    return Response(on, fastest, ring, late, apart, pole, delays)


def asked(
    stimulus: StimulusConfig, emitter: Emitter, delays_s: Float, t: float, to_array: Callable[[Float], Float]
) -> Complex:
    """Drive of each transducer whose sound arrives at time t [s] (less the common delay), shape (n,).

    to_array: stimulus frame -> frame of the first array, positions of shape (3,)
    """
    drive = np.zeros(len(delays_s), complex)
    for delay in np.unique(delays_s):
        frame = frame_at(stimulus, t - delay)
        if frame.arp_factor > 0.0:
            chosen = delays_s == delay
            unit, _ = emitter.unit_drive(to_array(frame.focus))
            drive[chosen] = math.sqrt(frame.arp_factor) * unit[chosen]
    return drive
