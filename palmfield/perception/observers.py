"""Level of skin motion above the thresholds of named contact observers, and the amplitude of lines in a motion.

The observers differ by up to 19 dB: report results for each, with its own spread. None of them was measured in mid-air.
The only mid-air threshold is one of force (`palmfield.perception.force_threshold`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.blas import one_blas_thread
from palmfield.errors import OutputError
from palmfield.types import Float

BLOCK = 64
"""Number of samples of all courses that are converted to double precision together, which fit in a cache."""


@dataclass(frozen=True)
class AreaSummation:
    """Spatial summation: thresholds fall by 3 dB per doubling of the moving area, between two areas and frequencies.

    low_Hz, high_Hz: [Hz]; low_m2, high_m2: limits to which the area is clipped [m^2]
    contact_m2: contact area of the table of thresholds [m^2]
    """

    low_Hz: float
    high_Hz: float
    low_m2: float
    high_m2: float
    contact_m2: float

    def factor(self, f_Hz: ArrayLike, area_m2: float) -> Float:
        """Return the threshold at an area over that of the table, in the shape of f_Hz [Hz]."""
        frequency = np.asarray(f_Hz, dtype=np.float64)
        summed = (frequency >= self.low_Hz) & (frequency <= self.high_Hz)
        return np.where(summed, np.sqrt(self.contact_m2 / min(max(area_m2, self.low_m2), self.high_m2)), 1.0)


@dataclass(frozen=True)
class TemporalSummation:
    """Temporal summation: a leaky sum of the squared motion, so that short stimuli need a higher level.

    from_Hz: lowest frequency [Hz]; tau_s: time constant [s]; the table of thresholds applies to stimuli of many tau_s
    """

    from_Hz: float
    tau_s: float

    def factor(self, f_Hz: ArrayLike, duration_s: float) -> Float:
        """Return the threshold of a steady vibration of this duration over that of the table, in the shape of f_Hz."""
        summed = np.asarray(f_Hz, dtype=np.float64) >= self.from_Hz
        return np.where(summed, 1.0 / np.sqrt(-np.expm1(-duration_s / self.tau_s)), 1.0)


@dataclass(frozen=True)
class Observer:
    """Detection thresholds of one study, for a body that vibrates in contact with the skin.

    frequency_Hz: rising [Hz], shape (n,); peak_m: peak displacement at threshold [m], shape (n,)
    stated: quantity in the table of the source, with peak or rms
    percent_correct: share of correct answers at threshold [%], None if not established
    source: reference and validity of the values
    why: one line on the meaning of a level of this observer in mid-air
    spread_dB: half-width of the spread [dB], None if not established; spread_of: origin of the spread, in words
    channels_from_Hz: frequencies at which the most sensitive channel of the skin changes [Hz]; levels of channels are
        not summed, the highest is used
    least_area_m2: smallest area of moving skin to which the study applies [m^2]; 0 without a limit
    summation: dependence of thresholds on area, None if the source has no such law
    temporal: dependence of thresholds on duration, None if the source has no such law
    """

    name: str
    frequency_Hz: Float
    peak_m: Float
    stated: str
    percent_correct: float | None
    source: str
    why: str
    spread_dB: float | None
    spread_of: str
    channels_from_Hz: tuple[float, ...] = ()
    least_area_m2: float = 0.0
    summation: AreaSummation | None = None
    temporal: TemporalSummation | None = None


def _bolanowski() -> Observer:
    level_dB = np.array([29, 29, 21, 15, 8, -6, -19, -10, -3])
    return Observer(
        name="bolanowski_1988",
        frequency_Hz=np.array([0.4, 2, 10, 20, 40, 100, 250, 400, 500]),
        peak_m=1e-6 * 10 ** (level_dB / 20),
        stated="displacement, dB re 1 um, taken as um peak",
        percent_correct=None,
        source="Bolanowski et al. 1988, four channels: the composite curve of a contactor of 2.9 cm2, read to +-4 "
        "dB; not yet compared with the print, and peak amplitude is an assumption. Below 40 Hz the non-Pacinian "
        "channels set it, above the Pacinian one, whose threshold falls by 3 dB per doubling of area from 0.02 to "
        "2.9 cm2 at 80 to 320 Hz. Temporal summation follows Zwislocki's law (J. Acoust. Soc. Am. 32 (1960) "
        "1046), which Verrillo (ibid. 37 (1965) 843) found in the Pacinian channel only; the time constant of 0.2 "
        "s is not yet compared with the print. A contactor has a rigid surround; mid-air stimulation has none, "
        "which changes the threshold below 40 Hz by an unknown amount.",
        why="measured with a contactor of 2.9 cm2 in a rigid surround; mid-air stimulation has neither",
        spread_dB=4.0,
        spread_of="reading of the composite curve",
        channels_from_Hz=(40.0,),
        summation=AreaSummation(80.0, 320.0, 0.02e-4, 2.9e-4, 2.9e-4),
        temporal=TemporalSummation(40.0, 0.2),
    )


def _morioka_griffin() -> Observer:
    frequency = np.array([8, 10, 12.5, 16, 20, 25, 31.5, 40, 50, 63, 80, 100, 125, 160, 200, 250, 315])
    rms = [0.095, 0.1, 0.095, 0.108, 0.15, 0.16, 0.109, 0.065, 0.072, 0.049, 0.028, 0.023, 0.022, 0.021, 0.029, 0.032]
    acceleration = np.array([*rms, 0.061])
    return Observer(
        name="morioka_griffin_2006",
        frequency_Hz=frequency,
        peak_m=np.sqrt(2) * acceleration / (2 * np.pi * frequency) ** 2,
        stated="acceleration, m/s^2 rms; peak displacement = sqrt(2) a / (2 pi f)^2",
        percent_correct=None,
        source="M. Morioka and M. J. Griffin, J. Sound Vib. 295 (2006) 633-648: hand-transmitted vibration, hand "
        "around a handle. The contact is large, so thresholds for a small area are higher. Percent correct: not "
        "established here.",
        why="measured on a gripped handle; a large part of the skin moves",
        spread_dB=None,
        spread_of="not established",
        least_area_m2=2e-3,
    )


def _afferent_human() -> Observer:
    peak_um = [24.3, 11.1, 5.34, 1.87, 0.908, 0.304, 0.115, 0.079, 0.050, 0.042, 0.046, 0.070, 0.120]
    return Observer(
        name="afferent_human",
        frequency_Hz=np.array([2.0, 5, 10, 20, 30, 50, 80, 100, 150, 200, 250, 300, 350]),
        peak_m=1e-6 * np.array(peak_um),
        stated="displacement, um peak",
        percent_correct=None,
        source="Human detection thresholds digitised from the public data of a model of single afferents, which "
        "lists them with those of RA1, PC and SA1 units. Not digitised again from the psychophysics; contact size "
        "and percent correct not established here.",
        why="human thresholds listed with those of single afferents; the contact is unknown",
        spread_dB=None,
        spread_of="not established",
    )


OBSERVERS = {observer.name: observer for observer in (_bolanowski(), _morioka_griffin(), _afferent_human())}


def threshold_m(
    observer: Observer, f_Hz: ArrayLike, area_m2: float | None = None, duration_s: float | None = None
) -> Float:
    """Return the peak displacement at threshold [m], interpolated on log-log axes.

    f_Hz: [Hz], any shape; the result has the same shape and is NaN outside the table of the observer.
    area_m2: moving area [m^2] for spatial summation; None for the contact area of the table of the observer
    duration_s: duration of the steady vibration [s]; None for a long one
    Raises OutputError for an area or duration that is not above 0, or if the observer has no law for it.
    """
    frequency = np.asarray(f_Hz, dtype=np.float64)
    low, high = observer.frequency_Hz[0], observer.frequency_Hz[-1]
    inside = (frequency >= low) & (frequency <= high)
    log_f = np.log(np.where(inside, frequency, low))
    log_peak = np.interp(log_f, np.log(observer.frequency_Hz), np.log(observer.peak_m))
    threshold = np.where(inside, np.exp(log_peak), np.nan)
    if area_m2 is not None:
        if observer.summation is None:
            raise OutputError(_without_law(observer, "areas", "area_m2", "summation"))
        if not area_m2 > 0:
            raise OutputError(f"area_m2 is {area_m2}; allowed: above 0")
        threshold = threshold * observer.summation.factor(frequency, area_m2)
    if duration_s is not None:
        if observer.temporal is None:
            raise OutputError(_without_law(observer, "durations", "duration_s", "temporal"))
        if not duration_s > 0:
            raise OutputError(f"duration_s is {duration_s}; allowed: above 0")
        threshold = threshold * observer.temporal.factor(frequency, duration_s)
    return threshold


def _without_law(observer: Observer, law: str, argument: str, field: str) -> str:
    summing = ", ".join(name for name, one in OBSERVERS.items() if getattr(one, field) is not None)
    return f"observer '{observer.name}' has no law for {law}: omit {argument}, or use {summing}"


def level_dB_SL(
    observer: Observer,
    frequencies: ArrayLike,
    peak_amplitudes_m: ArrayLike,
    area_m2: float | None = None,
    duration_s: float | None = None,
) -> float:
    """Return `levels_dB_SL` of one point, peak_amplitudes_m of shape (n,)."""
    amplitudes = np.asarray(peak_amplitudes_m, dtype=np.float64)
    return float(levels_dB_SL(observer, frequencies, amplitudes[..., None], area_m2, duration_s)[0])


def levels_dB_SL(
    observer: Observer,
    frequencies: ArrayLike,
    peak_amplitudes_m: ArrayLike,
    area_m2: float | None = None,
    duration_s: float | None = None,
) -> Float:
    """Return sensation levels 20 log10 sqrt(sum (A_i / T(f_i))^2) [dB], shape (m,); 0 dB is the threshold.

    The level is -inf without motion, and NaN for motion only outside the table of the observer or a NaN amplitude. The
    sum is over the lines of one channel, and the channel with the highest level is used. DC and lines outside the
    table are ignored. Pass lines (`line_amplitude`), not the bins of a windowed spectrum: a Hann window counts a line
    1.5 times.
    frequencies: frequencies of the lines [Hz], shape (n,); peak_amplitudes_m: peak amplitudes at m points [m], shape
    (n, m)
    area_m2, duration_s: as for `threshold_m`, with the same errors
    """
    frequency, amplitude = (np.asarray(one, dtype=np.float64) for one in (frequencies, peak_amplitudes_m))
    if frequency.ndim != 1 or amplitude.ndim != 2 or len(amplitude) != len(frequency):
        raise OutputError(
            f"frequencies have shape {frequency.shape} and amplitudes {amplitude.shape}; give (n,) and (n, m)"
        )
    threshold = threshold_m(observer, frequency, area_m2, duration_s)
    excess = np.where(np.isfinite(threshold)[:, None], amplitude / threshold[:, None], 0.0) ** 2
    channel = np.digitize(frequency, observer.channels_from_Hz)
    energies = [excess[channel == number].sum(axis=0) for number in range(len(observer.channels_from_Hz) + 1)]
    in_table = np.isfinite(threshold)
    outside = (np.abs(amplitude[(frequency > 0.0) & ~in_table]) > 0.0).any(axis=0)
    silent = ~(np.abs(amplitude[in_table]) > 0.0).any(axis=0)
    with np.errstate(divide="ignore"):
        levels = 10.0 * np.log10(np.max(energies, axis=0))
    return np.where(outside & silent | np.isnan(amplitude).any(axis=0), np.nan, levels)


def line_amplitude(time: ArrayLike, x: ArrayLike, f: float, periods: int | None = None) -> float:
    """Return `line_amplitudes` of one course, x of shape (n,)."""
    return float(line_amplitudes(time, np.asarray(x, dtype=np.float64)[..., None], f, periods)[0])


def line_amplitudes(time: ArrayLike, x: ArrayLike, f: float, periods: int | None = None) -> Float:
    """Return the peak amplitudes of the line at frequency f [Hz], shape (m,), in the unit of x.

    DC and one sine are fitted by least squares over whole periods at the end of the record.

    time: rising [s], shape (n,); x: courses, shape (n, m), in any unit
    periods: number of periods used, counted from the end; None for all
    Raises OutputError for f <= 0, a record shorter than the periods, fewer than 3 samples per period, times that are
    not finite, and courses of another length.
    """
    times = np.asarray(time, dtype=np.float64)
    if not 0 < f < np.inf:
        raise OutputError(f"frequency is {f} Hz; allowed: above 0")
    if not np.isfinite(times).all() or np.shape(x)[:1] != times.shape or np.ndim(x) != 2:
        raise OutputError(f"times of shape {times.shape} and courses of {np.shape(x)}: give finite (n,) and (n, m)")
    # A record of n samples covers n steps, so its length is one step more than from first to last sample.
    step = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 0.0
    whole = int(np.floor((times[-1] - times[0] + step) * f + 1e-6))
    used = whole if periods is None else periods
    if not 1 <= used <= whole or step * f > 1 / 3:
        raise OutputError(
            f"a fit at {f:g} Hz over {used} periods needs that many whole periods with 3 or more samples each; the "
            f"record holds {whole} with {step:.3g} s per sample: run for longer, or store more often"
        )
    first = int(np.searchsorted(times, times[-1] - used / f + 1e-6 * step, side="right"))
    phase = 2 * np.pi * f * (times[first:] - times[-1])
    fit = np.linalg.pinv(np.column_stack([np.ones(phase.size), np.cos(phase), np.sin(phase)]))[1:]
    courses = np.asarray(x)[first:]
    parts = np.zeros((2, courses.shape[1]))
    with one_blas_thread:
        for start in range(0, len(courses), BLOCK):
            rows = slice(start, start + BLOCK)
            parts += fit[:, rows] @ courses[rows].astype(np.float64)
    return np.asarray(np.hypot(*parts), dtype=np.float64)
