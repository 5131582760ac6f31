"""Draw a sweep: lines for one key, heat maps for two keys, otherwise points over each key."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from palmfield.errors import OutputError
from palmfield.outputs.style import COLOURS, LINES, save, style
from palmfield.studies.sweeps.store import FAILED, swept_keys
from palmfield.types import Float

DPI = 150
MARKS = "osD^v"
MOST_PANELS = 4
"""Largest number of keys over which points are drawn."""
MOST_TICKS = 7
"""Largest number of values that all have a label on an axis."""
SPACED = 3.0
"""Ratio for the choice of a logarithmic axis of positive values.

The axis is logarithmic if ratios of neighbours vary less than their differences, by this factor.
"""


class _Quantity(NamedTuple):
    """A drawn quantity. name: name of the variable; unit: unit on the axis; factor: factor from SI to this unit"""

    name: str
    title: str
    unit: str
    factor: float


LEVEL = _Quantity("level_all_lines", "Level above threshold", "dB SL", 1.0)
QUANTITIES = (LEVEL, _Quantity("peak_displacement", "Peak normal displacement", "µm", 1e6))
MORE = (_Quantity("peak_velocity", "Peak normal velocity", "mm/s", 1e3),)


def plot_sweep(dataset: xr.Dataset, path: Path) -> None:
    """Draw a PNG of level and peak displacement over the swept keys: lines, heat maps, or points.

    dataset: as returned by `open_dataset`. Raises OutputError if no point is done or `path` cannot be written.
    """
    keys = swept_keys(dataset)
    available = [quantity for quantity in QUANTITIES if _finite(dataset[quantity.name])]
    if not available:
        raise OutputError("no point of the sweep has results yet; the dataset contains the cause of each failure")
    with style():
        if "point" not in dataset.dims and len(keys) == 1:
            figure = _lines(dataset, keys[0], [*available, *MORE])
        elif "point" not in dataset.dims and len(keys) == 2:
            figure = _maps(dataset, keys, available)
        else:
            figure = _points(dataset, keys, available)
        failed = int((dataset["status"] == FAILED).sum())
        missing = int(dataset["status"].size - (dataset["status"] > 0).sum())
        notes = [f"{failed} points failed"] * bool(failed) + [f"{missing} points not computed yet"] * bool(missing)
        figure.suptitle(
            "; ".join([f"{Path(str(dataset.attrs['scene'])).stem}: {dataset['status'].size} points", *notes]),
            fontsize=9, color="#555555",
        )  # fmt: skip
        save(figure, path, DPI)


def _lines(dataset: xr.Dataset, key: str, quantities: list[_Quantity]) -> Figure:
    figure = Figure(figsize=(7.5, 2.5 * len(quantities)), dpi=DPI, layout="constrained")
    panels = figure.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0]
    places, words = _places(dataset, key)
    for axes, quantity in zip(panels, quantities, strict=True):
        curves = list(_curves(dataset, quantity))
        for number, (label, values) in enumerate(curves):
            colour = COLOURS[number % len(COLOURS)]
            mark = MARKS[number % len(MARKS)] + LINES[number % len(LINES)]
            axes.plot(places, values, mark, ms=3.5, color=colour, label=label)
        axes.set(ylabel=f"{quantity.title.lower()}\n[{quantity.unit}]")
        if quantity is LEVEL:
            axes.axhline(0.0, color="#999999", lw=0.8)
        else:
            axes.set_ylim(bottom=0.0)
        if any(label for label, _ in curves):
            axes.legend(loc="best", fontsize=8)
    _name_axis(panels[-1].xaxis, key, dataset, places, words)
    return figure


def _maps(dataset: xr.Dataset, keys: list[str], quantities: list[_Quantity]) -> Figure:
    """Draw one map for each quantity and skin. Levels are those of the first observer that has levels."""
    skins = [str(name) for name in dataset["skin"].values]
    figure = Figure(figsize=(4.6 * len(quantities), 3.9 * len(skins) + 0.3), dpi=DPI, layout="constrained")
    panels = figure.subplots(len(skins), len(quantities), squeeze=False)
    along, up = keys[1], keys[0]
    for row, skin in zip(panels, skins, strict=True):
        for axes, quantity in zip(row, quantities, strict=True):
            values = quantity.factor * _of(dataset, quantity).sel(skin=skin).transpose(up, along).values
            x, x_words = _places(dataset, along)
            y, y_words = _places(dataset, up)
            drawn = axes.pcolormesh(_edges(x), _edges(y), values, cmap="viridis", shading="flat")
            failed = np.argwhere(dataset["status"].transpose(up, along).values == FAILED)
            if len(failed):
                axes.plot(x[failed[:, 1]], y[failed[:, 0]], "x", color="#b91c1c", ms=7, label="failed")
                axes.legend(loc="upper right", fontsize=8)
            axes.grid(visible=False)
            axes.set_facecolor("#e5e5e5")  # colour of missing values
            for side in ("left", "bottom"):
                axes.spines[side].set_visible(False)
            figure.colorbar(drawn, ax=axes, pad=0.02, label=quantity.unit)
            title = quantity.title + (f"\n({_mapped_observer(dataset)})" if quantity is LEVEL else "")
            axes.set_title(title + (f", '{skin}'" if len(skins) > 1 else ""))
            _name_axis(axes.xaxis, along, dataset, x, x_words)
            _name_axis(axes.yaxis, up, dataset, y, y_words)
    return figure


def _points(dataset: xr.Dataset, keys: list[str], quantities: list[_Quantity]) -> Figure:
    """Draw each quantity over each key. In a grid, points with equal values differ in the other keys."""
    shown = keys[:MOST_PANELS]
    flat = dataset[[quantity.name for quantity in quantities]]
    if "point" not in dataset.dims:
        flat = flat.stack(point=keys, create_index=False)
    figure = Figure(figsize=(0.8 + 3.2 * len(shown), 2.8 * len(quantities)), dpi=DPI, layout="constrained")
    panels = figure.subplots(len(quantities), len(shown), sharey="row", sharex="col", squeeze=False)
    for row, quantity in zip(panels, quantities, strict=True):
        for axes, key in zip(row, shown, strict=True):
            places, words = _places(flat, key)
            for number, (label, values) in enumerate(_curves(flat, quantity)):
                colour = COLOURS[number % len(COLOURS)]
                axes.plot(
                    places, values, MARKS[number % len(MARKS)], ms=3.0, mew=0.0, alpha=0.7, color=colour, label=label
                )
            if axes is row[0]:
                axes.set(ylabel=f"{quantity.title.lower()}\n[{quantity.unit}]")
                if any(axes.get_legend_handles_labels()[1]):
                    axes.legend(loc="best", fontsize=8)
            if row is panels[-1]:
                _name_axis(axes.xaxis, key, flat, places, words)
    return figure


def _curves(dataset: xr.Dataset, quantity: _Quantity) -> list[tuple[str, Float]]:
    """Return label and values of each skin and observer along the remaining dimensions, in the unit of the quantity."""
    values = dataset[quantity.name]
    skins = [str(name) for name in dataset["skin"].values]
    curves = []
    for skin in skins:
        of_skin = values.sel(skin=skin)
        whose = [f"'{skin}'"] if len(skins) > 1 else []
        observers = [str(name) for name in dataset["observer"].values] if "observer" in of_skin.dims else [None]
        for observer in observers:
            one = of_skin if observer is None else of_skin.sel(observer=observer)
            if observer is not None and not _finite(one) and _finite(of_skin):
                continue  # no level at any point
            label = ", ".join([*whose, *([] if observer is None else [observer])])
            curves.append((label, quantity.factor * np.asarray(one.values, dtype=float)))
    return curves


def _of(dataset: xr.Dataset, quantity: _Quantity) -> xr.DataArray:
    values = dataset[quantity.name]
    return values.sel(observer=_mapped_observer(dataset)) if "observer" in values.dims else values


def _mapped_observer(dataset: xr.Dataset) -> str:
    """Return the first observer with a level at any point."""
    levels = dataset[LEVEL.name]
    return next(str(name) for name in levels["observer"].values if _finite(levels.sel(observer=name)))


def _finite(values: xr.DataArray) -> bool:
    return bool(np.isfinite(values.values).any())


def _places(dataset: xr.Dataset, key: str) -> tuple[Float, list[str]]:
    """Return the positions of the values of a key on an axis; if the values are texts, also their names."""
    values = dataset[key].values
    if values.dtype.kind in "fiu":
        return values.astype(float), []
    words, places = np.unique([str(value) for value in values], return_inverse=True)
    if dataset[key].dims == (key,):  # along a grid the order is that of the design
        return np.arange(len(values), dtype=float), [str(value) for value in values]
    return places.astype(float), [str(word) for word in words]


def _edges(places: Float) -> Float:
    """Return the borders of cells around positions. Outer cells are as wide as their neighbours."""
    if len(places) == 1:
        width = abs(places[0]) or 1.0
        return np.array([places[0] - 0.5 * width, places[0] + 0.5 * width])
    middles = 0.5 * (places[1:] + places[:-1])
    return np.concatenate([[2 * places[0] - middles[0]], middles, [2 * places[-1] - middles[-1]]])


def _name_axis(axis: Any, key: str, dataset: xr.Dataset, places: Float, words: list[str]) -> None:
    unit = dataset[key].attrs.get("units", "")
    axis.set_label_text(f"{key} [{unit}]" if unit else key)
    if words:
        axis.set_ticks(range(len(words)), words)
    elif len(places) <= MOST_TICKS and "point" not in dataset.dims:
        axis.set_ticks(places, [f"{place:.4g}" for place in places])
    if not words and len(places) > 2 and (places > 0.0).all() and "point" not in dataset.dims and _geometric(places):
        axis.axes.set(**{f"{axis.axis_name}scale": "log"})


def _geometric(places: Float) -> bool:
    """Return whether values increase by factors rather than by steps."""
    ordered = np.sort(places)
    ratios, steps = ordered[1:] / ordered[:-1], np.diff(ordered)
    return bool(np.ptp(np.log(ratios)) * SPACED < np.ptp(np.log(steps)))
