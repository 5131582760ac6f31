"""Draw Figures 7, 8 and 9 of Mizushima & Sato 2024 from our data."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from palmfield.outputs.style import COLOURS
from palmfield_papers.answer import Picture, Setting
from palmfield_papers.mizushima2024.bows import bows_of, focus_of, mean_square
from palmfield_papers.mizushima2024.drive import course_over_frequency, parts
from palmfield_papers.mizushima2024.field import scan
from palmfield_papers.mizushima2024.gel import (
    Gel,
    course_um,
    frequencies,
    uniaxial_m,
)

PRINTED_MM = {"x": (10.0, 8.0), "y": (3.0,), "z": (8.0, 10.0)}


def half_widths(setting: Setting) -> Figure:
    """Draw curves along the three axes, for the base and for the focal length and radius that fit the angles."""
    base = bows_of(setting)
    short = replace(base, focal_length_m=30e-3, radius_m=5e-3)
    figure = Figure(figsize=(9.0, 5.2), layout="constrained")
    axes = figure.subplots(2, 3, sharey=True)
    for row, (name, bows) in enumerate((("50 mm, radius 6 mm", base), ("30 mm, radius 5 mm", short))):
        kinds = (
            ("both bows in step, point", replace(bows, receiver_m=0.0), "#bbbbbb"),
            ("in step, quarter inch", bows, COLOURS[0]),
            ("incoherent, quarter inch", replace(bows, coherent=False), COLOURS[1]),
        )
        for column, axis in enumerate("xyz"):
            panel = axes[row, column]
            for label, kind, colour in kinds:
                at, square = scan(kind, axis)
                panel.plot(1e3 * at, square, color=colour, label=label)
            for printed in PRINTED_MM[axis]:
                panel.plot([-printed, printed], [0.5, 0.5], "k.", markersize=5)
            panel.axhline(0.5, color="#999999", linewidth=0.8, linestyle=":")
            panel.set(xlim=(-30, 30) if axis != "z" else (-25, 45), ylim=(0, 1.05))
            panel.set_xlabel(f"{axis} from the focus [mm]")
        axes[row, 0].set_ylabel("radiation pressure / largest")
        axes[row, 0].set_title(f"Focal length {name}")
    axes[0, 2].legend(loc="upper right", fontsize=7)
    return figure


def focal_plane(setting: Setting) -> Figure:
    base = replace(bows_of(setting), receiver_m=0.0)
    short = replace(base, focal_length_m=30e-3, radius_m=5e-3)
    step = 0.5e-3 if setting.quick else 0.25e-3
    x, y = (np.arange(-wide, wide + 0.5 * step, step) for wide in (0.025, 0.012))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    figure = Figure(figsize=(7.0, 5.6), layout="compressed")
    panels = figure.subplots(2, 1, sharex=True)
    for panel, bows, name in zip(panels, (base, short), ("50 mm, radius 6 mm", "30 mm, radius 5 mm"), strict=True):
        points = np.column_stack([places, np.full(len(places), focus_of(bows)[2])])
        square = mean_square(bows, points).reshape(len(x), len(y))
        image = panel.pcolormesh(1e3 * x, 1e3 * y, (square / square.max()).T, cmap="magma", rasterized=True)
        panel.contour(1e3 * x, 1e3 * y, (square / square.max()).T, levels=[0.5], colors="white", linewidths=0.8)
        panel.set(ylabel="y [mm]", aspect="equal", title=f"Focal length {name}, both bows in step")
        panel.grid(False)
    panels[1].set_xlabel("x [mm]")
    figure.colorbar(image, ax=panels, label="radiation pressure / largest")
    return figure


def laws(setting: Setting) -> Figure:
    figure = Figure(figsize=(9.0, 2.9), layout="constrained")
    voltage, depth, course = figure.subplots(1, 3)
    v = np.linspace(0.0, 1.0, 41)
    voltage.plot(v, v**2, color=COLOURS[0])
    voltage.set(xlabel="voltage / largest", ylabel="part at f / largest", title="Voltage")
    m = np.linspace(0.05, 1.0, 20)
    found = [parts(float(value)) for value in m]
    for part, label, colour in zip(("mean", "first", "second"), ("steady", "at f", "at 2f"), COLOURS, strict=True):
        depth.plot(m, [one[part] for one in found], color=colour, label=label)
    depth.set(xlabel="modulation factor m", ylabel="radiation pressure / carrier's", title="Modulation factor")
    depth.legend()
    f = np.geomspace(1.0, 1000.0, 61)
    for quality, colour in zip((10.0, 25.0, 40.0), COLOURS, strict=True):
        course.semilogx(f, course_over_frequency(f, quality), color=colour, label=f"Q {quality:g}")
    course.axvline(300.0, color="#999999", linestyle=":", linewidth=0.8)
    course.set(xlabel="modulation frequency [Hz]", ylabel="part at f / at 0 Hz", title="Frequency", ylim=(0.0, 1.05))
    course.legend()
    return figure


def gels(setting: Setting) -> Figure:
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    f = frequencies()
    for panel, hardness in zip(panels, ("C0", "C7", "C15"), strict=True):
        bonded, slides = Gel(hardness), Gel(hardness, "free_slip")
        for label, values, colour in (
            ("bonded", course_um(bonded), COLOURS[0]),
            ("frictionless", course_um(slides), COLOURS[1]),
            ("uniaxial formula", np.array([1e6 * uniaxial_m(bonded, float(one)) for one in f]), COLOURS[2]),
        ):
            panel.loglog(f, values, "o-", markersize=3, color=colour, label=label)
        panel.axhline(170.0, color="black", linewidth=0.8, linestyle="--")
        panel.fill_between(f, 85.0, 340.0, color="#000000", alpha=0.06, linewidth=0)
        panel.set(xlabel="modulation frequency [Hz]", title=f"Gel {hardness}, 1 mm")
    panels[0].set_ylabel("amplitude at 4000 Pa [um]")
    panels[0].legend(fontsize=7)
    return figure


PICTURES = (
    Picture(
        "half_widths",
        "Figure 8: radiation pressure along the axes through the focus. Dots: the printed half-widths on either side.",
        half_widths,
    ),
    Picture(
        "focal_plane",
        "Figure 8b: radiation pressure in the focal plane, with the line of half its maximum.",
        focal_plane,
    ),
    Picture(
        "laws",
        "Figure 7: the part of the radiation pressure at the modulation frequency against voltage, modulation factor "
        "and frequency. The quality of the speakers is not printed; dotted: 300 Hz, above which it falls in the paper.",
        laws,
    ),
    Picture(
        "gels",
        "Figure 9c: displacement of a gel of 1 mm at 4000 Pa on the ellipse of half-widths 10 and 3 mm, by base. "
        "Dashed: the printed 170 um; grey: a factor of 2 about it. Moduli at other frequencies are assumed.",
        gels,
    ),
)
