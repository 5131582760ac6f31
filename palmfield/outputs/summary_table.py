"""The short table that `palmfield run` prints at its end."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from palmfield.outputs.budget_text import COARSE, Row, budget_rows, figures, widest
from palmfield.perception.registry import ALL_OBSERVERS
from palmfield.terminal import columns, folded

WIDTH = 110
"""Columns of the table where the terminal is no narrower."""


def format_summary(summary: Mapping[str, Any]) -> str:
    """The table of a run's numbers: the drive, a block a skin, and what the run took.

    summary: of `palmfield.outputs.summary.summary`. Further entries of a skin that are told where they are there:
    dofs, solver, accuracy_wanted_relative; p0_band_low and _high (factors on its motion) with
    peak_displacement_low_m and _high_m; displacement_error_relative with mesh_, step_, reduction_ and
    edge_error_relative, or displacement_error_missing (a reason); of modes reduction_velocity_error_relative;
    main_frequency_Hz and level_OBSERVER_dB_SL, with level_OBSERVER_why, _spread_dB and _spread_of, and
    level_area_OBSERVER_dB_SL with level_area_OBSERVER_m2. Of a stimulus: drive_level. Of an
    array: p0_Pa_m, p0_low_Pa_m, p0_high_Pa_m, p0_kind, calibrated. Of the run: wall_time_s, peak_memory_MiB.
    """
    skins, stimuli = summary["skins"], summary["stimuli"]
    drives = [
        ("drive" if len(stimuli) == 1 else f"drive, {one['name']}", of_full(one["drive_level"]))
        for one in stimuli
        if "drive_level" in one
    ] + array_rows(summary["arrays"])
    level = max((one.get("drive_level", 0.0) for one in stimuli), default=0.0)
    grid = Table(*folded(("", "")), show_header=False)
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
    Console(file=stream, width=columns(WIDTH)).print(grid)
    return stream.getvalue()


def _sound(skin: Mapping[str, Any], drive_level: float) -> list[Row]:
    """drive_level: highest of all stimuli, relative to full"""
    rows: list[Row] = []
    band = sound_band(skin)
    if "peak_pressure_Pa" in skin and skin["peak_pressure_dB_SPL"] is not None:
        spl = f"{skin['peak_pressure_dB_SPL']:.{0 if band > COARSE else 1}f} dB SPL"
        rows.append(("peak sound pressure", f"{figures(skin['peak_pressure_Pa'], band / 2.0)} Pa ({spl})"))
    elif "peak_pressure_Pa" in skin:
        runs = f"no sound pushes this skin, though the array runs, at {of_full(drive_level)}: see plan"
        rows.append(("peak sound pressure", runs if drive_level > 0.0 else "0 Pa (silence: the array doesn't run)"))
    if "peak_arp_Pa" in skin:
        rows.append(("peak ARP", f"{figures(skin['peak_arp_Pa'], band)} Pa"))
    if "total_force_peak_N" in skin:
        rows.append(("total force", f"{figures(1e3 * skin['total_force_peak_N'], band)} mN"))
    return rows


def unknown_or(band: float, skin: Mapping[str, Any]) -> float:
    """A band, or inf of a skin without an error budget, where it isn't all that is known."""
    return band if "error_budget" in skin else math.inf


def sound_band(skin: Mapping[str, Any]) -> float:
    """Widest band of what is known of a skin's ARP, relative: of p0, and of what is left out of the sound."""
    return unknown_or(max(level_band(skin), widest(skin.get("error_budget"), "left_out")), skin)


def response_band(skin: Mapping[str, Any]) -> float:
    """Widest band of what is known of a skin's motion per pascal of ARP, relative: of all but p0."""
    budget, error = skin.get("error_budget"), skin.get("displacement_error_relative", 0.0)
    return unknown_or(max(error, widest(budget, "left_out"), widest(budget, "inputs", ("p0",))), skin)


def of_full(level: float) -> str:
    """A drive relative to full, in words."""
    return f"{level:.3f} of full" if level == 0.0 or level >= 1e-3 else f"{level:.2g} of full"


def level_band(skin: Mapping[str, Any]) -> float:
    """How far p0 leaves a skin's ARP and motion open, relative: half of the range; 0 where the scene sets the level."""
    if "p0_band_low" not in skin:
        return 0.0
    return float(skin["p0_band_high"] - skin["p0_band_low"]) / 2.0


def array_rows(arrays: Sequence[Mapping[str, Any]]) -> list[Row]:
    """What is known of how loud the arrays' transducers are: one row for each number that they have."""
    rows: dict[str, list[str]] = {}
    for array in arrays:
        if "p0_Pa_m" in array:
            low, high = array["p0_low_Pa_m"], array["p0_high_Pa_m"]
            known = f"{array['p0_kind']}, {array['p0_Pa_m']:g} Pa m ({low:g} to {high:g})"
            text = f"calibrated: {known}" if array["calibrated"] else f"uncalibrated: {known}"
            rows.setdefault(text, []).append(array["name"])
    return [("p0" if len(rows) == 1 else f"p0, {', '.join(names)}", text) for text, names in rows.items()]


def _motion(skin: Mapping[str, Any]) -> list[Row]:
    error = skin.get("displacement_error_relative")
    numerical = "" if error is None else f" (numerical {figures(100 * error, 1.0)} %)"
    response = response_band(skin)
    band = max(level_band(skin), response)
    rows: list[Row] = []
    if "solver" in skin:
        unknowns = f"{skin['dofs']} unknowns, " if "dofs" in skin else ""
        rows.append(("skin", f"{unknowns}solver {skin['solver']}"))
    if "displacement_per_arp_m_Pa" in skin:
        per_pascal = figures(1e6 * skin["displacement_per_arp_m_Pa"], response)
        rows.append(("peak skin displacement per ARP", f"{per_pascal} um/Pa{numerical}"))
    if "peak_displacement_m" in skin:
        load = f" for {figures(skin['peak_arp_Pa'], sound_band(skin))} Pa" if "peak_arp_Pa" in skin else ""
        peak = figures(1e6 * skin["peak_displacement_m"], band)
        grazed = skin.get("peak_arp_Pa", 1.0) == 0.0 < skin["peak_displacement_m"]
        note = "; of sound that only grazes it: no estimate stands behind it" if grazed else ""
        rows.append(("peak skin displacement", f"{peak} um{load}{numerical}{_for_p0(skin)}{note}"))
        without = f"({figures(1e6 * skin['rms_displacement_without_dc_m'], band)} um without the mean)"
        rows.append(("rms skin displacement", f"{figures(1e6 * skin['rms_displacement_m'], band)} um {without}"))
    if error is not None:
        rows += budget_rows(skin)
        requested = skin.get("accuracy_wanted_relative")
        if requested is not None and error > requested:
            rows.append(("accuracy", f"NOT reached: {100 * requested:g} % wanted; {advice(skin)}"))
    if "displacement_error_missing" in skin:
        rows.append(("error estimate", f"none: {skin['displacement_error_missing']}"))
    return rows + _levels(skin)


def _levels(skin: Mapping[str, Any]) -> list[Row]:
    """A row for each observer: its level with its own spread, and why it applies or is refused."""
    rows = []
    for number, name in enumerate(ALL_OBSERVERS, start=1):
        if f"level_{name}_dB_SL" not in skin:
            continue
        level, why = skin[f"level_{name}_dB_SL"], skin.get(f"level_{name}_why", "")
        told = [why.partition(": ")[2]] if why else []
        if level is None:
            felt = "refused" if why.startswith("refused") else "none"
        else:
            felt = _level(skin, level)
            told += _spread(skin, name)
        text = f"{felt}, observer {number} ({name}{': ' if told else ''}{'; '.join(told)})"
        rows.append((f"level at {skin['main_frequency_Hz']:g} Hz", text))
        summed = skin.get(f"level_area_{name}_dB_SL")
        if summed is not None:
            area = f"{1e4 * skin[f'level_area_{name}_m2']:.2g} cm2 that move by half of the most or more"
            rows.append(("with area summation", f"{_level(skin, summed)}, observer {number}, over the {area}"))
    return rows


def _spread(skin: Mapping[str, Any], name: str) -> list[str]:
    """An observer's own spread in words; nothing where none is told."""
    spread, half = (skin.get(f"level_{name}_spread_{key}") for key in ("of", "dB"))
    if spread is None:
        return []
    return [f"spread {spread}" if half is None else f"spread +-{half:g} dB, {spread}"]


def _level(skin: Mapping[str, Any], level: float) -> str:
    """A felt level, and its range over that of p0."""
    if not level_band(skin):
        return f"{level:.1f} dB SL"
    low, high = (level + 20.0 * math.log10(skin[f"p0_band_{end}"]) for end in ("low", "high"))
    return f"{level:.0f} dB SL ({low:.0f} to {high:.0f} for the range of p0)"


def _for_p0(skin: Mapping[str, Any]) -> str:
    """The range of a skin's motion over that of p0, in words; nothing where p0 doesn't set the level."""
    if "peak_displacement_low_m" not in skin:
        return ""
    low, high = (figures(1e6 * skin[f"peak_displacement_{end}_m"], 1.0) for end in ("low", "high"))
    return f"; for the range of p0 {low} to {high} um"


def advice(skin: Mapping[str, Any]) -> str:
    """What would lower the largest part of a skin's error."""
    parts = {
        "a smaller --accuracy makes the mesh finer": skin["mesh_error_relative"],
        "a smaller --accuracy or step_s shortens the step": skin["step_error_relative"],
        "solver wedges leaves out the reduction": skin["reduction_error_relative"],
        "the layer's cut sides matter here: compare side fixed and free, or patch_radius_m": skin[
            "edge_error_relative"
        ],
        "precision accurate of palmfield.array computes the field in double precision": skin.get(
            "field_error_relative", 0.0
        ),
    }
    return max(parts, key=lambda text: parts[text])
