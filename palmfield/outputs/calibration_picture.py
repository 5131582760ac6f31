"""Draw a calibration: each transducer with phase, polarity and gain."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from palmfield.acoustics.calibration_file import Calibration
from palmfield.outputs.style import save, style
from palmfield.types import Array, Float


def draw_calibration(calibration: Calibration, array: Array, path: Path) -> Path:
    """Draw a PNG of two maps of the board, seen from its front; return its path.

    array: layout of the calibration. Raises OutputError if the picture cannot be written.
    """
    elements = calibration.elements
    with style():
        figure = Figure(figsize=(9.6, 4.6), dpi=150, layout="constrained")
        axes = figure.subplots(1, 2)
        x, y = 1e3 * array.positions[:, 0], 1e3 * array.positions[:, 1]
        size = _marker(array)
        for axis in axes:
            axis.set(aspect="equal", xlabel="x [mm]")
            axis.grid(False)
        axes[0].set_ylabel("y [mm]")
        if elements is None:
            for axis in axes:
                axis.scatter(x, y, s=size, c="#cccccc")
            axes[0].set_title("single transducers were not measured")
        else:
            alive = np.array(elements.enabled)
            phase = np.degrees(elements.phase_rad)
            limit = max(float(np.abs(phase[alive]).max(initial=0.0)), 1.0)
            turned = np.array(elements.polarity) < 0
            maps: list[tuple[Any, Any, Any, str, str]] = [
                (axes[0], phase, (-limit, limit), "coolwarm", "delay without polarity [deg]"),
                (
                    axes[1],
                    np.array(elements.gain),
                    _ends(np.array(elements.gain)[alive]),
                    "cividis",
                    "amplitude over p0",
                ),
            ]
            for axis, values, (low, high), colours, label in maps:
                dots = axis.scatter(x[alive], y[alive], s=size, c=values[alive], cmap=colours, vmin=low, vmax=high)
                axis.scatter(x[~alive], y[~alive], s=size, marker="x", c="#111111", label=f"silent: {(~alive).sum()}")
                figure.colorbar(dots, ax=axis, label=label, shrink=0.85)
            minus = turned & alive
            axes[0].scatter(x[minus], y[minus], s=0.12 * size, c="#111111", label=f"reversed polarity: {minus.sum()}")
            axes[0].set_title("phase and polarity")
            axes[1].set_title("gain")
            handles, labels = axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=2)
        p0 = calibration.p0
        level = "p0 not measured" if p0 is None else f"p0 {p0.value:.3g} Pa m ({p0.low:.3g} to {p0.high:.3g})"
        figure.suptitle(f"Calibration of {calibration.layout}: {level}")
        save(figure, path)
    return path


def _ends(values: Float) -> tuple[float, float]:
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)


def _marker(array: Array) -> float:
    """Return the marker area [points^2] at which neighbours nearly touch in a map of 3.4 inches."""
    extent = float(np.ptp(array.positions[:, :2], axis=0).max()) or 1.0
    pitch = extent / math.sqrt(len(array))
    return float(np.clip((0.8 * 72.0 * 3.0 * pitch / extent) ** 2, 2.0, 400.0))
