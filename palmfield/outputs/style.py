"""Look of the figures, and how they are saved."""

import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from palmfield.errors import OutputError, unwritable

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


def style() -> Any:
    """Context in which figures get palmfield's look; other figures of the process keep theirs."""
    return mpl.rc_context(RC)


FORMATS = ("png", "svg", "pdf")


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Write a picture in one atomic step, in the format of its suffix (FORMATS); text of SVG and PDF stays text.

    dpi: what a PNG says of its size; its pixels are those of the figure's own dpi
    Raises OutputError for another format, and where it cannot be written.
    """
    path = Path(path)
    kind = path.suffix[1:].lower()
    if kind not in FORMATS:
        raise OutputError(f"cannot write {path}: format '{kind}' is none of a picture's; allowed: {', '.join(FORMATS)}")
    temporary = path.with_name(f".{path.stem}.tmp.{kind}")
    try:
        if kind == "png":
            FigureCanvasAgg(figure).print_png(str(temporary), pil_kwargs={"dpi": (dpi, dpi)})
        else:
            FigureCanvasAgg(figure)
            with mpl.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42}):
                figure.savefig(temporary, format=kind)
        os.replace(temporary, path)
    except OSError as error:
        raise unwritable(path, error) from error
