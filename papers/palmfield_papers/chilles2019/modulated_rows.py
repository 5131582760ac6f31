"""Rows C17 to C21: the modulated focus, and the focus on a circle."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from palmfield.metrics import area_above, harmonics, peak_to_peak, rms, strongest_line, within
from palmfield.skin import shear_wave
from palmfield_papers.answer import Answer, Cause, Compute, Setting
from palmfield_papers.chilles2019.maps import Circles, Map, grid_axis, measured_circles, measured_map
from palmfield_papers.chilles2019.setup import (
    AM_HZ,
    CIRCLE_HZ,
    CIRCLE_RADIUS_M,
    Case,
    Probe,
    Stimulus,
    case_of,
    course,
    material_of,
    probe_of,
    reading,
)
from palmfield_papers.chilles2019.step_rows import LEVEL, banded, step_peak
from palmfield_papers.chilles2019.traces import Trace, fem_window, measured, measured_window, raw

STEP_PEAK_UM = -1.02
"""Measured value of Table I. The gain of configuration chilles.measured_gain is fitted to it."""
SHARE = 0.01
FAR_AM_M, FAR_STM_M = 0.0255, 0.02
FEM_STIMULI: dict[str, Stimulus] = {"am": "am_load", "stm": "stm"}
MEASURED_STIMULI: dict[str, Stimulus] = {"am": "am_pressure", "stm": "stm"}


def gain(case: Case, probe: Probe) -> float:
    """Return the factor on the load with which the step has the measured peak, with the same filter (row C10)."""
    return STEP_PEAK_UM / step_peak(case, probe)


def gained(case: Case, stimulus: Stimulus, probe: Probe) -> Trace:
    trace, factor = measured(case, stimulus, probe), gain(case, probe)
    return replace(trace, values=factor * trace.values, error=factor * trace.error)


def fem_trace(case: Case, kind: str, setting: Setting) -> tuple[Trace, tuple[float, float] | None]:
    stimulus = FEM_STIMULI[kind]
    return raw(case, stimulus), fem_window(reading(setting, "chilles_window_fem"), stimulus)


def measured_trace(case: Case, kind: str, setting: Setting) -> tuple[Trace, tuple[float, float] | None]:
    stimulus = MEASURED_STIMULI[kind]
    return gained(case, stimulus, probe_of(setting)), measured_window(reading(setting, "chilles_window"), stimulus)


Source = Callable[[Case, str, Setting], tuple[Trace, tuple[float, float] | None]]


def size(kind: str, source: Source, number: str) -> Compute:
    """Return peak to peak or rms of a stimulus, in the window of the reading."""

    def compute(setting: Setting) -> Answer:
        def value(case: Case) -> float:
            trace, window = source(case, kind, setting)
            if number == "p-p":
                return peak_to_peak(trace.times_s, trace.values, window)
            removed = reading(setting, "chilles_mean") == "mean removed"
            return rms(trace.times_s, trace.values, window, mean="removed" if removed else "kept")

        case = case_of(setting)
        error = source(case, kind, setting)[0].error
        shown = {}
        if source is measured_trace:
            shown = {
                "gain fitted on the step": gain(case, probe_of(setting)),
                "at 12 Pa": value(case) / gain(case, probe_of(setting)),
            }
        return Answer(
            value(case), (2.0 if number == "p-p" else 1.0) * error, banded(setting, case, value),
            note="error: the solver's difference from a finer run, and the vibrometer's sampling", shown=shown,
        )  # fmt: skip

    return compute


def highest(kind: str, inwards: bool) -> Compute:
    """Return the largest outward displacement. It is compared with a hundredth of the peak-to-peak value."""

    def compute(setting: Setting) -> Answer:
        def both(case: Case) -> tuple[float, float]:
            trace, window = fem_trace(case, kind, setting)
            values = within(trace.times_s, trace.values, window)[1]
            return float(values.max()), SHARE * float(np.ptp(values))

        case = case_of(setting)
        value, allowed = both(case)
        return Answer(
            value, fem_trace(case, kind, setting)[0].error, banded(setting, case, lambda one: both(one)[0]),
            margin=allowed - value if inwards else value - allowed,
            note=f"a hundredth of the peak-to-peak value is {allowed:.2g} um",
        )  # fmt: skip

    return compute


def loudest_radius(setting: Setting) -> Answer:
    """Return the radius at which the mean over the angle of the rms map under the moving spot is largest."""
    probe = probe_of(setting)

    def value(case: Case) -> float:
        return 1e3 * loudest_of(measured_circles(case, probe))

    case = case_of(setting)
    return Answer(value(case), 0.5, _map_band(setting, case, value), note="error: half of the grid of 1 mm")


def loudest_of(circles: Circles) -> float:
    """Return the radius of the largest angular mean on a grid of 1 mm [m], linear between circles."""
    radii = np.concatenate([[0.0], circles.radii_m])
    means = np.concatenate([[circles.middle], circles.values.mean(axis=1)])
    grid = 1e-3 * np.arange(0, 60)
    return float(grid[np.interp(grid, radii, means).argmax()])


def _map_band(setting: Setting, case: Case, value: Callable[[Case], float]) -> tuple[float, float] | None:
    """Return the band only for base readings in full runs, because maps of the moving spot take longest."""
    return None if setting.quick or case != Case(device=case.device) else banded(setting, case, value)


def far_over_middle(one: Map) -> float:
    """Return the largest value beyond 25.5 mm, divided by the value in the centre."""
    radius = np.hypot(*np.meshgrid(one.axis_m, one.axis_m, indexing="ij"))
    middle = len(one.axis_m) // 2
    return float(one.values[radius > FAR_AM_M].max() / one.values[middle, middle])


def far_am(setting: Setting) -> Answer:
    probe = probe_of(setting)

    def value(case: Case) -> float:
        return far_over_middle(measured_map(case, "am_pressure", probe))

    case = case_of(setting)
    ours, error = value(case), measured_map(case, "am_pressure", probe).error
    return Answer(ours, 2.0 * error * ours, banded(setting, case, value), margin=0.5 - ours)


def far_over_circle(circles: Circles) -> float:
    """Return the largest rms on circles beyond 20 mm, divided by the mean on the circle of 10 mm."""
    on_path = int(np.argmin(np.abs(circles.radii_m - CIRCLE_RADIUS_M)))
    return float(circles.values[circles.radii_m > FAR_STM_M + 1e-6].max() / circles.values[on_path].mean())


def far_stm(setting: Setting) -> Answer:
    probe = probe_of(setting)

    def value(case: Case) -> float:
        return far_over_circle(measured_circles(case, probe))

    case = case_of(setting)
    circles = measured_circles(case, probe)
    ours = value(case)
    on_path = circles.values[int(np.argmin(np.abs(circles.radii_m - CIRCLE_RADIUS_M)))]
    shown = {"least on the path over its mean": float(on_path.min() / on_path.mean())}
    note = "the rms at 10 mm is the mean over the angle"
    return Answer(ours, 2.0 * circles.error * ours, _map_band(setting, case, value), 1.0 - ours, note, shown)


def am_over_held(setting: Setting) -> Answer:
    """Return the rms under AM divided by that of the stationary focus, both through the vibrometer.

    Both use the same window.
    """
    removed = reading(setting, "chilles_mean") == "mean removed"
    probe = probe_of(setting)

    def one(case: Case, stimulus: Stimulus, probe: Probe) -> float:
        trace = measured(case, stimulus, probe)
        window = measured_window(reading(setting, "chilles_window"), "am_pressure")
        return rms(trace.times_s, trace.values, window, mean="removed" if removed else "kept")

    def value(case: Case) -> float:
        return one(case, "am_pressure", probe) / one(case, "step", probe)

    case = case_of(setting)
    ours = value(case)
    error = ours * sum(
        measured(case, stimulus, probe).error / one(case, stimulus, probe) for stimulus in ("am_pressure", "step")
    )
    plain = replace(probe, highpass=False)
    shown = {"without the high-pass": one(case, "am_pressure", plain) / one(case, "step", plain)}
    return Answer(ours, error, banded(setting, case, value), ours - 1.0 - 1e-9, shown=shown)


def area_of(one: Map) -> float:
    """Return the area in which a map exceeds 20 % of its maximum [m2]."""
    return area_above(one.values, one.axis_m, one.axis_m, LEVEL * float(one.values.max()))


def as_map(circles: Circles) -> Map:
    """Interpolate on a grid of 1 mm, linearly between circles and angles. The map is 0 outside the disc."""
    axis = grid_axis()
    x, y = np.meshgrid(axis, axis, indexing="ij")
    steps = 2.0 * np.pi / circles.values.shape[1] * np.arange(circles.values.shape[1] + 1)
    inner = np.full((1, len(steps)), circles.middle)
    values = np.vstack([inner, np.column_stack([circles.values, circles.values[:, 0]])])
    radii = np.concatenate([[0.0], circles.radii_m])
    lines = RegularGridInterpolator((radii, steps), values, bounds_error=False, fill_value=0.0)
    return Map(axis, lines((np.hypot(x, y), np.arctan2(y, x) % (2.0 * np.pi))), circles.error)


def stm_over_am_area(setting: Setting) -> Answer:
    """Return the area under STM divided by that under AM."""
    probe = probe_of(setting)

    def areas(case: Case) -> tuple[float, float]:
        return area_of(as_map(measured_circles(case, probe))), area_of(measured_map(case, "am_pressure", probe))

    moving, fixed = areas(case_of(setting))
    shown = {"STM [cm2]": 1e4 * moving, "AM [cm2]": 1e4 * fixed}
    return Answer(moving / fixed, margin=moving / fixed - 1.0 - 1e-9, shown=shown)


def load_ratio(setting: Setting) -> Answer:
    times = np.arange(4000) / 80e3
    lines = harmonics(times, course("am_pressure", times), AM_HZ, 2)
    return Answer(float(lines[1] / lines[0]), 0.0, note="lines of the load that the run is given")


def am_lines(setting: Setting) -> Answer:
    """Return the spectral lines at 200 and 400 Hz over the last periods, with the pressure modulated."""
    trace = measured(case_of(setting), "am_pressure", probe_of(setting))
    window = measured_window("last five periods of the stimulus", "am_pressure")
    times, values = within(trace.times_s, trace.values, window)
    first, second = harmonics(times, values, AM_HZ, 2)
    return Answer(
        strongest_line(times, values, (10.0, 2000.0))[0], 0.0,
        shown={"amplitude at 200 Hz, um": float(first), "amplitude at 400 Hz, um": float(second)},
    )  # fmt: skip


def linear_harmonic(setting: Setting) -> Answer:
    trace, window = fem_trace(
        case_of(setting), "am", replace(setting, readings=(("chilles_window_fem", "last five periods"),))
    )
    times, values = within(trace.times_s, trace.values, window)
    return Answer(float(harmonics(times, values, AM_HZ, 2)[1]), trace.error, note="amplitude of the line at 400 Hz")


def circle_line(number: int) -> Compute:
    """Return the frequency of a harmonic of the circle, with its amplitude in the raw motion."""

    def compute(setting: Setting) -> Answer:
        trace = raw(case_of(setting), "stm")
        times, values = within(trace.times_s, trace.values, fem_window("last five periods", "stm"))
        lines = harmonics(times, values, CIRCLE_HZ, 6)
        shown = {"amplitude over that at 70 Hz": float(lines[number - 1] / lines[0])}
        return Answer(number * CIRCLE_HZ, 0.0, note="a periodic load has no other lines", shown=shown)

    return compute


def least_rms(setting: Setting) -> Answer:
    """Return the rms of -A (1 + sin), whose maximum is 0, with a peak-to-peak value of 2.19 um."""
    times = np.arange(4000) / 80e3
    wave = -0.5 * 2.19 * (1.0 + np.sin(2.0 * np.pi * AM_HZ * times))
    return Answer(rms(times, wave), 0.0, note="so the mean was subtracted from the printed rms, at least in part")


def circle_mach(setting: Setting) -> Answer:
    speed = 2.0 * np.pi * CIRCLE_RADIUS_M * CIRCLE_HZ
    material = material_of(case_of(setting).material)
    relaxed = float(np.sqrt(material.shear_relaxed_Pa / material.density_kg_m3))
    shown = {"with the shear speed at 70 Hz": speed / shear_wave(material, CIRCLE_HZ)[0]}
    return Answer(speed / relaxed, 0.0, note="speed on the circle over the relaxed shear speed", shown=shown)


ANSWERS: dict[str, Compute] = {
    "C17a": highest("am", inwards=True),
    "C17b": linear_harmonic,
    "C18a": am_lines,
    "C18c": load_ratio,
    "C19a": size("am", measured_trace, "p-p"),
    "C19b": size("am", fem_trace, "p-p"),
    "C19c": size("am", measured_trace, "rms"),
    "C19d": size("am", fem_trace, "rms"),
    "C19e": least_rms,
    "C19f": am_over_held,
    "C20a": size("stm", measured_trace, "p-p"),
    "C20b": size("stm", fem_trace, "p-p"),
    "C20c": size("stm", measured_trace, "rms"),
    "C20d": size("stm", fem_trace, "rms"),
    "C20e": circle_line(2),
    "C20f": circle_line(3),
    "C20g": circle_line(4),
    "C20h": highest("stm", inwards=False),
    "C20i": circle_mach,
    "C21a": loudest_radius,
    "C21b": far_am,
    "C21c": far_stm,
    "C21d": stm_over_am_area,
}


def with_case(answer: Callable[[Case], Answer], change: Callable[[Case], Case], *, full: bool = False) -> Compute:
    """Return the answer with another case. full: whether to compute it only in full runs, because it takes minutes"""

    def compute(setting: Setting) -> Answer:
        if full and setting.quick:
            return Answer(None, note="in full runs only: it takes minutes")
        return answer(change(case_of(setting)))

    return compute


def _rises(case: Case) -> Answer:
    trace = raw(case, "stm")
    value = float(trace.values.max())
    return Answer(value, trace.error, margin=value - SHARE * float(np.ptp(trace.values)))


def _lossless(case: Case) -> Case:
    return replace(case, material="tau_printed")


def _far_am(case: Case) -> Answer:
    value = far_over_middle(measured_map(case, "am_pressure", Probe()))
    return Answer(value, margin=0.5 - value)


def _far_stm(case: Case) -> Answer:
    value = far_over_circle(measured_circles(case, Probe()))
    return Answer(value, margin=1.0 - value)


def _wide(case: Case) -> Case:
    return replace(case, circle_m=0.025)


def _loudest(case: Case) -> Answer:
    return Answer(1e3 * loudest_of(measured_circles(case, Probe())))


WIDE = "the spot on a circle of 25 mm in place of 10"
LATER = {
    "C20h": (
        Cause("a slab of a thousandth of the density, which is nearly static",
              with_case(_rises, lambda case: replace(case, material="massless"), full=True)),
    ),
    "C21a": (Cause(WIDE, with_case(_loudest, _wide, full=True)),),
    "C21b": (Cause("tau as printed, 0.171 us: next to no damping", with_case(_far_am, _lossless, full=True)),),
    "C21c": (
        Cause("tau as printed, 0.171 us: next to no damping", with_case(_far_stm, _lossless, full=True)),
        Cause(WIDE, with_case(_far_stm, _wide, full=True)),
    ),
}  # fmt: skip
