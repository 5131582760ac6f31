"""Draw the figures of the paper from our fields."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmfield.outputs.style import COLOURS, LINES
from palmfield.types import Float
from palmfield_papers.answer import Picture, Setting
from palmfield_papers.reardon2023 import figures, hand, lines
from palmfield_papers.reardon2023.configuration import DEEP, Plate, RADIUS_m, tissue_of
from palmfield_papers.reardon2023.phantom import SPEEDS, centroid_Hz, scanned_wake_cm
from palmfield_papers.reardon2023.resolution import level_of
from palmfield_papers.reardon2023.runs import straight

TWO = {"free, 0.02 Pa s": Plate(), "bonded, 1 Pa s": Plate(back="bonded", viscosity_Pa_s=1.0)}
"""The two readings in the figures: the base and another one."""
MACH = {3.0: "M = 0.6", 5.0: "M = 1", 7.0: "M = 1.4", 10.0: "M = 2"}


def _map(axes: Axes, places: Float, values: Float, *, signed: bool, half_m: float = RADIUS_m) -> None:
    """Draw a map relative to its largest magnitude, with axes in millimetres."""
    shown = np.abs(places) <= half_m * (1.0 + 1e-9)
    part = values[np.ix_(shown, shown)] / np.abs(values).max()
    end = 1e2 * places[shown][-1]
    axes.imshow(
        part.T, origin="lower", extent=(-end, end, -end, end), cmap="RdBu_r" if signed else "magma",
        vmin=-1.0 if signed else 0.0, vmax=1.0, interpolation="bilinear",
    )  # fmt: skip
    axes.grid(False)


def _scale(figure: Figure, all_axes: np.ndarray, label: str) -> None:
    for axes in all_axes[-1]:
        axes.set_xlabel("x [cm]")
    for axes in all_axes[:, 0]:
        axes.set_ylabel("y [cm]")
    image = all_axes.flat[0].images[0]
    figure.colorbar(image, ax=all_axes.ravel().tolist(), shrink=0.8, label=label)


def wakes(setting: Setting) -> Figure:
    """Draw Figure 1B: snapshots of straight runs."""
    figure = Figure(figsize=(9.6, 5.0), layout="constrained")
    all_axes = figure.subplots(2, 4, sharex=True, sharey=True)
    for row, (name, plate) in enumerate(TWO.items()):
        for axes, (speed, mach) in zip(all_axes[row], MACH.items(), strict=True):
            one = straight(plate, speed, 0.16, level_of(setting), setting.device)
            _map(axes, one.places_m, one.at_12_cm, signed=True)
            axes.plot([-8.0, 8.0], [0.0, 0.0], color="#777777", lw=0.5)
            axes.plot(4.0, 0.0, "o", ms=3.0, color="black", mfc="none")
            if speed > 5.0:
                slope = np.tan(np.arcsin(5.0 / speed))
                for sign in (-1.0, 1.0):
                    axes.plot([4.0, -2.0], [0.0, 6.0 * sign * slope], color="#222222", lw=0.8, ls="--")
            axes.set_title(f"{speed:g} m/s, {mach}" if row == 0 else "", fontsize=9)
        all_axes[row][0].annotate(name, (0.03, 0.05), xycoords="axes fraction", fontsize=8)
    _scale(figure, all_axes, "normal velocity / largest")
    return figure


def zs(setting: Setting) -> Figure:
    """Draw Figure 1A: the letter Z."""
    figure = Figure(figsize=(9.6, 4.8), layout="constrained")
    all_axes = figure.subplots(2, 4, sharex=True, sharey=True)
    for row, plate in enumerate(TWO.values()):
        first = figures.z_energy(plate, 0.06, 3.0, level_of(setting), setting.device)
        target = figures.design(figures.z_course(0.06, 3.0, level_of(setting)), first.places_m)
        _map(all_axes[row][0], first.places_m, target, signed=False, half_m=0.06)
        all_axes[row][0].set_title("design" if row == 0 else "", fontsize=9)
        for axes, speed in zip(all_axes[row][1:], (3.0, 5.0, 7.0), strict=True):
            drawn = figures.z_energy(plate, 0.06, speed, level_of(setting), setting.device)
            _map(axes, drawn.places_m, drawn.values, signed=False, half_m=0.06)
            axes.set_title(f"{speed:g} m/s, {MACH[speed]}" if row == 0 else "", fontsize=9)
    for axes, name in zip(all_axes[:, 0], TWO, strict=True):
        axes.annotate(name, (0.03, 0.05), xycoords="axes fraction", fontsize=8, color="white")
    _scale(figure, all_axes, "energy density / largest")
    return figure


def rates(setting: Setting) -> Figure:
    """Draw Figure 2: control rates."""
    figure = Figure(figsize=(9.6, 5.0), layout="constrained")
    all_axes = figure.subplots(2, 4, sharex=True, sharey=True)
    for row, (name, plate) in enumerate(TWO.items()):
        for axes, rate in zip(all_axes[row], (700.0, 1400.0, 4200.0, None), strict=True):
            delay = 0.0 if rate else -0.5 / lines.REFERENCE_Hz
            places, field = lines.held_snapshot(plate, rate, delay, level_of(setting), setting.device)
            _map(axes, places, field, signed=True)
            axes.set_title(("200 kHz" if rate is None else f"{1e-3 * rate:g} kHz") if row == 0 else "", fontsize=9)
        all_axes[row][0].annotate(name, (0.03, 0.05), xycoords="axes fraction", fontsize=8)
    _scale(figure, all_axes, "normal velocity / largest")
    return figure


def closed(setting: Setting) -> Figure:
    """Draw Figures 3 and 4B: rms velocity of squares and circles."""
    figure = Figure(figsize=(9.6, 7.0), layout="constrained")
    all_axes = figure.subplots(3, 4, sharex=True, sharey=True)
    level, device = level_of(setting), setting.device
    for column, speed in enumerate((5.0, 8.0, 9.0, 10.0)):
        for row, plate in enumerate(TWO.values()):
            drawn = figures.square_rms(plate, 0.03, speed, level, device)
            _map(all_axes[row][column], drawn.places_m, drawn.values, signed=False, half_m=0.05)
            all_axes[row][column].plot([-1.5, 1.5, 1.5, -1.5, -1.5], [-1.5, -1.5, 1.5, 1.5, -1.5], "w--", lw=0.6)
        all_axes[0][column].set_title(f"square, {speed:g} m/s", fontsize=9)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    for column, speed in enumerate((3.0, 5.0, 7.0, 10.0)):
        one = figures.circled(Plate(), 0.015, speed, level, device)
        _map(all_axes[2][column], one.map.places_m, one.map.values, signed=False, half_m=0.05)
        all_axes[2][column].plot(1.5 * np.cos(angle), 1.5 * np.sin(angle), "w--", lw=0.6)
        all_axes[2][column].set_title(f"circle, {speed:g} m/s", fontsize=9)
    for row, name in enumerate(("free, 0.02 Pa s", "bonded, 1 Pa s", "free, 0.02 Pa s")):
        all_axes[row][0].annotate(name, (0.03, 0.05), xycoords="axes fraction", fontsize=8, color="white")
    _scale(figure, all_axes, "rms velocity / largest")
    return figure


def _places(
    setting: Setting, of: Any, size: float, speeds: tuple[float, ...], profile: Any, place: Any, labels: tuple[str, str]
) -> tuple[Figure, Any, Any]:
    """Return, for each slab, a profile at the first speed, and the position of its maximum at all speeds [mm]."""
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (name, plate), colour, line in zip((TWO | {"60 mm deep": Plate(**DEEP)}).items(), COLOURS, LINES, strict=False):
        found = [of(plate, size, v, level_of(setting), setting.device) for v in speeds]
        at, values = profile(found[0])
        left.plot(at, values / values.max(), line, color=colour, label=name)
        marks: dict[str, Any] = {"marker": "o", "mfc": "none", "ms": 10.0 - 3.0 * len(right.lines)}
        right.plot(speeds, [place(one, size) for one in found], line, color=colour, **marks)
    left.set(xlabel=labels[0], ylabel=f"rms velocity at {speeds[0]:g} m/s / largest", ylim=(0.0, None))
    right.set(xlabel="speed of the focus [m/s]", ylabel=labels[1], xticks=speeds)
    left.legend(fontsize=7)
    return figure, left, right


def square_place(setting: Setting) -> Figure:
    """Draw R13c: rms velocity of the square over the distance inside its path, and the position of the maximum."""

    def profile(drawn: figures.Drawn) -> tuple[Float, Float]:
        across, at = 1e3 * np.abs(drawn.places_m), np.arange(-10.0, 16.0)
        inside = np.rint(15.0 - np.maximum(across[:, None], across))
        return at, np.array([drawn.values[inside == one].max() for one in at])

    names, speeds = ("distance inside the path [mm]", "largest of all, inside the path [mm]"), (8.0, 9.0, 10.0)
    figure, left, right = _places(setting, figures.square_rms, 0.03, speeds, profile, figures.inside_mm, names)
    left.axvspan(3.0, 15.0, color="#e5e5e5", zorder=0)
    right.bar([8.0], [12.0], 0.2, 3.0, color="#e5e5e5", zorder=0)
    return figure


def ring_place(setting: Setting) -> Figure:
    """Draw R14a: mean rms velocity of the circle by radius, and the radius of the ring by speed."""
    figure, left, right = _places(
        setting, figures.circled, 0.015, (10.0, 7.0, 5.0), lambda one: (1e3 * one.radii_m[:61], one.ring[:61]),
        lambda one, path: 1e3 * figures.ring_radius(one, path), ("radius [mm]", "radius of the ring [mm]"),
    )  # fmt: skip
    left.axvline(15.0, color="#888888", lw=0.8)
    right.bar([10.0, 7.0], right.lines[0].get_ydata()[1:], 0.6, color="#e5e5e5", zorder=0)
    right.set_ylim(10.0, 16.0)
    return figure


def on_hand(setting: Setting) -> Figure:
    """Draw Figure 7: the pass along the hand, wake lengths, and the observer."""
    figure = Figure(figsize=(9.6, 6.0), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.1))
    top, bottom = parts
    level = level_of(setting)
    plate = tissue_of(setting)
    maps = top.subplots(1, 5, sharey=True)
    for axes, speed in zip(maps, hand.SPEEDS, strict=True):
        one = hand.passed(plate, speed, level, setting.device)
        _map(axes, one.places_m, one.snapshot, signed=True)
        corners = 1e2 * np.array(hand.hand_course(speed, level).corners)
        axes.plot(*corners.T, color="#555555", lw=0.5)
        axes.set_title(f"{speed:g} m/s", fontsize=9)
        axes.set_xlabel("x [cm]")
    maps[0].set_ylabel("y [cm]")
    left, right = bottom.subplots(1, 2)
    for tissue, colour in (
        (plate, COLOURS[0]),
        (tissue_of(setting, viscosity_Pa_s=3.0), COLOURS[1]),
        (tissue_of(setting, shear_speed_m_s=3.0), COLOURS[2]),
    ):
        found = [hand.wake_cm(hand.passed(tissue, v, level, setting.device)) for v in hand.FELT]
        name = f"{tissue.shear_speed_m_s:g} m/s, {tissue.viscosity_Pa_s:g} Pa s"
        left.plot(hand.FELT, found, "o-", color=colour, label=name)
    left.axhline(10.0, color="#888888", lw=0.8, ls="--")
    left.set(xlabel="speed along the path [m/s]", ylabel="10 % wake [cm]", ylim=(0.0, None))
    left.legend(fontsize=7)
    of = hand.conditions(setting, level)
    for (name, shares), colour, form in zip(
        of.items(), (COLOURS[0], COLOURS[0], COLOURS[1], COLOURS[1]), ("o-", "s--", "o-", "s--"), strict=True
    ):
        right.plot(list(shares), list(shares.values()), form, color=colour, label=name)
    right.axhspan(50.0 - hand.CHANCE, 50.0 + hand.CHANCE, color="#e5e5e5", zorder=0)
    right.set(xlabel="speed along the path [m/s]", ylabel="right answers [%]", ylim=(43.0, 101.0))
    right.legend(fontsize=7)
    return figure


def spectra(setting: Setting) -> Figure:
    """Draw Figure 6B: wakes and spectra of the plate by speed."""
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for plate, colour, name in (
        (Plate(), COLOURS[0], "free, 0.02 Pa s"), (Plate(back="bonded"), COLOURS[1], "bonded, 0.02 Pa s"),
        (Plate(viscosity_Pa_s=1.0), COLOURS[2], "free, 1 Pa s"),
    ):  # fmt: skip
        found = [straight(plate, v, 0.16, level_of(setting), setting.device) for v in SPEEDS]
        left.plot(SPEEDS, [scanned_wake_cm(one) for one in found], "o-", color=colour, label=name)
        right.plot(SPEEDS, [centroid_Hz(one) for one in found], "o-", color=colour)
    left.axhline(12.0, color="#888888", lw=0.8, ls="--")
    left.set(xlabel="speed of the focus [m/s]", ylabel="10 % wake [cm]", ylim=(0.0, None))
    right.set(xlabel="speed of the focus [m/s]", ylabel="spectral centroid [Hz]", ylim=(0.0, None))
    left.legend(fontsize=7)
    return figure


PICTURES = (
    Picture(
        "fig1b_wakes",
        "Figure 1B: normal velocity after the focus (ring) has moved 12 of 16 cm, each relative to its maximum; "
        "dashed: asin(1/M) behind the focus.",
        wakes,
    ),
    Picture("fig1a_z", "Figure 1A: energy density of a Z of 6 cm, each relative to its maximum, and its design.", zs),
    Picture(
        "fig2_rates",
        "Figure 2: normal velocity at 7 m/s after 12 cm by control rate, each relative to its maximum.",
        rates,
    ),
    Picture(
        "fig3_4_closed",
        "Figures 3B and 4B: rms velocity of the square of 3 cm and the circle of 1.5 cm radius over five turns after "
        "five, each relative to its maximum; dashed: path.",
        closed,
    ),
    Picture(
        "r13c_square", "R13c, not explained: square of 3 cm. Grey: the place in the paper, at 8 m/s.", square_place
    ),
    Picture("r14a_ring", "R14a, not explained. Grey: the paper, within the free ring one speed below.", ring_place),
    Picture(
        "fig6b_plate",
        "Figure 6B: 10 % wake on the scan grid, with the 12 cm of the paper, and spectral centroid on the path.",
        spectra,
    ),
    Picture(
        "fig7_hand",
        "Figure 7: normal velocity at seven eighths of the zigzag, each relative to its maximum; 10 % wake, with the "
        "10 cm of the paper; expected right answers of the direction observer, chance in grey.",
        on_hand,
    ),
)
