"""Draw a trial: distance of the focus from the hand, remaining fraction of its pressure, and a view from above."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.types import Float

LOSSES = (
    ("late_Pa", "wanted_Pa", "after latency", "C0"),
    ("rounded_Pa", "late_Pa", "after rounding", "C1"),
    ("heard_Pa", "rounded_Pa", "after calibration", "C2"),
    ("heard_Pa", "wanted_Pa", "total", "k"),
)


def draw_trial(names: Sequence[str], rows: Float, numbers: Mapping[str, Any], path: Path) -> None:
    """Draw a trial over time into a PNG.

    names, rows: columns and their values, shape (k, columns), as in course.csv; numbers: as in trial.json
    Raises OutputError if it cannot be written.
    """
    from matplotlib.figure import Figure

    from palmfield.outputs.style import LINES, same_scale, save

    column = {name: rows[:, number] for number, name in enumerate(names)}
    moments = 1e3 * column["time_s"]
    figure = Figure(figsize=(11.0, 6.4), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 3)
    error = figure.add_subplot(grid[0, :2])
    shares = figure.add_subplot(grid[1, :2], sharex=error)
    above, side = figure.add_subplot(grid[0, 2]), figure.add_subplot(grid[1, 2])
    for name, label, line in (
        ("lateral_error_m", "across the axis of the array", "-"),
        ("depth_error_m", "along it", "--"),
    ):
        error.plot(moments, 1e3 * column[name], line, lw=1.0, label=label)
    error.axhline(0.0, color="0.8", lw=0.6, zorder=0)
    error.set_ylabel("distance of the focus from the hand [mm]")
    error.legend(loc="upper right", fontsize=8)
    for number, (after, before, label, colour) in enumerate(LOSSES):
        if label == "after calibration" and numbers.get("kept_calibration") is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            share = column[after] / column[before]
        shares.plot(moments, share, LINES[number], lw=1.0, color=colour, label=label)
    shares.set(ylabel="share of the pressure", xlabel="time [ms]")
    shares.axhline(1.0, color="0.8", lw=0.6, zorder=0)
    shares.legend(loc="lower right", fontsize=8)
    for axes, up in ((above, "y"), (side, "z")):
        for what, style, label in (("true", "k-", "on the hand"), ("sounding", "C3.", "of the sound")):
            axes.plot(1e3 * column[f"{what}_x_m"], 1e3 * column[f"{what}_{up}_m"], style, ms=3, lw=1.0, label=label)
        axes.set(xlabel="x [mm]", ylabel=f"{up} [mm]")
        x, rest = (
            1e3 * np.concatenate([column[f"{what}_{one}_m"] for what in ("true", "sounding")]) for one in ("x", up)
        )
        same_scale(axes, x, rest)
    above.legend(fontsize=8)
    figure.suptitle(f"{Path(str(numbers['scene'])).stem} on {numbers['board']}", fontsize=11)
    save(figure, path, dpi=110)
