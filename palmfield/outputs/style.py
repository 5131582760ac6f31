"""Look of the figures, and how they are saved."""

import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from palmfield.errors import OutputError

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


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Write a PNG in one atomic step. Raises OutputError where it cannot be written."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        FigureCanvasAgg(figure).print_png(str(temporary), pil_kwargs={"dpi": (dpi, dpi)})
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error.strerror or error}; choose a folder on a disk with room for it"
        ) from error
