"""Averages over time in a frame that rotates with the focus on a circle."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import above_zero, even_step, finite, trace
from palmfield.types import Float


def co_rotating_average(
    times_s: ArrayLike,
    values: ArrayLike,
    turn_Hz: float,
    angles_rad: ArrayLike,
    *,
    square: bool = False,
) -> Float:
    """Return the mean over time in the frame that rotates with a focus on a circle, shape (r, n_out).

    times_s: evenly spaced, shape (t,); values: shape (t, r, n), at r radii and n angles 2 pi j/n in the fixed frame
    turn_Hz: turns of the focus per second, positive counter-clockwise; the focus is at angle 0 at time 0
    angles_rad: angles from the focus at which the mean is computed, shape (n_out,)
    square: whether to return the root of the mean square instead of the mean
    Snapshots are interpolated trigonometrically, which is exact for fewer than n/2 waves round the circle.
    Raises MeasurementError for times that are not evenly spaced or cover less than one turn.
    """
    times, maps = trace(times_s, values, 2)
    if maps.ndim != 3:
        raise MeasurementError(f"values have shape {maps.shape}; give (t, radii, angles)")
    above_zero("the absolute value of turn_Hz", abs(turn_Hz))
    step = even_step(times)
    if (times[-1] - times[0] + step) * abs(turn_Hz) < 1.0 - 1e-6:
        raise MeasurementError(
            f"the record of {times[-1] - times[0]:g} s is shorter than one turn at {turn_Hz:g} Hz; record for longer"
        )
    angles = np.atleast_1d(np.asarray(angles_rad, dtype=float))
    finite("angles_rad", angles)
    count = maps.shape[2]
    orders = np.fft.rfftfreq(count, 1.0 / count)
    weight = np.where((orders == 0.0) | (2.0 * orders == count), 1.0, 2.0) / count
    # In the frame of the focus each angular order of a snapshot is multiplied by its own phase factor
    turn = np.exp(2j * np.pi * turn_Hz * np.outer(times, orders))
    back = np.exp(1j * np.outer(orders, angles))
    if not square:
        mean = sum(np.fft.rfft(snapshot, axis=1) * now for snapshot, now in zip(maps, turn, strict=True)) / len(times)
        return np.asarray(((mean * weight) @ back).real)
    total = np.zeros((maps.shape[1], len(angles)))
    for snapshot, now in zip(maps, turn, strict=True):
        total += ((np.fft.rfft(snapshot, axis=1) * (now * weight)) @ back).real ** 2
    return np.asarray(np.sqrt(total / len(times)))
