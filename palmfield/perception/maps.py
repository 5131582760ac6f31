"""Where on the skin how much is felt: the level above threshold at each vertex."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from palmfield.perception.observers import Observer, levels_dB_SL, line_amplitudes
from palmfield.types import Float


def level_map(
    observer: Observer,
    times_s: ArrayLike,
    displacement_m: ArrayLike,
    frequencies_Hz: Sequence[float],
    *,
    periods: int | None = None,
) -> Float:
    """Level above an observer's threshold at each place of the skin [dB SL], shape (m,); -inf where nothing moves.

    NaN where all lines that move lie outside the observer's table.

    times_s: rising [s], shape (n,); displacement_m: normal displacement of m places [m], shape (n, m)
    frequencies_Hz: lines of the motion that count, as `palmfield.stimulus.schedule.main_frequencies` has them
    periods: of each line, as of `line_amplitudes`, which says what it raises
    Each place is taken by itself: no summation over area.
    """
    lines = np.array([line_amplitudes(times_s, displacement_m, f, periods) for f in frequencies_Hz])
    return levels_dB_SL(observer, frequencies_Hz, lines.reshape(len(frequencies_Hz), np.shape(displacement_m)[1]))


def lines_in(times: Float, frequencies: list[float]) -> list[float]:
    """The frequencies [Hz] of which a record has three samples a period or more, none where it is shorter than two
    periods of the first.

    times: evenly spaced [s], shape (t,)
    """
    if not frequencies or len(times) < 2 or frequencies[0] * (times[-1] - times[0]) < 2.0:
        return []
    step = float(times[1] - times[0])
    return [f for f in frequencies if f * step <= 1 / 3]
