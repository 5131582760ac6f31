"""Draw one overview with a small picture of each kind that a run allows."""

import textwrap
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from palmfield.errors import MeasurementError, OutputError
from palmfield.files import made_folder
from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.pictures.options import Options
from palmfield.outputs.style import save, style

COLUMNS, SIDE_INCH = 4, 2.6
SMALL_DPI, DPI = 110, 150


def draw_sheet(result: xr.DataTree, path: Path) -> dict[str, str]:
    """Draw a small picture of every kind, with its name and description, into one PNG.

    Returns, by kind, the reasons why a picture could not be drawn. The overview shows the reason instead of the
    picture. Raises OutputError if the file cannot be written.
    """
    missing: dict[str, str] = {}
    made_folder(path.parent)
    rows = -(-len(KINDS) // COLUMNS)
    with style():
        size = (COLUMNS * SIDE_INCH, rows * SIDE_INCH)
        sheet = Figure(figsize=size, dpi=DPI, layout="constrained")
        axes = sheet.subplots(rows, COLUMNS, squeeze=False).ravel()
        for axis, (name, kind) in zip(axes, KINDS.items(), strict=False):
            try:
                figure = kind.draw(result, Options())
            except (OutputError, MeasurementError) as problem:
                missing[name] = str(problem)
                axis.text(0.5, 0.5, textwrap.fill(str(problem), 34), ha="center", va="center", fontsize=6)
            else:
                figure.set_dpi(SMALL_DPI)
                canvas = FigureCanvasAgg(figure)
                canvas.draw()
                axis.imshow(np.asarray(canvas.buffer_rgba()), interpolation="antialiased")
            axis.set_title(f"{name}\n{textwrap.fill(kind.about, 40)}", fontsize=7)
        for axis in axes:
            axis.set_axis_off()
        save(sheet, path, DPI)
    return missing
