"""The short table that `palmfield run` prints at its end."""

import io
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from palmfield.perception.observers import OBSERVERS

WIDTH = 110
Row = tuple[str, str]


def format_summary(summary: Mapping[str, Any]) -> str:
    """The table of a run's numbers: the drive, a block a skin, and what the run took.

    summary: of `palmfield.outputs.summary.summary`. Further entries of a skin that are told where they are there:
    dofs, solver, accuracy_wanted_relative; displacement_error_relative with mesh_, step_, reduction_ and
    edge_error_relative, or displacement_error_missing (a reason); of modes reduction_velocity_error_relative;
    peak_displacement_low_m and _high_m; main_frequency_Hz and level_OBSERVER_dB_SL. Of a stimulus: drive_level. Of the
    run: wall_time_s, peak_memory_MiB.
    """
    skins, stimuli = summary["skins"], summary["stimuli"]
    drives = [
        ("drive" if len(stimuli) == 1 else f"drive, {one['name']}", f"{one['drive_level']:.3f} of full")
        for one in stimuli
        if "drive_level" in one
    ]
    level = max((one.get("drive_level", 0.0) for one in stimuli), default=0.0)
    grid = Table(show_header=False)
    for number, skin in enumerate(skins):
        sound, motion = _sound(skin, level), _motion(skin)
        # With one skin, sound, drive and motion stand in the order in which one follows from the other.
        rows = sound + drives + motion if len(skins) == 1 else [("SKIN", skin["name"]), *sound, *motion]
        if number == 0 and len(skins) > 1:
            rows = [*drives, *rows]
        for row in rows:
            grid.add_row(*row)
        if len(skins) > 1:
            grid.add_section()
    if "wall_time_s" in summary:
        took = f"{summary['wall_time_s']:.1f} s, {summary['peak_memory_MiB']:.0f} MiB"
        grid.add_row("wall time, peak memory", took)
    stream = io.StringIO()
    Console(file=stream, width=WIDTH).print(grid)
    return stream.getvalue()


def _sound(skin: Mapping[str, Any], drive_level: float) -> list[Row]:
    """drive_level: highest of all stimuli, relative to full"""
    rows: list[Row] = []
    if "peak_pressure_Pa" in skin and skin["peak_pressure_dB_SPL"] is not None:
        rows.append(
            ("peak sound pressure", f"{skin['peak_pressure_Pa']:.0f} Pa ({skin['peak_pressure_dB_SPL']:.1f} dB SPL)")
        )
    elif "peak_pressure_Pa" in skin:
        runs = f"no sound pushes this skin, though the array runs, at {drive_level:.3f} of full: see plan"
        rows.append(("peak sound pressure", runs if drive_level > 0.0 else "0 Pa (silence: the array doesn't run)"))
    if "peak_arp_Pa" in skin:
        rows.append(("peak ARP", f"{skin['peak_arp_Pa']:.3g} Pa"))
    if "total_force_peak_N" in skin:
        rows.append(("total force", f"{1e3 * skin['total_force_peak_N']:.3g} mN"))
    return rows


def _motion(skin: Mapping[str, Any]) -> list[Row]:
    error = skin.get("displacement_error_relative")
    band = "" if error is None else f" +- {100 * error:.1f} %"
    rows: list[Row] = []
    if "solver" in skin:
        unknowns = f"{skin['dofs']} unknowns, " if "dofs" in skin else ""
        rows.append(("skin", f"{unknowns}solver {skin['solver']}"))
    if "peak_displacement_m" in skin:
        rows.append(("peak skin displacement", f"{1e6 * skin['peak_displacement_m']:.3g} um{band}"))
        without = f"({1e6 * skin['rms_displacement_without_dc_m']:.3g} um without the mean)"
        rows.append(("rms skin displacement", f"{1e6 * skin['rms_displacement_m']:.3g} um{band} {without}"))
    if error is not None:
        velocity = skin.get("reduction_velocity_error_relative")
        of_velocity = "" if velocity is None else f" ({100 * velocity:.2g} % of the velocity)"
        rows.append(
            (
                "error estimate",
                f"mesh {100 * skin['mesh_error_relative']:.2f} %, "
                f"time step {100 * skin['step_error_relative']:.2f} %, "
                f"reduction {100 * skin['reduction_error_relative']:.2f} %{of_velocity}, "
                f"cut edge {100 * skin['edge_error_relative']:.2f} %; material and p0 not included (see plan)",
            )
        )
        requested = skin.get("accuracy_wanted_relative")
        if requested is not None and error > requested:
            rows.append(("accuracy", f"NOT reached: {100 * requested:g} % wanted; {advice(skin)}"))
    if "displacement_error_missing" in skin:
        rows.append(("error estimate", f"none: {skin['displacement_error_missing']}"))
    if "peak_displacement_low_m" in skin:
        low, high = skin["peak_displacement_low_m"], skin["peak_displacement_high_m"]
        rows.append(("peak for the p0 range", f"{1e6 * low:.3g} to {1e6 * high:.3g} um"))
    for number, name in enumerate(OBSERVERS, start=1):
        key = f"level_{name}_dB_SL"
        if key in skin:
            felt = "outside the table of" if skin[key] is None else f"{skin[key]:.1f} dB SL,"
            rows.append((f"level at {skin['main_frequency_Hz']:g} Hz", f"{felt} observer {number} ({name})"))
    return rows


def advice(skin: Mapping[str, Any]) -> str:
    """What would lower the largest part of a skin's error."""
    parts = {
        "a smaller --accuracy makes the mesh finer": skin["mesh_error_relative"],
        "a smaller --accuracy or step_s shortens the step": skin["step_error_relative"],
        "solver wedges leaves out the reduction": skin["reduction_error_relative"],
        "the layer's cut sides matter here: compare side fixed and free, or patch_radius_m": skin[
            "edge_error_relative"
        ],
    }
    return max(parts, key=lambda text: parts[text])
