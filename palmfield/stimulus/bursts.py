"""Trains of bursts: level of a stimulus over time, rectangular or Hann."""

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import SceneError
from palmfield.types import Float

MOST_BURSTS = 10_000_000
TICK_s = 1e-9
"""Time before a jump [s] that counts as after it, so that t = k * period_s is in burst k with any rounding."""


def burst(
    times: ArrayLike,
    *,
    window: Literal["rectangular", "hann"],
    length_s: float,
    period_s: float,
    count: int | None = None,
) -> Float:
    """Return the level 0..1 at times [s], shape (n,): burst k = 0, 1, ... begins at k period_s and lasts length_s.

    rectangular: 1 within a burst; hann: (1 - cos(2 pi t / length_s)) / 2, with t from the beginning of the burst
    count: number of bursts; None for no end. Before time 0 the level is 0.
    Raises SceneError for another window, a length not in 0 < length_s <= period_s, or a count below 1.
    """
    if window not in ("rectangular", "hann"):
        raise SceneError(f"burst window {window!r} is unknown; use 'rectangular' or 'hann'")
    _check(length_s, period_s, count)
    at = np.asarray(times, dtype=np.float64)
    if not np.isfinite(at).all():
        raise SceneError("burst: times are not all finite; give seconds")
    number = np.floor((at + TICK_s) / period_s)
    since = np.maximum(at - number * period_s, 0.0)
    on = (number >= 0) & (number < (math.inf if count is None else count))
    if length_s < period_s:
        on &= since < length_s - TICK_s
    if window == "rectangular":
        return on.astype(np.float64)
    return np.where(on, 0.5 - 0.5 * np.cos(2.0 * math.pi * since / length_s), 0.0)


def onsets(start_s: float, end_s: float, *, length_s: float, period_s: float, count: int | None = None) -> Float:
    """Return the times [s], in ascending order, at which a rectangular `burst` is switched; shape (n,).

    Only times with start_s < t <= end_s are returned.

    Consecutive bursts without a gap (length_s = period_s) have no jump between them.
    Raises SceneError like `burst`.
    """
    _check(length_s, period_s, count)
    if not (math.isfinite(start_s) and math.isfinite(end_s) and abs(end_s - start_s) <= MOST_BURSTS * period_s):
        raise SceneError(
            f"burst: from {start_s} to {end_s} s every {period_s} s; give finite times and at most {MOST_BURSTS:,} "
            "bursts"
        )
    first = max(0, math.floor(start_s / period_s) - 1)
    last = math.ceil(end_s / period_s) + 1
    numbers = np.arange(first, last + 1 if count is None else min(last + 1, count))
    up, down = numbers * period_s, numbers * period_s + length_s
    if length_s == period_s:
        up, down = up[numbers == 0], down[numbers == (-1 if count is None else count - 1)]
    jumps = np.sort(np.concatenate([up, down]))
    return jumps[(jumps > start_s) & (jumps <= end_s)]


def _check(length_s: float, period_s: float, count: int | None) -> None:
    if not (math.isfinite(period_s) and 0.0 < length_s <= period_s):
        raise SceneError(
            f"burst: length_s = {length_s} and period_s = {period_s} do not fit; give 0 < length_s <= period_s"
        )
    if count is not None and not (math.isfinite(count) and count >= 1 and int(count) == count):
        raise SceneError(f"burst: count = {count} is not a count; give a whole number of 1 or more, or omit it")
