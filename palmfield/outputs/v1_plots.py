# Schema 1: for the old recorder, and deleted with it.
"""Figures of a run: pressure on the skin, and its motion in time and frequency."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from palmfield.errors import OutputError
from palmfield.outputs.spectrum import amplitude_spectrum, spectral_peaks
from palmfield.outputs.style import COLOURS, save, style
from palmfield.outputs.v1_frames import body_pose_at, has_records, loudest, posed, to_local, to_world
from palmfield.types import Float

DPI = 150
DISTANCES_M = (0.010, 0.020)


def plot_pressure(ds: xr.Dataset, path: Path) -> None:
    """PNG of peak pressure amplitude and ARP on the skin patch when loudest, seen from the array.

    ds: a result (outputs/schema.py) with the skin patch, array_pose and skin_pressure or arp
    Raises OutputError where neither is there, and where `path` cannot be written.
    """
    index, time_s = loudest(ds)
    panels: list[tuple[str, str, Float]] = []
    if has_records(ds, "skin_pressure"):
        panels.append(("Peak pressure", "magma", ds["skin_pressure"].values.astype(float)))
    if has_records(ds, "arp"):
        panels.append(("Radiation pressure (ARP)", "viridis", ds["arp"].values[index].astype(float)))
    if not panels:
        raise OutputError("the result holds neither skin_pressure nor arp; run at least one step before plotting")
    pose = ds["array_pose"].values
    seen = to_local(to_world(posed(ds, "skin", time_s), body_pose_at(ds, time_s)), pose)
    foci = to_local(ds["focus"].values, pose) if has_records(ds, "focus") else np.empty((0, 3))
    with style():
        figure = Figure(figsize=(0.6 + 4.4 * len(panels), 4.4), dpi=DPI, layout="constrained")
        columns = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (title, colours, values) in zip(columns, panels, strict=True):
            _draw_patch(figure, axes, ds["skin_faces"].values, seen, values, colours)
            if len(foci):
                axes.plot(*(foci[:, :2].T * 1e3), color="white", lw=0.6, alpha=0.5)
                axes.plot(*(foci[index, :2] * 1e3), "+", color="white", ms=12, mew=1.6, label="focus")
                axes.legend(loc="upper right", labelcolor="white", facecolor="#333333", frameon=True, framealpha=0.6)
            axes.set_title(f"{title}, max {_number(np.nanmax(values))} Pa")
        height = float(np.median(seen[:, 2])) * 1e3
        figure.suptitle(
            f"Skin patch at t = {time_s * 1e3:.2f} ms, seen from the array\n"
            f"(along its +z, so x runs left; the array is {height:.0f} mm nearer to you)",
            fontsize=9,
            color="#555555",
        )
        save(figure, path, DPI)


def plot_displacement(ds: xr.Dataset, path: Path) -> None:
    """PNG of the normal displacement over time at the vertex that moves most and two more, and its spectrum below.

    ds: a result with time, normal_displacement and skin_position
    Raises OutputError where there is no displacement, and where `path` cannot be written.
    """
    if not has_records(ds, "normal_displacement"):
        raise OutputError("the result holds no normal_displacement; run at least one step with the skin first")
    time_s = ds["time"].values
    motion = ds["normal_displacement"].values
    vertices = _probe_vertices(ds["skin_position"].values, motion)
    with style():
        figure = Figure(figsize=(8.0, 6.0), dpi=DPI, layout="constrained")
        above, below = figure.subplots(2, 1)
        for (vertex, distance), colour in zip(vertices, COLOURS, strict=False):
            label = "largest motion" if distance == 0 else f"{distance * 1e3:.1f} mm away"
            above.plot(time_s * 1e3, motion[:, vertex] * 1e6, color=colour, label=label)
        above.set(xlabel="time [ms]", ylabel="normal displacement [µm]")
        above.set_title("Normal displacement of the skin (negative: pushed in)")
        above.legend(loc="upper right", ncols=3)
        above.margins(x=0, y=0.2)
        _draw_spectra(below, time_s, motion, vertices)
        save(figure, path, DPI)


def _draw_patch(figure: Figure, axes: Any, faces: Any, seen: Float, values: Float, colours: str) -> None:
    """The patch in the array's x and y, far triangles first so that near ones cover them."""
    order = np.argsort(-seen[faces].mean(axis=1)[:, 2])
    triangles = Triangulation(seen[:, 0] * 1e3, seen[:, 1] * 1e3, faces[order])
    drawn = axes.tripcolor(
        triangles, np.nan_to_num(values), shading="gouraud", cmap=colours, vmin=0.0, vmax=max(np.nanmax(values), 1e-9)
    )
    axes.set(xlabel="array x [mm]", ylabel="array y [mm]", aspect="equal")
    axes.grid(visible=False)
    # Looking along +z with y up, +x points left.
    axes.invert_xaxis()
    figure.colorbar(drawn, ax=axes, shrink=0.85, pad=0.02, label="Pa")


def _probe_vertices(rest: Float, motion: Float) -> list[tuple[int, float]]:
    """(vertex, distance [m]) of the largest |u| and of those nearest to 10 and 20 mm from it (small patch: less)."""
    first = int(np.abs(motion).max(axis=0).argmax())
    distance = np.linalg.norm(rest - rest[first], axis=1)
    scale = min(1.0, 0.9 * float(distance.max()) / DISTANCES_M[-1])
    others = [int(np.abs(distance - scale * wanted).argmin()) for wanted in DISTANCES_M]
    return [(first, 0.0)] + [(v, float(distance[v])) for v in others if v != first]


def _draw_spectra(axes: Any, time_s: Float, motion: Float, vertices: list[tuple[int, float]]) -> None:
    try:
        spectra = [amplitude_spectrum(time_s, motion[:, v].astype(float)) for v, _ in vertices]
    except OutputError as error:
        axes.text(0.5, 0.5, f"no spectrum: {error}", ha="center", va="center", transform=axes.transAxes, wrap=True)
        axes.set_axis_off()
        return
    frequency, first = spectra[0]
    peaks = spectral_peaks(frequency, first)
    top = max(first.max() * 1e6, 1e-9)
    for (_, amplitude), colour in zip(spectra, COLOURS, strict=False):
        axes.semilogy(frequency, np.maximum(amplitude * 1e6, 1e-9 * top), color=colour)
    last = max([1000.0] + [1.3 * at for at, _ in peaks])
    before = -np.inf
    lifted = False
    for at, height in sorted(peaks):
        # Two lines of text side by side need a tenth of the axis.
        lifted = not lifted and at - before < 0.1 * last
        before = at
        axes.annotate(
            f"{at:.4g} Hz\n{_number(height * 1e6)} µm",
            (at, height * 1e6),
            (0, 30 if lifted else 6),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    axes.set(xlim=(0, min(last, frequency[-1])), ylim=(top * 1e-4, top * 40))
    axes.set(xlabel="frequency [Hz]", ylabel="amplitude [µm]")
    axes.set_title(f"Amplitude spectrum (single-sided, Hann window, DC excluded, bins of {frequency[0]:.3g} Hz)")


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
