"""Draw the drive: phase and amplitude of each transducer of an array."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from palmfield.outputs.pictures.options import Kind, Options, chosen_frame
from palmfield.outputs.sound import driven_arrays


def drives(result: xr.DataTree, options: Options) -> Figure:
    """Draw the phase (cyclic colour) and amplitude (size) of each transducer at a requested time."""
    arrays = driven_arrays(result)
    figure = Figure(figsize=(5.4 * len(arrays), 4.8), layout="constrained")
    for axes, (name, array) in zip(figure.subplots(1, len(arrays), squeeze=False)[0], arrays.items(), strict=True):
        amplitude = array["drive_amplitude"].values
        index, time_s = chosen_frame(result, array, options)
        x, y, _ = 1e3 * array["transducer_position"].values.T
        phase = np.mod(array["drive_phase"].values[index], 2.0 * np.pi)
        size = np.hypot(np.ptp(x), np.ptp(y))
        # A transducer at full drive fills its part of the face
        dots = (4.6 * 72.0 / max(size, 1e-9)) ** 2 * np.ptp(x) * np.ptp(y) / len(x) * 0.35
        areas = np.maximum(dots * amplitude[index], 0.5)
        drawn = axes.scatter(x, y, s=areas, c=phase, cmap="twilight", vmin=0.0, vmax=2.0 * np.pi)
        axes.set(xlabel="array x [mm]", ylabel="array y [mm]", aspect="equal")
        axes.grid(visible=False)
        most = f"area: amplitude, maximum {amplitude[index].max():.2f}"
        axes.set_title(f"Drive of '{name}' at {1e3 * time_s:.2f} ms\n({most})")
        bar = figure.colorbar(drawn, ax=axes, shrink=0.85, label="phase [rad] (positive: delay)")
        bar.set_ticks([0.0, np.pi, 2.0 * np.pi], labels=["0", "π", "2π"])
    return figure


KINDS = {"drives": Kind(drives, "phase and amplitude of each transducer", frozenset({"time_s"}), place=3)}
