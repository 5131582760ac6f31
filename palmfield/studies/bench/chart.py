"""Draw speed against error."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from palmfield.outputs.style import COLOURS, save, style
from palmfield.studies.bench.table import FieldRow

MARKERS = "os^"
PANEL_POINTS = 300.0
"""Approximate height of the axes of a panel in typographic points. Labels are at least LABEL_POINTS apart."""
LABEL_POINTS = 10.0


def draw(rows: list[FieldRow], models: dict[str, str], path: Path) -> None:
    with style():
        save(speed_figure(rows, models), path)


def speed_figure(rows: list[FieldRow], models: dict[str, str]) -> Figure:
    """Draw a panel with logarithmic axes for each range of distances, for up to three models.

    Labels name the methods.
    """
    measured = [row for row in rows if not row.missing]
    looks = dict(zip(models, zip(COLOURS, MARKERS, strict=True), strict=False))
    ranges = list(dict.fromkeys(row.range for row in rows))
    speeds = [speed(row) for row in measured]
    errors = [row.error for row in measured]
    on_gpu = any(row.pairs_per_core_s is None for row in measured)
    with style():
        figure = Figure(figsize=(11.0, 5.6), layout="constrained")
        axes = figure.subplots(1, len(ranges), sharex=True, sharey=True, squeeze=False)[0]
        axes[0].set(xscale="log", yscale="log")
        axes[0].set(xlim=(min(errors) / 5.0, max(errors) * 5.0), ylim=(min(speeds) / 2.0, max(speeds) * 2.0))
        axes[0].set_ylabel("pairs of transducer and point per core-second" + (" (GPU: per second)" if on_gpu else ""))
        for axis, text in zip(axes, ranges, strict=True):
            axis.set(title=f"Points {text} away", xlabel="relative L2 error against float64 of the same model")
            some = [row for row in measured if row.range == text]
            for row in some:
                colour, marker = looks[row.model]
                axis.plot(row.error, speed(row), marker, color=colour, markersize=6)
            label(axis, some)
        keys = [axes[0].plot([], [], marker, color=colour)[0] for colour, marker in looks.values()]
        figure.legend(keys, list(models.values()), loc="outside lower center", ncols=len(models))
    return figure


def speed(row: FieldRow) -> float:
    """Return the speed in pairs per core-second, which is independent of other load; on a GPU per wall second."""
    return row.pairs_per_s if row.pairs_per_core_s is None else row.pairs_per_core_s


def label(axis: Any, rows: list[FieldRow]) -> None:
    """Label the points, on the side of the middle of the panel.

    Labels are moved up or down so that they do not overlap.
    """
    low, high = np.log(axis.get_ylim())
    middle = np.sqrt(np.prod(axis.get_xlim()))
    last = {True: -np.inf, False: -np.inf}
    for row in sorted(rows, key=speed):
        right = bool(row.error > middle)
        height = PANEL_POINTS * (np.log(speed(row)) - low) / (high - low)
        last[right] = max(height, last[right] + LABEL_POINTS)
        axis.annotate(
            row.name,
            (row.error, speed(row)),
            (-24 if right else 24, last[right] - height),
            textcoords="offset points",
            ha="right" if right else "left",
            va="center",
            fontsize=8,
            fontweight="bold" if row.name.startswith("palmfield") else "normal",
            arrowprops={"arrowstyle": "-", "color": "#999999", "linewidth": 0.6, "relpos": (1.0 * right, 0.5)},
        )
