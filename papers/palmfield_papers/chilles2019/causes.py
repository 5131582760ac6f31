"""Possible reasons for claims that disagree, each tested separately."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from palmfield.metrics import peak_to_peak, rms, strongest_line
from palmfield_papers.answer import Answer, Cause, Compute, Setting
from palmfield_papers.chilles2019.modulated_rows import MEASURED_STIMULI, STEP_PEAK_UM, gained
from palmfield_papers.chilles2019.setup import Case, Probe, case_of, probe_of, reading
from palmfield_papers.chilles2019.step_rows import DOMINANT_HZ, LINES_HZ, peak_of, steady_of
from palmfield_papers.chilles2019.traces import Trace, measured, measured_window, raw

ONSET_S = 0.03


def steady_without_filter(setting: Setting) -> Answer:
    trace = measured(case_of(setting), "step", replace(probe_of(setting), highpass=False))
    return Answer(steady_of(trace), trace.error)


def steady_with_gain(setting: Setting) -> Answer:
    trace = measured(case_of(setting), "step", replace(probe_of(setting), highpass=False))
    factor = STEP_PEAK_UM / peak_of(trace)
    return Answer(factor * steady_of(trace), factor * trace.error, note=f"gain {factor:.3g}")


def steady_of_stiff(setting: Setting) -> Answer:
    trace = measured(replace(case_of(setting), material="stiff"), "step", replace(probe_of(setting), highpass=False))
    return Answer(steady_of(trace), trace.error)


def line_of(trace: Trace) -> Answer:
    """Return the largest line of a trace, compared with the range of row C16."""
    value = strongest_line(trace.times_s, trace.values, LINES_HZ)[0]
    spacing = 1.0 / (trace.times_s[-1] - trace.times_s[0])
    return Answer(value, 0.5 * spacing, margin=min(value - DOMINANT_HZ[0], DOMINANT_HZ[1] - value))


def line_of_velocity(setting: Setting) -> Answer:
    trace = measured(case_of(setting), "step", probe_of(setting))
    return line_of(replace(trace, values=np.gradient(trace.values, trace.times_s)))


def line_of_onset(setting: Setting) -> Answer:
    return line_of(measured(case_of(setting), "step", probe_of(setting)).until(ONSET_S))


def line_in(change: Callable[[Case], Case], probe: Callable[[Probe], Probe] = lambda one: one) -> Compute:
    def compute(setting: Setting) -> Answer:
        return line_of(measured(change(case_of(setting)), "step", probe(probe_of(setting))))

    return compute


def line_of_raw(setting: Setting) -> Answer:
    return line_of(raw(case_of(setting), "step"))


def size_with(
    kind: str,
    number: Callable[..., float],
    case: Callable[[Case], Case] = lambda one: one,
    probe: Callable[[Probe], Probe] = lambda one: one,
) -> Compute:
    """Return peak to peak or rms under AM or STM with another slab or vibrometer, and gain fitted again on the step."""

    def compute(setting: Setting) -> Answer:
        stimulus = MEASURED_STIMULI[kind]
        trace = gained(case(case_of(setting)), stimulus, probe(probe_of(setting)))
        window = measured_window(reading(setting, "chilles_window"), stimulus)
        return Answer(number(trace.times_s, trace.values, window), trace.error)

    return compute


def of_size(kind: str, number: Callable[..., float]) -> tuple[Cause, ...]:
    return (
        Cause("no high-pass on the velocity", size_with(kind, number, probe=lambda one: replace(one, highpass=False))),
        Cause(
            "the high-pass runs forward and backward",
            size_with(kind, number, probe=lambda one: replace(one, phase="zero_phase")),
        ),
        Cause(
            "the head points straight down", size_with(kind, number, probe=lambda one: replace(one, incidence_deg=0.0))
        ),
        Cause(
            "both moduli one standard deviation higher",
            size_with(kind, number, case=lambda one: replace(one, material="stiff")),
        ),
    )


CAUSES: dict[str, tuple[Cause, ...]] = {
    "C14a": (
        Cause("no high-pass on the velocity", steady_without_filter),
        Cause("no high-pass, and the load's gain fitted on the measured peak", steady_with_gain),
        Cause("no high-pass, and both moduli one standard deviation higher", steady_of_stiff),
    ),
    "C16a": (
        Cause("the spectrum is of the velocity", line_of_velocity),
        Cause(f"the record is of the first {1e3 * ONSET_S:g} ms, without the end of the stimulus", line_of_onset),
        Cause("no vibrometer and no filter, record of 200 ms", line_of_raw),
        Cause("both moduli one standard deviation higher", line_in(lambda case: replace(case, material="stiff"))),
        Cause("slab of 10 mm", line_in(lambda case: replace(case, thickness_m=0.01))),
    ),
    "C19a": of_size("am", peak_to_peak),
    "C19c": of_size("am", rms),
    "C20a": of_size("stm", peak_to_peak),
    "C20c": of_size("stm", rms),
}
