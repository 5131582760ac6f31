"""Evaluate a log: thresholds by condition, from the procedure and from a fitted psychometric function.

Thresholds have intervals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.errors import OutputError
from palmfield.perception.psychometric import BEYOND, Fit, Shape, counts, fit
from palmfield.studies.experiment.design import Design
from palmfield.studies.experiment.log import Log, Trial, next_trial, read_experiment_log
from palmfield.studies.experiment.procedures import Adjustment, Answered, Limits, Staircase

STEEP = 0.5
"""Fraction of the smallest distance between levels. A function with a smaller spread rises between two levels."""


@dataclass(frozen=True)
class ConditionReport:
    """Evaluation of one condition.

    runs: trials by block
    estimates: estimates by the procedure, one for each block, in the unit of the varied key
    levels: levels in the scale of fits (dB re 1 for ratios)
    shares: fraction of right answers (or of "yes") at each level
    trials: number of trials at each level
    fit: the fit, or None
    why: reason why there is no fit
    """

    name: str
    runs: tuple[tuple[Answered, ...], ...]
    estimates: tuple[float, ...]
    levels: tuple[float, ...]
    trials: tuple[int, ...]
    shares: tuple[float, ...]
    fit: Fit | None
    why: str

    @property
    def answered(self) -> int:
        """Number of trials."""
        return sum(len(run) for run in self.runs)


@dataclass(frozen=True)
class Report:
    """Report of a log.

    convergence: fraction of right answers to which staircases converge, None for other procedures
    spread_known: whether the spread was specified, so that it is not fitted
    """

    log: Log
    conditions: tuple[ConditionReport, ...]
    convergence: float | None
    finished: bool
    spread_known: bool

    @property
    def design(self) -> Design:
        """Design of the log."""
        return self.log.design


def report_of(
    path: Path,
    *,
    shape: Shape = "normal",
    lapse: float | None = 0.02,
    spread: float | None = None,
    confidence: float = 0.95,
) -> Report:
    """Return the report of the log of an experiment, finished or not.

    shape, lapse, spread, confidence: options of the fit (`palmfield.perception.psychometric.fit`). lapse and spread are
        fitted if None; for ratios, spread is in dB
    Raises OutputError for a file that is not a log, and for values of shape, lapse and confidence that the fit does not
    allow.
    """
    log = read_experiment_log(path)
    design = log.design
    if shape == "weibull" and design.varied.scale == "log":
        raise OutputError("shape 'weibull' needs linear levels, but the scale 'log' of this log is in dB; "
                          "allowed: normal, logistic")  # fmt: skip
    settings = {"shape": shape, "lapse": lapse, "spread": spread, "confidence": confidence}
    conditions = tuple(
        _condition(design, number, [trial for trial in log.trials if trial.condition == number], settings)
        for number in range(len(design.conditions))
    )
    procedure = design.procedure_of(0, 0)
    convergence = procedure.convergence if isinstance(procedure, Staircase) else None
    return Report(log, conditions, convergence, next_trial(design, log.trials) is None, spread is not None)


def _condition(design: Design, number: int, trials: Sequence[Trial], settings: dict[str, Any]) -> ConditionReport:
    runs, estimates = [], []
    for block in range(design.blocks):
        run = [trial.answered for trial in trials if trial.block == block]
        procedure = design.procedure_of(block, number)
        runs.append(tuple(run))
        if isinstance(procedure, Staircase | Limits | Adjustment):
            estimates.append(procedure.estimate(run))
    adjusted = design.procedure["kind"] == "adjustment"
    # Steps in dB return to a level only within rounding errors
    answers = [(round(design.varied.in_scale(one.level), 6), one.right) for run in runs for one in run]
    silent = sum(not math.isfinite(level) for level, _ in answers)
    finite = [(level, right) for level, right in answers if math.isfinite(level)]
    name = design.conditions[number].name
    if not finite or adjusted:
        why = "settings are not answers to levels" if adjusted else "no trial yet"
        return ConditionReport(name, tuple(runs), tuple(estimates), (), (), (), None, why)
    levels, count, right = counts([level for level, _ in finite], [right for _, right in finite])
    adaptive = design.procedure["kind"] in ("staircase", "limits")
    found, notes = None, [f"{silent} trials with level 0 are excluded"] if silent else []
    try:
        found = fit(levels, count, right, guess=design.task.chance, adaptive=adaptive, **settings)
        if not found.settled:
            notes.append(
                "the threshold lies outside the levels, or the spread is at its bound: there are too few "
                "answers near the threshold"
            )
        elif settings["spread"] is None and found.spread < STEEP * float(np.diff(levels).min()):
            notes.append(
                "the spread is small compared with the distance of the levels, so only an upper bound is known"
            )
    except OutputError as error:
        notes.append(str(error))
    return ConditionReport(
        name, tuple(runs), tuple(estimates), tuple(levels.tolist()), tuple(count.astype(int).tolist()),
        tuple((right / count).tolist()), found, "; ".join(notes),
    )  # fmt: skip


def interval_of(design: Design, one: ConditionReport) -> tuple[float | None, float | None]:
    """Return the interval of the threshold in the unit of the varied key. An end outside the allowed levels is None."""
    assert one.fit is not None
    low, high = (design.varied.level(end) for end in one.fit.threshold_interval)
    least, most = design.playable()
    # An end at the limit of the search is not bounded
    ratios = one.fit.function.shape == "weibull"
    places, ends = (np.log(x) if ratios else np.array(x) for x in (one.levels, one.fit.threshold_interval))
    searched = BEYOND * np.ptp(places) - 1e-6
    return (
        None if low < least or ends[0] <= places.min() - searched else low,
        None if high > most or ends[1] >= places.max() + searched else high,
    )


def threshold_of(design: Design, one: ConditionReport) -> tuple[float | None, str]:
    """Return the threshold in the unit of the varied key, and in words. It is None outside the allowed levels."""
    assert one.fit is not None
    (least, most), level = design.playable(), design.varied.level(one.fit.threshold)
    if least <= level <= most:
        return level, f"{level:.4g}"
    return None, f"< {least:.4g}" if level < least else f"> {most:.4g}"


def written(low: float | None, high: float | None) -> str:
    """Return an interval in words. low, high: its ends, from `interval_of`"""
    if low is None and high is None:
        return "not bounded"
    return f"{'not bounded' if low is None else f'{low:.4g}'} to {'not bounded' if high is None else f'{high:.4g}'}"


def as_dict(report: Report) -> dict[str, Any]:
    """Return the report with units in the names. Values outside the levels that can be presented are None."""
    varied, head = report.design.varied, report.log.head
    rows = []
    for one in report.conditions:
        row: dict[str, Any] = {
            "condition": one.name, "trials": one.answered,
            "estimates": [None if math.isnan(value) else value for value in one.estimates],
        }  # fmt: skip
        if one.fit is not None:
            low, high = interval_of(report.design, one)
            row |= {
                "threshold": threshold_of(report.design, one)[0], "threshold_low": low, "threshold_high": high,
                "confidence": one.fit.confidence, "deviance": one.fit.deviance,
                ("spread_dB" if varied.scale == "log" else "spread"): one.fit.spread,
                "deviance_share": one.fit.deviance_share, "lapse": one.fit.function.lapse, "settled": one.fit.settled,
            }  # fmt: skip
        rows.append(row | ({"note": one.why} if one.why else {}))
    return {
        "experiment": head["name"], "participant": head["participant"], "observer": head["observer"],
        "board": head["board"], "digest": head["digest"], "sessions": report.log.sessions,
        "trials": len(report.log.trials), "finished": report.finished, "varied": varied.key, "unit": varied.unit,
        "guess": report.design.task.chance, "convergence": report.convergence, "conditions": rows,
    }  # fmt: skip


def as_text(report: Report) -> str:
    """Return the report as a table in words."""
    head, varied = report.log.head, report.design.varied
    state = "finished" if report.finished else "not finished"
    lines = [
        f"{head['name']}: participant {head['participant']}, observer {head['observer']}, board {head['board']}; "
        f"{len(report.log.trials)} trials in {report.log.sessions} "
        f"session{'' if report.log.sessions == 1 else 's'}, {state}"
    ]
    if report.convergence is not None:
        lines.append(
            f"staircases converge to {100 * report.convergence:.1f} % right; their estimates are for that level"
        )
    half = 0.5 * (1.0 + report.design.task.chance)
    unit = f" [{varied.unit}]" if varied.unit else ""
    lines.append(f"threshold of {varied.key}{unit}: F = 1/2, {100 * half:.0f} % right without lapses")
    width = max(9, *(len(one.name) for one in report.conditions))
    lines.append(f"{'condition':<{width}}  trials  threshold  interval               spread  procedure's estimates")
    for one in report.conditions:
        threshold = interval = spread = "-"
        if one.fit is not None:
            threshold = threshold_of(report.design, one)[1]
            interval = written(*interval_of(report.design, one))
            spread = f"{one.fit.spread:.3g}{' dB' if varied.scale == 'log' else ''}"
        estimates = ", ".join("-" if math.isnan(value) else f"{value:.4g}" for value in one.estimates) or "-"
        lines.append(
            f"{one.name:<{width}}  {one.answered:>6}  {threshold:>9}  {interval:<21}  {spread:<6}  {estimates}"
        )
    for one in report.conditions:
        if one.why:
            lines.append(f"note: {one.name}: {one.why}")
        if one.fit is not None and one.fit.deviance_share < 0.05:
            lines.append(
                f"note: {one.name}: poor fit: only {100 * one.fit.deviance_share:.0f} % of samples from the fitted "
                f"function have a deviance above {one.fit.deviance:.1f}"
            )
    if isinstance(report.design.procedure_of(0, 0), Staircase) and not report.spread_known:
        lines.append(
            "note: spreads fitted to staircases are biased low, so the threshold intervals are widened: give "
            "--spread if it is known (docs/experiments.md)"
        )
    return "\n".join(lines)
