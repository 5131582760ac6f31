"""Draw a safety sheet: maps of levels in the sphere of the head and on the skins, with limits, and levels over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palmfield.types import Float

if TYPE_CHECKING:
    from matplotlib.tri import Triangulation

SHOWN_DB = 40.0
"""Range of the colour scale below the highest level [dB]."""
FAR = 4.0
"""Ratio of an edge to the median edge above which the edge crosses a gap."""


@dataclass(frozen=True)
class LevelMap:
    """Highest level of a play at each point of a region, projected to a plane.

    places_m: points in the plane [m], shape (n, 2)
    levels_dB: their levels, shape (n,)
    loudest_m: loudest point, shape (2,)
    loudest_dB: level at this point
    limits_dB: limits by name
    axes: names of the two directions of the plane
    """

    name: str
    places_m: Float
    levels_dB: Float
    loudest_m: Float
    loudest_dB: float
    limits_dB: Mapping[str, float]
    axes: tuple[str, str]


@dataclass(frozen=True)
class LevelCourse:
    """Highest level in each region at moments of a play. levels_dB: levels by region, shape (k,) each"""

    times_s: Float
    levels_dB: Mapping[str, Float]


def draw_levels(title: str, maps: Sequence[LevelMap], course: LevelCourse, path: Path) -> None:
    """Draw maps next to each other, and levels over time below them, into a PNG. Raises OutputError if that fails."""
    from matplotlib.figure import Figure

    from palmfield.outputs.style import LINES, save

    figure = Figure(figsize=(max(8.0, 4.6 * len(maps)), 7.0), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, len(maps), height_ratios=[3, 2])
    for number, one in enumerate(maps):
        axes = figure.add_subplot(grid[0, number])
        mesh = _meshed(1e3 * one.places_m)
        levels_dB = np.maximum(one.levels_dB, one.loudest_dB - SHOWN_DB)
        shown = axes.tripcolor(mesh, levels_dB, shading="gouraud", cmap="viridis")
        figure.colorbar(shown, ax=axes, label="dB SPL")
        limits = {what: limit for what, limit in one.limits_dB.items() if levels_dB.min() < limit < levels_dB.max()}
        if limits:
            ordered = sorted(limits.items(), key=lambda pair: pair[1])
            lines = axes.tricontour(mesh, levels_dB, levels=[limit for _, limit in ordered], colors="w", linewidths=1.0)
            axes.clabel(lines, fmt=lambda value: f"{value:g} dB", fontsize=7)
        axes.plot(*(1e3 * one.loudest_m), "r+", ms=10, mew=1.5)
        above = [f"{limit:g} ({what})" for what, limit in one.limits_dB.items() if one.loudest_dB > limit]
        outcome = "above " + ", ".join(above) if above else "below its limits" if one.limits_dB else "no limit is set"
        axes.set_title(f"{one.name}: {one.loudest_dB:.0f} dB at +\n{outcome}", fontsize=8)
        axes.set(xlabel=f"{one.axes[0]} [mm]", ylabel=f"{one.axes[1]} [mm]", aspect="equal")
    over = figure.add_subplot(grid[1, :])
    for number, (name, levels) in enumerate(course.levels_dB.items()):
        over.plot(
            course.times_s, levels, f".{LINES[number % len(LINES)]}",
            ms=3, lw=0.8, color=f"C{number}", label=f"loudest place of {name}",
        )  # fmt: skip
    for what, limit in {what: limit for one in maps for what, limit in one.limits_dB.items()}.items():
        place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
        over.axhline(limit, color="C3", lw=0.9, ls="--")
        over.annotate(f"head: {what}", (1.0, limit), fontsize=7, color="C3", **place)
    finite = np.concatenate([*course.levels_dB.values(), [limit for one in maps for limit in one.limits_dB.values()]])
    finite = finite[np.isfinite(finite)]
    if len(finite):
        over.set_ylim(max(finite.min(), finite.max() - 2.0 * SHOWN_DB) - 3.0, finite.max() + 5.0)
    over.set(xlabel="time of the play [s]", ylabel="dB SPL")
    over.legend(loc="lower left", fontsize=8)
    figure.suptitle(title, fontsize=11)
    save(figure, path, dpi=110)


def _meshed(places: Float) -> "Triangulation":
    """Return triangles between points, shape (n, 2), without triangles across gaps in the region."""
    from matplotlib.tri import Triangulation

    mesh = Triangulation(*places.T)
    corners = places[mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    mesh.set_mask(longest > FAR * np.median(longest))
    return mesh
