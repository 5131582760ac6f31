"""Compute displacement over time at the observer, raw or through the vibrometer, and windows of the numbers."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from palmfield.instruments import Vibrometer, highpass, lines_of_sight, sampled, vibrometer_record
from palmfield.instruments.vibrometer import along_beam
from palmfield.metrics import last_periods
from palmfield.metrics.traces import Window
from palmfield.types import Float
from palmfield_papers.chilles2019.runs import at_observer
from palmfield_papers.chilles2019.setup import (
    AM_HZ,
    CIRCLE_HZ,
    RECORD_S,
    STIMULUS_S,
    Case,
    Probe,
    Stimulus,
)

SAMPLING_HZ = 128e3
CUTOFF_HZ = 50.0
PERIODS = 5
UM = 1e6


@dataclass(frozen=True)
class Trace:
    """A displacement [um] over evenly spaced times [s], both (t,), positive outward. error: numerical error [um]"""

    times_s: Float
    values: Float
    error: float

    def until(self, end_s: float) -> "Trace":
        kept = self.times_s <= end_s + 1e-9
        return Trace(self.times_s[kept], self.values[kept], self.error)


def vibrometer(probe: Probe, rate_Hz: float = SAMPLING_HZ) -> Vibrometer:
    """Return the vibrometer of sections III.C and D.

    It is at 45 degrees, with a high-pass of 50 Hz on the velocity. The velocity is integrated and divided by sin 45
    degrees.
    """
    return Vibrometer(
        incidence_deg=probe.incidence_deg,
        azimuth_deg=probe.azimuth_deg,
        distance_m=probe.distance_m,
        sampling_rate_Hz=rate_Hz,
        duration_s=RECORD_S,
        highpass_Hz=CUTOFF_HZ if probe.highpass else None,
        highpass_order=probe.order,
        phase=probe.phase,
    )


def raw(case: Case, stimulus: Stimulus) -> Trace:
    """Return the vertical displacement during the 200 ms of the simulation in the paper."""
    run = at_observer(case, stimulus)
    times = np.arange(round(STIMULUS_S * SAMPLING_HZ) + 1) / SAMPLING_HZ
    values = UM * case.level_Pa * sampled(run.motion.times_s, run.motion.displacement_m[:, 0, 2], times)
    return Trace(times, values, run.error * float(np.abs(values).max()))


def measured(case: Case, stimulus: Stimulus, probe: Probe) -> Trace:
    """Return the vibrometer reading at the observer during 256 ms."""
    times, values, error = _recorded(replace(case, level_Pa=1.0), stimulus, probe)
    scale = UM * case.level_Pa
    return Trace(times, scale * values, scale * error)


@cache
def _recorded(case: Case, stimulus: Stimulus, probe: Probe) -> tuple[Float, Float, float]:
    """Return times, reading per pascal [m], and its error from the solver and the integration of velocities."""
    run, settings = at_observer(case, stimulus), vibrometer(probe)
    record = vibrometer_record(run.motion, settings)
    times, values = record["time"].values, record.values[:, 0]
    # Filter and integral commute, so filtering the displacement gives the same result
    beams = lines_of_sight(run.motion.points, settings)
    moved = sampled(run.motion.times_s, along_beam(run.motion.displacement_m, beams, settings), times)[:, 0]
    error = run.error * float(np.abs(moved).max())
    if probe.phase == "causal":
        if probe.highpass:
            moved = highpass(moved, SAMPLING_HZ, CUTOFF_HZ, probe.order)
        error += float(np.abs(values - moved).max())
    return times, values, error


@cache
def fem_window(name: str, stimulus: Stimulus) -> Window:
    """Return the time window [s] for a value of reading chilles_window_fem."""
    return None if name == "0-200 ms" else _last(stimulus)


@cache
def measured_window(name: str, stimulus: Stimulus) -> Window:
    """Return the time window [s] for a value of reading chilles_window."""
    if name == "0-256 ms":
        return None
    return (0.0, STIMULUS_S) if name == "0-200 ms" else _last(stimulus)


def _last(stimulus: Stimulus) -> tuple[float, float]:
    frequency = CIRCLE_HZ if stimulus == "stm" else AM_HZ
    times = np.arange(round(STIMULUS_S * SAMPLING_HZ)) / SAMPLING_HZ
    return last_periods(times, frequency, PERIODS)
