"""Due times of frames."""

import bisect
import math
from collections.abc import Sequence
from typing import NamedTuple

from palmfield.config import StimulusConfig
from palmfield.errors import SceneError
from palmfield.stimulus.schedule import frame_rates, jumps

REFRESH_S = 0.1
"""A constant frame is repeated at this interval [s], so that a byte lost on the line has no lasting effect."""
MOST_FRAMES = 100_000_000
ON_STEP = 1e-6
"""Distance of a moment from the beginning of a step, in steps, below which it counts as the beginning."""


class TimedFrame(NamedTuple):
    """One frame.

    time_s: due time of the emission (last byte on the line), since the start [s]; data: bytes
    sounds: whether any transducer is on in this frame
    """

    time_s: float
    data: bytes
    sounds: bool = True


def frame_times(
    stimuli: Sequence[StimulusConfig],
    duration_s: float,
    step_s: float | None = None,
    besides: Sequence[float] = (),
    least_s: float = 0.0,
) -> list[float]:
    """Return due times of frames [s]: at points of paths, control ticks and jumps, and every REFRESH_S otherwise.

    step_s: MuJoCo step [s], if a part moves: poses change at the start of a step, so rarer frames are due then
    besides: further due times, which are omitted if another due time is within least_s [s]
    Raises SceneError for a duration or a step that is not finite and above 0, and for more than MOST_FRAMES.
    """
    for name, value in (("duration_s", duration_s), ("step_s", 1.0 if step_s is None else step_s)):
        if not 0.0 < value < math.inf:
            raise SceneError(f"{name} is {value}; allowed: finite seconds, above 0")
    rates = [rate for stimulus in stimuli for rate in frame_rates(stimulus)]
    period_s = 1.0 / max(rates) if rates else REFRESH_S
    if duration_s > MOST_FRAMES * period_s:
        raise SceneError(f"duration_s is {duration_s:g}; allowed: {MOST_FRAMES:,} frames, one every {period_s:g} s")
    edges = {t for stimulus in stimuli for t in jumps(stimulus, 0.0, duration_s) if 0.0 < t < duration_s}
    times = {k * period_s for k in range(math.ceil(duration_s / period_s - 1e-9))}
    if step_s is not None and period_s >= step_s:
        times = {math.ceil(time_s / step_s - ON_STEP) * step_s for time_s in times}
    due = sorted({time_s for time_s in times | edges if time_s < duration_s})
    return filled(due, besides, least_s, duration_s)


def filled(due: list[float], besides: Sequence[float], least_s: float, duration_s: float) -> list[float]:
    """Return due times with further times that are at least least_s [s] from all others."""
    result = list(due)
    for time_s in sorted(besides):
        at = bisect.bisect_left(result, time_s)
        before = time_s - result[at - 1] if at else math.inf
        after = result[at] - time_s if at < len(result) else math.inf
        if min(before, after) >= least_s * (1.0 - ON_STEP) and time_s < duration_s:
            result.insert(at, time_s)
    return result
