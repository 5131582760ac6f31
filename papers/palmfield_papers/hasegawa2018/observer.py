"""Rows H19 to H21: the thresholds that palmfield's observers predict for the stimulus of Hasegawa and Shinoda.

See configuration hasegawa.observer and [metrics.threshold] of tolerances.toml. A sinusoidal or square force with a
steady part acts on the palm; it is detected when an observer reaches 1. Outside the frequency range of an observer
there is no result.
"""

import math
from collections.abc import Callable
from functools import cache, partial

import numpy as np
from matplotlib.figure import Figure

from palmfield.outputs.style import COLOURS
from palmfield.perception import FORCE_OBSERVER, OBSERVERS, Observer, level_dB_SL, summed_gain, threshold_m
from palmfield_papers.answer import Answer, Cause, Compute, Picture, Setting
from palmfield_papers.entries import book
from palmfield_papers.hasegawa2018.focus import force
from palmfield_papers.hasegawa2018.palm_focus import JIG_M, MATERIALS, force_N, motion_m_per_N, moved_area_m2
from palmfield_papers.hasegawa2018.units import units_of

SINES_Hz = (5.0, 10.0, 20.0, 30.0, 50.0, 100.0, 200.0, 300.0, 500.0, 1000.0)
RECTANGLES_Hz = (10.0, 50.0, 100.0)
BEST_Hz, SLOW_Hz, SLOWEST_FELT_Hz = 200.0, 10.0, 60.0
FULL_N = 2e-3 * 9.80665
"""Force at 0 dB of Figure 14: 2 gf [N]."""
PRINTED_N = 0.4e-3
THIN_M = 0.004
"""Depth of a finger pulp [m]. It is the smallest depth to bone in the sources of this project."""
PLATE_M = 0.4
"""Base value of the reading `hasegawa_plate`."""
PERSONS_dB = 10.0
"""Half of the upper end of the printed spread of 15 to 20 dB. It is used as band of the threshold of one observer."""
NAMED = dict(zip(book().axes["observers"], ("afferent_human", "morioka_griffin_2006", "bolanowski_1988"), strict=True))
DEPTHS_M = dict(zip(book().axes["hasegawa_palm"], (0.01, 0.02), strict=True))
AS_PRINTED = book().axes["hasegawa_eq8"][0]
LOWER_BOUND = "The hand-grip table is that of a large contact, so that its threshold is a lower bound for a small spot."


def sine_N(observer: Observer, frequency_Hz: float, depth_m: float, material: str = "preset") -> float:
    """Return the peak amplitude of the sinusoidal force at threshold [N]; NaN outside the observer's range."""
    (motion,) = motion_m_per_N((frequency_Hz,), depth_m, material)
    return float(threshold_m(observer, frequency_Hz)) / motion


def rectangle_N(observer: Observer, frequency_Hz: float, depth_m: float, material: str = "preset") -> float:
    """Return half the height of a square-wave force at threshold [N].

    It is computed from the odd harmonics inside the frequency range of the observer. It is NaN without such a harmonic.
    """
    last = observer.frequency_Hz[-1]
    orders = np.arange(1, math.floor(last / frequency_Hz) + 1, 2)
    lines = frequency_Hz * orders
    inside = lines >= observer.frequency_Hz[0]
    if not inside.any():
        return math.nan
    motion = motion_m_per_N(tuple(lines[inside].tolist()), depth_m, material)
    level = level_dB_SL(observer, lines[inside], 4.0 / (math.pi * orders[inside]) * motion)
    return float(10.0 ** (-level / 20.0))


def relative_dB(force_N: float) -> float:
    """Return the level of a force re 2 gf [dB]."""
    return 20.0 * math.log10(force_N / FULL_N)


def _chosen(setting: Setting) -> tuple[Observer, float]:
    return OBSERVERS[NAMED[setting.reading("observers")]], DEPTHS_M[setting.reading("hasegawa_palm")]


@cache
def _error_dB(frequencies_Hz: tuple[float, ...], depth_m: float) -> float:
    """Return the largest change of a level if the reach and the wavenumbers of the motion are doubled."""
    coarse, fine = (motion_m_per_N(frequencies_Hz, depth_m, fine=fine) for fine in (False, True))
    return float(np.abs(20.0 * np.log10(coarse / fine)).max())


def _inside(observer: Observer) -> tuple[float, ...]:
    return tuple(f for f in SINES_Hz if observer.frequency_Hz[0] <= f <= observer.frequency_Hz[-1])


def best_frequency(setting: Setting) -> Answer:
    """Return the answer of entry H19-H21a.

    The margin is the additional level that both neighbours of 200 Hz need, or the negative one of 200 Hz.
    """
    observer, depth = _chosen(setting)
    frequencies = _inside(observer)
    levels = [relative_dB(sine_N(observer, f, depth)) for f in frequencies]
    best = int(np.argmin(levels))
    own = frequencies.index(BEST_Hz)
    neighbours = [levels[i] - levels[own] for i in (own - 1, own + 1) if 0 <= i < len(levels)]
    margin = min(neighbours) if best == own else levels[best] - levels[own]
    return Answer(
        frequencies[best],
        error=0.0,
        margin=margin,
        note=f"Margin in dB, with an error of {_error_dB(frequencies, depth):.1g} dB, by twice the reach and "
        f"the wavenumbers; tested frequencies inside the table: {', '.join(f'{f:g}' for f in frequencies)} Hz. "
        f"{_described(observer)}",
        shown={f"at {f:g} Hz, dB re 2 gf": round(level, 2) for f, level in zip(frequencies, levels, strict=True)},
    )


def threshold_level(setting: Setting) -> Answer:
    """Return the answer of entry H19-H21b."""
    observer, depth = _chosen(setting)
    peak_to_peak = setting.reading("hasegawa_eq8") != AS_PRINTED
    own = sine_N(observer, BEST_Hz, depth)
    ends = [_eq8(relative_dB(sine_N(observer, BEST_Hz, depth, material)), peak_to_peak) for material in MATERIALS[1:]]
    (motion,) = motion_m_per_N((BEST_Hz,), depth)
    printed_N = PRINTED_N / 2.0 if peak_to_peak else PRINTED_N
    shown = {f"threshold by {name}, mN": sine_N(one, BEST_Hz, depth) * 1e3 for name, one in OBSERVERS.items()}
    shown |= {
        f"level of the printed force by {name}, dB SL": level_dB_SL(one, [BEST_Hz], [printed_N * motion])
        for name, one in OBSERVERS.items()
    }
    shown |= {
        f"threshold by {FORCE_OBSERVER.name}, which is this paper's own, mN": FORCE_OBSERVER.threshold_N * 1e3,
        "by the softest palm, dB": ends[0],
        "by the stiffest palm, dB": ends[1],
    }
    return Answer(
        _eq8(relative_dB(own), peak_to_peak),
        error=_error_dB((BEST_Hz,), depth),
        band=(min(ends) - PERSONS_dB, max(ends) + PERSONS_dB),
        note="Force on 12 x 12 mm. The band is that of the stiffness of the palm and of persons, printed as 15 to "
        f"20 dB. {_described(observer)}",
        shown={name: round(float(value), 4) for name, value in shown.items()},
    )


def _by_stiff_palm(setting: Setting) -> Answer:
    observer, depth = _chosen(setting)
    return _other(sine_N(observer, BEST_Hz, depth, "stiffest"), setting)


def _by_thin_palm(setting: Setting) -> Answer:
    return _other(sine_N(_chosen(setting)[0], BEST_Hz, THIN_M), setting)


def _by_all_force(setting: Setting) -> Answer:
    observer, depth = _chosen(setting)
    share = force_N(JIG_M) / force_N(PLATE_M)
    return _other(
        sine_N(observer, BEST_Hz, depth) / share,
        setting,
        f"{share:.2f} of the force on {PLATE_M:g} m lie on 12 x 12 mm.",
    )


def _by_small_area(setting: Setting) -> Answer:
    """Apply the ratio of Bolanowski's area law to the observer of the setting."""
    observer, depth = _chosen(setting)
    summing = OBSERVERS["bolanowski_1988"]
    area = moved_area_m2(BEST_Hz, depth)
    factor = float(threshold_m(summing, BEST_Hz, area) / threshold_m(summing, BEST_Hz))
    return _other(
        sine_N(observer, BEST_Hz, depth) * factor,
        setting,
        f"The motion exceeds half of its largest on {1e4 * area:.2f} cm2, against a contactor of 2.9 cm2.",
    )


def _by_window(setting: Setting) -> Answer:
    """Apply temporal summation to the sine in its Hann window. The law is that of an observer with summation."""
    observer, depth = _chosen(setting)
    temporal = OBSERVERS["bolanowski_1988"].temporal
    assert temporal is not None
    step = 1e-4
    envelope = np.tile(np.hanning(round(1.0 / step)), 2)
    gain = summed_gain(envelope, step, temporal.tau_s)
    return _other(sine_N(observer, BEST_Hz, depth) / gain, setting, f"Energy summed over {temporal.tau_s:g} s.")


def _other(force_N: float, setting: Setting, note: str = "") -> Answer:
    peak_to_peak = setting.reading("hasegawa_eq8") != AS_PRINTED
    return Answer(_eq8(relative_dB(force_N), peak_to_peak), note=note)


def _eq8(level_dB: float, peak_to_peak: bool) -> float:
    """Return the answer for eq. 8. With its factor 1/2, the printed 0.4 mN is peak to peak, as the compared value."""
    return level_dB + (20.0 * math.log10(2.0) if peak_to_peak else 0.0)


def rectangle_against_sine(setting: Setting) -> Answer:
    """Return the answer of entry H19-H21e: the threshold of a square wave relative to that of a sine."""
    observer, depth = _chosen(setting)
    if math.isnan(sine_N(observer, SLOW_Hz, depth)):
        return Answer(None, note=f"{observer.name} has no threshold at {SLOW_Hz:g} Hz.")

    def relative(material: str) -> float:
        ratio = rectangle_N(observer, SLOW_Hz, depth, material) / sine_N(observer, SLOW_Hz, depth, material)
        return 20.0 * math.log10(ratio)

    levels = [relative(material) for material in MATERIALS]
    lines = tuple(np.arange(SLOW_Hz, observer.frequency_Hz[-1] + 1e-9, 2.0 * SLOW_Hz).tolist())
    return Answer(
        levels[0],
        error=_error_dB(lines, depth),
        band=(min(levels), max(levels)),
        note=f"{len(lines)} harmonics lie inside the table, up to {lines[-1]:g} Hz; the amplitude of a rectangle is "
        f"half its height. The band is that of the palm's stiffness. {_described(observer)}",
        shown={
            f"rectangle at {f:g} Hz, dB re 2 gf": round(relative_dB(rectangle_N(observer, f, depth)), 2)
            for f in RECTANGLES_Hz
        },
    )


def one_unit_slow(setting: Setting, *, lower_dB: float = 0.0) -> Answer:
    """Return the answer of entry H19-H21p. lower_dB: reduction of the level, for causes"""
    observer, depth = _chosen(setting)
    slow = [f for f in _inside(observer) if f < SLOWEST_FELT_Hz]
    if not slow:
        return Answer(None, note=f"{observer.name} has no threshold below {SLOWEST_FELT_Hz:g} Hz.")
    four, one = (force(units_of(setting, count), JIG_M, device=setting.device) for count in (4, 1))
    share = 20.0 * math.log10(one[0] / four[0])
    error = 20.0 / math.log(10.0) * sum(abs(of - coarse) / of for of, coarse in (four, one)) / 3.0
    levels = {f: share - relative_dB(sine_N(observer, f, depth)) - lower_dB for f in slow}
    value = max(levels.values())
    return Answer(
        value, error + _error_dB(tuple(slow), depth), (value - PERSONS_dB, value + PERSONS_dB), margin=-value,
        note=f"One unit has {share:.1f} dB of the force of four. The band is that of persons. {_described(observer)}",
        shown={f"one unit at {f:g} Hz, dB SL": level for f, level in levels.items()}
        | {f"four units at {f:g} Hz, dB SL": level - share for f, level in levels.items()},
    )  # fmt: skip


def _described(observer: Observer) -> str:
    return LOWER_BOUND if observer.name == "morioka_griffin_2006" else ""


def _no_value(reason: str) -> Compute:
    return lambda setting: Answer(None, note=reason)


def _lowest_level(setting: Setting) -> Answer:
    """Return the answer of entry H19-H21k: the printed value of beta."""
    return Answer(
        20.0 * math.log10(0.02), error=0.0, note="20 log10(0.02); section 7 prints -35 dB.", shown={"as printed": -35.0}
    )


def _meaning(setting: Setting) -> Answer:
    """Return the answer of entry H19-H21l.

    It is the level of the printed force in both of its meanings, for the observer of this paper.
    """
    return Answer(
        None,
        note="Words: an amplitude of 0.4 mN as printed, one of 0.2 mN with the factor 1/2 that eq. 8 lacks. Row "
        "H19-H21b is answered under both.",
        shown={"amplitude as printed, mN": 0.4, "amplitude as corrected, mN": 0.2},
    )


ANSWERS: dict[str, Compute] = {
    "H19-H21a": best_frequency,
    "H19-H21b": threshold_level,
    "H19-H21e": rectangle_against_sine,
    "H19-H21k": _lowest_level,
    "H19-H21l": _meaning,
    "H19-H21m": _no_value("An observer stands for one person, and one of the tables begins above 5 Hz."),
    "H19-H21n": _no_value("The observers' tables end at 315, 350 and 500 Hz."),
    "H19-H21p": one_unit_slow,
}

CAUSES: dict[str, tuple[Cause, ...]] = {
    "H19-H21b": (
        Cause("The palm is as stiff as the preset's range allows (times 1.67).", _by_stiff_palm),
        Cause("The bone lies 4 mm below the skin instead of 10.", _by_thin_palm),
        Cause("The printed force is that on a plate of 0.4 m, not on 12 x 12 mm.", _by_all_force),
        Cause(
            "The skin moves on less than the contactor's area, by the law for areas of the Pacinian channel.",
            _by_small_area,
        ),
        Cause("The sine lasts under a Hann window of 1 s, and energy is summed over time.", _by_window),
    ),
    "H19-H21p": (
        Cause(
            "The strongest sine has half the force of the unit (the 1/2 that eq. 8 lacks).",
            partial(one_unit_slow, lower_dB=20.0 * math.log10(2.0)),
        ),
        Cause(
            "A person whose threshold lies 10 dB higher, the spread that is printed.",
            partial(one_unit_slow, lower_dB=PERSONS_dB),
        ),
    ),
}


def _sines(setting: Setting) -> Figure:
    """Draw the upper part of Figure 14, for sines."""
    return _curves(SINES_Hz, sine_N, "sine")


def _rectangles(setting: Setting) -> Figure:
    """Draw the lower part of Figure 14, for square waves."""
    return _curves(RECTANGLES_Hz, rectangle_N, "rectangle")


def _curves(frequencies_Hz: tuple[float, ...], threshold_N: Callable[..., float], waveform: str) -> Figure:
    figure = Figure(figsize=(5.6, 3.6), layout="constrained")
    axes = figure.subplots()
    depth = next(iter(DEPTHS_M.values()))
    for colour, name in zip(COLOURS, NAMED.values(), strict=True):
        observer = OBSERVERS[name]
        inside = [f for f in frequencies_Hz if f in _inside(observer)]
        levels = [relative_dB(threshold_N(observer, f, depth)) for f in inside]
        ends = [[relative_dB(threshold_N(observer, f, depth, which)) for f in inside] for which in MATERIALS[1:]]
        axes.fill_between(inside, np.min(ends, axis=0), np.max(ends, axis=0), color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(inside, levels, "o-", color=colour, markersize=4, label=name)
    if waveform == "sine":
        axes.plot(BEST_Hz, relative_dB(PRINTED_N), "k*", markersize=9, label="paper, as printed")
        axes.plot(BEST_Hz, relative_dB(PRINTED_N / 2.0), "k*", markersize=9, fillstyle="none", label="with eq. 8's 1/2")
    axes.axhline(0.0, color="#777777", linewidth=0.8, linestyle="--")
    axes.text(frequencies_Hz[-1], 1.0, "0 dB: 2 gf, all that the device gives", color="#555555", fontsize=7, ha="right")
    axes.set_xscale("log")
    axes.set_xticks(frequencies_Hz, [f"{f:g}" for f in frequencies_Hz])
    axes.minorticks_off()
    axes.set_xlim(0.85 * frequencies_Hz[0], 1.18 * frequencies_Hz[-1])
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("threshold of the force\n[dB re 2 gf]")
    axes.set_title(f"Detection of a {waveform} on half the largest force")
    axes.legend(fontsize=7, loc="upper right", bbox_to_anchor=(1.0, 0.86))
    return figure


PICTURES: tuple[Picture, ...] = (
    Picture(
        "thresholds_sine",
        "Thresholds of a sinusoidal force on the palm by three contact observers, inside their tables; bands: the "
        "stiffness of the palm. The hand-grip table (morioka_griffin_2006) is a lower bound for a small spot. The "
        "paper has its curve only in a figure, so only its one printed value is shown.",
        _sines,
    ),
    Picture(
        "thresholds_rectangle",
        "The same for a square wave, with all its harmonics inside the table; the amplitude is half its height.",
        _rectangles,
    ),
)
