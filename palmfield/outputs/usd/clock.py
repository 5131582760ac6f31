"""Times of a run in a USD scene, and their time codes. Time [s] = time code / codes per second."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from palmfield.errors import OutputError
from palmfield.outputs.usd.shown import Shown
from palmfield.types import Float, Int

DECIMALS = 6
"""Number of decimals of time codes. A millionth of a frame is much finer than the times of the run."""


class Clock(NamedTuple):
    """Times of a run that a USD scene includes.

    places: indices of the included times
    times_s: these times [s], shape (n,)
    codes: their time codes, shape (n,)
    per_second: number of time codes per second of the run
    """

    places: slice
    times_s: Float
    codes: Float
    per_second: float

    def code(self, time_s: float) -> float:
        """Return the time code of any time of the run [s]."""
        return round(time_s * self.per_second, DECIMALS)


def rows_at(variable: xr.DataArray, dim: str, numbers: Int) -> NDArray[Any]:
    """Return rows of a variable along its record dimension, in one read. numbers: rising numbers of the rows"""
    first = int(numbers[0])
    return np.asarray(variable.isel({dim: slice(first, int(numbers[-1]) + 1)}).values)[numbers - first]


def clock_of(result: xr.DataTree, shown: Shown) -> Clock:
    """Return the clock of a result. If the result has no times, the clock has none.

    Raises OutputError for times outside the run.
    """
    times: Float = np.asarray(result.coords["time"].values, float) if "time" in result.coords else np.zeros(0)
    if len(times) == 0:
        return Clock(slice(0, 0), times, times, 1.0)
    start = times[0] if shown.start_s is None else shown.start_s
    end = times[-1] if shown.end_s is None else shown.end_s
    if not times[0] <= start <= end <= times[-1]:
        raise OutputError(
            f"the scene would run from {1e3 * start:g} to {1e3 * end:g} ms; allowed: rising times within "
            f"{1e3 * times[0]:g} to {1e3 * times[-1]:g} ms"
        )
    slack = 1e-9 * max(1.0, abs(float(times[-1])))
    first, last = int(np.searchsorted(times, start - slack)), int(np.searchsorted(times, end + slack, "right"))
    last = max(last, first + 1)
    places = slice(first, last, max(1, -(-(last - first) // shown.frames)))
    chosen = times[places]
    per_second = float(f"{1.0 / float(np.median(np.diff(chosen))):.12g}") if len(chosen) > 1 else 1.0
    return Clock(places, chosen, np.round(chosen * per_second, DECIMALS), per_second)
