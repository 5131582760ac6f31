"""Rows C14 to C16: the stationary focus."""

from collections.abc import Callable

from palmfield.errors import MeasurementError
from palmfield.metrics import peak, settling_time, spot_diameter, steady_value, strongest_line
from palmfield_papers.answer import Answer, Compute, Setting
from palmfield_papers.chilles2019.maps import STEADY_S, Map, measured_map, raw_profile, round_map
from palmfield_papers.chilles2019.setup import (
    STARTS,
    STIMULUS_S,
    Case,
    Probe,
    Stimulus,
    at_base,
    case_of,
    ends,
    probe_of,
    reading,
)
from palmfield_papers.chilles2019.traces import Trace, measured, raw

STEP_RECORD_S = (0.0, STIMULUS_S)
BANDS = (0.02, 0.05, 0.1)
LEVEL = 0.2
LINES_HZ = (10.0, 2000.0)
DOMINANT_HZ = (100.0, 500.0)


def banded(setting: Setting, case: Case, value: Callable[[Case], float]) -> tuple[float, float] | None:
    """Return the smallest and the largest value with moduli at their ends. In quick runs only for base readings."""
    if setting.control or (setting.quick and not at_base(setting)):
        return None
    found = [value(one) for one in (case, *ends(case))]
    return min(found), max(found)


def start_of(setting: Setting) -> Stimulus:
    return STARTS[reading(setting, "chilles_start")]


def steady_of(trace: Trace) -> float:
    return steady_value(trace.times_s, trace.values, STEADY_S)


def peak_of(trace: Trace) -> float:
    """Return the largest inward displacement, negative."""
    return peak(trace.times_s, trace.values, STEP_RECORD_S, of="negative")[1]


def step_peak(case: Case, probe: Probe, start: Stimulus = "step") -> float:
    """Return the peak of the step through the vibrometer [um]."""
    return peak_of(measured(case, start, probe))


def traced(number: Callable[[Trace], float], through_vibrometer: bool) -> Compute:
    """Return the answer function for a number of the trace of the step."""

    def compute(setting: Setting) -> Answer:
        def trace(case: Case) -> Trace:
            start = start_of(setting)
            return measured(case, start, probe_of(setting)) if through_vibrometer else raw(case, start)

        case = case_of(setting)
        found = trace(case)
        band = banded(setting, case, lambda one: number(trace(one)))
        return Answer(number(found), found.error, band, note=_NOTE)

    return compute


_NOTE = "error: the solver's difference from a finer run, and the vibrometer's sampling"


def settling(through_vibrometer: bool) -> Compute:
    """Return the time until the trace stays in a band about the steady value, for each band of the metric."""

    def compute(setting: Setting) -> Answer:
        case, start = case_of(setting), start_of(setting)
        trace = measured(case, start, probe_of(setting)) if through_vibrometer else raw(case, start)
        steady = steady_of(trace)
        shown = {}
        for band in BANDS:
            try:
                found = settling_time(trace.times_s, trace.values, steady, band, end_s=STIMULUS_S)
                shown[f"band of {100 * band:g} %"] = 1e3 * found
            except MeasurementError:
                continue
        middle = shown.get("band of 5 %")
        note = "band of 5 %; others are shown"
        if middle is None:
            note = f"the filter leaves {steady:.2g} um of the steady value: the motion stays in no band about it"
        return Answer(middle, None, note=note, shown=shown)

    return compute


def diameter_of(one: Map) -> float:
    return 1e3 * spot_diameter(one.values, one.axis_m, one.axis_m, LEVEL)


def diameter_error(one: Map) -> float:
    """Return the change of the diameter [mm] due to errors of the map at the level and at the peak."""
    more, less = (
        1e3 * spot_diameter(one.values, one.axis_m, one.axis_m, LEVEL * (1.0 + sign * 2.0 * one.error))
        for sign in (1, -1)
    )
    return abs(more - less) / 2.0


def diameter(through_vibrometer: bool) -> Compute:
    """Return the diameter in which the map of the step exceeds 20 % of its peak."""

    def compute(setting: Setting) -> Answer:
        def map_of(case: Case) -> Map:
            if through_vibrometer:
                return measured_map(case, "step", probe_of(setting))
            return round_map(*raw_profile(case, start_of(setting), reading(setting, "chilles_diameter_map")))

        case = case_of(setting)
        found = map_of(case)
        try:
            value = diameter_of(found)
        except MeasurementError as reason:
            return Answer(None, note=str(reason))
        note = "error: the solver's, carried to the level"
        try:
            band = banded(setting, case, lambda one: diameter_of(map_of(one)))
        except MeasurementError as reason:
            band, note = None, f"{note}; no band: with the moduli at an end, {reason}"
        return Answer(value, diameter_error(found), band, note=note)

    return compute


def dominant(setting: Setting) -> Answer:
    """Return the largest line of the spectrum of the step in the centre, through the vibrometer."""

    def line(case: Case) -> float:
        trace = measured(case, "step", probe_of(setting))
        return strongest_line(trace.times_s, trace.values, LINES_HZ)[0]

    case = case_of(setting)
    value = line(case)
    margin = min(value - DOMINANT_HZ[0], DOMINANT_HZ[1] - value)
    spacing = 1.0 / 0.256
    return Answer(value, 0.5 * spacing, banded(setting, case, line), margin, f"lines are {spacing:.2g} Hz apart")


def carrier(setting: Setting) -> Answer:
    return Answer(None, note="the load is a pressure averaged over the carrier: the model has no motion at 40 kHz")


def filtered_steady(setting: Setting) -> Answer:
    case = case_of(setting)
    trace = measured(case, "step", probe_of(setting))
    plain = measured(case, "step", Probe(highpass=False))
    return Answer(
        steady_of(trace),
        trace.error,
        note="a high-pass on the velocity forces its integral back to 0: the printed value is from another chain",
        shown={"without the filter": steady_of(plain)},
    )


def printed_diameter(setting: Setting) -> Answer:
    found = measured_map(case_of(setting), "step", probe_of(setting))
    return Answer(diameter_of(found), diameter_error(found), note="Table I prints 25.2 mm, the text 25.5 mm")


ANSWERS: dict[str, Compute] = {
    "C6m": filtered_steady,
    "C14a": traced(steady_of, True),
    "C14b": settling(True),
    "C14c": traced(peak_of, True),
    "C14d": diameter(True),
    "C14e": printed_diameter,
    "C15a": traced(steady_of, False),
    "C15b": settling(False),
    "C15c": traced(peak_of, False),
    "C15d": diameter(False),
    "C16a": dominant,
    "C16b": carrier,
}
