"""Draw the normal motion of the skin along a straight line, over space and time."""

import numpy as np
import xarray as xr
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from palmfield.errors import OutputError
from palmfield.outputs.frames import in_world
from palmfield.outputs.motion import extremes, normal_component
from palmfield.outputs.pictures.options import IN_MICRO, UNITS, Kind, Options, chosen_skin, chosen_vertices, limits_of
from palmfield.outputs.schema import instances
from palmfield.outputs.style import beyond, signed_colours

FEWEST = 8
"""Smallest number of vertices near the line."""


def wavefronts(result: xr.DataTree, options: Options) -> Figure:
    """Draw normal motion along a line on the skin, over time. A straight front is a wave with constant speed.

    The line goes through the first two requested places, or along the largest extent of the skin through the vertex of
    largest motion. Vertices within the mesh spacing of the line are shown, at their position along it.
    """
    name, skin = chosen_skin(result, options, options.quantity)
    at_rest = in_world(skin, instances(result, "body").get(name), float(skin["time"].values[0]))
    if len(options.places) == 1:
        raise OutputError("wavefronts need a line; give --place twice, or omit it")
    if options.places:
        (first, _), (second, _) = chosen_vertices(result, name, skin, options)[:2]
        if first == second:
            raise OutputError("both ends of the line have the same nearest vertex; give --place values farther apart")
        middle, way = at_rest[first], at_rest[second] - at_rest[first]
    else:
        middle = at_rest[int(extremes(skin, options.quantity).peak.argmax())]
        way = np.linalg.svd(at_rest - at_rest.mean(axis=0), full_matrices=False)[2][0]
    way = way / np.linalg.norm(way)
    faces = skin["face"].values
    spacing = float(np.median(np.linalg.norm(at_rest[faces[:, 0]] - at_rest[faces[:, 1]], axis=1)))
    along = (at_rest - middle) @ way
    distance = np.linalg.norm(at_rest - middle - along[:, None] * way, axis=1)
    near = np.flatnonzero(distance <= spacing)
    if len(near) < FEWEST:
        raise OutputError(f"{len(near)} vertices lie near the line; needed: {FEWEST} or more; give points on the skin")
    order = near[np.argsort(along[near])]
    motion = IN_MICRO * normal_component(skin.isel(vertex=order), options.quantity).values.astype(float)
    largest = max(float(np.abs(motion).max()), 1e-9)
    low, high = limits_of(options, -largest, largest)
    colours = ListedColormap(signed_colours(low, high))
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    times = 1e3 * skin["time"].values
    drawn = axes.pcolormesh(times, 1e3 * along[order], motion.T, cmap=colours, vmin=low, vmax=high, shading="nearest")
    axes.set(xlabel="time [ms]", ylabel="along the line [mm]")
    axes.grid(visible=False)
    axes.set_title(f"Normal {options.quantity} along a line on the skin ({len(order)} vertices, negative: inward)")
    figure.colorbar(drawn, ax=axes, label=UNITS[options.quantity], extend=beyond(motion, low, high))
    return figure


KINDS = {"wavefronts": Kind.of_motion(wavefronts, "motion along a line on the skin, over time", place=23)}
