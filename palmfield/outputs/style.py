"""Style of the figures, and saving of figures."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from palmfield.errors import OutputError
from palmfield.files import whole, writing
from palmfield.types import Float

RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#333333",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "savefig.facecolor": "white",
}
COLOURS = ("#c2410c", "#0f766e", "#4338ca")
LINES = ("-", "--", ":", "-.")
"""Line styles that can be distinguished without colour."""
LEAST_MM = 10.0
"""Smallest range of spatial axes [mm]. A fixed focus or hand would otherwise have no extent."""


def style() -> Any:
    """Return a context manager that sets the style of palmfield. Other figures of the process do not change."""
    return mpl.rc_context(RC)


def same_scale(axes: Any, x: Float, y: Float) -> None:
    """Set limits of equal length on both axes around points [mm]; NaN is ignored."""
    finite = np.isfinite(x) & np.isfinite(y)
    pairs = np.stack([x[finite], y[finite]]) if finite.any() else np.zeros((2, 1))
    middle = 0.5 * (pairs.min(axis=1) + pairs.max(axis=1))
    half = 0.55 * max(LEAST_MM, float(np.ptp(pairs, axis=1).max()))
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal", adjustable="box")


def signed_colours(low: float, high: float, cut_off: float = 0.0) -> Float:
    """Return colours from blue through white to red, shape (256, 4), with white at 0 for any limits.

    cut_off: fraction of the map at each end that is too dark to use
    """
    most = max(abs(low), abs(high))
    return np.asarray(mpl.colormaps["RdBu_r"](0.5 + (0.5 - cut_off) * np.linspace(low, high, 256) / most))


def beyond(values: Float, low: float, high: float) -> Any:
    """Return at which ends of a colour bar values exceed the range: "min", "max", "both" or "neither"."""
    slack = 1e-6 * (high - low)
    below, above = bool((values < low - slack).any()), bool((values > high + slack).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def rounded_down(value: float) -> float:
    """Return the largest number of the series 1, 2, 5, 10, 20, ... that is not above a value."""
    ten = 10.0 ** np.floor(np.log10(value))
    return float(ten * max(step for step in (1.0, 2.0, 5.0) if step * ten <= value * (1.0 + 1e-9)))


FORMATS = ("png", "svg", "pdf")


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Write a picture in one atomic step; the suffix (FORMATS) sets the format. Text in SVG and PDF stays text.

    dpi: resolution of a PNG [pixels per inch]
    Raises OutputError for an unknown format, and if it cannot be written.
    """
    path = Path(path)
    kind = path.suffix[1:].lower()
    if kind not in FORMATS:
        raise OutputError(f"cannot write {path}: '{kind}' is not a picture format; allowed: {', '.join(FORMATS)}")
    with writing(path), whole(path) as part:
        if kind == "png":
            FigureCanvasAgg(figure).print_png(str(part), pil_kwargs={"dpi": (dpi, dpi), "compress_level": 3})
        else:
            FigureCanvasAgg(figure)
            with mpl.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42}):
                figure.savefig(part, format=kind)


def linear_rgb(srgb: Float) -> Float:
    """Return linear RGB of sRGB (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
