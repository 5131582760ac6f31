"""Draw Figures 3, 6, 7, 9, 11 and 13 of Hasegawa & Shinoda 2018, and results of sections 3 and 4, from our data."""

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import butter, sosfiltfilt

from palmfield.drive.boards.autd2018 import CARRIER_HZ, PACKET_RATE_HZ
from palmfield.drive.pulse_width import HASEGAWA_TICKS, Edge, edge_phase
from palmfield.outputs.style import COLOURS
from palmfield.stimulus.duty_law import relative_pressure
from palmfield_papers.answer import Picture, Setting
from palmfield_papers.hasegawa2018.drive import (
    DEFINITIONS,
    FREQUENCIES_HZ,
    Chain,
    emitted,
    levels_dB,
    packets,
)
from palmfield_papers.hasegawa2018.focus import DRIFT_PPM, STEPS_M, force, level_of_units, peaks_mm
from palmfield_papers.hasegawa2018.pulses import resample
from palmfield_papers.hasegawa2018.units import (
    DEPTHS_M,
    FORCE_DEPTH_M,
    Units,
    drive_of,
    focal_pressure,
    pressure_at,
)

HALF_MAP_M = 0.05
SHADES = ("#fdba74", "#f97316", "#c2410c", "#7c2d12", "#4338ca", "#1e1b4b")
"""Colours of the six depths, near to far."""


def focus_maps(setting: Setting) -> Figure:
    step = 2e-3 if setting.quick else 1e-3
    at = np.arange(-HALF_MAP_M, HALF_MAP_M + 0.5 * step, step)
    places = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
    figure = Figure(figsize=(10.5, 4.0), layout="constrained")
    panels = figure.subplots(2, len(DEPTHS_M), sharex=True, sharey=True)
    most = focal_pressure(Units(4), 0.2, "point")
    for row, count in enumerate((1, 4)):
        for column, depth in enumerate(DEPTHS_M):
            points = np.column_stack([places, np.full(len(places), depth)])
            level = np.abs(pressure_at(Units(count), points, drive_of(Units(count), depth), setting.device))
            panel = panels[row, column]
            image = panel.pcolormesh(
                1e3 * at,
                1e3 * at,
                (level / level.max()).reshape(len(at), -1).T,
                cmap="magma",
                vmin=0.0,
                rasterized=True,
            )
            share = level.max() / np.sqrt(2.0) / most
            panel.set_title(f"{1e3 * depth:.0f} mm: {share:.2f}", fontsize=9)
            panel.set_aspect("equal")
            panel.grid(False)
        panels[row, 0].set_ylabel(f"{count} unit{'s' if count > 1 else ''}\ny [mm]")
    for panel in panels[1]:
        panel.set_xlabel("x [mm]")
    figure.colorbar(image, ax=panels, label="pressure / largest of the panel")
    return figure


def cross_sections(setting: Setting) -> Figure:
    at = np.linspace(-0.1, 0.1, 401)
    figure = Figure(figsize=(8.5, 3.2), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    most = focal_pressure(Units(4), 0.2, "point")
    for panel, count in zip(panels, (1, 4), strict=True):
        for depth, colour in zip(DEPTHS_M, SHADES, strict=True):
            points = np.column_stack([at, np.zeros(len(at)), np.full(len(at), depth)])
            level = np.abs(pressure_at(Units(count), points, drive_of(Units(count), depth), setting.device))
            panel.plot(
                1e3 * at, level / np.sqrt(2.0) / most, color=colour, label=f"{1e3 * depth:.0f} mm", linewidth=1.1
            )
        panel.set(xlabel="x [mm]", title="One unit" if count == 1 else "Four units")
    panels[0].set_ylabel("rms pressure / four units at 200 mm")
    panels[1].legend(title="focus at", fontsize=7, title_fontsize=7)
    return figure


def axial(setting: Setting) -> Figure:
    depths = np.arange(0.1, 1.0001, 0.05 if setting.quick else 0.025)
    figure = Figure(figsize=(8.5, 3.4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    printed = {1: ((400.0, 0.5),), 4: ((800.0, 0.5), (1000.0, 0.4))}
    kinds = (("piston", "pistons of 4.5 mm"), ("table", "table of the T4010A1"), ("point", "points"))
    for panel, count in zip(panels, (1, 4), strict=True):
        for (directivity, label), colour in zip(kinds, COLOURS, strict=True):
            units = Units(count, directivity)
            for receiver, line in (("microphone", "-"), ("point", ":")):
                curve = np.array([focal_pressure(units, round(float(d), 6), receiver) for d in depths])
                name = label if receiver == "microphone" else None
                panel.plot(1e3 * depths, curve / focal_pressure(units, 0.2, receiver), line, color=colour, label=name)
        for depth, share in printed[count]:
            panel.errorbar(depth, share, yerr=0.25 * share, fmt="ko", markersize=4, capsize=3)
        panel.set(xlabel="depth of the focus [mm]", title="One unit" if count == 1 else "Four units", ylim=(0.0, 2.0))
    panels[0].set_ylabel("pressure at the focus / at 200 mm")
    panels[1].legend()
    return figure


def forces(setting: Setting) -> Figure:
    edges = np.array([0.006, 0.009, 0.012, 0.016, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.4])
    figure = Figure(figsize=(5.5, 3.4), layout="constrained")
    panel = figure.subplots()
    for directivity, label, colour in (
        ("piston", "pistons of 4.5 mm", COLOURS[0]),
        ("table", "table of the T4010A1", COLOURS[1]),
    ):
        units = Units(4, directivity)
        found = np.array([force(units, float(edge), FORCE_DEPTH_M, setting.device)[0] for edge in edges])
        panel.semilogx(1e3 * edges, 20.0 * found / found[2], "o-", markersize=3, color=colour, label=label)
    panel.plot([12.0, 12.0], [20.0, 20.0], "ks", markersize=5, label="printed on 12 x 12 mm")
    panel.axhline(40.8, color="black", linestyle="--", linewidth=0.8, label="printed in all")
    panel.set(xlabel="edge of the square reflector [mm]", ylabel="force, 20 mN on 12 x 12 mm [mN]", ylim=(0.0, None))
    panel.legend()
    return figure


def pulse_width_law(setting: Setting) -> Figure:
    figure = Figure(figsize=(8.5, 3.2), layout="constrained")
    law, edge = figure.subplots(1, 2)
    duty = np.arange(0, HASEGAWA_TICKS // 2 + 1) / HASEGAWA_TICKS
    for exponent, colour in zip((1.0, 1.5, 2.0), COLOURS, strict=True):
        law.plot(duty, relative_pressure(duty, exponent) ** 2, color=colour, label=f"as sin(pi d), power {exponent:g}")
    law.set(xlabel="duty cycle d", ylabel="radiation pressure / largest", title="Law of the device")
    law.legend()
    kinds: tuple[tuple[Edge, str, str], ...] = (
        ("leading", "leading edge held, eq. 6", COLOURS[0]),
        ("centre", "centre held", COLOURS[1]),
    )
    for fixed, name, colour in kinds:
        turned = np.degrees(np.subtract(edge_phase(duty, fixed), edge_phase(0.5, fixed)))
        edge.plot(duty, turned, color=colour, label=name)
    edge.set(xlabel="duty cycle d", ylabel="phase [deg]", title="Phase of the sound")
    edge.legend()
    return figure


def saw_waves(setting: Setting) -> Figure:
    """Draw a saw-tooth wave of 50 Hz that is designed for three exponents, on a device with exponent 1.5."""
    rate, periods = 50.0, 6
    times = np.arange(0, periods / rate, 1.0 / PACKET_RATE_HZ)
    target = (times * rate) % 1.0
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey="row")
    low = butter(5, 3000.0, fs=CARRIER_HZ, output="sos")
    for column, (design, colour) in enumerate(zip((1.0, 1.5, 2.0), COLOURS, strict=True)):
        envelope = np.abs(emitted(packets(target, design), 25.0))
        arp = sosfiltfilt(low, envelope**2)
        at = np.arange(len(envelope)) / CARRIER_HZ
        shown = (at >= 2.0 / rate) & (at < 4.0 / rate)
        panels[0, column].fill_between(1e3 * at[shown], -envelope[shown], envelope[shown], color=colour, linewidth=0)
        panels[1, column].plot(1e3 * at[shown], arp[shown], color=colour)
        panels[1, column].plot(1e3 * at[shown], (at[shown] * rate) % 1.0, color="#888888", linewidth=0.8, linestyle=":")
        panels[0, column].set_title(f"Designed for p^{design:g}")
        panels[1, column].set_xlabel("time [ms]")
    panels[0, 0].set_ylabel("pressure / largest")
    panels[1, 0].set_ylabel("radiation pressure / largest")
    return figure


def flatness_curves(setting: Setting) -> Figure:
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for panel, definition in zip(panels, DEFINITIONS, strict=True):
        for quality, colour in ((17.0, COLOURS[2]), (25.0, COLOURS[0]), (40.0, COLOURS[1])):
            for flight, line in ((False, "-"), (True, ":")):
                levels = levels_dB(definition, Chain(quality, 90.0, flight=flight))
                name = None if flight else f"Q {quality:g}"
                panel.semilogx(FREQUENCIES_HZ, levels - levels[0], line, marker=".", color=colour, label=name)
        panel.axhspan(-2.0, 0.0, color="#000000", alpha=0.06, linewidth=0)
        panel.set(xlabel="modulation frequency [Hz]")
        panel.set_title(definition[0].upper() + definition[1:], fontsize=8)
    panels[0].set_ylabel("level / at 5 Hz [dB]")
    panels[0].legend()
    return figure


def beat(setting: Setting) -> Figure:
    """Draw the pressure in the focus over time if the clocks drift. They are synchronised every 500 us or never."""
    times = np.linspace(0.0, 2.0, 801)
    figure = Figure(figsize=(6.5, 2.8), layout="constrained")
    panel = figure.subplots()
    for label, since, colour in (
        ("never set", times, COLOURS[0]),
        ("set every 500 us, 1 us of skew", np.full(len(times), 0.5 / PACKET_RATE_HZ), COLOURS[1]),
    ):
        panel.plot(times, level_of_units(Units(4), since), color=colour, label=label)
    panel.set(xlabel="time [s]", ylabel="pressure / in step", ylim=(0.0, 1.05))
    panel.legend(loc=(0.42, 0.72))
    return figure


def smoothing(setting: Setting) -> Figure:
    """Draw the spectrum of the pressure envelope for a sine of 100 Hz: with constant and with filtered duty.

    Constant duty stays for 20 periods.
    """
    times = np.arange(0.0, 1.0, 1.0 / PACKET_RATE_HZ)
    duty = packets(0.5 + 0.5 * np.sin(2.0 * np.pi * 100.0 * times), 1.5) / HASEGAWA_TICKS
    ratio = round(CARRIER_HZ / PACKET_RATE_HZ)
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    panel = figure.subplots()
    for label, course, colour in (
        ("held for 20 periods", np.repeat(duty, ratio), COLOURS[0]),
        ("filtered", np.clip(resample(duty, PACKET_RATE_HZ, carrier_Hz=CARRIER_HZ), 0.0, 0.5), COLOURS[1]),
    ):
        # Whole periods away from the ends, where the filter has no more packets
        envelope = relative_pressure(np.asarray(course, dtype=float), 1.5)[len(course) // 10 : -len(course) // 10]
        lines = np.abs(np.fft.rfft(envelope)) / len(envelope)
        f = np.fft.rfftfreq(len(envelope), 1.0 / CARRIER_HZ)
        loud = (lines > 1e-6) & (f > 0.0) & (f < 10e3)
        panel.vlines(
            1e-3 * f[loud], -120.0, 20.0 * np.log10(2.0 * lines[loud]), color=colour, label=label, linewidth=1.4
        )
    panel.set(xlabel="frequency in the envelope [kHz]", ylabel="level [dB of full drive]", ylim=(-100.0, 0.0))
    panel.legend()
    return figure


def steps(setting: Setting) -> Figure:
    figure = Figure(figsize=(4.6, 3.4), layout="constrained")
    panel = figure.subplots()
    for directivity, label, marker, colour in (
        ("piston", "pistons of 4.5 mm", "o", COLOURS[0]),
        ("table", "table of the T4010A1", "x", COLOURS[1]),
    ):
        off = np.array(peaks_mm(Units(4, directivity), True)) - 1e3 * STEPS_M
        panel.plot(1e3 * STEPS_M, 1e3 * off, marker + "-", color=colour, label=label, linewidth=0.8)
    panel.axhline(0.0, color="#888888", linewidth=0.8)
    panel.set(xlabel="commanded x [mm]", ylabel="largest pressure less command [um]", ylim=(-25.0, 25.0))
    panel.legend()
    return figure


PICTURES = (
    Picture(
        "focus_maps",
        "Figure 11: pressure in the focal plane of one and four units at six depths (pistons, at points). Above "
        "each: its maximum relative to that of four units at 200 mm.",
        focus_maps,
    ),
    Picture("cross_sections", "Figure 11: the same along x through the focus.", cross_sections),
    Picture(
        "axial",
        "Figure 13: pressure at the focal point over its depth, through the microphone (lines) and at a point "
        "(dotted). Black: the printed halvings and 40 %, with the tolerance of 25 %.",
        axial,
    ),
    Picture("forces", "Force on a square reflector at 200 mm over its edge, scaled to 20 mN on 12 x 12 mm.", forces),
    Picture(
        "pulse_width_law",
        "Figure 6: radiation pressure over the duty cycle by three exponents, and the effect of eq. 6 on the phase.",
        pulse_width_law,
    ),
    Picture(
        "saw_waves",
        "Figure 7: a saw wave of 50 Hz designed for three exponents, on a device with exponent 1.5 and quality 25; "
        "radiation pressures behind the 3 kHz filter. Dotted: requested.",
        saw_waves,
    ),
    Picture(
        "flatness",
        "Figure 9: level over the modulation frequency by three definitions, packets on crests; dotted: with the "
        "flight of the sound from all four units. Grey: 2 dB.",
        flatness_curves,
    ),
    Picture(
        "beat",
        f"Figure 3: pressure in the focus if the clocks of the four units differ by up to {DRIFT_PPM:g} ppm (assumed).",
        beat,
    ),
    Picture(
        "smoothing",
        "Section 4.2: images of a 100 Hz sine about multiples of 2 kHz in the envelope, with duty cycles held and "
        "filtered.",
        smoothing,
    ),
    Picture("steps", "Section 3.4: error of the focal position in commands of 0.5 mm; four units, 200 mm.", steps),
)
