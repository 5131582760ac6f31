"""Compute all processing chains from the vibrometer to the printed numbers, and how many of the six each explains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

from scipy.signal import detrend

from palmfield.instruments import vibrometer_record
from palmfield.metrics import peak_to_peak, rms
from palmfield_papers.chilles2019.filter_rows import SIX, agreeing
from palmfield_papers.chilles2019.modulated_rows import STEP_PEAK_UM
from palmfield_papers.chilles2019.runs import at_observer
from palmfield_papers.chilles2019.setup import RECORD_S, Case, Probe, Stimulus
from palmfield_papers.chilles2019.step_rows import peak_of, steady_of
from palmfield_papers.chilles2019.traces import UM, Trace, measured, measured_window, vibrometer
from palmfield_papers.entries import book


@dataclass(frozen=True)
class Chain:
    """One processing chain.

    order: order of the high-pass, 0 for none
    drift: whether a straight line is subtracted from the displacement
    gain: whether the load is fitted on the peak of the step; otherwise it is 12 Pa
    """

    order: int
    phase: str
    drift: bool
    gain: bool
    azimuth_deg: float
    window: str


@dataclass(frozen=True)
class Explained:
    """Result of a chain: the six numbers [um] by id, and which of them are within their tolerances."""

    chain: Chain
    numbers: dict[str, float]
    within: Sequence[str]


def chains() -> list[Chain]:
    """Return all combinations of order, phase, drift, level, azimuth and window. Without a filter there is no phase."""
    kinds = [(0, "causal"), *((order, phase) for order in (1, 2, 4) for phase in ("causal", "zero_phase"))]
    return [
        Chain(order, phase, drift, gain, azimuth, window)
        for order, phase in kinds
        for drift in (False, True)
        for gain in (False, True)
        for azimuth in (0.0, 90.0)
        for window in book().axes["chilles_window"]
    ]


@cache
def _trace(case: Case, stimulus: Stimulus, chain: Chain) -> Trace:
    probe = Probe(
        azimuth_deg=chain.azimuth_deg, order=max(chain.order, 1),
        phase="zero_phase" if chain.phase == "zero_phase" else "causal", highpass=chain.order > 0,
    )  # fmt: skip
    trace = measured(case, stimulus, probe)
    return replace(trace, values=detrend(trace.values)) if chain.drift else trace


def explained(case: Case, chain: Chain) -> Explained:
    """Return the six numbers of a chain. If the gain is fitted on the peak of the step, this peak always agrees."""
    key = replace(chain, gain=False, window="")
    step = _trace(case, "step", key)
    numbers = {"C14a": steady_of(step), "C14c": peak_of(step)}
    stimuli: tuple[tuple[Stimulus, str, str], ...] = (("am_pressure", "C19a", "C19c"), ("stm", "C20a", "C20c"))
    for stimulus, size, mean in stimuli:
        trace, window = _trace(case, stimulus, key), measured_window(chain.window, stimulus)
        numbers[size] = peak_to_peak(trace.times_s, trace.values, window)
        numbers[mean] = rms(trace.times_s, trace.values, window)
    factor = STEP_PEAK_UM / numbers["C14c"] if chain.gain else 1.0
    numbers = {name: factor * value for name, value in numbers.items()}
    return Explained(chain, numbers, agreeing(numbers))


@cache
def all_explained(case: Case) -> tuple[Explained, ...]:
    return tuple(explained(case, chain) for chain in chains())


def both_ways(case: Case, order: int, before_s: float) -> tuple[float, float]:
    """Return steady state and peak of the step [um] if the filter runs forward and backward.

    The record begins `before_s` before the trigger.
    """
    run = at_observer(case, "step")
    settings = vibrometer(Probe(order=order, phase="zero_phase"))
    early = settings.model_copy(update={"trigger_s": -before_s, "duration_s": RECORD_S + before_s})
    record = vibrometer_record(run.motion, early)
    times = record["time"].values - before_s
    trace = Trace(times, UM * case.level_Pa * record.values[:, 0], 0.0)
    return steady_of(trace), peak_of(trace)


def fully(found: Sequence[Explained]) -> list[Explained]:
    """Return the chains with all six numbers within their tolerances."""
    return [one for one in found if len(one.within) == len(SIX)]
