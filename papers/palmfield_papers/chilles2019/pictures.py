"""Draw Figures 2 to 5 of Chilles et al. 2019 from our data, and the effects of base, sides and chains."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmfield.metrics import amplitude_spectrum
from palmfield.outputs.style import COLOURS
from palmfield.types import Float
from palmfield_papers.answer import Picture, Setting
from palmfield_papers.chilles2019.chains import Explained, all_explained
from palmfield_papers.chilles2019.filter_rows import ORDERS, SIX
from palmfield_papers.chilles2019.maps import Circles, grid_axis, measured_circles, measured_map
from palmfield_papers.chilles2019.modulated_rows import gained
from palmfield_papers.chilles2019.setup import (
    CIRCLE_RADIUS_M,
    RADIUS_M,
    SIDES,
    STIMULUS_S,
    Probe,
    Stimulus,
    case_of,
)
from palmfield_papers.chilles2019.traces import Trace, measured, raw

SHADES = ("#9a9a9a", *COLOURS)


def _line(panel: Axes, trace: Trace, label: str, colour: str) -> None:
    panel.plot(1e3 * trace.times_s, trace.values, color=colour, label=label)


def _spectrum(panel: Axes, trace: Trace, label: str, colour: str) -> None:
    frequency, amplitude = amplitude_spectrum(trace.times_s, trace.values, taper="none")
    panel.semilogy(frequency, amplitude, color=colour, label=label, linewidth=1.0)


def _printed(panel: Axes, values: dict[str, float], colour: str) -> None:
    for label, value in values.items():
        panel.axhline(value, color=colour, linewidth=0.9, linestyle=":")
        panel.text(
            0.995,
            value,
            label,
            color=colour,
            fontsize=7,
            ha="right",
            va="bottom",
            transform=panel.get_yaxis_transform(),
        )


def step(setting: Setting) -> Figure:
    case = case_of(setting)
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _line(left, raw(case, "step"), "raw motion", COLOURS[0])
    for order, colour in zip(ORDERS, ("#5eada5", COLOURS[1], "#0a4f4a"), strict=True):
        trace = measured(case, "step", Probe(order=order))
        _line(left, trace, f"vibrometer, high-pass of order {order}", colour)
        _spectrum(right, trace, f"order {order}", colour)
    _spectrum(right, raw(case, "step"), "raw, 200 ms", COLOURS[0])
    _printed(left, {"FEM steady -2.2": -2.2, "FEM peak -3.05": -3.05}, COLOURS[0])
    _printed(left, {"measured steady -0.58": -0.58, "measured peak -1.02": -1.02}, COLOURS[1])
    left.set(
        xlim=(0, 60),
        ylim=(-3.3, 1.2),
        xlabel="time [ms]",
        ylabel="displacement [µm]",
        title="Focus that is held, 12 Pa",
    )
    right.axvspan(100, 500, color="#efefef", zorder=0)
    right.set(xlim=(0, 600), ylim=(1e-4, 1), xlabel="frequency [Hz]", ylabel="amplitude [µm]", title="Its spectrum")
    left.legend(fontsize=7, loc="upper right")
    right.legend(fontsize=7, loc="upper right")
    return figure


def conditions(setting: Setting) -> Figure:
    case = case_of(setting)
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for side, colour in zip(SIDES, SHADES, strict=True):
        _line(left, raw(replace(case, side=side), "step"), side.replace("_", "-"), colour)
    _line(right, raw(case, "step"), "base: bonded, 20 mm", SHADES[0])
    _line(right, raw(replace(case, base="free_slip"), "step"), "slides, 20 mm", SHADES[1])
    _line(right, raw(replace(case, thickness_m=0.01), "step"), "bonded, 10 mm", SHADES[2])
    _line(right, raw(replace(case, material="tau_printed"), "step"), "bonded, 20 mm, tau as printed", SHADES[3])
    for panel, title in ((left, "Raw motion by the sides"), (right, "By base, thickness and tau, sides fixed")):
        panel.set(xlim=(0, 60), xlabel="time [ms]", title=title)
        panel.legend(fontsize=7, loc="upper right")
    left.set_ylabel("displacement [µm]")
    return figure


def modulated(setting: Setting) -> Figure:
    return _two_columns(setting, "am_load", "am_pressure", "Modulated at 200 Hz", (0, 60))


def circle(setting: Setting) -> Figure:
    return _two_columns(setting, "stm", "stm", "On a circle at 70 Hz", (0, 100))


def _two_columns(setting: Setting, fem: Stimulus, optical: Stimulus, title: str, span: tuple[float, float]) -> Figure:
    case = case_of(setting)
    simulated, vibrated = raw(case, fem), gained(case, optical, Probe())
    figure = Figure(figsize=(9.0, 5.2), layout="constrained")
    panels = figure.subplots(2, 2)
    load = ", load modulated" if fem == "am_load" else ""
    pressure = ", pressure modulated" if optical == "am_pressure" else ""
    rows = (
        (simulated, f"raw motion, 12 Pa{load}", COLOURS[0]),
        (vibrated, f"vibrometer, order 2, gain of the step{pressure}", COLOURS[1]),
    )
    for (left, right), (trace, label, colour) in zip(panels, rows, strict=True):
        _line(left, trace, label, colour)
        left.axhline(0.0, color="#777777", linewidth=0.7)
        left.set(xlim=span, ylabel="displacement [µm]", title=label[0].upper() + label[1:])
        _spectrum(right, trace.until(STIMULUS_S - 1e-5), label, colour)
        right.set(xlim=(0, 600), ylim=(1e-4, 3), ylabel="amplitude [µm]")
    panels[0, 1].set_title(f"{title}: spectra over 200 ms")
    for panel in panels[1]:
        panel.set_xlabel("time [ms]" if panel is panels[1, 0] else "frequency [Hz]")
    return figure


def maps(setting: Setting) -> Figure:
    case, probe = case_of(setting), Probe()
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    axis = 1e3 * grid_axis()
    titles = ("Held", "Modulated at 200 Hz", "On a circle at 70 Hz")
    shown: list[Float] = [
        measured_map(case, "step", probe).values, measured_map(case, "am_pressure", probe).values,
        _on_grid(measured_circles(case, probe)),
    ]  # fmt: skip
    for panel, values, title in zip(panels, shown, titles, strict=True):
        inside = np.hypot(*np.meshgrid(axis, axis, indexing="ij")) <= 1e3 * RADIUS_M
        drawn = panel.imshow(
            np.where(inside, values, np.nan).T, origin="lower", extent=(axis[0], axis[-1], axis[0], axis[-1]),
            cmap="viridis", vmin=0.0,
        )  # fmt: skip
        panel.grid(False)
        panel.set(title=title, xlabel="x [mm], towards the head")
        figure.colorbar(drawn, ax=panel, label="rms over 256 ms [µm]", shrink=0.85)
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    radius = 1e3 * CIRCLE_RADIUS_M
    panels[2].plot(radius * np.cos(turn), radius * np.sin(turn), color="white", linewidth=0.7, linestyle=":")
    panels[0].set_ylabel("y [mm]")
    return figure


def _on_grid(circles: Circles) -> Float:
    """Interpolate circles on the grid of the other maps, linearly in radius and angle.

    It is constant beyond the last circle.
    """
    axis = grid_axis()
    x, y = np.meshgrid(axis, axis, indexing="ij")
    radii = np.concatenate([[0.0], circles.radii_m])
    values = np.vstack([np.full(circles.values.shape[1], circles.middle), circles.values])
    count = circles.values.shape[1]
    place = np.mod(np.arctan2(y, x), 2.0 * np.pi) * count / (2.0 * np.pi)
    before = np.floor(place).astype(int)
    by_angle = np.stack([np.interp(np.hypot(x, y), radii, column) for column in values.T])
    rows, columns = np.indices(x.shape)
    low, high = by_angle[before % count, rows, columns], by_angle[(before + 1) % count, rows, columns]
    return np.asarray(low + (place - before) * (high - low))


def _name(one: Explained) -> str:
    chain = one.chain
    order = "no filter" if chain.order == 0 else f"order {chain.order}, {chain.phase.replace('_', ' ')}"
    return f"{order}{', drift off' if chain.drift else ''}{', gain' if chain.gain else ', 12 Pa'}"


def chain_table(setting: Setting) -> Figure:
    found = all_explained(case_of(setting))
    names = list(dict.fromkeys(_name(one) for one in found))
    columns = list(dict.fromkeys((one.chain.azimuth_deg, one.chain.window) for one in found))
    table = np.zeros((len(names), len(columns)))
    for one in found:
        table[names.index(_name(one)), columns.index((one.chain.azimuth_deg, one.chain.window))] = len(one.within)
    figure = Figure(figsize=(7.5, 7.5), layout="constrained")
    panel = figure.subplots()
    drawn = panel.imshow(table, cmap="YlGnBu", vmin=0, vmax=len(SIX), aspect="auto")
    for (row, column), number in np.ndenumerate(table):
        panel.text(column, row, f"{number:.0f}", ha="center", va="center", color="white" if number > 3 else "#333333")
    panel.grid(False)
    panel.set_yticks(range(len(names)), names, fontsize=7)
    labels = [f"azimuth {azimuth:g}°\n{window.replace(' of the stimulus', '')}" for azimuth, window in columns]
    panel.set_xticks(range(len(columns)), labels, fontsize=7)
    panel.set_title("Numbers of six within a factor of 2")
    figure.colorbar(drawn, ax=panel, label="numbers within", shrink=0.6)
    return figure


PICTURES = (
    Picture(
        "step",
        "Figure 3 recomputed: constant focus. Left: raw motion and motion measured by the vibrometer; dotted: printed "
        "values. Right: spectra, with the range of row C16 in grey.",
        step,
    ),
    Picture(
        "conditions",
        "The same raw motion by sides, which the paper leaves open, and by base, thickness and characteristic time.",
        conditions,
    ),
    Picture(
        "am",
        "Figure 4 recomputed: raw motion with a modulated load (FEM of the paper), and record of the vibrometer with a "
        "modulated pressure (measurement of the paper).",
        modulated,
    ),
    Picture("stm", "Figure 5 recomputed: the focus on the circle, at its start point (10 mm, 0).", circle),
    Picture(
        "rms_maps",
        "Figures 2b to 2d recomputed: rms over 256 ms through the vibrometer, high-pass of order 2, head towards x, "
        "12 Pa. Dotted: the path.",
        maps,
    ),
    Picture(
        "chains",
        "Number of the six measured values (steady, peak, both peak-to-peak, both rms) that each chain of filter, "
        "phase, drift, level, azimuth and window explains.",
        chain_table,
    ),
)
