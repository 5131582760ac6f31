"""Metrics of one signal over time: steady value, peak, overshoot, settling, peak to peak, RMS.

All take times [s], shape (t,), and a signal in any unit, shape (t,). They raise MeasurementError for other shapes, NaN,
and windows with fewer than two samples. A window is (start, end) [s], both included; None is the whole record.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import MeasurementError
from palmfield.metrics.checks import above_zero, share, trace
from palmfield.types import Float

Window = tuple[float, float] | None
Of = Literal["magnitude", "negative", "positive"]


def within(times_s: ArrayLike, values: ArrayLike, window_s: Window, *, single: bool = False) -> tuple[Float, Float]:
    """Return the samples in a window: times, shape (k,), and values, shape (k, ...).

    times_s: rising times [s], shape (t,)
    values: values in any unit, shape (t, ...)
    window_s: (start, end) [s], both included; None is the whole record
    single: whether to require one signal, shape (t,)
    Raises MeasurementError for other shapes, NaN, and a window with fewer than two samples.
    """
    times, signal = trace(times_s, values, single=single)
    if window_s is None:
        return times, signal
    step = float(np.median(np.diff(times)))
    start, end = window_s
    chosen = (times >= start - 1e-6 * step) & (times <= end + 1e-6 * step)
    if chosen.sum() < 2:
        raise MeasurementError(
            f"the window from {start:g} to {end:g} s holds {chosen.sum()} samples of a record from {times[0]:g} to "
            f"{times[-1]:g} s; needed: two or more"
        )
    return times[chosen], signal[chosen]


def last_periods(times_s: ArrayLike, frequency_Hz: float, periods: int) -> tuple[float, float]:
    """Return a window with the last whole periods of a record [s]. It excludes the sample that begins the next period.

    Raises MeasurementError if the record is shorter.
    """
    times, _ = trace(times_s, np.zeros(np.shape(times_s)))
    above_zero("frequency_Hz", frequency_Hz)
    step = float(np.median(np.diff(times)))
    length = periods / frequency_Hz
    if periods < 1 or length > times[-1] - times[0] + step * (1.0 + 1e-6):
        raise MeasurementError(
            f"{periods} periods of {frequency_Hz:g} Hz take {length:g} s, the record {times[-1] - times[0]:g}; give "
            "1 or more that fit"
        )
    return float(times[-1] - length + 0.5 * step), float(times[-1])


def mean_value(times_s: ArrayLike, values: ArrayLike, window_s: Window = None) -> float:
    """Return the mean of the samples in a window, in the unit of the signal.

    times_s: rising [s], shape (t,); values: values in any unit, shape (t,); window_s: as for `within`
    Raises MeasurementError like `within`.
    """
    return float(within(times_s, values, window_s)[1].mean())


def steady_value(times_s: ArrayLike, values: ArrayLike, window_s: tuple[float, float]) -> float:
    """Return the final value of a step response: the mean over a window near the end of the stimulus.

    times_s: rising [s], shape (t,); values: values in any unit, shape (t,); window_s: as for `within`
    Raises MeasurementError like `within`.
    """
    return mean_value(times_s, values, window_s)


def peak(
    times_s: ArrayLike, values: ArrayLike, window_s: Window = None, *, of: Of = "magnitude"
) -> tuple[float, float]:
    """Return time [s] and signed value of the sample of largest magnitude, or of the lowest or highest sample.

    times_s: rising [s], shape (t,); values: values in any unit, shape (t,); window_s: as for `within`
    of: "magnitude", "negative" or "positive"
    Raises MeasurementError like `within`, and for another `of`.
    """
    times, signal = within(times_s, values, window_s, single=True)
    if of not in ("magnitude", "negative", "positive"):
        raise MeasurementError(f"of is '{of}'; use magnitude, negative or positive")
    size = {"magnitude": np.abs(signal), "negative": -signal, "positive": signal}[of]
    place = int(size.argmax())
    return float(times[place]), float(signal[place])


def overshoot(times_s: ArrayLike, values: ArrayLike, steady: float, window_s: Window = None) -> float:
    """Return the overshoot of a step response relative to its steady value, (peak - steady)/steady, at least 0.

    times_s, values, window_s: as for `mean_value`
    steady: steady value, not 0, for example by `steady_value`; the peak has the sign of the steady value
    Raises MeasurementError like `within`, and for a steady value of 0.
    """
    if not (np.isfinite(steady) and steady != 0.0):
        raise MeasurementError(f"the steady value is {steady}; an overshoot is relative to one that is not 0")
    highest = float((within(times_s, values, window_s)[1] / steady).max())
    return max(0.0, highest - 1.0)


def settling_time(
    times_s: ArrayLike,
    values: ArrayLike,
    steady: float,
    band: float,
    *,
    start_s: float = 0.0,
    end_s: float | None = None,
) -> float:
    """Return the time from `start_s` until the signal stays within band * |steady| of the steady value [s].

    times_s, values: as for `mean_value`; steady: as for `overshoot`
    band: share of the steady value, above 0 and below 1; the last crossing is interpolated linearly between two samples
    end_s: end of the evaluated signal, for example of the stimulus
    Raises MeasurementError if the signal is still outside the band at the end.
    """
    share("band", band)
    if not (np.isfinite(steady) and steady != 0.0):
        raise MeasurementError(f"the steady value is {steady}; a band is relative to one that is not 0")
    times, signal = within(times_s, values, (start_s, np.inf if end_s is None else end_s), single=True)
    off = np.abs(signal - steady) / abs(steady)
    outside = np.flatnonzero(off > band)
    if len(outside) == 0:
        return 0.0
    last = int(outside[-1])
    if last == len(times) - 1:
        raise MeasurementError(
            f"at {times[-1]:g} s the signal is {100 * off[last]:.3g} % from its steady value, outside the band of "
            f"{100 * band:g} %: record for longer, or give a wider band"
        )
    part = (off[last] - band) / (off[last] - off[last + 1])
    return float(times[last] + part * (times[last + 1] - times[last]) - start_s)


def peak_to_peak(times_s: ArrayLike, values: ArrayLike, window_s: Window = None) -> float:
    """Return the largest minus the smallest value, in the unit of the signal.

    times_s, values: as for `mean_value`
    window_s: None is the whole record with the onset; `last_periods` gives the steady part. The results differ, because
    a modulated load that starts from rest also moves the mean position of the skin. Raises MeasurementError as
    `within`.
    """
    return float(np.ptp(within(times_s, values, window_s)[1]))


def rms(
    times_s: ArrayLike, values: ArrayLike, window_s: Window = None, *, mean: Literal["kept", "removed"] = "kept"
) -> float:
    """Return the root mean square over a window, in the unit of the signal.

    times_s: rising [s], shape (t,); values: values in any unit, shape (t,); window_s: as for `within`
    mean: "kept" or "removed", whether the mean is subtracted first
    Raises MeasurementError like `within`, and for another `mean`.
    """
    signal = within(times_s, values, window_s)[1]
    return float(np.sqrt(np.mean((signal - _mean(signal, mean)) ** 2)))


def rms_map(
    times_s: ArrayLike, values: ArrayLike, window_s: Window = None, *, mean: Literal["kept", "removed"] = "kept"
) -> Float:
    """Return `rms` of many signals: values of shape (t, ...) give a result of shape (...).

    The other arguments and errors are those of `rms`.
    """
    signal = within(times_s, values, window_s)[1]
    return np.asarray(np.sqrt(np.mean((signal - _mean(signal, mean)) ** 2, axis=0)))


def _mean(signal: Float, mean: str) -> Float:
    if mean not in ("kept", "removed"):
        raise MeasurementError(f"mean is '{mean}'; use kept or removed")
    return signal.mean(axis=0) if mean == "removed" else np.zeros(signal.shape[1:])
