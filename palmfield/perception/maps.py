"""Map of the perceived level on the skin: the level above threshold at each vertex."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from palmfield.config import StimulusConfig
from palmfield.perception.observers import Observer, levels_dB_SL, line_amplitudes
from palmfield.stimulus.schedule import main_frequencies, repeat_rate_Hz, turn_rate_Hz
from palmfield.types import Float

MOVED_SHARE = 0.5
"""Share of the largest amplitude above which skin counts as moving."""
HIGHEST_FELT_HZ = 500.0
"""Highest harmonic of a path that is used [Hz]; the tables of all observers end below it."""


def level_map(
    observer: Observer,
    times_s: ArrayLike,
    displacement_m: ArrayLike,
    frequencies_Hz: Sequence[float],
    *,
    periods: int | None = None,
) -> Float:
    """Return the level above the threshold of an observer at each point of the skin [dB SL], shape (m,).

    The level is -inf without motion, and NaN if all lines with motion are outside the table of the observer. There is
    no summation over area.

    times_s: rising [s], shape (n,); displacement_m: normal displacement of m points [m], shape (n, m)
    frequencies_Hz: frequencies of the motion that are used, for example by `felt_lines`
    periods: number of periods of each line, as for `line_amplitudes`, with the same errors
    """
    if periods is None:
        lines = lines_of(np.asarray(times_s, dtype=np.float64), displacement_m, frequencies_Hz)
    else:
        lines = np.array([line_amplitudes(times_s, displacement_m, f, periods) for f in frequencies_Hz])
    return levels_dB_SL(observer, frequencies_Hz, lines.reshape(len(frequencies_Hz), np.shape(displacement_m)[1]))


def too_little_skin(observer: Observer, lines_m: Float, areas_m2: Float) -> str:
    """Return why an observer does not apply, if less skin moves than in its study, else an empty text.

    lines_m: amplitudes of the lines [m], shape (n, S); areas_m2: areas of the vertices [m^2], shape (S,)
    """
    amplitude = np.linalg.norm(lines_m, axis=0)
    moves_m2 = float(areas_m2[amplitude > MOVED_SHARE * amplitude.max(initial=0.0)].sum())
    if not 0.0 < moves_m2 < observer.least_area_m2:
        return ""
    return (
        f"it applies to {1e4 * observer.least_area_m2:g} cm2 or more of moving skin, but {1e4 * moves_m2:.2g} cm2 move "
        "by half of the maximum"
    )


def felt_lines(times: Float, config: StimulusConfig) -> list[float]:
    """Return the frequencies [Hz] from which all levels in outputs are computed.

    First the main frequencies of the stimulus that the record resolves (`lines_in`), rising. Then, if the record has
    two turns of a path, all harmonics of the turn up to HIGHEST_FELT_HZ. With a modulated path, the harmonics are those
    of the common repetition (`repeat_rate_Hz`), which contain the combinations of both. The list is empty if `lines_in`
    is, or if the record has fewer than two such repetitions.

    times: evenly spaced [s], shape (t,); config: keys of the stimulus
    """
    lines = lines_in(times, main_frequencies(config))
    rate = repeat_rate_Hz(config)
    if not lines or rate is None:
        return lines
    if rate != turn_rate_Hz(config) and not lines_in(times, [rate]):
        return []
    turn = lines_in(times, [rate * n for n in range(1, int(HIGHEST_FELT_HZ / rate + 1e-9) + 1)])
    return lines + [f for f in turn if not np.isclose(f, lines, rtol=1e-6).any()]


def wanted_s(config: StimulusConfig) -> tuple[float, str]:
    """Return the record length that `felt_lines` needs [s], and its reason in words; the load must be periodic."""
    rate, lowest = repeat_rate_Hz(config), main_frequencies(config)[0]
    if rate is None or rate == turn_rate_Hz(config):
        return 2.0 / lowest, f"two periods of {lowest:g} Hz"
    return 2.0 / rate, f"two repeats of path and modulation together, {rate:.4g} per second"


def lines_of(times: Float, displacement_m: ArrayLike, frequencies: Sequence[float]) -> Float:
    """Return the peak amplitudes of lines [m], shape (n, m), fitted over whole periods at the end of the record.

    Harmonics of the lowest line are fitted over whole periods of the lowest line, which avoids leakage.

    times: [s], shape (t,); displacement_m: shape (t, m); frequencies: [Hz], shape (n,)
    """
    lowest = min(frequencies, default=1.0)
    lasts = float(times[-1] - times[0]) * len(times) / max(1, len(times) - 1)
    whole = int(lasts * lowest + 1e-6)

    def periods(f: float) -> int | None:
        order = round(f / lowest)
        return min(whole * order, int(lasts * f + 1e-6)) if abs(f / lowest - order) < 1e-6 * order else None

    return np.array([line_amplitudes(times, displacement_m, f, periods(f)) for f in frequencies])


def lines_in(times: Float, frequencies: list[float]) -> list[float]:
    """Return the frequencies [Hz] for which a record has at least three samples per period. The list is empty if the
    record is shorter than two periods of the first frequency.

    times: evenly spaced [s], shape (t,)
    """
    if not frequencies or len(times) < 2 or frequencies[0] * (times[-1] - times[0]) < 2.0:
        return []
    step = float(times[1] - times[0])
    return [f for f in frequencies if f * step <= 1 / 3]
