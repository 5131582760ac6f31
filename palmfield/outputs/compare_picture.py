"""Draw a measured and a computed scan: maps of gain, delay and coherence; frequency and wavenumber."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from palmfield.instruments.agreement import Agreement
from palmfield.instruments.frequency_wavenumber import FrequencyWavenumber, on_plane
from palmfield.instruments.scan import Scan
from palmfield.outputs.style import COLOURS, LINES, save, style

DEPTH = 1e-2
"""Smallest drawn amplitude, relative to the largest amplitude."""
SHOWN = {"displacement": (1e6, "displacement [um]"), "velocity": (1e3, "velocity [mm/s]")}


def draw_agreement(measured: Scan, computed: Scan, numbers: Agreement, path: Path) -> Path:
    """Draw a PNG with the signal at the point of largest motion and maps of the agreement; return its path."""
    flat = 1e3 * on_plane(measured.points)
    loud = numbers.level >= 0.1
    with style():
        figure = Figure(figsize=(10.5, 6.4), dpi=150, layout="constrained")
        axes = figure.subplot_mosaic([["trace"] * 4, ["level", "gain", "delay", "coherence"]])
        best = int(numbers.level.argmax())
        factor, label = SHOWN[measured.quantity]
        trace = axes["trace"]
        both = (measured, "measured"), (computed, "computed")
        for (scan, name), colour, line in zip(both, COLOURS, LINES, strict=False):
            trace.plot(1e3 * scan.times_s, factor * scan.values[:, best], line, color=colour, lw=1.0, label=name)
        trace.set(xlabel="time [ms]", ylabel=label)
        trace.set_title(f"loudest point, gain {numbers.gain[best]:.2f}, coherence {numbers.coherence[best]:.2f}")
        trace.legend(loc="upper right")
        maps: list[tuple[str, Any, str, str, tuple[float, float] | None]] = [
            ("level", numbers.level, "rms, loudest 1", "cividis", (0.0, 1.0)),
            ("gain", numbers.gain, "gain", "viridis", None),
            ("delay", 1e3 * numbers.delay_s, "delay [ms]", "coolwarm", None),
            ("coherence", numbers.coherence, "coherence", "cividis", (0.0, 1.0)),
        ]
        size = float(np.clip(4000.0 / len(flat), 4.0, 120.0))
        for name, values, title, colours, limits in maps:
            axis = axes[name]
            chosen = np.ones(len(flat), bool) if name == "level" else loud
            low, high = limits or tuple(np.quantile(values[loud], [0.02, 0.98]))
            axis.scatter(flat[~chosen, 0], flat[~chosen, 1], s=0.2 * size, c="#cccccc", lw=0)
            dots = axis.scatter(
                flat[chosen, 0], flat[chosen, 1], s=size, c=values[chosen], cmap=colours, vmin=low, vmax=high, lw=0
            )
            figure.colorbar(dots, ax=axis, shrink=0.7)
            axis.set(title=title, aspect="equal", xlabel="along the scan [mm]")
            axis.grid(False)
        save(figure, path)
    return path


def draw_wavenumbers(measured: FrequencyWavenumber, computed: FrequencyWavenumber, path: Path) -> Path:
    """Draw a PNG of amplitude over frequency and wavenumber, one panel per scan; return its path."""
    with style():
        figure = Figure(figsize=(9.6, 4.2), dpi=150, layout="constrained")
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, one, name in zip(axes, (measured, computed), ("measured", "computed"), strict=True):
            largest = float(one.amplitude.max())
            shown = axis.pcolormesh(
                one.wavenumber_rad_m, one.frequency_Hz, np.maximum(one.amplitude / largest, DEPTH), cmap="magma",
                norm=LogNorm(DEPTH, 1.0), shading="nearest", rasterized=True,
            )  # fmt: skip
            for speed in (1.0, 2.0, 4.0, 8.0):
                axis.plot(one.wavenumber_rad_m, speed * one.wavenumber_rad_m / (2.0 * np.pi), color="white", lw=0.5,
                          ls=":")  # fmt: skip
            axis.set(ylim=(one.frequency_Hz[0], one.frequency_Hz[-1]), title=name, xlabel="wavenumber [rad/m]")
            axis.grid(False)
        axes[0].set_ylabel("frequency [Hz]")
        figure.colorbar(shown, ax=list(axes), label="amplitude, largest 1; dotted: 1, 2, 4, 8 m/s")
        save(figure, path)
    return path
