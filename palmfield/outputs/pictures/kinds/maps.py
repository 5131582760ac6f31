"""Draw maps of a skin, seen from the array: pressure, motion at a time, rms motion, levels above threshold."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure

from palmfield.errors import OutputError, refuse_unknown
from palmfield.hand.triangles import vertex_areas
from palmfield.outputs.frames import in_world, to_local
from palmfield.outputs.motion import extremes, normal_component
from palmfield.outputs.pictures.options import (
    IN_MICRO,
    UNITS,
    Kind,
    Options,
    chosen_names,
    chosen_skin,
    chosen_time,
    chosen_vertices,
    limits_of,
)
from palmfield.outputs.plots import pressure_picture
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import instances
from palmfield.outputs.skin_view import SkinView, draw_patch, view_of_skin
from palmfield.outputs.style import signed_colours
from palmfield.perception.maps import felt_lines, lines_of, too_little_skin
from palmfield.perception.observers import OBSERVERS, levels_dB_SL
from palmfield.stimulus.resolved_keys import ResolvedStimulus
from palmfield.stimulus.schedule import steady_stretch_s
from palmfield.types import Float

SIZES = "cividis"
LEAST_LEVEL_DB = -20.0
"""Lowest level in maps [dB SL]. Lower levels are below threshold, and are drawn with this value."""
MARKERS = "os^Dv"


def pressure(result: xr.DataTree, options: Options) -> Figure:
    """Draw the peak pressure amplitude and the ARP on each skin, at the loudest moment or at a requested time.

    The view is from the array that the skin faces.
    """
    return pressure_picture(result, chosen_names(result, options), options.time_s)


def motion_map(result: xr.DataTree, options: Options) -> Figure:
    """Draw the normal displacement or velocity of the skin at a time. The default is the time of the largest motion."""
    name, skin = chosen_skin(result, options, options.quantity)
    found = extremes(skin, options.quantity)
    index = chosen_time(skin, options, int(found.when[found.peak.argmax()]))
    values = IN_MICRO * normal_component(skin, options.quantity, slice(index, index + 1)).values[0].astype(float)
    time_s = float(skin["time"].values[index])
    largest = float(np.abs(values).max())
    unit = UNITS[options.quantity]
    view = view_of_skin(result, name, skin)
    vertices = to_local(in_world(skin, instances(result, "body").get(name), time_s), view.pose)
    limits = limits_of(options, -max(largest, 1e-9), max(largest, 1e-9))
    colours = ListedColormap(signed_colours(*limits))
    range_of = f"{values.min():.3g} to {values.max():.3g} {unit}"
    title = f"Normal {options.quantity} at {1e3 * time_s:.2f} ms\n(negative: inward), {range_of}"
    marks = _marked(result, name, skin, options)
    return _one(view._replace(vertices=vertices), skin, values, colours, limits, unit, title, marks)


def rms_map(result: xr.DataTree, options: Options) -> Figure:
    """Draw the root mean square of the normal displacement or velocity over the run. The mean is included."""
    name, skin = chosen_skin(result, options, options.quantity)
    values = IN_MICRO * np.sqrt(extremes(skin, options.quantity).mean_square)
    unit = UNITS[options.quantity]
    title = f"RMS of the normal {options.quantity} over the run\n(mean included), maximum {values.max():.3g} {unit}"
    limits = limits_of(options, 0.0, float(values.max()))
    marks = _marked(result, name, skin, options)
    return _one(view_of_skin(result, name, skin), skin, values, SIZES, limits, unit, title, marks)


def level_map_of(result: xr.DataTree, options: Options) -> Figure:
    """Draw the level above threshold at each vertex, without summation over area, for one observer or for each that
    applies to the moving area.
    """
    name, skin = chosen_skin(result, options, "displacement")
    if options.observer is not None:
        refuse_unknown(OutputError, "--observer has value {}", options.observer, OBSERVERS)
    steady, lines = _repeating(result, skin)
    times = skin["time"].values[steady]
    motion = normal_component(skin, times=steady).values.astype(float)
    shown: list[tuple[str, Float]] = []
    areas = vertex_areas(skin["rest_position"].values, skin["face"].values)
    amplitudes = lines_of(times.astype(float), motion, lines)
    for key in [options.observer] if options.observer else list(OBSERVERS):
        refusal = too_little_skin(OBSERVERS[key], amplitudes, areas)
        if refusal and options.observer:
            raise OutputError(f"no map of observer {key}: {refusal}")
        if refusal:
            continue
        levels = levels_dB_SL(OBSERVERS[key], lines, amplitudes)
        if np.isfinite(levels).any():
            shown.append((key, np.maximum(levels, LEAST_LEVEL_DB)))
    if not shown:
        frequencies = ", ".join(f"{f:g}" for f in lines)
        raise OutputError(f"no observer has a threshold at {frequencies} Hz; see docs/results.md")
    top = max(float(levels.max()) for _, levels in shown)
    limits = limits_of(options, min(0.0, top), top)
    view = view_of_skin(result, name, skin)
    marks = _marked(result, name, skin, options)
    figure = Figure(figsize=(0.6 + 4.4 * len(shown), 4.6), layout="constrained")
    for axes, (key, levels) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        draw_patch(figure, axes, skin["face"].values, view.vertices, levels, SIZES, limits, "dB above threshold")
        _mark(axes, view.vertices, levels, "dB SL", marks)
        largest = f"maximum {levels.max():.0f} dB SL" if levels.max() > 0.0 else "below threshold"
        of = f"all {len(lines)} lines" if len(lines) > 1 else f"line at {lines[0]:g} Hz"
        axes.set_title(f"{OBSERVERS[key].name}, {of}\n{largest}")
    return figure


def _repeating(result: xr.DataTree, skin: xr.Dataset) -> tuple[slice, list[float]]:
    """Return the steady part of the records, and the main frequencies of the response to the stimuli.

    The steady part is between ramp and silence.

    Raises OutputError if the stimuli are not periodic, or last less than two periods.
    """
    configs = [keys_of(ResolvedStimulus, name, one) for name, one in instances(result, "stimulus").items()]
    times: Float = skin["time"].values
    for config in configs:
        begin, end = steady_stretch_s(config)
        stretch = slice(*np.searchsorted(times, [begin, min(end, np.inf)]).tolist())
        if lines := felt_lines(times[stretch], config):
            return stretch, lines
    raise OutputError(
        "the load does not repeat for two periods between ramp and silence, so no level above threshold can be "
        "computed; use AM or a closed path, or run for longer"
    )


def _marked(result: xr.DataTree, name: str, skin: xr.Dataset, options: Options) -> list[tuple[int, str]]:
    """Return vertices and descriptions of the requested places."""
    return chosen_vertices(result, name, skin, options) if options.places else []


def _mark(axes: Any, vertices: Float, values: Float, unit: str, marks: list[tuple[int, str]]) -> None:
    """Mark places on a map, with their values in the legend below."""
    for number, (vertex, what) in enumerate(marks):
        axes.plot(
            *(1e3 * vertices[vertex, :2]), MARKERS[number % len(MARKERS)], ms=6, mfc="none", mec="black", mew=1.2,
            ls="none", label=f"{what}: {values[vertex]:.3g} {unit}",
        )  # fmt: skip
    if marks:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), fontsize=8)


def _one(
    view: SkinView,
    skin: xr.Dataset,
    values: Float,
    colours: str | Colormap,
    limits: tuple[float, float],
    unit: str,
    title: str,
    marks: list[tuple[int, str]],
) -> Figure:
    figure = Figure(figsize=(5.6, 5.2), layout="constrained")
    axes = figure.subplots()
    draw_patch(figure, axes, skin["face"].values, view.vertices, values, colours, limits, unit)
    _mark(axes, view.vertices, values, unit, marks)
    axes.set_title(title)
    return figure


LEVELS_HEED = frozenset({"places", "limits", "skin", "observer"})
KINDS = {
    "pressure": Kind(
        pressure, "peak pressure and ARP on each skin at their largest", frozenset({"time_s", "skin"}), place=1
    ),
    "motion": Kind.of_motion(motion_map, "normal displacement or velocity of the skin at one time", "time_s", place=10),
    "rms": Kind.of_motion(rms_map, "root mean square of the skin motion over the run", place=11),
    "levels": Kind(level_map_of, "level above threshold on the skin, by observer", LEVELS_HEED, "dB SL", 12),
}
