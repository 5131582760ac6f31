"""Draw every array layout and the field at its focus; writes docs/images/arrays/NAME.png and docs/arrays.md.

    python scripts/draw_arrays.py [NAME ...]

Fields are float64 sums (`palmfield.acoustics.reference`) at full drive in air of 20 C, 50 % humidity. With names, only
those pictures are made, and the page does not change.
"""

import argparse
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import brentq

from palmfield.acoustics.arrays import LAYOUTS, layout
from palmfield.acoustics.directivities.t4010a1 import T4010A1_DIRECTIVITY
from palmfield.acoustics.focus import focus
from palmfield.acoustics.layouts import TRANSDUCER_DIAMETER_M
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transducer import ANY_P0, ANY_QUALITY, table_misfit
from palmfield.outputs.style import save, style
from palmfield.types import Air, Array, Estimate

ROOT = Path(__file__).resolve().parents[1]
AIR = Air()
RADIUS_MM = TRANSDUCER_DIAMETER_M * 500
LABELLED = 300
"""Largest number of transducers of an array that are drawn with numbers."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Spot:
    """Focus of one array. Lengths in mm, between the points of half the focal pressure; peak over p0 in 1/m."""

    peak: float
    width_x: float
    width_y: float
    depth: float
    loudest_z: float


class Beam:
    """Pressure over p0 [1/m] of an array focused at its usual distance."""

    def __init__(self, name: str) -> None:
        self.array: Array = layout(name)
        self.at = np.array(LAYOUTS[name].focus_m)
        self.drive = focus(self.array, AIR, self.at)

    def along(self, axis: int, offsets_m: Values) -> Values:
        return self.magnitude(self.at + np.eye(3)[axis] * offsets_m[:, None])

    def magnitude(self, points: Values) -> Values:
        return np.abs(pressure64(points, self.array, self.drive, AIR)[0]) / self.array.p0_Pa_m


def half_point_m(beam: Beam, axis: int, sign: int) -> float:
    """Return the distance from the focus along an axis to the first half pressure; infinite if there is none."""
    peak = beam.magnitude(beam.at[None])[0]

    def excess(offset: float) -> float:
        return float(beam.along(axis, np.array([sign * offset]))[0] / peak) - 0.5

    depth = float(beam.at[2])
    reach = (
        np.linspace(0.0, (0.95 if sign < 0 else 6.0) * depth, 1200) if axis == 2 else np.linspace(0, 0.5 * depth, 600)
    )
    below = np.flatnonzero(beam.along(axis, sign * reach) < 0.5 * peak)
    if len(below) == 0:
        return float("inf")
    return float(brentq(excess, reach[below[0] - 1], reach[below[0]]))


def spot(beam: Beam) -> Spot:
    heights = np.linspace(-0.9, 1.0, 800) * beam.at[2]
    axial = beam.along(2, heights)
    x, y, z = (1e3 * (half_point_m(beam, axis, -1) + half_point_m(beam, axis, 1)) for axis in range(3))
    loudest = 1e3 * float(beam.at[2] + heights[np.argmax(axial)])
    return Spot(float(beam.magnitude(beam.at[None])[0]), x, y, z, loudest)


def draw_top(axes: Axes, array: Array) -> None:
    place = array.positions * 1e3
    order = np.arange(len(array))
    # a tilted disc is seen as an ellipse, narrow along the direction in which it leans
    lean = np.degrees(np.arctan2(array.normals[:, 1], array.normals[:, 0]))
    size = np.full(len(array), 2 * RADIUS_MM)
    discs = EllipseCollection(
        size * array.normals[:, 2], size, lean, units="xy", offsets=place[:, :2], offset_transform=axes.transData,
        array=order, cmap="viridis", alpha=0.55, edgecolor="#333333", linewidth=0.4,
    )  # fmt: skip
    axes.add_collection(discs)
    shown = order if len(array) <= LABELLED else order[np.isin(order % 249, (0, 248))]
    for i in shown:
        axes.text(*place[i, :2], str(i), ha="center", va="center", fontsize=8 if len(shown) <= 16 else 5.5)
    arrows = array.normals[:, :2] * 12
    if np.any(arrows):
        axes.quiver(*place[:, :2].T, *arrows.T, angles="xy", scale_units="xy", scale=1, width=0.003, color="#c2410c")
    low, high = place.min(axis=0) - RADIUS_MM, place.max(axis=0) + RADIUS_MM
    axes.set_xlim(low[0] - 8, high[0] + 8)
    axes.set_ylim(low[1] - 8, high[1] + 8)
    what = "address" if array.address is not None else "index"
    axes.set_title(f"{len(array)} transducers, {what}; discs span {high[0] - low[0]:.1f} x {high[1] - low[1]:.1f} mm")
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")


def draw_side(axes: Axes, array: Array, at_mm: Values, across: int, show_focus: bool) -> None:
    """Draw transducers as discs seen from the side with their axes, along -y (across 0) or x (across 1)."""
    place, facing = array.positions[:, [across, 2]] * 1e3, array.normals[:, [across, 2]]
    edge = np.column_stack([facing[:, 1], -facing[:, 0]]) * RADIUS_MM
    axes.plot(*np.stack([place - edge, place + edge], axis=1).T, color="#4338ca", linewidth=2.0)
    axes.quiver(*place.T, *(facing * 12).T, angles="xy", scale_units="xy", scale=1, width=0.004, color="#c2410c")
    top = place[:, 1].max() + 16
    if show_focus:
        axes.plot(at_mm[across], at_mm[2], "+", color="black", markersize=10)
        top = at_mm[2] + 6
    axes.set_ylim(place[:, 1].min() - 8, top)
    axes.set_xlim(place[:, 0].min() - 12, place[:, 0].max() + 12)
    axes.set_aspect("equal")
    axes.set_title(f"seen along {'yx'[across]}, axes" + (", focus" if show_focus else ""))
    axes.set_xlabel("xy"[across] + " [mm]")
    axes.set_ylabel("z [mm]")


def draw_plane(axes: Axes, beam: Beam, across: int, up: int, u_mm: Values, v_mm: Values, peak: float) -> None:
    """Draw |p|/p0 over a plane through the focus, and the line of half its value at the focus."""
    points = np.tile(beam.at, (len(u_mm) * len(v_mm), 1))
    u, v = np.meshgrid(u_mm, v_mm)
    points[:, across], points[:, up] = u.ravel() * 1e-3, v.ravel() * 1e-3
    values = beam.magnitude(points).reshape(u.shape)
    levels = MaxNLocator(24).tick_values(0.0, 1.1 * peak)
    image = axes.contourf(u, v, values, levels, cmap="magma", extend="max")
    axes.contour(u, v, values, [0.5 * peak], colors="white", linewidths=0.9)
    axes.plot(beam.at[across] * 1e3, beam.at[up] * 1e3, "+", color="#22d3ee", markersize=9)
    axes.grid(False)
    axes.set_xlabel("xyz"[across] + " [mm]")
    axes.set_ylabel("xyz"[up] + " [mm]")
    axes.set_aspect("equal")
    if up == 2:
        axes.figure.colorbar(image, ax=axes, label="|p|/p0 [1/m]", shrink=0.9, ticks=levels[::4])


def draw(name: str, beam: Beam, found: Spot, folder: Path) -> Path:
    with style():
        figure = Figure(figsize=(13.0, 7.6), layout="constrained")
        grid = figure.add_gridspec(2, 3, width_ratios=[1.5, 1.0, 1.0], height_ratios=[2.6, 1.0])
        tall, flat = figure.add_subplot(grid[:, 1]), figure.add_subplot(grid[0, 2])
        draw_top(figure.add_subplot(grid[0, 0]), beam.array)
        bent = bool(np.ptp(beam.array.normals, axis=0).max() > 0.0)
        cells = grid[1, 0].subgridspec(1, 2 if bent else 1)
        for across in range(2 if bent else 1):
            draw_side(figure.add_subplot(cells[across]), beam.array, beam.at * 1e3, across, bent)
        depth = float(beam.at[2]) * 1e3
        reach = 0.22 * depth + 8.0
        side = np.linspace(-reach, reach, 101)
        draw_plane(tall, beam, 0, 2, side, np.linspace(0.3 * depth, 1.7 * depth, 221), found.peak)
        tall.set_title("vertical plane y = 0")
        draw_plane(flat, beam, 0, 1, side, side, found.peak)
        flat.set_title(f"focal plane z = {depth:.1f} mm")
        notes = figure.add_subplot(grid[1, 2])
        notes.axis("off")
        lines = [
            f"focus at z = {depth:.1f} mm, + in the planes",
            f"|p|/p0 there: {found.peak:.1f} 1/m",
            f"-6 dB width in x: {found.width_x:.1f} mm",
            f"-6 dB width in y: {found.width_y:.1f} mm",
            f"-6 dB depth in z: {text_mm(found.depth)} mm",
            f"loudest on the axis at z = {found.loudest_z:.1f} mm",
            "white lines: half of |p| at the focus",
        ]
        notes.text(0.0, 1.0, "\n".join(lines), va="top", linespacing=1.5)
        figure.suptitle(f"{name}: {LAYOUTS[name].about}", x=0.01, ha="left", fontsize=11)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.png"
        save(figure, path)
    # a palette of 256 colours, spread over those in use, is a third of the size
    shown = Image.open(path).convert("RGB")
    shown.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def text_mm(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "no end within 6 focal distances"


def sight_angles_deg(name: str) -> Values:
    """Return the angle between the axis of a bow and its speakers 1, 2 and 3, at the focus."""
    rays = (np.array(LAYOUTS[name].focus_m) - layout(name).positions)[:6]
    axis = rays.sum(axis=0)
    cosine = rays[:3] @ axis / np.linalg.norm(rays[:3], axis=1) / np.linalg.norm(axis)
    return np.degrees(np.arccos(cosine))


def in_phase(name: str) -> float:
    """Return |p| at the focus with all transducers in phase, relative to |p| of a focused drive."""
    beam = Beam(name)
    together, _ = pressure64(beam.at[None], beam.array, np.ones(len(beam.array)), AIR)
    return float(abs(together[0]) / beam.array.p0_Pa_m / beam.magnitude(beam.at[None])[0])


def bow_notes(spots: dict[str, Spot]) -> list[str]:
    names = [name for name in spots if name.startswith("two_bow")]
    lines = [
        "The layouts `two_bow_...` are from Mizushima & Sato 2024. At the focus, the paper prints angles of 40, 28 and "
        "10 deg between the speakers and the axis of a bow. The printed half-widths of the focus are 3 mm in y, 10 mm "
        "in x and 8 mm in z; the conclusion of the paper exchanges x and z. The last column is |p| at the focus if all "
        "speakers have the same phase, divided by |p| if they are focused.",
        "",
        "| layout | angles [deg] | half-width y, x, z [mm] | same phase / focused |",
        "|---|---|---|---|",
    ]
    for name in names:
        angles = ", ".join(f"{angle:.1f}" for angle in sight_angles_deg(name))
        half = ", ".join(f"{w / 2:.1f}" for w in (spots[name].width_y, spots[name].width_x, spots[name].depth))
        lines.append(f"| {name} | {angles} | {half} | {in_phase(name):.2f} |")
    return lines


def page(spots: dict[str, Spot]) -> str:
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    lines = [
        "# Arrays",
        "",
        f"For everyone who chooses an array. Made by `python scripts/draw_arrays.py`, commit {commit}; do not edit. "
        "The table has the focus of each array at full drive, for linear sound in air of 20 C and 50 % humidity. The "
        "peak is "
        "|p| at the focus, divided by p0. Width and depth are those of the region where |p| is above half of the "
        "peak (-6 dB). The size is the distance between the outermost centres plus 10 mm. [Glossary](glossary.md).",
        "",
        "| layout | transducers | size [mm] | focus z [mm] | peak/p0 [1/m] | width x [mm] | width y [mm] | depth "
        "[mm] | loudest on axis at z [mm] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, found in spots.items():
        array, entry = layout(name), LAYOUTS[name]
        size = np.ptp(array.positions, axis=0) * 1e3 + 2 * RADIUS_MM
        lines.append(
            f"| [{name}](#{name}) | {len(array)} | {size[0]:.1f} x {size[1]:.1f} | {entry.focus_m[2] * 1e3:.1f} | "
            f"{found.peak:.1f} | {found.width_x:.1f} | {found.width_y:.1f} | {text_mm(found.depth)} | "
            f"{found.loudest_z:.1f} |"
        )
    lines += ["", *NOTES]
    lines += [*bow_notes(spots), ""]
    lines += [
        "The measured directivity of the T4010A1 is a table. palmfield uses a polynomial, which differs from this "
        "table by at most "
        f"{table_misfit(T4010A1_DIRECTIVITY):.4f} of the value on the axis.",
        "",
    ]
    lines += ["## How loud the transducers are", "", *LEVEL, *level_table(spots), "", *CSV]
    first: dict[str, str] = {}
    for name in spots:
        entry = LAYOUTS[name]
        known = first.setdefault(entry.source, name)
        source = f"{entry.source}." if known == name else f"Source: that of {known}."
        lines += [f"## {name}", "", f"{entry.about}.", "", source, ""]
        lines += [f"![{name}](images/arrays/{name}.png)", ""]
    return "\n".join(lines)


def level_table(names: Iterable[str]) -> list[str]:
    """Return rows of p0 and quality; layouts with equal numbers share a row."""
    rows: dict[tuple[Estimate, Estimate], list[str]] = {}
    for name in names:
        rows.setdefault((LAYOUTS[name].p0, LAYOUTS[name].quality), []).append(name)
    rows.setdefault((ANY_P0, ANY_QUALITY), []).extend(["sites", "csv"])
    lines = ["| layouts | p0 [Pa m] | range | kind | source | Q | range of Q |", "|---|---|---|---|---|---|---|"]
    for (p0, quality), same in rows.items():
        lines.append(
            f"| {', '.join(same)} | {p0.value:g} | {p0.low:g} to {p0.high:g} | {p0.kind} | {p0.source} | "
            f"{quality.value:g} | {quality.low:g} to {quality.high:g}, {quality.kind} |"
        )
    return lines


LEVEL = [
    "p0 is the peak pressure of one transducer at 1 m on its axis at full drive. ARP and motion are proportional "
    "to its square: a range of 0.7 to 2.6 Pa m is a factor of 14. p0 was not measured for any layout. So results "
    "are uncalibrated and have a range, until key `calibration` of `palmfield.array` names a "
    "[calibration](calibration.md). With key `arp_peak_Pa`, p0 decides only whether the array can reach the level. "
    "Q is the quality of the resonance.",
    "",
]
CSV = [
    "## Arrays from a file",
    "",
    "Layout `csv` reads the file that key `transducers` names. It has column names and one line per transducer. "
    "`x_m`, `y_m`, `z_m` (or `_mm`) are the position in the frame of the site of the array. `nx`, `ny`, `nz` are "
    "the direction of emission (default z). `gain` is relative to p0 (0 is dead, -1 inverted), `phase_deg` is the "
    "phase, and `address` the place in the byte order of the board.",
    "",
]
NOTES = [
    "In Python, `palmfield.acoustics.arrays` has functions for arrays. `from_poses` makes an array from positions "
    "and axes, `placed` moves it, `combined` joins several, and `with_faults` silences or inverts transducers. "
    "`palmfield.acoustics.focus.compensate` corrects phase errors, and "
    "`palmfield.acoustics.calibrate.calibrate_p0` estimates p0 from microphone readings.",
    "",
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(LAYOUTS)}; all by default")
    names = parser.parse_args().names or list(LAYOUTS)
    spots = {}
    for name in names:
        beam = Beam(name)
        spots[name] = spot(beam)
        path = draw(name, beam, spots[name], ROOT / "docs" / "images" / "arrays")
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB, {spots[name]}")
    if names == list(LAYOUTS):
        (ROOT / "docs" / "arrays.md").write_text(page(spots), encoding="utf-8")


if __name__ == "__main__":
    main()
