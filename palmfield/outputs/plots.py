"""Draw the figures of a run: pressure on each skin, and its motion in time and frequency."""

import json
import textwrap
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.markers import TICKLEFT
from matplotlib.ticker import NullLocator

from palmfield.errors import MeasurementError, OutputError
from palmfield.metrics.spectra import amplitude_spectrum, spectral_peaks
from palmfield.outputs.budget_text import in_a_line
from palmfield.outputs.frames import Loudest, check_time, foci_at, in_world, loudest, nearest, to_local
from palmfield.outputs.motion import at_vertices, extremes
from palmfield.outputs.schema import has_records, instances
from palmfield.outputs.skin_view import SkinView, draw_patch, probe_vertices, view_of_skin
from palmfield.outputs.style import COLOURS, LINES, save, style
from palmfield.types import Float

DPI = 150
NARROW = 1.5
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LABEL = 0.1
"""Width of the label of a spectral line, as a share of the axis. Lines that are closer are listed in the corner."""
SIDE_LOBES = 0.5
"""Exponent of the pressure colours. With it, a side lobe of -13 dB is 0.22 of the peak, and its ARP is 0.05."""


def plot_pressure(result: xr.DataTree, path: Path) -> None:
    """Write `pressure_picture` as a PNG. Raises its OutputError, and OutputError if `path` cannot be written."""
    with style():
        save(pressure_picture(result), path, DPI)


def pressure_picture(result: xr.DataTree, names: list[str] | None = None, time_s: float | None = None) -> Figure:
    """Draw peak pressure amplitude and ARP on each skin at its loudest moment, seen from the array that it faces.

    result: as returned by `open_result` or `tree`, with a skin and loudest_pressure or arp, and an array. Each skin
    has a row.
    names: names of skins, None for all; time_s: another time [s], for results with pressure or arp over time
    Raises OutputError if none of these exists, and for a time outside the run.
    """
    shown = {name: skin for name, skin in instances(result, "skin").items() if names is None or name in names}
    instants = {name: loudest(skin) if time_s is None else _instant(skin, time_s) for name, skin in shown.items()}
    panels = {name: _pressures(skin, instants[name], time_s is not None) for name, skin in shown.items()}
    skins = {name: skin for name, skin in shown.items() if panels[name]}
    if not skins:
        raise OutputError("the result contains neither loudest_pressure nor arp; run at least one step before plotting")
    if not instances(result, "array"):
        raise OutputError("the result contains no array, whose frame the plot needs; keep the groups /array")
    views = {name: view_of_skin(result, name, skin, instants[name]) for name, skin in skins.items()}
    foci = _foci_of_skins(result)
    columns = max(len(panels[name]) for name in skins)
    figure = Figure(figsize=(0.6 + 4.4 * columns, 4.4 * len(skins)), dpi=DPI, layout="constrained")
    rows: list[Any] = [figure] if len(skins) == 1 else list(figure.subfigures(len(skins), 1, squeeze=False)[:, 0])
    for row, (name, skin) in zip(rows, skins.items(), strict=True):
        stimuli = instances(result, "stimulus")
        _draw_skin(row, skin, views[name], panels[name], [(stimuli[key], own) for key, own in foci[name].items()])
        height = float(np.median(views[name].vertices[:, 2])) * 1e3
        whose = f" '{name}'" if len(skins) > 1 else ""
        onto = f"array '{views[name].array}'" if len(instances(result, "array")) > 1 else "the array"
        title = (
            f"Skin patch{whose} at t = {views[name].loudest.time_s * 1e3:.2f} ms, view onto {onto}\n"
            f"through the hand: x to the right, y up; the array is {height:.0f} mm behind the skin"
        )
        row.suptitle(title, fontsize=9, color="#555555")
    return figure


def plot_displacement(result: xr.DataTree, path: Path) -> None:
    """Draw a PNG with the normal displacement and the spectrum of each skin.

    They are shown at the vertex of largest motion and at two others.

    result: as returned by `open_result` or `tree`, with displacement; each skin has a column
    Raises OutputError if there is no displacement, and if `path` cannot be written.
    """
    skins = {name: skin for name, skin in instances(result, "skin").items() if has_records(skin, "displacement")}
    if not skins:
        raise OutputError("the result contains no displacement; run at least one step with the skin first")
    with style():
        figure = Figure(figsize=(8.0 * len(skins), 6.0), dpi=DPI, layout="constrained")
        budgets = json.loads(result.attrs.get("error_budget", "{}"))
        columns: list[Any] = [figure] if len(skins) == 1 else list(figure.subfigures(1, len(skins), squeeze=False)[0])
        for column, (name, skin) in zip(columns, skins.items(), strict=True):
            _draw_motion(column, skin, f" '{name}'" if len(skins) > 1 else "")
            if worth := in_a_line(budgets.get(name)):
                column.suptitle(textwrap.fill(worth, 110), fontsize=8, color="#555555")
        save(figure, path, DPI)


def _instant(skin: xr.Dataset, time_s: float) -> Loudest:
    """Return a time within the record of a skin [s]. Raises OutputError for a time outside the record."""
    times: Float = skin["time"].values
    if not len(times):
        raise OutputError(
            f"--time has value {1e3 * time_s:g} ms; allowed: no --time, because the result has no samples"
        )
    check_time("--time", time_s, float(times[0]), float(times[-1]))
    place = nearest(times, time_s)
    return Loudest(float(times[place]), place, 0.0)


def _pressures(skin: xr.Dataset, when: Loudest, over_time: bool) -> list[tuple[str, str, Float]]:
    """Return title, colours and values [Pa] of each panel of a skin.

    over_time: whether the values are taken from the record at the time `when`
    """
    panels: list[tuple[str, str, Float]] = []
    for name, title, colours in ("pressure", "Peak pressure", "magma"), ("arp", "Radiation pressure (ARP)", "viridis"):
        if not over_time and has_records(skin, f"loudest_{name}"):
            values = skin[f"loudest_{name}"]
        elif (over_time or name == "arp") and has_records(skin, name):
            values = skin[name].isel(time=when.place)
        else:
            continue
        panels.append((title, colours, values.values.astype(float)))
    return panels


def _foci_of_skins(result: xr.DataTree) -> dict[str, dict[str, list[int]]]:
    """Return, for each skin and stimulus, the numbers of the foci that are closest to this skin."""
    by_skin: dict[str, dict[str, list[int]]] = {name: {} for name in instances(result, "skin")}
    for key, stimulus in instances(result, "stimulus").items():
        if not has_records(stimulus, "foci"):
            continue
        distances = []
        for name, skin in instances(result, "skin").items():
            when = loudest(skin)
            vertices = in_world(skin, instances(result, "body").get(name), when.time_s)
            foci = stimulus["foci"].isel(time=when.place).values
            distances.append(np.linalg.norm(vertices[:, None] - foci, axis=2).min(axis=0))
        for number, nearest_skin in enumerate(np.argmin(distances, axis=0)):
            by_skin[list(by_skin)[int(nearest_skin)]].setdefault(key, []).append(number)
    return by_skin


def _draw_skin(
    figure: Any,
    skin: xr.Dataset,
    view: SkinView,
    panels: list[tuple[str, str, Float]],
    stimuli: list[tuple[xr.Dataset, list[int]]],
) -> None:
    """Draw one skin with its foci. stimuli: stimuli, with the numbers of the foci to draw"""
    columns = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (title, colours, values) in zip(columns, panels, strict=True):
        faces, shown, limits = skin["face"].values, np.nan_to_num(values), (0.0, max(float(np.nanmax(values)), 1e-9))
        draw_patch(figure, axes, faces, view.vertices, shown, colours, limits, "Pa", SIDE_LOBES)
        for stimulus, numbers in stimuli:
            _draw_foci(axes, stimulus, view, numbers)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper right", labelcolor="white", facecolor="#333333", frameon=True, framealpha=0.6)
        span = np.ptp(view.vertices[:, :2], axis=0)
        # The title needs two lines for a narrow patch
        gap = ",\n" if span[1] > NARROW * span[0] else ", "
        axes.set_title(f"{title}{gap}max {_number(np.nanmax(values))} Pa")


def _draw_foci(axes: Any, stimulus: xr.Dataset, view: SkinView, numbers: list[int]) -> None:
    """Draw the paths of some foci while they are active, and their positions at the loudest moment."""
    foci = stimulus["foci"].values[:, numbers]
    way: Float = to_local(foci.reshape(-1, 3), view.pose).reshape(foci.shape)
    way[~stimulus["sounding"].values.astype(bool)] = np.nan
    for number in range(way.shape[1]):
        axes.plot(*(way[:, number, :2].T * 1e3), color="white", lw=0.6, alpha=0.5)
    now = foci_at(stimulus, view.loudest.place)
    if len(now):
        now = now[numbers]
        label = None if "focus" in axes.get_legend_handles_labels()[1] else "focus"
        axes.plot(*(to_local(now, view.pose)[:, :2].T * 1e3), "+", color="white", ms=12, mew=1.6, label=label)


def _draw_motion(figure: Any, skin: xr.Dataset, whose: str) -> None:
    time_s = skin["time"].values
    vertices = probe_vertices(skin["rest_position"].values, extremes(skin).peak)
    motion = at_vertices(skin, [vertex for vertex, _ in vertices])
    above, below = figure.subplots(2, 1)
    for (_, distance), course, colour, line in zip(vertices, motion.T, COLOURS, LINES, strict=False):
        label = "largest motion" if distance == 0 else f"{distance * 1e3:.1f} mm away"
        above.plot(time_s * 1e3, course * 1e6, line, color=colour, label=label)
    above.set(xlabel="time [ms]", ylabel="normal displacement [µm]")
    above.set_title(f"Normal displacement of the skin{whose} (negative: pushed in)")
    above.legend(loc="upper right", ncols=3)
    above.margins(x=0, y=0.2)
    _draw_spectra(below, time_s, motion)


def _draw_spectra(axes: Any, time_s: Float, motion: Any) -> None:
    try:
        spectra = [amplitude_spectrum(time_s, course.astype(float)) for course in motion.T]
    except MeasurementError as error:
        axes.text(0.5, 0.5, f"no spectrum: {error}", ha="center", va="center", transform=axes.transAxes, wrap=True)
        axes.set_axis_off()
        return
    frequency, first = spectra[0]
    peaks = spectral_peaks(frequency, first)
    top = max(first.max() * 1e6, 1e-9)
    for (_, amplitude), colour, line in zip(spectra, COLOURS, LINES, strict=False):
        axes.semilogy(frequency, np.maximum(amplitude * 1e6, 1e-9 * top), line, color=colour)
    last = max([1000.0] + [1.3 * at for at, _ in peaks])
    texts = [f"{at:.4g} Hz\n{_number(height * 1e6)} µm" for at, height in peaks]
    if min(np.diff(sorted(at for at, _ in peaks)), default=last) < LABEL * last:
        listed = "\n".join(text.replace("\n", ": ") for text in texts)
        axes.text(0.98, 0.95, listed, ha="right", va="top", fontsize=8, transform=axes.transAxes)
    else:
        for (at, height), text in zip(peaks, texts, strict=True):
            side = "left" if at < 0.5 * LABEL * last else "center"
            axes.annotate(text, (at, height * 1e6), (0, 6), textcoords="offset points", ha=side, fontsize=8)
    axes.set(xlim=(0, min(last, frequency[-1])), ylim=(top * 1e-4, top * 40))
    _lighten_log_axis(axes)
    axes.set(xlabel="frequency [Hz]", ylabel="amplitude [µm]")
    axes.set_title(f"Amplitude spectrum (single-sided, Hann window, DC excluded, bins of {frequency[0]:.3g} Hz)")


def _lighten_log_axis(axes: Any) -> None:
    """Draw the minor ticks of a logarithmic y axis as one line, and its powers of ten without the formula parser.

    This reduces the drawing time by a third.
    """
    low, high = axes.get_ylim()
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    minor = np.outer(decades, np.arange(2, 10)).ravel()
    minor = minor[(minor >= low) & (minor <= high)]
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(lambda value, _: "10" + str(round(np.log10(value))).translate(RAISED))
    axes.plot(
        np.zeros(len(minor)), minor, ls="", marker=TICKLEFT, ms=mpl.rcParams["ytick.minor.size"],
        mew=mpl.rcParams["ytick.minor.width"], color=mpl.rcParams["ytick.color"],
        transform=axes.get_yaxis_transform(), clip_on=False,
    )  # fmt: skip


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
