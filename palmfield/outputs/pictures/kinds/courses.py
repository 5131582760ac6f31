"""Draw the motion of a skin at a few points: over time, spectra and spectrograms."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import hann

from palmfield.errors import OutputError
from palmfield.metrics.spectra import amplitude_spectrum
from palmfield.outputs.motion import at_vertices
from palmfield.outputs.pictures.options import IN_MICRO, UNITS, Kind, Options, chosen_skin, chosen_vertices, limits_of
from palmfield.outputs.style import COLOURS, LINES, beyond
from palmfield.types import Float

WINDOW_S = 0.02
SHOWN_DB = 60.0
LEAST_Hz = 1000.0


def _motion(result: xr.DataTree, options: Options) -> tuple[Float, list[tuple[str, Float]]]:
    """Return times [s], and for each chosen point its description and normal motion [um or um/s]."""
    name, skin = chosen_skin(result, options, options.quantity)
    chosen = chosen_vertices(result, name, skin, options)
    motion = IN_MICRO * at_vertices(skin, [vertex for vertex, _ in chosen], options.quantity).astype(float)
    return skin["time"].values, [(what, values) for (_, what), values in zip(chosen, motion.T, strict=True)]


def course(result: xr.DataTree, options: Options) -> Figure:
    """Draw the normal displacement or velocity over time."""
    times, motion = _motion(result, options)
    figure = Figure(figsize=(7.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for n, (what, values) in enumerate(motion):
        axes.plot(1e3 * times, values, LINES[n % len(LINES)], color=COLOURS[n % len(COLOURS)], label=what)
    axes.set(xlabel="time [ms]", ylabel=f"normal {options.quantity} [{UNITS[options.quantity]}]")
    axes.set_title("Motion of the skin (negative: inward)")
    if options.limits is not None:
        axes.set_ylim(*options.limits)
    axes.margins(x=0)
    axes.margins(y=0.15)
    axes.legend(ncols=min(3, len(motion)), loc="upper right")
    return figure


def spectrum(result: xr.DataTree, options: Options) -> Figure:
    """Draw single-sided amplitude spectra of the normal motion, with a Hann window. The mean is removed."""
    times, motion = _motion(result, options)
    figure = Figure(figsize=(7.0, 3.4), layout="constrained")
    axes = figure.subplots()
    top = 0.0
    for n, (what, values) in enumerate(motion):
        at, size = amplitude_spectrum(times, values)
        top = max(top, float(size.max()))
        style = LINES[n % len(LINES)]
        axes.semilogy(at, np.maximum(size, 1e-12), style, color=COLOURS[n % len(COLOURS)], label=what)
    axes.set(xlabel="frequency [Hz]", ylabel=f"amplitude [{UNITS[options.quantity]}]")
    axes.set_xlim(0.0, min(LEAST_Hz, float(at[-1])))
    if options.limits is not None and options.limits[0] <= 0.0:
        raise OutputError(
            f"--limits has value {options.limits[0]:g},{options.limits[1]:g}; allowed for a spectrum: above 0"
        )
    axes.set_ylim(*limits_of(options, 1e-4 * max(top, 1e-9), 2.0 * max(top, 1e-9)))
    axes.set_title(f"Amplitude spectrum of the normal {options.quantity} (bins of {at[0]:.3g} Hz)")
    axes.legend(loc="best")
    return figure


def spectrogram(result: xr.DataTree, options: Options) -> Figure:
    """Draw the power of the normal motion over time and frequency, at the first `--place`."""
    name, skin = chosen_skin(result, options, options.quantity)
    vertex, what = chosen_vertices(result, name, skin, options)[0]
    values = at_vertices(skin, [vertex], options.quantity)[:, 0].astype(float)
    times = skin["time"].values
    step_s = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    count = min(round(WINDOW_S / step_s), len(times) // 2) if step_s > 0.0 else 0
    if count < 8:
        raise OutputError(
            f"a spectrogram of {len(times)} samples is not meaningful; run for longer, or record more often"
        )
    hop = max(1, count // 16)
    transform = ShortTimeFFT(hann(count, sym=False), hop, 1.0 / step_s, scale_to="magnitude")
    # Only whole windows, because the signal would jump at its ends
    first, last = transform.lower_border_end[1], transform.upper_border_begin(len(values))[1]
    power = transform.spectrogram(values - values.mean(), p0=first, p1=last)
    level = 10.0 * np.log10(np.maximum(power / max(float(power.max()), 1e-300), 1e-30))
    moments = 1e3 * (times[0] + transform.t(len(values), first, last))
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    low, high = limits_of(options, -SHOWN_DB, 0.0)
    drawn = axes.pcolormesh(moments, transform.f, level, cmap="magma", vmin=low, vmax=high, shading="nearest")
    axes.set(xlabel="time [ms]", ylabel="frequency [Hz]", xlim=(1e3 * times[0], 1e3 * times[-1]))
    axes.set_ylim(0.0, min(LEAST_Hz, float(transform.f[-1])))
    axes.grid(visible=False)
    axes.set_title(f"Normal {options.quantity} at {what} (whole windows of {1e3 * count * step_s:.3g} ms)")
    figure.colorbar(drawn, ax=axes, label="dB re largest", extend=beyond(level, low, high))
    return figure


KINDS = {
    "course": Kind.of_motion(course, "motion of the skin over time at a few points", place=20),
    "spectrum": Kind.of_motion(spectrum, "its amplitude spectrum", place=21),
    "spectrogram": Kind.of_motion(spectrogram, "power of the motion over time and frequency", place=22, unit="dB"),
}
