"""Row C6: effect of the 50 Hz high-pass, and whether any pair of order and window explains all six numbers."""

from collections.abc import Callable
from dataclasses import replace

from palmfield.metrics import peak_to_peak, rms
from palmfield_papers.answer import Answer, Compute, Setting
from palmfield_papers.chilles2019.setup import Case, Probe, Stimulus, case_of
from palmfield_papers.chilles2019.step_rows import peak_of, steady_of
from palmfield_papers.chilles2019.traces import measured, measured_window, raw
from palmfield_papers.entries import Entry, book
from palmfield_papers.verdicts import distance_in_tolerances

ORDERS = (1, 2, 4)
SIX = ("C14a", "C14c", "C19a", "C19c", "C20a", "C20c")
"""Ids of the six measured values: steady state and peak of the step; peak to peak and rms of AM and STM."""
CONFIGURATIONS: dict[str, tuple[str, Stimulus]] = {
    "first": ("infinite", "ramp"),
    "second": ("infinite", "step"),
}
"""The two configurations. papers.md does not name them; ours are the infinite slab with and without the ramp."""


def six(case: Case, probe: Probe, window: str, factor: float = 1.0) -> dict[str, float]:
    """Return the six numbers [um] for one chain and one window. factor: factor on the load"""
    step = measured(case, "step", probe)
    found = {"C14a": steady_of(step), "C14c": peak_of(step)}
    stimuli: tuple[tuple[Stimulus, str, str], ...] = (("am_pressure", "C19a", "C19c"), ("stm", "C20a", "C20c"))
    for stimulus, size, mean in stimuli:
        trace, span = measured(case, stimulus, probe), measured_window(window, stimulus)
        found[size] = peak_to_peak(trace.times_s, trace.values, span)
        found[mean] = rms(trace.times_s, trace.values, span)
    return {name: factor * value for name, value in found.items()}


def agreeing(found: dict[str, float]) -> list[str]:
    """Return which of the six numbers are within their tolerances."""
    entries: dict[str, Entry] = {entry.id: entry for entry in book().entries if entry.id in found}
    return [
        name
        for name, value in found.items()
        if distance_in_tolerances(
            value, float(str(entries[name].value)), entries[name].tolerance.kind, entries[name].tolerance.value
        ) >= 0.0
    ]  # fmt: skip


def pairs(setting: Setting) -> Answer:
    """Return for how many pairs of order and window all six numbers are within their tolerances at 12 Pa."""
    case, windows = case_of(setting), book().axes["chilles_window"]
    found = {
        (order, window): len(agreeing(six(case, Probe(order=order), window))) for order in ORDERS for window in windows
    }
    count = sum(number == len(SIX) for number in found.values())
    best = max(found, key=lambda pair: found[pair])
    note = f"the best, order {best[0]} over {best[1]}, brings {found[best]} of {len(SIX)}"
    return Answer(float(count), 0.0, margin=count - 1.0, note=note)


def peak_before(which: str) -> Compute:
    def compute(setting: Setting) -> Answer:
        side, start = CONFIGURATIONS[which]
        trace = raw(replace(case_of(setting), side=side), start)
        return Answer(-peak_of(trace), trace.error, note=f"{side} slab, {start}: papers.md names no configuration")

    return compute


def peak_after(which: str, order: int) -> Compute:
    def compute(setting: Setting) -> Answer:
        side, start = CONFIGURATIONS[which]
        trace = measured(replace(case_of(setting), side=side), start, Probe(order=order))
        return Answer(-peak_of(trace), trace.error, note=f"{side} slab, {start}: papers.md names no configuration")

    return compute


def peak_in_range(order: int, least: float, most: float) -> Compute:
    """Return a comparison with a range, because the entry has no single number."""

    def compute(setting: Setting) -> Answer:
        trace = measured(case_of(setting), "step", Probe(order=order))
        value = -peak_of(trace)
        where = "inside" if least <= value <= most else "outside"
        return Answer(None, note=f"{value:.3g} um, {where} of {least:g} to {most:g} um; a range is not compared")

    return compute


def modulated(stimulus: Stimulus, number: Callable[..., float], window: str, side: str = "fixed") -> Compute:
    def compute(setting: Setting) -> Answer:
        trace = measured(replace(case_of(setting), side=side), stimulus, Probe())
        last = number(trace.times_s, trace.values, measured_window("last five periods of the stimulus", stimulus))
        whole = number(trace.times_s, trace.values, None)
        value = last if window == "last" else whole
        above = measured(replace(case_of(setting), side=side), stimulus, Probe(incidence_deg=0.0))
        shown = {
            "last five periods": last,
            "whole record of 256 ms": whole,
            "whole record, head straight above": number(above.times_s, above.values, None),
        }
        return Answer(value, trace.error, note=f"{side} sides, 12 Pa", shown=shown)

    return compute


ANSWERS: dict[str, Compute] = {
    "C6b": peak_before("first"),
    "C6c": peak_after("first", 2),
    "C6d": peak_before("second"),
    "C6e": peak_after("second", 2),
    "C6f": peak_in_range(1, 1.3, 1.4),
    "C6g": peak_in_range(4, 0.7, 0.8),
    "C6h": modulated("am_pressure", peak_to_peak, "last", "infinite"),
    "C6i": modulated("am_pressure", peak_to_peak, "last"),
    "C6j": modulated("am_pressure", rms, "whole"),
    "C6k": modulated("stm", peak_to_peak, "whole"),
    "C6l": pairs,
}
