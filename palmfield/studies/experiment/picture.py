"""Picture of a report: for each condition its runs, trial by trial, and its psychometric function."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmfield.errors import OutputError
from palmfield.studies.experiment.design import Design
from palmfield.studies.experiment.procedures import Adjustment, Limits, Staircase
from palmfield.studies.experiment.report import ConditionReport, Report, interval_of, threshold_of, written

BLUE, ORANGE, GREY = "#2060a0", "#d07020", "#808080"
MOST_CONDITIONS = 12


def draw_report(report: Report, path: Path) -> None:
    """Draw the first MOST_CONDITIONS conditions into a PNG, SVG or PDF. Raises OutputError if it cannot be written."""
    shown = report.conditions[:MOST_CONDITIONS]
    figure = Figure(figsize=(9.0, 0.6 + 2.7 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), 2, squeeze=False)
    for row, condition in zip(axes, shown, strict=True):
        _runs(row[0], condition, report.design)
        _function(row[1], condition, report)
    head = report.log.head
    figure.suptitle(f"{head['name']}: {head['participant']}, {head['observer']}", fontsize=11)
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise OutputError(f"cannot write {path}: {error}; give a .png, .svg or .pdf in a folder that exists") from None


def _level_name(design: Design) -> str:
    varied = design.varied
    if varied.scale == "log":
        return f"{varied.key} [dB re 1{f' {varied.unit}' if varied.unit else ''}]"
    return f"{varied.key}{f' [{varied.unit}]' if varied.unit else ''}"


def _runs(axes: Axes, condition: ConditionReport, design: Design) -> None:
    """Draw the level over trials, with filled markers for right answers. Mark reversals and estimate of a staircase."""
    begin = 0
    for block, run in enumerate(condition.runs):
        if not run:
            continue
        x = begin + 1 + np.arange(len(run))
        y = np.array([design.varied.in_scale(one.level) for one in run])
        right = np.array([one.right for one in run])
        axes.plot(x, y, color=GREY, linewidth=0.8)
        axes.plot(x[right], y[right], "o", color=BLUE, markersize=4)
        axes.plot(x[~right], y[~right], "o", color=BLUE, markersize=4, markerfacecolor="white")
        procedure = design.procedure_of(block, 0)
        if isinstance(procedure, Staircase):
            turns = procedure.turns(run)
            axes.plot(x[turns], y[turns], "s", color=ORANGE, markersize=8, markerfacecolor="none")
        if isinstance(procedure, Staircase | Limits | Adjustment):
            estimate = condition.estimates[block]
            if np.isfinite(estimate):
                axes.plot(x[[0, -1]], [design.varied.in_scale(estimate)] * 2, "--", color=ORANGE, linewidth=1.2)
        begin += len(run)
    axes.set_title(f"{condition.name}: filled: right, open: wrong, squares: reversals", fontsize=9)
    axes.set_xlabel("trial", fontsize=9)
    axes.set_ylabel(_level_name(design), fontsize=9)
    axes.tick_params(labelsize=8)


def _function(axes: Axes, condition: ConditionReport, report: Report) -> None:
    """Draw the fraction of right answers at each level, the fitted function, and its threshold interval.

    The area of a marker shows the number of trials.
    """
    design = report.design
    if condition.levels:
        sizes = 12.0 + 120.0 * np.array(condition.trials) / max(condition.trials)
        axes.scatter(condition.levels, condition.shares, s=sizes, color=BLUE, alpha=0.6, linewidths=0)
    if condition.fit is not None:
        low, high = min(condition.levels), max(condition.levels)
        x = np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), 300)
        function = condition.fit.function
        axes.plot(x, function(x), color="black", linewidth=1.2)
        at = float(function(condition.fit.threshold))
        axes.plot(condition.fit.threshold_interval, [at, at], color=ORANGE, linewidth=3, solid_capstyle="butt")
        axes.plot([condition.fit.threshold], [at], "|", color=ORANGE, markersize=14, markeredgewidth=2)
        unit = f" {design.varied.unit}" if design.varied.unit else ""
        axes.set_title(
            f"threshold {threshold_of(design, condition)[1]}{unit}, "
            f"{100 * condition.fit.confidence:g} %: {written(*interval_of(design, condition))}", fontsize=9,
        )  # fmt: skip
    else:
        axes.set_title(condition.why[:70], fontsize=8)
    axes.axhline(design.task.chance, color=GREY, linewidth=0.8, linestyle=":")
    axes.set_ylim(-0.04, 1.04)
    axes.set_xlabel(_level_name(design), fontsize=9)
    axes.set_ylabel("share right" if design.task.kind == "nafc" else "share yes", fontsize=9)
    axes.tick_params(labelsize=8)
