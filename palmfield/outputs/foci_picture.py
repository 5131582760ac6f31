"""A picture of decoded foci: where they lie, seen from above and from the side, and when."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palmfield.types import Float


def draw_foci(times_s: Sequence[float], foci: Float, path: Path) -> None:
    """Draw foci [m], shape (n, 3), NaN where there is none, by their times [s], into a PNG.

    Raises OutputError where it can't be written.
    """
    from matplotlib.figure import Figure

    from palmfield.outputs.style import same_scale, save

    figure = Figure(figsize=(9.0, 3.6), dpi=120, layout="constrained")
    above, side, course = figure.subplots(1, 3)
    moments, places = 1e3 * np.asarray(times_s), 1e3 * foci
    dots = above.scatter(places[:, 0], places[:, 1], c=moments, s=12)
    side.scatter(places[:, 0], places[:, 2], c=moments, s=12)
    for axes, up in ((above, 1), (side, 2)):
        axes.set_xlabel("x [mm]")
        axes.set_ylabel(f"{'xyz'[up]} [mm]")
        same_scale(axes, places[:, 0], places[:, up])
    for number, name in enumerate("xyz"):
        # A single moment is no line
        course.step(moments, places[:, number], "." if len(moments) == 1 else "", where="post", label=name)
    course.set_xlabel("time [ms]")
    course.set_ylabel("focus [mm]")
    course.legend()
    figure.colorbar(dots, ax=side, label="time [ms]")
    save(figure, path, dpi=120)
