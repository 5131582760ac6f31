"""Format the short table that `palmfield run` prints at its end."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from palmfield.outputs.budget_text import (
    COARSE,
    TextRow,
    budget_rows,
    combined,
    figures,
    input_parts,
    largest_omitted,
    of_full,
    parts_text,
    widest,
)
from palmfield.outputs.verdict import RULE, band_text, chosen_observer, first_line, level_text, shown_level, top_line
from palmfield.perception.registry import READ_FIRST
from palmfield.terminal import printed, table

WIDTH = 110
"""Width of the table in columns, unless the terminal is narrower."""


def format_summary(summary: Mapping[str, Any], details: bool = False) -> str:
    """Return the verdict of a run in one line, and a table of its numbers.

    summary: as returned by `palmfield.outputs.summary.summary`, with the additions of `palmfield.estimate.summary` if
    any
    details: whether to add drive, p0, solver, all observers and all parts of the error. Else the table has 14 lines
    for one skin: pressure, ARP, force, displacement, one level, error and time.
    """
    skins = summary["skins"]
    level = max((one.get("drive_level", 0.0) for one in summary["stimuli"]), default=0.0)
    drives = []
    if details:
        one_alone, stimuli = len(summary["stimuli"]) == 1, [one for one in summary["stimuli"] if "drive_level" in one]
        drives = [("drive" if one_alone else f"drive, {one['name']}", of_full(one["drive_level"])) for one in stimuli]
        drives += array_rows(summary["arrays"])
    grid = table(())
    for number, skin in enumerate(skins):
        sound, motion = _sound(skin, level), _motion(skin) if details else _short(skin)
        # With one skin the order is sound, drive, motion
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
    return f"{first_line(summary)}\n{printed(grid, most=WIDTH)}"


def _short(skin: Mapping[str, Any]) -> list[TextRow]:
    """Return the motion of a skin in the main table: displacement with its band, one level, and the error."""
    rows: list[TextRow] = []
    if "peak_displacement_m" in skin:
        rows.append(("peak skin displacement", _peak(skin)))
    if (name := chosen_observer(skin)) is not None:
        level, lines = shown_level(skin, name)
        assert level is not None
        band = band_text(skin, name)
        parts = f"band: {band}; " if band else ""
        rows.append(("level above threshold", f"{level_text(skin, name, level)}, {lines}, {name}; {parts}{RULE}"))
    error = skin.get("displacement_error_relative")
    if error is not None:
        missed = f"target accuracy of {100 * skin['accuracy_wanted_relative']:g} % NOT reached: {advice(skin)}"
        reached = f"; {missed}" if skin.get("accuracy_reached") is False else ""
        budget = skin.get("error_budget")
        omitted, kind = largest_omitted(budget), f" ({budget['estimate']} estimate)" if budget else ""
        velocity = skin.get("velocity_error_relative")
        fast = "" if velocity is None else f", of the velocity {figures(100 * velocity, 1.0)} %"
        rows.append(("error", f"numerical {figures(100 * error, 1.0)} %{fast}{kind}{reached}{omitted}"))
    return rows + _no_estimate(skin) + _driven(skin)


def _driven(skin: Mapping[str, Any]) -> list[TextRow]:
    """Return the row of the motion driven by the body, if key inertia is on."""
    if "motion_peak_displacement_m" not in skin:
        return []
    peak, rms, normal = (1e6 * skin[f"motion_{kind}displacement_m"] for kind in ("peak_", "rms_", "peak_normal_"))
    text = f"peak {peak:.3g} um, rms {rms:.3g} um, normal peak {normal:.3g} um; not in the other rows"
    if (edge := skin.get("motion_edge_error_relative")) is not None:
        numerical = math.hypot(edge, skin["motion_reduction_error_relative"])
        text += f"; cut sides and reduction {figures(100 * numerical, 1.0)} %, mesh not estimated"
    return [("by the body's acceleration", text)]


def _no_estimate(skin: Mapping[str, Any]) -> list[TextRow]:
    missing = skin.get("displacement_error_missing")
    return [] if missing is None else [("error estimate", f"none: {missing}")]


def _peak(skin: Mapping[str, Any]) -> str:
    """Describe the peak displacement with its band, over all inputs with a known range, and the parts of the band."""
    parts = input_parts(skin)
    (low, high), peak = combined(parts), 1e6 * skin["peak_displacement_m"]
    band = max((high - low) / 2.0, response_band(skin))
    text = f"{figures(peak, band)} um"
    if parts:
        text += f" ({figures(peak * low, 1.0)} to {figures(peak * high, 1.0)} um for {parts_text(parts)})"
    grazed = skin.get("peak_arp_Pa", 1.0) == 0.0 < skin["peak_displacement_m"]
    return text + ("; the sound only grazes the skin, for which there is no error estimate" if grazed else "")


def _sound(skin: Mapping[str, Any], drive_level: float) -> list[TextRow]:
    """drive_level: highest level of all stimuli relative to full drive"""
    rows: list[TextRow] = []
    band = sound_band(skin)
    if "peak_pressure_Pa" in skin and skin["peak_pressure_dB_SPL"] is not None:
        spl = f"{skin['peak_pressure_dB_SPL']:.{0 if band > COARSE else 1}f} dB SPL"
        rows.append(("peak sound pressure", f"{figures(skin['peak_pressure_Pa'], band / 2.0)} Pa ({spl})"))
    elif "peak_pressure_Pa" in skin:
        runs = f"no sound acts on this skin, although the array is on, at {of_full(drive_level)}: see the plan"
        rows.append(("peak sound pressure", runs if drive_level > 0.0 else "0 Pa (silence: the array is off)"))
    if "peak_arp_Pa" in skin:
        rows.append(("peak ARP", f"{figures(skin['peak_arp_Pa'], band)} Pa"))
    if "total_force_peak_N" in skin:
        rows.append(("total force", f"{figures(1e3 * skin['total_force_peak_N'], band)} mN"))
    return rows


def unknown_or(band: float, skin: Mapping[str, Any]) -> float:
    """Return a band.

    For a skin without an error budget the band is inf, because its other uncertainties are unknown.
    """
    return band if "error_budget" in skin else math.inf


def sound_band(skin: Mapping[str, Any]) -> float:
    """Return the largest relative band of the ARP on a skin, due to p0 and to ignored effects on the sound."""
    return unknown_or(max(level_band(skin), widest(skin.get("error_budget"))), skin)


def response_band(skin: Mapping[str, Any]) -> float:
    """Return the largest relative band of the motion of a skin per ARP, due to all inputs except p0."""
    low, high = combined(input_parts(skin, ("p0",)))
    error = skin.get("displacement_error_relative", 0.0)
    return unknown_or(max(error, widest(skin.get("error_budget")), (high - low) / 2.0), skin)


def level_band(skin: Mapping[str, Any]) -> float:
    """Return the relative uncertainty of ARP and motion due to p0.

    It is half of the range of p0, or 0 if the scene sets the level.
    """
    if "p0_band_low" not in skin:
        return 0.0
    return float(skin["p0_band_high"] - skin["p0_band_low"]) / 2.0


def array_rows(arrays: Sequence[Mapping[str, Any]]) -> list[TextRow]:
    """Return one row for each different p0 of the arrays."""
    rows: dict[str, list[str]] = {}
    for array in arrays:
        if "p0_Pa_m" in array:
            low, high = array["p0_low_Pa_m"], array["p0_high_Pa_m"]
            described = f"{array['p0_kind']}, {array['p0_Pa_m']:g} Pa m ({low:g} to {high:g})"
            text = f"calibrated: {described}" if array["calibrated"] else f"uncalibrated: {described}"
            rows.setdefault(text, []).append(array["name"])
    return [("p0" if len(rows) == 1 else f"p0, {', '.join(names)}", text) for text, names in rows.items()]


def _motion(skin: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows of the motion of a skin with all details."""
    error = skin.get("displacement_error_relative")
    numerical = "" if error is None else f" (numerical {figures(100 * error, 1.0)} %)"
    response = response_band(skin)
    band = max(level_band(skin), response)
    rows: list[TextRow] = []
    if "solver" in skin:
        unknowns = f"{skin['dofs']} unknowns, " if "dofs" in skin else ""
        rows.append(("skin", f"{unknowns}solver {skin['solver']}"))
    if "displacement_per_arp_m_Pa" in skin:
        parts, per_pascal = input_parts(skin, ("p0",)), 1e6 * skin["displacement_per_arp_m_Pa"]
        ends = [figures(per_pascal * factor, 1.0) for factor in combined(parts)]
        of = f" ({ends[0]} to {ends[1]} for {parts_text(parts)})" if parts else ""
        rows.append(("peak skin displacement per ARP", f"{figures(per_pascal, response)} um/Pa{of}{numerical}"))
    if "peak_displacement_m" in skin:
        rows.append(("peak skin displacement", f"{_peak(skin)}{numerical}"))
        (low, high), parts = combined(input_parts(skin)), input_parts(skin)
        rms = [f"{figures(1e6 * skin[f'rms_displacement{key}_m'], band)} um" for key in ("", "_without_dc")]
        of = f"; band x {low:.2g} to {high:.2g}" if parts else ""
        rows.append(("rms skin displacement", f"{rms[0]} ({rms[1]} about the mean{of})"))
    if error is not None:
        rows += budget_rows(skin)
        if skin.get("accuracy_reached") is False:
            requested = skin["accuracy_wanted_relative"]
            rows.append(("accuracy", f"NOT reached: target {100 * requested:g} %; {advice(skin)}"))
    return rows + _no_estimate(skin) + _driven(skin) + _levels(skin)


def _levels(skin: Mapping[str, Any]) -> list[TextRow]:
    """Return a row for each observer: level with band, frequency lines, and why the observer applies or is refused."""
    rows = []
    present = [name for name in READ_FIRST if f"level_{name}_dB_SL" in skin]
    for number, name in enumerate(present, start=1):
        (level, lines), why = shown_level(skin, name), skin.get(f"level_{name}_why", "")
        details = [why.partition(": ")[2]] if why else []
        if level is None:
            value = "refused" if why.startswith("refused") else "none"
        else:
            value = level_text(skin, name, level)
            details += [text for text in (top_line(skin, name), band_text(skin, name)) if text]
            details += _spread(skin, name)
        text = f"{value}, observer {number} ({name}{': ' if details else ''}{'; '.join(details)})"
        rows.append((f"level, {lines}" if lines else "level", text))
        summed = skin.get(f"level_area_{name}_dB_SL")
        if summed is not None:
            area = f"{1e4 * skin[f'level_area_{name}_m2']:.2g} cm2 that move by half of the maximum or more"
            text = f"{level_text(skin, name, summed)}, observer {number}, {lines}, over the {area}"
            rows.append(("with area summation", text))
    return rows


def _spread(skin: Mapping[str, Any], name: str) -> list[str]:
    """Describe the spread of an observer and the source of this value; empty if no spread is known."""
    spread, half = (skin.get(f"level_{name}_spread_{key}") for key in ("of", "dB"))
    if spread is None:
        return []
    return [f"spread {spread}" if half is None else f"spread +-{half:g} dB, {spread}"]


def advice(skin: Mapping[str, Any]) -> str:
    """Return advice that would reduce the largest part of the error of a skin."""
    parts = {
        "a smaller --accuracy makes the mesh finer": skin["mesh_error_relative"],
        "a smaller --accuracy or step_s shortens the step": skin["step_error_relative"],
        "solver wedges avoids the reduction error": skin["reduction_error_relative"],
        "the cut sides of the layer affect the result: compare side fixed and free, or increase patch_radius_m": skin[
            "edge_error_relative"
        ],
        "precision accurate of palmfield.array computes the field in double precision": skin.get(
            "field_error_relative", 0.0
        ),
    }
    return max(parts, key=lambda text: parts[text])
