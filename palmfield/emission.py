"""What the transducers make of the drive over time: their resonance, and the spread of the sound's flight time.

The carrier is never stepped. Each transducer is one complex pole, stepped exactly under a held or linear drive; sound
that is longer under way starts from an earlier drive. A delay common to all is left out: it shifts results in time.
"""

from dataclasses import dataclass

import numpy as np

from palmfield.aim import Aim
from palmfield.config import StimulusConfig
from palmfield.drive.response import Pole, flight_times
from palmfield.emitter import Board, Emitter
from palmfield.envelope import Cost, cost
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Complex, Float

DELAY_STEP_S = 20e-6
"""Flight times are rounded to this: 2 % of a turn of an envelope of 1 kHz."""


@dataclass(frozen=True)
class Response:
    """Whether ring-up and flight time are modelled, and what leaving them out would cost.

    ring, late: errors of the pressure without ring-up, and with the sound of all transducers arriving at once
    spread_s: between the first and the last transducer's sound; pole: of the transducers
    delays_s: of each transducer against the middle [s] in the reference pose, shape (n,), zeros where left out
    """

    on: bool
    ring: Cost
    late: Cost
    spread_s: float
    pole: Pole
    delays_s: Float


def response(
    boards: tuple[Board, ...],
    emitter: Emitter,
    stimulus: StimulusConfig,
    aim: Aim,
    focus: Float,
    accuracy: float,
    *,
    spread: bool = True,
) -> Response:
    """Decide what to model. ARP goes with the square of the pressure, so `auto` allows a quarter of the accuracy.

    aim: where the stimulus's points are in the reference pose
    focus: where the sound goes first, in the frame of the first array [m]
    accuracy: wanted of the skin's displacement, relative; spread: whether flight times may differ
    """
    counts = [len(part) for part in emitter.parts]
    configs = [board.config for board in boards]
    f0 = np.concatenate([np.full(n, config.resonance_Hz) for n, config in zip(counts, configs, strict=True)])
    quality = np.concatenate([np.full(n, config.quality) for n, config in zip(counts, configs, strict=True)])
    pole = Pole(f0, quality, emitter.array.frequency_Hz)
    times = flight_times(emitter.array, focus, emitter.air)
    ring, late = cost(stimulus, aim.course, emitter, focus, pole, times)
    wanted = {config.response for config in configs}
    on = "on" in wanted or ("auto" in wanted and ring.rms + late.rms > 0.25 * accuracy)
    matters = on and spread and late.rms > 0.25 * accuracy
    delays = delays_to(emitter, focus) if matters else np.zeros(len(times))
    return Response(on, ring, late, float(np.ptp(times)), pole, delays)


def delays_to(emitter: Emitter, focus: Float) -> Float:
    """Flight time of each transducer's sound to a focus against the middle, in whole DELAY_STEP_S [s], shape (n,).

    Of several foci, shape (m, 3), the first one counts.
    """
    times = flight_times(emitter.array, np.atleast_2d(focus)[0], emitter.air)
    return np.asarray(np.round((times - 0.5 * (times.max() + times.min())) / DELAY_STEP_S) * DELAY_STEP_S)


def asked(stimulus: StimulusConfig, emitter: Emitter, delays_s: Float, t: float, aim: Aim) -> Complex:
    """Drive of each transducer whose sound arrives at time t [s] (less the common delay), shape (n,).

    aim: where the stimulus's points are
    """
    delays, group = np.unique(delays_s, return_inverse=True)
    points, factors = frames_at(stimulus, t - delays)
    drives = np.zeros((len(delays), len(delays_s)), complex)
    heard = factors > 0.0
    if heard.any():
        drives[heard] = emitter.unit_drives(points[heard], aim)
    return np.asarray(np.sqrt(factors)[group] * drives[group, np.arange(len(delays_s))])
